//! Mappings of virtual links to paths, a(n1,n2), and their reservations on links.
//!
//! A mapping is for packets from one node to another. It carries all virtual links between VNFs on these nodes, and
//! reserves the sum of their rates on each link of its path. It keeps the reservation while its path is cut, so that the
//! path can be used again. If a link has too little capacity for all reservations, the latest mapping loses its own first.
//! It gets the reservation back once there is capacity. Whether links keep reservations for the packets of a mapping is the
//! testbed's decision. A mapping with a reservation of its own has its own rate, or decides for itself.

use std::{collections::BTreeMap, fmt};

use cotorra_fabric::{Carries, PinnedPath, Reservation};
use cotorra_graph::{BitRate, Direction, LinkId, MapReservation, NodeId, Reservations};

/// One direction of a link.
pub(crate) type Hop = (LinkId, Direction);

/// A path for packets from one node to another.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Mapping {
    pub(crate) from: NodeId,
    pub(crate) to: NodeId,
    pub(crate) links: Vec<LinkId>,
    pub(crate) hops: Vec<Hop>,
    own: Option<MapReservation>,
    /// Reserved rate, also while it lacks the reservation, bit/s.
    rate_bps: f64,
    state: State,
}

/// The state of a mapped path.
#[derive(Debug, Clone, PartialEq)]
enum State {
    Used,
    /// The robot is attached to another radio unit.
    Away,
    /// A link loses every packet.
    Cut(LinkId),
    Full(Shortage),
}

/// A link with too little capacity for a mapping.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Shortage {
    hop: Hop,
    left_bps: f64,
    needed_bps: f64,
}

impl fmt::Display for Shortage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { hop: (link, direction), left_bps, needed_bps } = self;
        let way = format!("{direction:?}").to_lowercase();
        let (left, needed) = (left_bps / 1e6, needed_bps / 1e6);
        write!(f, "the link `{link}` has {left} Mbit/s left {way}, and {needed} Mbit/s are needed")
    }
}

impl Mapping {
    pub(crate) fn new(
        [from, to]: [NodeId; 2],
        links: Vec<LinkId>,
        hops: Vec<Hop>,
        own: Option<MapReservation>,
    ) -> Self {
        Self { from, to, links, hops, own, rate_bps: 0.0, state: State::Used }
    }

    /// Whether packets take its path now.
    pub(crate) fn is_used(&self) -> bool {
        self.state == State::Used
    }

    /// Returns its path for the fabric, and the rate that links keep for it.
    pub(crate) fn pinned(&self, reservations: Reservations) -> PinnedPath {
        let is_limited = match self.own.map_or(reservations, |own| own.kept) {
            Reservations::Counted => None,
            Reservations::Guaranteed => Some(false),
            Reservations::Limited => Some(true),
        };
        // Without a virtual link on its nodes now, nothing is reserved.
        let rate = BitRate::from_bits_per_second(self.rate_bps.round() as u64);
        let reservation = is_limited.zip(rate).map(|(is_limited, rate)| Reservation { rate, is_limited });
        PinnedPath { from: self.from.clone(), to: self.to.clone(), links: self.links.clone(), reservation }
    }

    /// Returns the shortage that prevents its reservation.
    pub(crate) fn shortage(&self) -> Option<&Shortage> {
        match &self.state {
            State::Full(shortage) => Some(shortage),
            _ => None,
        }
    }

    /// Describes a change of its state for people. Handovers have events of their own.
    fn describe_change(&self, before: &State) -> Option<String> {
        let why = match &self.state {
            State::Cut(link) => format!("is cut at `{link}`: packets take the shortest"),
            State::Full(shortage) => format!("lost its reservation: {shortage}; packets take the shortest"),
            State::Used | State::Away => match before {
                State::Cut(_) | State::Full(_) => "can be used again".to_owned(),
                State::Used | State::Away => return None,
            },
        };
        let over: Vec<_> = self.links.iter().map(LinkId::as_str).collect();
        Some(format!("the path from `{}` to `{}` over {} {why}", self.from, self.to, over.join(", ")))
    }
}

/// All mappings, in order of creation.
#[derive(Debug, Clone, Default)]
pub(crate) struct Mappings(Vec<Mapping>);

impl Mappings {
    pub(crate) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    pub(crate) fn get(&self, from: &NodeId, to: &NodeId) -> Option<&Mapping> {
        self.0.iter().find(|mapping| mapping.from == *from && mapping.to == *to)
    }

    /// Adds a mapping, and replaces one of the same nodes.
    pub(crate) fn insert(&mut self, mapping: Mapping) {
        self.remove(&mapping.from, &mapping.to);
        self.0.push(mapping);
    }

    /// Removes a mapping. Returns whether it existed.
    pub(crate) fn remove(&mut self, from: &NodeId, to: &NodeId) -> bool {
        let before = self.0.len();
        self.0.retain(|mapping| mapping.from != *from || mapping.to != *to);
        self.0.len() < before
    }

    /// Returns the hops of all mappings.
    pub(crate) fn hops(&self) -> impl Iterator<Item = &Hop> {
        self.0.iter().flat_map(|mapping| &mapping.hops)
    }

    /// Returns the mappings that packets take, or will take once the robot is attached there.
    pub(crate) fn pinned(&self) -> impl Iterator<Item = &Mapping> {
        self.0.iter().filter(|mapping| matches!(mapping.state, State::Used | State::Away))
    }

    /// Returns the reservations on each direction of a link, bit/s.
    pub(crate) fn reserved(&self) -> BTreeMap<&Hop, f64> {
        let mut reserved = BTreeMap::new();
        for mapping in self.0.iter().filter(|mapping| mapping.shortage().is_none()) {
            for hop in &mapping.hops {
                *reserved.entry(hop).or_default() += mapping.rate_bps;
            }
        }
        reserved
    }

    /// Updates reservations and states, by the rates between nodes and the capacities of links. Returns the changes, for
    /// people.
    pub(crate) fn settle(
        &mut self,
        rate_bps: impl Fn(&NodeId, &NodeId) -> f64,
        carries: &BTreeMap<Hop, Carries>,
    ) -> Vec<String> {
        let mut left: BTreeMap<&Hop, f64> =
            carries.iter().map(|(hop, carries)| (hop, carries.rate_bps)).collect();
        // Present reservations come before new ones.
        let mut order: Vec<_> = self.0.iter_mut().collect();
        order.sort_by_key(|mapping| mapping.shortage().is_some());
        let mut changes = Vec::new();
        for mapping in order {
            let own = mapping.own.and_then(|own| own.rate);
            let own = own.map(|rate| rate.bits_per_second() as f64);
            mapping.rate_bps = own.unwrap_or_else(|| rate_bps(&mapping.from, &mapping.to));
            let needed_bps = mapping.rate_bps;
            let left_on = |hop: &Hop| left.get(hop).copied().unwrap_or(0.0);
            let short = mapping.hops.iter().find(|hop| left_on(hop) < needed_bps);
            let shortage = short.map(|hop| Shortage { hop: hop.clone(), left_bps: left_on(hop), needed_bps });
            let state = match shortage {
                Some(shortage) => State::Full(shortage),
                None => {
                    for hop in &mapping.hops {
                        left.entry(hop).and_modify(|left| *left -= needed_bps);
                    }
                    state(&mapping.hops, carries)
                }
            };
            let before = std::mem::replace(&mut mapping.state, state);
            if std::mem::discriminant(&before) != std::mem::discriminant(&mapping.state) {
                changes.extend(mapping.describe_change(&before));
            }
        }
        changes
    }
}

/// Returns the state of a path with enough capacity.
fn state(hops: &[Hop], carries: &BTreeMap<Hop, Carries>) -> State {
    let first = |lacks: fn(&Carries) -> bool| hops.iter().find(|hop| carries.get(hop).is_none_or(lacks));
    match (first(|carries| carries.is_cut), first(|carries| !carries.is_there)) {
        (Some((link, _)), _) => State::Cut(link.clone()),
        (None, Some(_)) => State::Away,
        (None, None) => State::Used,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn hop(link: &str) -> Hop {
        (link.parse().unwrap(), Direction::Forward)
    }

    /// A mapping from the node `name` to `z` over these links.
    fn mapping(name: &str, links: &[&str]) -> Mapping {
        let hops: Vec<_> = links.iter().map(|link| hop(link)).collect();
        let links = hops.iter().map(|(link, _)| link.clone()).collect();
        Mapping::new([name, "z"].map(|node| node.parse().unwrap()), links, hops, None)
    }

    fn carries(links: &[(&str, f64)]) -> BTreeMap<Hop, Carries> {
        let all = |&(link, rate_bps)| (hop(link), Carries { rate_bps, is_cut: false, is_there: true });
        links.iter().map(all).collect()
    }

    /// Updates mappings that need 4 bit/s each.
    fn settle(mappings: &mut Mappings, carries: &BTreeMap<Hop, Carries>) -> Vec<String> {
        mappings.settle(|_, _| 4.0, carries)
    }

    fn used(mappings: &Mappings) -> Vec<&str> {
        let used = mappings.0.iter().filter(|mapping| mapping.is_used());
        used.map(|mapping| mapping.from.as_str()).collect()
    }

    #[test]
    fn a_narrow_link_takes_the_latest_reservation_and_returns_it() {
        let mut mappings = Mappings::default();
        ["a", "b"].iter().for_each(|name| mappings.insert(mapping(name, &["x", "y"])));
        let wide = carries(&[("x", 8.0), ("y", 8.0)]);
        assert!(settle(&mut mappings, &wide).is_empty());
        assert_eq!(used(&mappings), ["a", "b"]);
        assert_eq!(mappings.reserved().into_values().collect::<Vec<_>>(), [8.0, 8.0]);

        let narrow = carries(&[("x", 8.0), ("y", 7.0)]);
        let changes = settle(&mut mappings, &narrow);
        assert_eq!(used(&mappings), ["a"]);
        assert_eq!(mappings.reserved().into_values().collect::<Vec<_>>(), [4.0, 4.0]);
        assert!(changes.len() == 1 && changes[0].contains("from `b` to `z`"), "{changes:?}");
        assert!(settle(&mut mappings, &narrow).is_empty());

        let changes = settle(&mut mappings, &wide);
        assert_eq!(used(&mappings), ["a", "b"]);
        assert!(changes.len() == 1 && changes[0].ends_with("can be used again"), "{changes:?}");
    }

    #[test]
    fn present_reservations_come_before_lost_older_ones() {
        let mut mappings = Mappings::default();
        mappings.insert(mapping("old", &["x"]));
        settle(&mut mappings, &carries(&[("x", 3.0)]));
        mappings.insert(mapping("new", &["y"]));
        settle(&mut mappings, &carries(&[("x", 3.0), ("y", 4.0)]));
        mappings.insert(mapping("new", &["x"]));
        settle(&mut mappings, &carries(&[("x", 5.0)]));
        assert_eq!(used(&mappings), ["new"]);
    }

    #[test]
    fn a_cut_path_keeps_its_reservation_and_is_used_again() {
        let mut mappings = Mappings::default();
        mappings.insert(mapping("a", &["x", "y"]));
        let whole = carries(&[("x", 4.0), ("y", 4.0)]);
        let with = |is_cut, is_there| {
            let mut carries = whole.clone();
            carries.insert(hop("y"), Carries { rate_bps: 4.0, is_cut, is_there });
            carries
        };
        let changes = settle(&mut mappings, &with(true, false));
        assert!(changes.len() == 1 && changes[0].contains("over x, y is cut at `y`"), "{changes:?}");
        assert_eq!((used(&mappings).len(), mappings.pinned().count()), (0, 0));
        assert_eq!(mappings.reserved().len(), 2);
        // The fabric itself checks attachments.
        settle(&mut mappings, &with(false, false));
        assert_eq!((used(&mappings).len(), mappings.pinned().count()), (0, 1));
        assert!(settle(&mut mappings, &whole).is_empty());
        assert_eq!(used(&mappings), ["a"]);
    }
}
