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

    pub(crate) fn and(self, other: Self) -> Self {
        Self { delay_ns: self.delay_ns.saturating_add(other.delay_ns), failure: self.failure + other.failure }
    }
}

/// The way to a node in a tree.
#[derive(Debug, Clone, Copy)]
struct Reached {
    figures: Figures,
    /// The node before it and the link from there; `None` at the source.
    by: Option<(usize, usize)>,
}

/// The shortest paths from one node.
pub(crate) struct Tree(Vec<Option<Reached>>);

impl Tree {
    /// What the shortest path to a node amounts to; `None` if there is none.
    pub(crate) fn figures(&self, to: usize) -> Option<Figures> {
        self.0[to].map(|reached| reached.figures)
    }

    /// The links of the shortest path to a node, in order.
    pub(crate) fn links(&self, to: usize) -> Vec<usize> {
        let mut links = Vec::new();
        let mut at = to;
        while let Some((before, link)) = self.0[at].and_then(|reached| reached.by) {
            links.push(link);
            at = before;
        }
        links.reverse();
        links
    }
}

/// A way from one node to another: links in order.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Path {
    pub(crate) links: Vec<usize>,
    pub(crate) figures: Figures,
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
    trees: HashMap<Key, Rc<Tree>>,
    alternatives: HashMap<(Key, usize), Rc<[Path]>>,
}

impl<'a> Paths<'a> {
    /// Up to `at_most` paths between any two nodes.
    pub(crate) fn new(infrastructure: &'a Infrastructure, at_most: usize) -> Self {
        let mut edges = vec![Vec::new(); infrastructure.nodes.len()];
        for (i, link) in infrastructure.links.iter().enumerate().filter(|(_, link)| !link.wireless) {
            let [a, b] = link.ends;
            edges[a].push((b, i));
            edges[b].push((a, i));
        }
        let figures = infrastructure.links.iter().map(Figures::of).collect();
        let (trees, alternatives) = (HashMap::new(), HashMap::new());
        Self { infrastructure, figures, edges, at_most, trees, alternatives }
    }

    /// What a link amounts to.
    pub(crate) fn figures(&self, link: usize) -> Figures {
        self.figures[link]
    }

    /// The shortest paths from a node to all others over links that have so much free.
    pub(crate) fn shortest(&mut self, from: usize, rate_bps: f64) -> Rc<Tree> {
        let key = (from, rate_bps.to_bits());
        if let Some(tree) = self.trees.get(&key) {
            return tree.clone();
        }
        let tree = Rc::new(self.tree(from, None, rate_bps, &BTreeSet::new(), &BTreeSet::new()));
        self.trees.insert(key, tree.clone());
        tree
    }

    /// The links of the shortest path that was found before.
    pub(crate) fn known(&self, from: usize, to: usize, rate_bps: f64) -> Vec<usize> {
        self.trees.get(&(from, rate_bps.to_bits())).map_or_else(Vec::new, |tree| tree.links(to))
    }

    /// The next paths after the shortest, shortest first.
    pub(crate) fn next(&mut self, from: usize, to: usize, rate_bps: f64) -> Rc<[Path]> {
        let key = ((from, rate_bps.to_bits()), to);
        if let Some(paths) = self.alternatives.get(&key) {
            return paths.clone();
        }
        let tree = self.shortest(from, rate_bps);
        let found: Rc<[_]> = match tree.figures(to).filter(|_| from != to) {
            Some(figures) => self.yen(from, to, rate_bps, Path { links: tree.links(to), figures }).into(),
            None => Rc::from([]),
        };
        self.alternatives.insert(key, found.clone());
        found
    }

    fn yen(&self, from: usize, to: usize, rate_bps: f64, first: Path) -> Vec<Path> {
        let mut found = vec![first];
        // By delay, then by links, so that equals come in an order of their own.
        let mut candidates: BTreeSet<(u64, Vec<usize>)> = BTreeSet::new();
        while found.len() < self.at_most {
            let last = found[found.len() - 1].links.clone();
            let mut spur = from;
            let mut passed = BTreeSet::new();
            for i in 0..last.len() {
                let without: BTreeSet<_> = found
                    .iter()
                    .filter(|path| path.links.len() > i && path.links[..i] == last[..i])
                    .map(|path| path.links[i])
                    .collect();
                let tree = self.tree(spur, Some(to), rate_bps, &passed, &without);
                if tree.figures(to).is_some() {
                    let links: Vec<_> = last[..i].iter().copied().chain(tree.links(to)).collect();
                    candidates.insert((self.sum(&links).delay_ns, links));
                }
                passed.insert(spur);
                let [a, b] = self.infrastructure.links[last[i]].ends;
                spur = if a == spur { b } else { a };
            }
            let Some((_, links)) = candidates.pop_first() else { break };
            let figures = self.sum(&links);
            found.push(Path { links, figures });
        }
        found.remove(0);
        found
    }

    fn sum(&self, links: &[usize]) -> Figures {
        links.iter().fold(Figures::default(), |sum, &link| sum.and(self.figures[link]))
    }

    /// Dijkstra's algorithm, over nodes that forward; of equals the one with fewer hops, then the first. Nothing
    /// beyond `to` is sought.
    fn tree(
        &self,
        from: usize,
        to: Option<usize>,
        rate_bps: f64,
        without_nodes: &BTreeSet<usize>,
        without_links: &BTreeSet<usize>,
    ) -> Tree {
        let mut reached: Vec<Option<Reached>> = vec![None; self.edges.len()];
        let mut best = vec![(u64::MAX, u32::MAX); self.edges.len()];
        let mut queue = BinaryHeap::from([Reverse((0, 0, from))]);
        reached[from] = Some(Reached { figures: Figures::default(), by: None });
        best[from] = (0, 0);
        while let Some(Reverse((delay_ns, hops, at))) = queue.pop() {
            if Some(at) == to {
                break;
            }
            let Some(before) = reached[at].filter(|_| (delay_ns, hops) == best[at]) else { continue };
            if at != from && !self.infrastructure.nodes[at].forwards {
                continue;
            }
            for &(next, link) in &self.edges[at] {
                let full = self.infrastructure.links[link].free_bps < rate_bps;
                if full || without_nodes.contains(&next) || without_links.contains(&link) {
                    continue;
                }
                let figures = before.figures.and(self.figures[link]);
                if (figures.delay_ns, hops + 1) < best[next] {
                    best[next] = (figures.delay_ns, hops + 1);
                    reached[next] = Some(Reached { figures, by: Some((at, link)) });
                    queue.push(Reverse((figures.delay_ns, hops + 1, next)));
                }
            }
        }
        Tree(reached)
    }
}
