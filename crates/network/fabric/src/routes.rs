//! Routes over the wired links: shortest paths by delay towards each destination, and spanning trees away from each sender
//! for frames to all hosts. Both are worked out at first use, and again after a delay changed. Frames from one host to
//! another can be pinned to a path.

use std::{collections::BTreeSet, sync::Arc, time::Duration};

use cotorra_graph::{Arrival, cheapest_paths, steps_back};

use crate::port::PortId;

/// The destination of a frame.
#[derive(Debug, Clone)]
pub(crate) enum Target {
    /// One host, along the path that the frame started on, until that ends.
    Port { port: PortId, along: Option<Arc<Path>> },
    /// All hosts but the one at the source port, along the tree that the frame started on.
    All { tree: Arc<Tree>, source: PortId },
}

/// Cost of a path: its delay in nanoseconds, its hops, then its last edge, so that the order of edges decides.
type Cost = (u64, u32, u32);

/// A spanning tree without the branches that lead to no host.
#[derive(Debug)]
pub(crate) struct Tree {
    /// Pairs of vertex and leaving edge, sorted.
    branches: Vec<(u32, u32)>,
}

impl Tree {
    /// Returns the edges that lead on from a vertex.
    pub(crate) fn branches(&self, vertex: usize) -> impl Iterator<Item = usize> + '_ {
        let begin = self.branches.partition_point(|(from, _)| (*from as usize) < vertex);
        self.branches[begin..]
            .iter()
            .take_while(move |(from, _)| *from as usize == vertex)
            .map(|(_, edge)| *edge as usize)
    }
}

/// The wired part of a path that frames are pinned to.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Path {
    /// Source and destination of its frames.
    pub(crate) ends: [PortId; 2],
    /// First vertex.
    pub(crate) begin: usize,
    /// Last vertex.
    pub(crate) end: usize,
    pub(crate) edges: Vec<usize>,
}

/// Properties of a vertex.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Vertex {
    /// Whether it forwards frames for others.
    pub(crate) forwards: bool,
    /// Whether frames are delivered there.
    pub(crate) has_port: bool,
}

#[derive(Debug)]
struct Edge {
    ends: [u32; 2],
    delay_ns: u64,
}

/// A result and the version of the routes that it holds for.
type Cached<T> = Option<(u64, T)>;

/// The wired network as a graph of vertices and edges.
#[derive(Debug)]
pub(crate) struct Routes {
    vertices: Vec<Vertex>,
    edges: Vec<Edge>,
    /// Edges that leave, and that enter, each vertex.
    adjacent: [Vec<Vec<u32>>; 2],
    version: u64,
    /// Next edges from all vertices to each root.
    towards: Vec<Cached<Box<[Option<u32>]>>>,
    away: Vec<Cached<Arc<Tree>>>,
}

/// Direction in which edges are followed.
#[derive(Debug, Clone, Copy)]
enum Sense {
    /// Away from the root.
    Away = 0,
    /// Towards the root.
    Towards = 1,
}

impl Routes {
    /// Creates a network of these vertices, without edges.
    pub(crate) fn new(vertices: Vec<Vertex>) -> Self {
        let count = vertices.len();
        Self {
            vertices,
            edges: Vec::new(),
            adjacent: std::array::from_fn(|_| vec![Vec::new(); count]),
            version: 0,
            towards: vec![None; count],
            away: vec![None; count],
        }
    }

    /// Adds an edge. Edges are numbered from 0 in the order of these calls.
    pub(crate) fn connect(&mut self, from: usize, to: usize, delay: Duration) {
        let edge = self.edges.len() as u32;
        self.edges.push(Edge { ends: [from as u32, to as u32], delay_ns: delay.as_nanos() as u64 });
        self.adjacent[Sense::Away as usize][from].push(edge);
        self.adjacent[Sense::Towards as usize][to].push(edge);
        self.version += 1;
    }

    /// Changes the delay of an edge.
    pub(crate) fn set_delay(&mut self, edge: usize, delay: Duration) {
        let delay_ns = delay.as_nanos() as u64;
        if std::mem::replace(&mut self.edges[edge].delay_ns, delay_ns) != delay_ns {
            self.version += 1;
        }
    }

    /// Returns the vertex that an edge leaves.
    pub(crate) fn start(&self, edge: usize) -> usize {
        self.edges[edge].ends[0] as usize
    }

    /// Returns the vertex that an edge enters.
    pub(crate) fn end(&self, edge: usize) -> usize {
        self.edges[edge].ends[1] as usize
    }

    /// Returns the properties of a vertex.
    pub(crate) fn vertex(&self, vertex: usize) -> Vertex {
        self.vertices[vertex]
    }

    /// Returns the next edge from a vertex towards another; `None` without a wired path.
    pub(crate) fn step(&mut self, from: usize, to: usize) -> Option<usize> {
        if self.towards[to].as_ref().is_none_or(|(version, _)| *version != self.version) {
            let next = |arrival: Option<Arrival<Cost>>| arrival?.by.map(|(_, edge)| edge as u32);
            let steps = self.shortest(to, Sense::Towards).into_iter().map(next).collect();
            self.towards[to] = Some((self.version, steps));
        }
        let (_, steps) = self.towards[to].as_ref()?;
        steps[from].map(|edge| edge as usize)
    }

    /// Returns the edge of a path that leaves a vertex.
    pub(crate) fn along(&self, path: &Path, vertex: usize) -> Option<usize> {
        path.edges.iter().copied().find(|edge| self.start(*edge) == vertex)
    }

    /// Returns the edges of the shortest path between two vertices; `None` without a wired path.
    pub(crate) fn path(&self, from: usize, to: usize) -> Option<Vec<usize>> {
        let steps = self.shortest(to, Sense::Towards);
        steps[from]?;
        Some(steps_back(&steps, from).map(|(_, edge)| edge).collect())
    }

    /// Returns the tree that a frame to all hosts takes from a vertex.
    pub(crate) fn tree(&mut self, root: usize) -> Arc<Tree> {
        if let Some((version, tree)) = &self.away[root]
            && *version == self.version
        {
            return Arc::clone(tree);
        }
        let steps = self.shortest(root, Sense::Away);
        let mut branches = BTreeSet::new();
        for vertex in (0..self.vertices.len()).filter(|vertex| self.vertices[*vertex].has_port) {
            // A known branch has a known way from the root.
            let is_new = |(from, edge): &(usize, usize)| branches.insert((*from as u32, *edge as u32));
            steps_back(&steps, vertex).take_while(is_new).for_each(drop);
        }
        let tree = Arc::new(Tree { branches: branches.into_iter().collect() });
        self.away[root] = Some((self.version, Arc::clone(&tree)));
        tree
    }

    /// Returns the shortest paths between the root and all vertices. Of equal delays, fewer hops win, then the order of
    /// edges. Every step raises the cost, so no path has a loop.
    fn shortest(&self, root: usize, sense: Sense) -> Vec<Option<Arrival<Cost>>> {
        cheapest_paths(
            self.vertices.len(),
            &[(root, (0, 0, 0))],
            |vertex| self.vertices[vertex].forwards,
            |vertex, (so_far, hops, _): Cost| {
                self.adjacent[sense as usize][vertex].iter().map(move |&i| {
                    let Edge { ends, delay_ns } = &self.edges[i as usize];
                    (ends[1 - sense as usize] as usize, i as usize, (so_far + delay_ns, hops + 1, i))
                })
            },
        )
    }
}
