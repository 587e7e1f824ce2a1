//! Searches for the cheapest paths from some nodes to all others.

use std::{cmp::Reverse, collections::BinaryHeap};

/// The cheapest path to a node.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Arrival<C> {
    /// Cost of the whole path, with that of its source.
    pub cost: C,
    /// The node before it and the edge from there; `None` at a source.
    pub by: Option<(usize, usize)>,
}

/// A node that waits for its turn.
#[derive(PartialEq, Eq, PartialOrd, Ord)]
struct Waiting<C> {
    cost: C,
    at: usize,
    is_source: bool,
}

/// Returns the cheapest path to each of so many nodes from any of the sources (Dijkstra 1959); `None` without a path.
///
/// `edges(node, cost)` returns the edges that a path of that cost goes on by from a node: the far node, the edge, and the
/// cost of the path there, which must be higher. Paths begin at each source, even where one from another source leads
/// there that is cheaper. They go on from other nodes only where `forwards` says so.
///
/// Of equal costs the path that is found first wins: the one whose last node but one is cheaper, then has the lower number,
/// then lists the edge earlier. Other rules are part of `C`: hops as its second figure prefer paths with fewer.
pub fn cheapest_paths<C, E>(
    nodes: usize,
    sources: &[(usize, C)],
    forwards: impl Fn(usize) -> bool,
    edges: impl Fn(usize, C) -> E,
) -> Vec<Option<Arrival<C>>>
where
    C: Copy + Ord,
    E: Iterator<Item = (usize, usize, C)>,
{
    let mut reached: Vec<Option<Arrival<C>>> = vec![None; nodes];
    let mut queue = BinaryHeap::new();
    for &(at, cost) in sources {
        queue.push(Reverse(Waiting { cost, at, is_source: true }));
        if reached[at].is_none_or(|known| cost < known.cost) {
            reached[at] = Some(Arrival { cost, by: None });
        }
    }
    while let Some(Reverse(Waiting { cost, at, is_source })) = queue.pop() {
        if !is_source && reached[at].is_none_or(|known| known.cost != cost) {
            continue;
        }
        for (to, edge, cost) in edges(at, cost) {
            if reached[to].is_none_or(|known| cost < known.cost) {
                reached[to] = Some(Arrival { cost, by: Some((at, edge)) });
                if forwards(to) {
                    queue.push(Reverse(Waiting { cost, at: to, is_source: false }));
                }
            }
        }
    }
    reached
}

/// Returns the edges of the path from the only source to a node, from the last one back, each with the node that it leaves;
/// none without a path.
pub fn steps_back<C>(reached: &[Option<Arrival<C>>], to: usize) -> impl Iterator<Item = (usize, usize)> {
    let by = |at: usize| reached[at].as_ref().and_then(|arrival| arrival.by);
    std::iter::successors(by(to), move |(before, _)| by(*before))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Delay, then hops.
    type Cost = (u64, u32);

    /// Searches over edges from, to and cost; some nodes forward.
    fn search(
        edges: &[(usize, usize, u64)],
        forwards: &[bool],
        sources: &[(usize, Cost)],
    ) -> Vec<Option<Arrival<Cost>>> {
        cheapest_paths(
            forwards.len(),
            sources,
            |node| forwards[node],
            |at, (delay, hops)| {
                let leaving = edges.iter().enumerate().filter(move |(_, edge)| edge.0 == at);
                leaving.map(move |(i, edge)| (edge.1, i, (delay + edge.2, hops + 1)))
            },
        )
    }

    fn path(reached: &[Option<Arrival<Cost>>], to: usize) -> Vec<usize> {
        let mut path: Vec<_> = steps_back(reached, to).map(|(_, edge)| edge).collect();
        path.reverse();
        path
    }

    #[test]
    fn of_equal_costs_fewer_hops_win_then_the_lower_node_then_the_earlier_edge() {
        let all = [true; 5];
        let hops = search(&[(0, 1, 1), (1, 4, 1), (0, 4, 2)], &all, &[(0, (0, 0))]);
        assert_eq!(path(&hops, 4), [2]);
        let nodes = search(&[(0, 2, 1), (0, 1, 1), (2, 4, 1), (1, 4, 1)], &all, &[(0, (0, 0))]);
        assert_eq!(path(&nodes, 4), [1, 3]);
        let edges = search(&[(0, 4, 1), (0, 4, 1)], &all, &[(0, (0, 0))]);
        assert_eq!(path(&edges, 4), [0]);
    }

    #[test]
    fn paths_begin_at_sources_that_others_reach_at_less_and_do_not_forward() {
        let reached = search(&[(0, 1, 1), (1, 2, 1)], &[false; 3], &[(0, (0, 0)), (1, (5, 0))]);
        assert_eq!(reached[1], Some(Arrival { cost: (1, 1), by: Some((0, 0)) }));
        assert_eq!(reached[2], Some(Arrival { cost: (6, 1), by: Some((1, 1)) }));
    }

    proptest! {
        #[test]
        fn no_path_is_cheaper_and_only_nodes_that_forward_are_inside_of_one(
            edges in prop::collection::vec((0usize..8, 0usize..8, 0u64..4), 0..24),
            forwards in prop::collection::vec(prop::bool::ANY, 8),
        ) {
            let reached = search(&edges, &forwards, &[(0, (0, 0))]);
            // All ways (Bellman-Ford).
            let mut costs = [None; 8];
            costs[0] = Some((0, 0));
            for _ in 0..8 {
                for &(from, to, delay) in edges.iter().filter(|edge| edge.0 == 0 || forwards[edge.0]) {
                    let by = costs[from].map(|(so_far, hops)| (so_far + delay, hops + 1));
                    costs[to] = [costs[to], by].into_iter().flatten().min();
                }
            }
            for (to, cost) in costs.iter().enumerate() {
                prop_assert_eq!(reached[to].map(|arrival| arrival.cost), *cost);
                let path = path(&reached, to);
                prop_assert_eq!(path.iter().map(|&edge| edges[edge].2).sum::<u64>(), cost.map_or(0, |cost| cost.0));
                prop_assert!(path.iter().skip(1).all(|&edge| forwards[edges[edge].0]));
            }
        }
    }
}
