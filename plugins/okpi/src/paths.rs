//! Paths between hosts over wired links, from one host to all others by one tree: the fastest, those that fail least
//! often, and the fastest that have room beside what is sent already.

use std::{cmp::Ordering, collections::HashMap, rc::Rc};

use cotorra_graph::{Arrival, cheapest_paths, steps_back};

use crate::model::{Infrastructure, Link};

/// Delay and reliability of some links in a row.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Figures {
    pub(crate) delay_ns: u64,
    /// Negative logarithm of the probability that all work.
    pub(crate) failure: f64,
}

impl Figures {
    pub(crate) fn of(link: &Link) -> Self {
        let delay_ns = u64::try_from(link.round_trip.as_nanos()).unwrap_or(u64::MAX);
        Self { delay_ns, failure: -link.reliability.ln() }
    }

    /// Returns the figures of a repeated use: it takes time again, but can fail only once.
    pub(crate) fn again(self) -> Self {
        Self { failure: 0.0, ..self }
    }

    pub(crate) fn and(self, other: Self) -> Self {
        Self { delay_ns: self.delay_ns.saturating_add(other.delay_ns), failure: self.failure + other.failure }
    }
}

/// Figure by which a path is shortest.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum By {
    Delay,
    Failure,
}

impl By {
    /// Returns the figure to minimise first. Floats are ordered by their bits.
    fn weigh(self, figures: Figures) -> (u64, u64) {
        let both = (figures.delay_ns, figures.failure.max(0.0).to_bits());
        match self {
            Self::Delay => both,
            Self::Failure => (both.1, both.0),
        }
    }
}

/// Cost of a path: the weight of its figures, then its hops.
#[derive(Debug, Clone, Copy)]
struct Cost {
    rank: ((u64, u64), u32),
    figures: Figures,
    /// Free rate on the narrowest link, bit/s.
    free_bps: f64,
}

impl Ord for Cost {
    fn cmp(&self, other: &Self) -> Ordering {
        self.rank.cmp(&other.rank)
    }
}

impl PartialOrd for Cost {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Cost {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other).is_eq()
    }
}

impl Eq for Cost {}

/// The shortest paths from one node.
#[derive(Debug)]
pub(crate) struct Tree(Vec<Option<Arrival<Cost>>>);

impl Tree {
    /// Returns the figures of the shortest path to a node, and its free rate; `None` if there is none.
    pub(crate) fn to(&self, to: usize) -> Option<(Figures, f64)> {
        self.0[to].map(|reached| (reached.cost.figures, reached.cost.free_bps))
    }

    /// The links of the shortest path to a node, in order.
    pub(crate) fn links(&self, to: usize) -> Vec<usize> {
        let mut links: Vec<_> = self.walk(to).collect();
        links.reverse();
        links
    }

    /// The links of the shortest path to a node, from the last one back.
    pub(crate) fn walk(&self, to: usize) -> impl Iterator<Item = usize> {
        steps_back(&self.0, to).map(|(_, link)| link)
    }
}

/// The shortest paths from one node.
#[derive(Debug, Clone)]
pub(crate) struct Shortest {
    pub(crate) fastest: Rc<Tree>,
    /// Those that fail least often, where reliability counts.
    pub(crate) safest: Option<Rc<Tree>>,
    /// The fastest with room beside what is sent already, once they were asked for.
    around: Option<Rc<Tree>>,
}

/// A source, and the rate that links must have free (as bits, so that it can be a key).
type Key = (usize, u64);

/// Paths over an infrastructure's wired links, each found once.
pub(crate) struct Paths<'a> {
    infrastructure: &'a Infrastructure,
    figures: Vec<Figures>,
    /// Wired links of each node: the other end and the link.
    edges: Vec<Vec<(usize, usize)>>,
    /// Highest number of paths between two hosts.
    at_most: usize,
    reliability_counts: bool,
    shortest: HashMap<Key, Shortest>,
}

impl<'a> Paths<'a> {
    /// Up to `at_most` paths between any two nodes.
    pub(crate) fn new(infrastructure: &'a Infrastructure, at_most: usize, reliability_counts: bool) -> Self {
        let mut edges = vec![Vec::new(); infrastructure.nodes.len()];
        for (i, link) in infrastructure.links.iter().enumerate().filter(|(_, link)| !link.wireless) {
            let [a, b] = link.ends;
            edges[a].push((b, i));
            edges[b].push((a, i));
        }
        let figures = infrastructure.links.iter().map(Figures::of).collect();
        Self { infrastructure, figures, edges, at_most, reliability_counts, shortest: HashMap::new() }
    }

    /// Returns the figures of a link.
    pub(crate) fn figures(&self, link: usize) -> Figures {
        self.figures[link]
    }

    /// The shortest paths from a node to all others over links that have so much free.
    pub(crate) fn shortest(&mut self, from: usize, rate_bps: f64) -> Shortest {
        let key = (from, rate_bps.to_bits());
        if let Some(known) = self.shortest.get(&key) {
            return known.clone();
        }
        let tree = |by| Rc::new(self.tree(by, &[(from, Figures::default())], rate_bps, &|_| 0.0));
        let safest = (self.reliability_counts && self.at_most > 1).then(|| tree(By::Failure));
        let found = Shortest { fastest: tree(By::Delay), safest, around: None };
        self.shortest.insert(key, found.clone());
        found
    }

    /// The least that lies between each node and any of some others, each with what lies beyond it; nowhere is less
    /// delay or less failure, though perhaps not both on one path.
    pub(crate) fn to_any(&self, ends: Vec<(usize, Figures)>, rate_bps: f64) -> Vec<u64> {
        let mut ends = ends;
        // Over the air as well.
        let wireless = |i: &usize| self.infrastructure.links[*i].wireless;
        let air: Vec<_> = (0..self.figures.len()).filter(wireless).collect();
        for &link in &air {
            let [robot, unit] = self.infrastructure.links[link].ends;
            let beyond = ends.iter().find(|(end, _)| *end == robot).map(|(_, beyond)| *beyond);
            ends.extend(beyond.map(|beyond| (unit, beyond.and(self.figures[link]))));
        }
        let tree = self.tree(By::Delay, &ends, rate_bps, &|_| 0.0);
        let nowhere = u64::MAX;
        let mut all: Vec<_> =
            (0..self.edges.len()).map(|node| tree.to(node).map_or(nowhere, |(f, _)| f.delay_ns)).collect();
        for &link in &air {
            let [robot, unit] = self.infrastructure.links[link].ends;
            all[robot] = all[robot].min(all[unit].saturating_add(self.figures[link].delay_ns));
        }
        all
    }

    /// The fastest paths from a node that have so much free besides what is sent over links already; `None` where so
    /// many paths are not to be tried.
    pub(crate) fn around(
        &self,
        known: &mut Shortest,
        from: usize,
        rate_bps: f64,
        sent: &[Option<f64>],
    ) -> Option<Rc<Tree>> {
        if self.at_most < 3 {
            return None;
        }
        let tree = || {
            self.tree(By::Delay, &[(from, Figures::default())], rate_bps, &|link| sent[link].unwrap_or(0.0))
        };
        Some(Rc::clone(known.around.get_or_insert_with(|| Rc::new(tree()))))
    }

    /// The shortest paths from some nodes, over nodes that forward and wired links that have so much free besides what
    /// is sent over them; of equals the path with fewer hops, then the first.
    fn tree(
        &self,
        by: By,
        from: &[(usize, Figures)],
        rate_bps: f64,
        sent_bps: &dyn Fn(usize) -> f64,
    ) -> Tree {
        let cost = |figures, hops, free_bps| Cost { rank: (by.weigh(figures), hops), figures, free_bps };
        let sources: Vec<_> =
            from.iter().map(|&(at, figures)| (at, cost(figures, 0, f64::INFINITY))).collect();
        Tree(cheapest_paths(
            self.edges.len(),
            &sources,
            |node| self.infrastructure.nodes[node].forwards,
            |at, so_far| {
                self.edges[at].iter().filter_map(move |&(next, link)| {
                    let free = self.infrastructure.links[link].free_bps;
                    fits(free, rate_bps + sent_bps(link)).then(|| {
                        let figures = so_far.figures.and(self.figures[link]);
                        (next, link, cost(figures, so_far.rank.1 + 1, so_far.free_bps.min(free)))
                    })
                })
            },
        ))
    }
}

/// Whether so much is free, but for rounding errors of sums.
pub(crate) fn fits(free: f64, needed: f64) -> bool {
    needed <= free + free.abs().min(1e12) * 1e-9
}
