//! Paths between hosts over wired links: the shortest to all by one tree, and the next shortest by Yen's algorithm
//! (Management Science 17(11), 1971), which is run only for the pairs that need more than the shortest.

use std::{
    cmp::Reverse,
    collections::{BTreeSet, BinaryHeap, HashMap},
    rc::Rc,
};

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

    /// What is used once more takes its time again, but can fail only once.
    pub(crate) fn again(self) -> Self {
        Self { failure: 0.0, ..self }
    }

    pub(crate) fn and(self, other: Self) -> Self {
        Self { delay_ns: self.delay_ns.saturating_add(other.delay_ns), failure: self.failure + other.failure }
    }
}

/// What a path is short in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum By {
    Delay,
    Failure,
}

impl By {
    /// What is to be least, first; that of a float is in the order of its bits.
    fn weigh(self, figures: Figures) -> (u64, u64) {
        let both = (figures.delay_ns, figures.failure.max(0.0).to_bits());
        match self {
            Self::Delay => both,
            Self::Failure => (both.1, both.0),
        }
    }
}

/// The way to a node in a tree.
#[derive(Debug, Clone, Copy)]
struct Reached {
    figures: Figures,
    /// What is free on its narrowest link, bit/s.
    free_bps: f64,
    /// The node before it and the link from there; `None` at the source.
    by: Option<(usize, usize)>,
}

/// The shortest paths from one node.
#[derive(Debug)]
pub(crate) struct Tree(Vec<Option<Reached>>);

impl Tree {
    /// What the shortest path to a node amounts to, and what is free on it; `None` if there is none.
    pub(crate) fn to(&self, to: usize) -> Option<(Figures, f64)> {
        self.0[to].map(|reached| (reached.figures, reached.free_bps))
    }

    /// The links of the shortest path to a node, in order.
    pub(crate) fn links(&self, to: usize) -> Vec<usize> {
        let mut links: Vec<_> = self.walk(to).collect();
        links.reverse();
        links
    }

    /// The links of the shortest path to a node, from the last one back.
    pub(crate) fn walk(&self, to: usize) -> impl Iterator<Item = usize> {
        let by = |at: usize| self.0[at].and_then(|reached| reached.by);
        std::iter::successors(by(to), move |(before, _)| by(*before)).map(|(_, link)| link)
    }
}

/// A way from one node to another: links in order.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Path {
    pub(crate) links: Rc<[usize]>,
    pub(crate) figures: Figures,
    /// What is free on its narrowest link, bit/s.
    pub(crate) free_bps: f64,
}

/// The shortest paths from one node: the fastest and, where reliability counts, those that fail least often.
#[derive(Debug, Clone)]
pub(crate) struct Shortest {
    pub(crate) fastest: Rc<Tree>,
    pub(crate) safest: Option<Rc<Tree>>,
}

/// A source, and the rate that links must have free (as bits, so that it can be a key).
type Key = (usize, u64);

/// Paths over an infrastructure's wired links, each found once.
pub(crate) struct Paths<'a> {
    infrastructure: &'a Infrastructure,
    figures: Vec<Figures>,
    /// Wired links of each node: the other end and the link.
    edges: Vec<Vec<(usize, usize)>>,
    at_most: usize,
    reliability_counts: bool,
    shortest: HashMap<Key, Shortest>,
    alternatives: HashMap<(Key, usize), Rc<[Path]>>,
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
        let (shortest, alternatives) = (HashMap::new(), HashMap::new());
        Self { infrastructure, figures, edges, at_most, reliability_counts, shortest, alternatives }
    }

    /// What a link amounts to.
    pub(crate) fn figures(&self, link: usize) -> Figures {
        self.figures[link]
    }

    /// The shortest paths from a node to all others over links that have so much free.
    pub(crate) fn shortest(&mut self, from: usize, rate_bps: f64) -> Shortest {
        let key = (from, rate_bps.to_bits());
        if let Some(known) = self.shortest.get(&key) {
            return known.clone();
        }
        let tree = |by| Rc::new(self.tree(by, &[(from, Figures::default())], None, rate_bps, &|_, _| true));
        let safest = self.reliability_counts.then(|| tree(By::Failure));
        let found = Shortest { fastest: tree(By::Delay), safest };
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
        let tree = self.tree(By::Delay, &ends, None, rate_bps, &|_, _| true);
        let nowhere = u64::MAX;
        let mut all: Vec<_> =
            (0..self.edges.len()).map(|node| tree.to(node).map_or(nowhere, |(f, _)| f.delay_ns)).collect();
        for &link in &air {
            let [robot, unit] = self.infrastructure.links[link].ends;
            all[robot] = all[robot].min(all[unit].saturating_add(self.figures[link].delay_ns));
        }
        all
    }

    /// The next paths after the fastest, fastest first.
    pub(crate) fn next(&mut self, from: usize, to: usize, rate_bps: f64) -> Rc<[Path]> {
        let key = ((from, rate_bps.to_bits()), to);
        if let Some(paths) = self.alternatives.get(&key) {
            return paths.clone();
        }
        let tree = self.shortest(from, rate_bps).fastest;
        let found: Rc<[_]> = if from == to || tree.to(to).is_none() {
            Rc::from([])
        } else {
            self.yen(from, to, rate_bps, tree.links(to)).into()
        };
        self.alternatives.insert(key, found.clone());
        found
    }

    fn yen(&self, from: usize, to: usize, rate_bps: f64, first: Vec<usize>) -> Vec<Path> {
        let mut found = vec![first];
        // By delay, then by links, so that equals come in an order of their own.
        let mut candidates: BTreeSet<(u64, Vec<usize>)> = BTreeSet::new();
        while found.len() < self.at_most {
            let last = found[found.len() - 1].clone();
            let mut spur = from;
            let mut passed = BTreeSet::new();
            for i in 0..last.len() {
                let same_so_far = found.iter().filter(|path| path.len() > i && path[..i] == last[..i]);
                let without: BTreeSet<_> = same_so_far.map(|path| path[i]).collect();
                let open = |node: usize, link: usize| !passed.contains(&node) && !without.contains(&link);
                let tree = self.tree(By::Delay, &[(spur, Figures::default())], Some(to), rate_bps, &open);
                if tree.to(to).is_some() {
                    let links: Vec<_> = last[..i].iter().copied().chain(tree.links(to)).collect();
                    candidates.insert((self.path(&links).figures.delay_ns, links));
                }
                passed.insert(spur);
                let [a, b] = self.infrastructure.links[last[i]].ends;
                spur = if a == spur { b } else { a };
            }
            let Some((_, links)) = candidates.pop_first() else { break };
            found.push(links);
        }
        found.iter().skip(1).map(|links| self.path(links)).collect()
    }

    fn path(&self, links: &[usize]) -> Path {
        let figures = links.iter().fold(Figures::default(), |sum, &link| sum.and(self.figures[link]));
        let free = links.iter().map(|&link| self.infrastructure.links[link].free_bps);
        Path { links: links.into(), figures, free_bps: free.fold(f64::INFINITY, f64::min) }
    }

    /// Dijkstra's algorithm from some nodes, over nodes that forward; of equals the one with fewer hops, then the
    /// first. Nothing beyond `to` is sought, and of the wired links with so much free only the open ones are taken.
    fn tree(
        &self,
        by: By,
        from: &[(usize, Figures)],
        to: Option<usize>,
        rate_bps: f64,
        open: &dyn Fn(usize, usize) -> bool,
    ) -> Tree {
        let nodes = &self.infrastructure.nodes;
        let mut reached: Vec<Option<Reached>> = vec![None; self.edges.len()];
        let mut best = vec![((u64::MAX, u64::MAX), u32::MAX); self.edges.len()];
        let mut queue = BinaryHeap::new();
        for (i, &(at, figures)) in from.iter().enumerate() {
            let rank = (by.weigh(figures), 0);
            queue.push(Reverse((rank, at, Some(i))));
            if rank < best[at] {
                best[at] = rank;
                reached[at] = Some(Reached { figures, free_bps: f64::INFINITY, by: None });
            }
        }
        while let Some(Reverse((rank, at, beginning))) = queue.pop() {
            if Some(at) == to {
                break;
            }
            // Paths begin at each of the first nodes, even where one from another leads there that is shorter.
            let begun = beginning.map(|i| (from[i].1, f64::INFINITY));
            let known = || reached[at].filter(|_| rank == best[at]).map(|r| (r.figures, r.free_bps));
            let Some((figures_here, free_here)) = begun.or_else(known) else { continue };
            for &(next, link) in &self.edges[at] {
                let free = self.infrastructure.links[link].free_bps;
                if free < rate_bps || !open(next, link) {
                    continue;
                }
                let figures = figures_here.and(self.figures[link]);
                let rank = (by.weigh(figures), rank.1 + 1);
                if rank < best[next] {
                    best[next] = rank;
                    let free_bps = free_here.min(free);
                    reached[next] = Some(Reached { figures, free_bps, by: Some((at, link)) });
                    if nodes[next].forwards || Some(next) == to {
                        queue.push(Reverse((rank, next, None)));
                    }
                }
            }
        }
        Tree(reached)
    }
}
