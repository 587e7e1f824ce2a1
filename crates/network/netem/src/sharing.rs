//! The rate of one interface, shared by several parties: HTB with a class for each of them and one for all other frames, and a
//! NetEm in each class. Without shares there is only a NetEm.
//!
//! HTB sends what its classes may send, and NetEm in a class delays, loses and queues. The interface is nobody else's.

use cotorra_graph::BitRate;

use crate::{
    device::{Interface, Plan},
    filter::{Filter, Packets, Verdict},
    handle::Handle,
    netem::Netem,
    request::{Discipline, Object, Request, Shape, Verb},
};

/// A party: the frames from one address to another, and what they get of the rate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Share {
    /// MAC address that the frames come from.
    pub from: [u8; 6],
    /// MAC address that they go to.
    pub to: [u8; 6],
    /// Their assured rate (`rate` in HTB), of frames without FCS.
    pub rate: BitRate,
    /// Whether that is also the most (`ceil`). Otherwise they may borrow all of the interface's rate.
    pub is_limited: bool,
}

impl Share {
    fn key(&self) -> ([u8; 6], [u8; 6]) {
        (self.from, self.to)
    }
}

/// The conditions of an interface, and its shares.
#[derive(Debug, Clone, PartialEq)]
pub struct Sharing {
    netem: Netem,
    /// Shares, with the numbers of their classes.
    shares: Vec<(u16, Share)>,
}

/// The class of the interface's rate, and that of all other frames.
const WHOLE: u16 = 1;
const REST: u16 = 2;
const FIRST: u16 = 3;

/// Bytes of a full frame.
const FULL_FRAME: u64 = 1514;
/// Least tokens of a class, bytes: the default of `tc`.
const BURST: u64 = 1600;
/// Most bytes of a class's turn (`htb_change_class`).
const LARGEST_QUANTUM: u64 = 200_000;
/// HTB takes no class without a rate. The least that all other frames have, bit/s.
const LEAST: u64 = 8_000;

impl Sharing {
    /// Creates the conditions of an interface without shares.
    pub fn new(netem: Netem) -> Self {
        Self { netem, shares: Vec::new() }
    }

    /// Returns other conditions with the same shares.
    #[must_use]
    pub fn with_netem(&self, netem: Netem) -> Self {
        Self { netem, shares: self.shares.clone() }
    }

    /// Returns the same conditions with other shares. Parties that stay keep their classes.
    #[must_use]
    pub fn with_shares(&self, shares: &[Share]) -> Self {
        let mut after = Self::new(self.netem.clone());
        for share in shares {
            let kept = self.shares.iter().find(|(_, other)| other.key() == share.key());
            let is_free = |number: &u16| self.shares.iter().chain(&after.shares).all(|(n, _)| n != number);
            let number = kept.map(|(number, _)| *number).or_else(|| (FIRST..).find(is_free));
            after.shares.push((number.expect("a link has fewer mappings"), *share));
        }
        after
    }

    /// Whether there are shares.
    pub fn is_shared(&self) -> bool {
        !self.shares.is_empty()
    }

    /// Plans the conditions and shares of an interface that has none.
    pub fn set_up(&self, interface: &Interface) -> Plan {
        Plan(self.create(&At(interface)))
    }

    /// Plans the change to other conditions and shares in place. The first share and the end of the last one create the
    /// disciplines anew. The packets that wait there are lost, and those of a party that goes.
    pub fn change_to(&self, after: &Self, interface: &Interface) -> Plan {
        let at = At(interface);
        if self.is_shared() != after.is_shared() {
            let root = if self.is_shared() { self.htb() } else { self.plain() };
            let mut requests = vec![at.root(Verb::Delete, root)];
            requests.extend(after.create(&at));
            return Plan(requests);
        }
        if !after.is_shared() {
            let discipline =
                Discipline::Netem { netem: after.netem.clone(), before: Some(self.netem.clone()) };
            return Plan(vec![at.root(Verb::Change, discipline)]);
        }
        let mut requests = Vec::new();
        for (number, shape) in after.classes() {
            match self.classes().into_iter().find(|(other, _)| *other == number) {
                None => requests.push(at.class(Verb::Add, number, shape, None)),
                Some((_, before)) if before != shape => {
                    requests.push(at.class(Verb::Change, number, shape, Some(before)));
                }
                Some(_) => {}
            }
        }
        if self.netem != after.netem {
            requests.extend(self.leaves().filter(|number| after.has(*number)).map(|number| {
                let discipline = Discipline::Netem { netem: after.leaf(), before: Some(self.leaf()) };
                at.leaf(Verb::Change, number, discipline)
            }));
        }
        for (number, share) in after.shares.iter().filter(|(number, _)| !self.has(*number)) {
            requests.push(at.leaf(Verb::Add, *number, after.fresh_leaf()));
            requests.push(at.filter(Verb::Add, *number, share));
        }
        for (number, share) in self.shares.iter().filter(|(number, _)| !after.has(*number)) {
            let shape = self.classes().into_iter().find(|(other, _)| other == number);
            requests.push(at.filter(Verb::Delete, *number, share));
            requests.push(at.leaf(Verb::Delete, *number, self.fresh_leaf()));
            let (number, shape) = shape.expect("each share has a class");
            requests.push(at.class(Verb::Delete, number, shape, None));
        }
        Plan(requests)
    }

    fn create(&self, at: &At<'_>) -> Vec<Request> {
        if !self.is_shared() {
            return vec![at.root(Verb::Add, self.plain())];
        }
        let mut requests = vec![at.root(Verb::Add, self.htb())];
        let classes = self.classes().into_iter();
        requests.extend(classes.map(|(number, shape)| at.class(Verb::Add, number, shape, None)));
        requests.extend(self.leaves().map(|number| at.leaf(Verb::Add, number, self.fresh_leaf())));
        requests.extend(self.shares.iter().map(|(number, share)| at.filter(Verb::Add, *number, share)));
        requests
    }

    fn has(&self, number: u16) -> bool {
        self.leaves().any(|other| other == number)
    }

    /// Returns the numbers of the classes that hold packets.
    fn leaves(&self) -> impl Iterator<Item = u16> {
        [REST].into_iter().chain(self.shares.iter().map(|(number, _)| *number))
    }

    fn plain(&self) -> Discipline {
        Discipline::Netem { netem: self.netem.clone(), before: None }
    }

    fn htb(&self) -> Discipline {
        Discipline::Htb { default: REST }
    }

    /// Returns the conditions in a class. The rate is HTB's.
    fn leaf(&self) -> Netem {
        Netem { rate: None, limit: Some(self.netem.limit()), ..self.netem.clone() }
    }

    fn fresh_leaf(&self) -> Discipline {
        Discipline::Netem { netem: self.leaf(), before: None }
    }

    /// Returns all classes by their numbers. All other frames have what is not reserved. Turns are in proportion to the rates,
    /// of a full frame at least, and a class keeps the tokens of a turn of all.
    fn classes(&self) -> Vec<(u16, Shape)> {
        let whole = self.netem.rate.map_or(Shape::UNLIMITED_BPS, BitRate::bits_per_second);
        let rates = self.shares.iter().map(|(_, share)| share.rate.bits_per_second());
        let left = whole.saturating_sub(rates.clone().fold(0, u64::saturating_add)).max(LEAST);
        let least = rates.chain([left]).min().unwrap_or(left).max(1);
        let round = FULL_FRAME * (self.shares.len() as u64 + 1);
        let shape = |parent, rate: u64, ceiling: u64| Shape {
            parent,
            rate_bps: rate,
            ceiling_bps: ceiling,
            quantum: (u128::from(FULL_FRAME) * u128::from(rate) / u128::from(least))
                .clamp(FULL_FRAME.into(), LARGEST_QUANTUM.into()) as u32,
            burst: BURST + (round as f64 * (rate as f64 / whole as f64).min(1.0)) as u64,
        };
        let inside = Handle::class(WHOLE);
        let of_share = |(number, share): &(u16, Share)| {
            let rate = share.rate.bits_per_second();
            (*number, shape(inside, rate, if share.is_limited { rate } else { whole.max(rate) }))
        };
        let first =
            [(WHOLE, shape(Handle::OURS, whole, whole)), (REST, shape(inside, left, whole.max(left)))];
        first.into_iter().chain(self.shares.iter().map(of_share)).collect()
    }
}

/// Requests for an interface.
struct At<'a>(&'a Interface);

impl At<'_> {
    fn request(&self, verb: Verb, object: Object) -> Request {
        Request { verb, interface: (self.0.index, self.0.name.clone()), object }
    }

    fn root(&self, verb: Verb, discipline: Discipline) -> Request {
        self.request(verb, Object::Discipline { parent: Handle::ROOT, handle: Handle::OURS, discipline })
    }

    fn class(&self, verb: Verb, number: u16, shape: Shape, before: Option<Shape>) -> Request {
        self.request(verb, Object::Class { number, shape, before })
    }

    fn leaf(&self, verb: Verb, number: u16, discipline: Discipline) -> Request {
        let (parent, handle) = (Handle::class(number), Handle::leaf(number));
        self.request(verb, Object::Discipline { parent, handle, discipline })
    }

    fn filter(&self, verb: Verb, number: u16, share: &Share) -> Request {
        let packets = Packets::Frames { from: share.from, to: share.to };
        let filter = Filter { packets, verdict: Verdict::Class(Handle::class(number)), priority: number };
        self.request(verb, Object::Filter { parent: Handle::OURS, filter })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn share(number: u8, mbps: f64, is_limited: bool) -> Share {
        let rate = BitRate::from_mbps(mbps).unwrap();
        Share { from: [2, 0, 0, 0, 0, number], to: [2, 0, 0, 0, 1, number], rate, is_limited }
    }

    fn sharing(shares: &[Share]) -> Sharing {
        let netem = Netem { rate: BitRate::from_mbps(10.0), ..Netem::default() };
        Sharing::new(netem).with_shares(shares)
    }

    fn text(plan: &Plan) -> Vec<String> {
        plan.to_string().lines().map(str::to_owned).collect()
    }

    fn interface() -> Interface {
        Interface { index: 7, name: "e".to_owned(), loopback: false }
    }

    #[test]
    fn shares_are_classes_of_htb_below_the_rate_of_the_interface() {
        let plan = sharing(&[share(1, 6.0, false), share(2, 1.0, true)]).set_up(&interface());
        let expected = "\
tc qdisc add dev e root handle c070: htb default 2
tc class add dev e parent c070: classid c070:1 htb rate 10000000bit ceil 10000000bit quantum 15140 burst 6142b cburst 6142b
tc class add dev e parent c070:1 classid c070:2 htb rate 3000000bit ceil 10000000bit quantum 4542 burst 2962b cburst 2962b
tc class add dev e parent c070:1 classid c070:3 htb rate 6000000bit ceil 10000000bit quantum 9084 burst 4325b cburst 4325b
tc class add dev e parent c070:1 classid c070:4 htb rate 1000000bit ceil 1000000bit quantum 1514 burst 2054b cburst 2054b
tc qdisc add dev e parent c070:2 handle c072: netem limit 1000 delay 0ms rate 8796093022208bit
tc qdisc add dev e parent c070:3 handle c073: netem limit 1000 delay 0ms rate 8796093022208bit
tc qdisc add dev e parent c070:4 handle c074: netem limit 1000 delay 0ms rate 8796093022208bit
tc filter add dev e parent c070: protocol all pref 3 u32 match u32 0x02000000 0xffffffff at -14 match u32 0x01010200 \
0xffffffff at -10 match u32 0x00000001 0xffffffff at -6 flowid c070:3
tc filter add dev e parent c070: protocol all pref 4 u32 match u32 0x02000000 0xffffffff at -14 match u32 0x01020200 \
0xffffffff at -10 match u32 0x00000002 0xffffffff at -6 flowid c070:4
";
        assert_eq!(plan.to_string(), expected);
    }

    #[test]
    fn parties_that_stay_keep_their_packets() {
        let before = sharing(&[share(1, 6.0, false), share(2, 1.0, true)]);
        let after = before.with_shares(&[share(2, 2.0, true), share(3, 1.0, false)]);
        let plan = before.change_to(&after, &interface());
        let done = text(&plan);
        assert!(
            done.iter().any(|line| line.starts_with("tc class change dev e parent c070:1 classid c070:4"))
        );
        assert!(done.iter().any(|line| line.starts_with("tc class add dev e parent c070:1 classid c070:5")));
        let deleted: Vec<_> = done.iter().filter(|line| line.contains(" delete ")).collect();
        assert_eq!(deleted.len(), 3);
        assert!(deleted.iter().all(|line| line.contains("c070:3") || line.contains("pref 3")), "{deleted:?}");
    }

    #[test]
    fn the_first_share_and_the_end_of_the_last_create_the_disciplines_anew() {
        let plain = sharing(&[]);
        let shared = plain.with_shares(&[share(1, 1.0, false)]);
        let first = text(&plain.change_to(&shared, &interface()));
        assert_eq!(
            first[..2],
            ["tc qdisc delete dev e root handle c070:", "tc qdisc add dev e root handle c070: htb default 2"]
        );
        let last = text(&shared.change_to(&plain, &interface()));
        assert!(
            last.len() == 2 && last[1].contains("netem") && last[1].ends_with("rate 10000000bit"),
            "{last:?}"
        );
    }

    #[test]
    fn other_conditions_change_each_class_in_place() {
        let before = sharing(&[share(1, 1.0, false)]);
        let netem = Netem { rate: BitRate::from_mbps(5.0), ..Netem::default() };
        let done = text(&before.change_to(&before.with_netem(netem), &interface()));
        assert!(done.iter().all(|line| line.contains(" change ")), "{done:?}");
        assert!(done.iter().any(|line| line.contains("classid c070:2 htb rate 4000000bit ceil 5000000bit")));
    }
}
