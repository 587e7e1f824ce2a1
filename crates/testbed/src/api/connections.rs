//! Admission of the API's connections, decided without a socket or a clock.
//!
//! A connection is a stranger's until a request on it is admitted. [`Strangers`] have few places. Admitted callers have
//! separate places. Only idle connections among them give up their place.

use std::{collections::BTreeMap, net::IpAddr};

use cotorra_admission::Strangers;
use cotorra_graph::{DomainId, PluginId};

/// Maximum numbers of connections.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Limits {
    /// Connections of strangers. At most half of them are from one address.
    pub(super) strangers: usize,
    /// Connections of the operator, and as many of all domains and plug-ins together. At most half of them are streams.
    pub(super) callers: usize,
}

impl Limits {
    /// Returns limits that leave most of the process's open files to the core. Strangers, the operator, and domains with
    /// plug-ins have an eighth each, up to a useful maximum.
    pub(super) fn of(open_files: u64) -> Self {
        let share = usize::try_from(open_files / 8).unwrap_or(usize::MAX);
        Self { strangers: share.clamp(16, 256), callers: share.clamp(16, 1024) }
    }

    /// Returns the limits of the socket for the run's own user. Its places are separate, so that strangers on the port take
    /// none.
    pub(super) fn of_user(self) -> Self {
        Self { strangers: self.strangers / 4, callers: self.callers / 4 }
    }

    fn of_another(self) -> usize {
        self.callers / 4
    }
}

/// Owner of a connection.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Whose {
    Operator,
    Domain(DomainId),
    /// A plug-in that the run started.
    Plugin(PluginId),
}

/// All places of a caller are in use by requests that are being answered.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("{limit} {what} are open, which is the most that this API serves you: close one and ask again")]
pub(super) struct Full {
    limit: usize,
    what: &'static str,
}

/// The open connections. Each has a handle that closes it when it is dropped.
#[derive(Debug)]
pub(super) struct Connections<H> {
    limits: Limits,
    /// Grows with each connection that becomes idle.
    last: u64,
    strangers: Strangers<H>,
    callers: BTreeMap<u64, Caller<H>>,
}

#[derive(Debug)]
struct Caller<H> {
    whose: Whose,
    doing: Doing,
    _handle: H,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Doing {
    Nothing {
        /// Grows with time.
        since: u64,
    },
    Answer,
    Stream,
}

impl<H> Connections<H> {
    pub(super) fn new(limits: Limits) -> Self {
        Self { limits, last: 0, strangers: Strangers::new(limits.strangers), callers: BTreeMap::new() }
    }

    pub(super) fn limits(&self) -> Limits {
        self.limits
    }

    /// Adds a new connection, and returns its number.
    pub(super) fn arrive(&mut self, from: IpAddr, handle: H) -> u64 {
        self.strangers.arrive(from, handle).number
    }

    /// Admits a request on a connection.
    pub(super) fn let_in(&mut self, number: u64, whose: Whose) -> Result<(), Full> {
        let Limits { callers, .. } = self.limits;
        let what = "connections";
        let is_operator = whose == Whose::Operator;
        if !is_operator {
            let limit = self.limits.of_another();
            self.make_room(number, limit, |other| other.whose == whose).map_err(|()| Full { limit, what })?;
        }
        self.make_room(number, callers, |other| (other.whose == Whose::Operator) == is_operator)
            .map_err(|()| Full { limit: callers, what })?;
        if let Some(handle) = self.strangers.leave(number) {
            let caller = Caller { whose, doing: Doing::Answer, _handle: handle };
            self.callers.insert(number, caller);
        } else if let Some(caller) = self.callers.get_mut(&number) {
            (caller.whose, caller.doing) = (whose, Doing::Answer);
        }
        Ok(())
    }

    /// Closes the connection that was idle for longest, if the number of those selected by `of` has reached the limit.
    fn make_room(&mut self, number: u64, limit: usize, of: impl Fn(&Caller<H>) -> bool) -> Result<(), ()> {
        let others = || self.callers.iter().filter(|(other, caller)| **other != number && of(caller));
        if others().count() < limit {
            return Ok(());
        }
        let idle = others().filter_map(|(other, caller)| match caller.doing {
            Doing::Nothing { since } => Some((since, *other)),
            _ => None,
        });
        let (_, longest) = idle.min().ok_or(())?;
        self.callers.remove(&longest);
        Ok(())
    }

    /// Marks a connection as answered by a stream, which does not end by itself.
    pub(super) fn stream(&mut self, number: u64) -> Result<(), Full> {
        let Some(whose) = self.callers.get(&number).map(|caller| caller.whose.clone()) else {
            return Ok(());
        };
        let limit = if whose == Whose::Operator { self.limits.callers } else { self.limits.of_another() } / 2;
        let streams = |caller: &&Caller<H>| caller.whose == whose && caller.doing == Doing::Stream;
        if self.callers.values().filter(streams).count() >= limit {
            return Err(Full { limit, what: "streams" });
        }
        self.callers.entry(number).and_modify(|caller| caller.doing = Doing::Stream);
        Ok(())
    }

    /// Marks a connection as idle.
    pub(super) fn rest(&mut self, number: u64) {
        self.last += 1;
        let since = self.last;
        self.callers.entry(number).and_modify(|caller| caller.doing = Doing::Nothing { since });
    }

    /// Removes a closed connection.
    pub(super) fn leave(&mut self, number: u64) {
        self.strangers.leave(number);
        self.callers.remove(&number);
    }

    /// Whether a request on the connection was admitted.
    pub(super) fn is_let_in(&self, number: u64) -> bool {
        self.callers.contains_key(&number)
    }

    /// Closes a stranger's connection, because the process has no file left.
    pub(super) fn shed(&mut self) {
        self.strangers.shed();
    }
}

#[cfg(test)]
mod tests {
    use std::rc::{Rc, Weak};

    use super::*;

    const LIMITS: Limits = Limits { strangers: 8, callers: 8 };

    /// Connections whose handles show whether they were closed.
    struct Rig {
        connections: Connections<Rc<()>>,
    }

    impl Rig {
        fn new() -> Self {
            Self { connections: Connections::new(LIMITS) }
        }

        fn arrive(&mut self, from: &str) -> (u64, Weak<()>) {
            let handle = Rc::new(());
            let is_open = Rc::downgrade(&handle);
            (self.connections.arrive(from.parse().unwrap(), handle), is_open)
        }

        /// Adds a connection that is being answered.
        fn caller(&mut self, domain: Option<&str>) -> Result<(u64, Weak<()>), Full> {
            let (number, is_open) = self.arrive("127.0.0.1");
            let whose = domain.map_or(Whose::Operator, |name| Whose::Domain(DomainId::new(name).unwrap()));
            self.connections.let_in(number, whose)?;
            Ok((number, is_open))
        }
    }

    fn open(connections: &[(u64, Weak<()>)]) -> Vec<bool> {
        connections.iter().map(|(_, is_open)| is_open.strong_count() > 0).collect()
    }

    #[test]
    fn a_stranger_takes_the_place_of_the_oldest_of_its_address() {
        let mut rig = Rig::new();
        let neighbour = rig.arrive("10.0.0.9");
        let flood: Vec<_> = (0..1000).map(|_| rig.arrive("10.0.0.1")).collect();
        assert_eq!(open(&[neighbour]), [true], "a flood pushes out its own");
        assert_eq!(open(&flood[996..]), [true; 4]);
        assert!(open(&flood[..996]).iter().all(|open| !open));
        let flood: Vec<_> = (0..1000).map(|i| rig.arrive(&format!("10.1.{}.{}", i / 256, i % 256))).collect();
        assert_eq!(open(&flood).iter().filter(|open| **open).count(), LIMITS.strangers);
    }

    #[test]
    fn strangers_push_out_no_admitted_connection() {
        let mut rig = Rig::new();
        let answered = rig.caller(None).unwrap();
        let idle = rig.caller(None).unwrap();
        rig.connections.rest(idle.0);
        (0..1000).for_each(|_| drop(rig.arrive("127.0.0.1")));
        assert_eq!(open(&[answered, idle]), [true, true]);
    }

    #[test]
    fn an_admitted_connection_replaces_the_longest_idle_and_no_active_one() {
        let mut rig = Rig::new();
        let callers: Vec<_> = (0..8).map(|_| rig.caller(None).unwrap()).collect();
        let full = rig.caller(None).unwrap_err();
        assert_eq!(full, Full { limit: 8, what: "connections" });
        for at in [5, 3] {
            rig.connections.rest(callers[at].0);
        }
        let next = rig.caller(None).unwrap();
        let expected = [true, true, true, true, true, false, true, true];
        assert_eq!(open(&callers), expected, "5 was idle before 3");
        assert_eq!(open(&[next]), [true]);
        // A second request on an open connection needs no second place.
        rig.connections.let_in(callers[3].0, Whose::Operator).unwrap();
        assert_eq!(open(&callers), expected);
    }

    #[test]
    fn a_domain_takes_no_places_of_another_or_of_the_operator() {
        let mut rig = Rig::new();
        for domain in ["one", "two"] {
            for _ in 0..2 {
                rig.caller(Some(domain)).unwrap();
            }
            assert_eq!(rig.caller(Some(domain)).unwrap_err().limit, 2);
        }
        for _ in 0..8 {
            rig.caller(None).unwrap();
        }
    }

    #[test]
    fn streams_leave_room_for_requests() {
        let mut rig = Rig::new();
        for _ in 0..4 {
            let (number, _) = rig.caller(None).unwrap();
            rig.connections.stream(number).unwrap();
        }
        let (number, _) = rig.caller(None).unwrap();
        assert_eq!(rig.connections.stream(number).unwrap_err(), Full { limit: 4, what: "streams" });
        rig.connections.rest(number);
        for _ in 0..4 {
            rig.caller(None).unwrap();
        }
    }

    #[test]
    fn most_files_are_left_to_the_core() {
        for files in [256, 1024, 20_000, u64::MAX] {
            let Limits { strangers, callers } = Limits::of(files);
            assert!((strangers + 2 * callers) as u64 <= files / 2, "{files}: {strangers}, {callers}");
        }
    }
}
