//! Places of connections that have not said whose they are, decided without a socket or a clock.
//!
//! Such connections have few places, and a new one takes the place of the oldest. A client that opens many connections and
//! says nothing only pushes out its own, and cannot keep others from being served. Servers of the API, of agents and of a ROS
//! master use it.
#![forbid(unsafe_code)]
#![warn(missing_docs)]

use std::{
    collections::{BTreeMap, BTreeSet},
    net::{IpAddr, Ipv6Addr},
};

/// Most addresses that are [known](Strangers::know).
const MOST_KNOWN: usize = 1024;

/// The connections that have not said whose they are, each with a handle of its owner.
#[derive(Debug)]
pub struct Strangers<H> {
    most: usize,
    last: u64,
    /// By number, i.e. the oldest first.
    waiting: BTreeMap<u64, Stranger<H>>,
    known: BTreeSet<IpAddr>,
}

#[derive(Debug)]
struct Stranger<H> {
    from: IpAddr,
    handle: H,
}

/// A place that a new connection took.
#[derive(Debug, PartialEq, Eq)]
pub struct Place<H> {
    /// Number of the new connection.
    pub number: u64,
    /// The connection to close, because it gave up its place.
    pub replaced: Option<H>,
}

impl<H> Strangers<H> {
    /// Creates so many places. At most half of them are of one address.
    pub fn new(most: usize) -> Self {
        Self { most, last: 0, waiting: BTreeMap::new(), known: BTreeSet::new() }
    }

    /// Adds a new connection. If its address has half of all places, it replaces the oldest of this address. If all are taken,
    /// it replaces the oldest of an address that is not [known](Self::know), or else the oldest.
    pub fn arrive(&mut self, from: IpAddr, handle: H) -> Place<H> {
        let from = network(from);
        let neighbours = || self.waiting.iter().filter(|(_, stranger)| stranger.from == from);
        let replaced = if neighbours().count() >= (self.most / 2).max(1) {
            neighbours().next()
        } else if self.waiting.len() >= self.most {
            let unknown = self.waiting.iter().find(|(_, stranger)| !self.known.contains(&stranger.from));
            unknown.or_else(|| self.waiting.first_key_value())
        } else {
            None
        };
        let replaced = replaced.map(|(number, _)| *number).and_then(|number| self.leave(number));
        self.last += 1;
        self.waiting.insert(self.last, Stranger { from, handle });
        Place { number: self.last, replaced }
    }

    /// Prefers connections from an address, from which one said whose it is.
    pub fn know(&mut self, from: IpAddr) {
        if self.known.len() < MOST_KNOWN {
            self.known.insert(network(from));
        }
    }

    /// Removes a connection that ended, or that has said whose it is.
    pub fn leave(&mut self, number: u64) -> Option<H> {
        self.waiting.remove(&number).map(|stranger| stranger.handle)
    }

    /// Removes the oldest connection, because the process has no file left.
    pub fn shed(&mut self) -> Option<H> {
        self.waiting.pop_first().map(|(_, stranger)| stranger.handle)
    }
}

/// Returns what counts as one address: for IPv6 the network of 64 bits, in which a machine can choose any address.
pub fn network(address: IpAddr) -> IpAddr {
    match address.to_canonical() {
        IpAddr::V6(v6) if !v6.is_loopback() => {
            IpAddr::V6(Ipv6Addr::from_bits(v6.to_bits() & !u128::from(u64::MAX)))
        }
        other => other,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn arrive(strangers: &mut Strangers<u32>, from: &str, handle: u32) -> Option<u32> {
        strangers.arrive(from.parse().unwrap(), handle).replaced
    }

    fn handles(strangers: &Strangers<u32>) -> Vec<u32> {
        strangers.waiting.values().map(|stranger| stranger.handle).collect()
    }

    #[test]
    fn a_new_connection_takes_the_place_of_the_oldest_of_its_address() {
        let mut strangers = Strangers::new(8);
        assert_eq!(arrive(&mut strangers, "10.0.0.9", 9), None);
        let replaced: Vec<_> = (100..1100).filter_map(|i| arrive(&mut strangers, "10.0.0.1", i)).collect();
        assert_eq!(replaced, (100..1096).collect::<Vec<_>>());
        assert_eq!(handles(&strangers), [9, 1096, 1097, 1098, 1099]);
        for i in 0..1000 {
            arrive(&mut strangers, &format!("10.1.{}.{}", i / 256, i % 256), i);
        }
        assert_eq!(handles(&strangers), (992..1000).collect::<Vec<_>>());
    }

    #[test]
    fn known_addresses_keep_their_places_before_others() {
        let mut strangers = Strangers::new(4);
        strangers.know("10.0.0.9".parse().unwrap());
        arrive(&mut strangers, "10.0.0.9", 9);
        for i in 0..100 {
            arrive(&mut strangers, &format!("10.1.0.{i}"), 100 + i);
        }
        assert_eq!(handles(&strangers), [9, 197, 198, 199]);
        // If all are known, the oldest goes.
        for i in 0..4 {
            let address = format!("10.2.0.{i}");
            strangers.know(address.parse().unwrap());
            arrive(&mut strangers, &address, i);
        }
        assert_eq!(handles(&strangers), [0, 1, 2, 3]);
    }

    #[test]
    fn addresses_of_one_ipv6_network_count_as_one() {
        let mut strangers = Strangers::new(8);
        for i in 0..100 {
            arrive(&mut strangers, &format!("2001:db8::{i:x}"), i);
        }
        assert_eq!(handles(&strangers), [96, 97, 98, 99]);
        assert_eq!(network("::ffff:10.0.0.1".parse().unwrap()), IpAddr::from([10, 0, 0, 1]));
    }

    #[test]
    fn those_that_leave_make_room() {
        let mut strangers = Strangers::new(2);
        let place = strangers.arrive("10.0.0.1".parse().unwrap(), 1);
        assert_eq!((strangers.leave(place.number), strangers.leave(place.number)), (Some(1), None));
        assert_eq!(arrive(&mut strangers, "10.0.0.1", 2), None);
        assert_eq!(arrive(&mut strangers, "10.0.0.1", 3), Some(2));
        assert_eq!((strangers.shed(), strangers.shed()), (Some(3), None));
    }
}
