//! Shortest paths over G, for whoever maps virtual links or asks what a placement can reach at best.
//! Only switches and radio units forward; hosts are where paths begin and end.

use std::{collections::HashMap, time::Duration};

use crate::{
    hardware::{HardwareGraph, NodeKind},
    id::{LinkId, NodeId},
    search::{Arrival, cheapest_paths, steps_back},
};

/// A path from one node to another.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Route {
    /// The links, in order; none from a node to itself.
    pub links: Vec<LinkId>,
    /// Sum of their delays in that direction, as the testbed file has them.
    pub delay: Duration,
}

impl HardwareGraph {
    /// The path of least delay from one node to another; of equals, the one with fewer hops, then the one whose
    /// nodes and links come first in the file. `attached` says to which radio unit a robot is attached: that wireless
    /// link is the only one that it has. `None` if there is no path, or no such node.
    pub fn route<'a>(
        &'a self,
        from: &NodeId,
        to: &NodeId,
        attached: impl Fn(&NodeId) -> Option<&'a NodeId>,
    ) -> Option<Route> {
        let mut topology = Topology::new(self);
        // Robots forward nothing, so that only those at the ends matter.
        for robot in [from, to] {
            if let Some(unit) = attached(robot) {
                topology.attach(robot, unit);
            }
        }
        let (from, to) = (topology.place(from)?, topology.place(to)?);
        let tree = topology.search(&[(from, 0)], Edge::delay_ns);
        let (delay_ns, _) = tree[to]?.cost;
        let mut links: Vec<_> = steps_back(&tree, to).map(|(at, edge)| topology.link_id(at, edge)).collect();
        links.reverse();
        Some(Route { links, delay: Duration::from_nanos(delay_ns) })
    }
}

fn nanos(delay: Duration) -> u64 {
    u64::try_from(delay.as_nanos()).unwrap_or(u64::MAX)
}

/// G as adjacency lists, to find paths of least cost. Nodes go by their places in [`HardwareGraph::nodes`].
#[derive(Debug)]
pub struct Topology<'a> {
    graph: &'a HardwareGraph,
    places: HashMap<&'a str, usize>,
    edges: Vec<Vec<Edge>>,
}

/// One direction of a link, from the node that lists it.
#[derive(Debug, Clone, Copy)]
pub struct Edge {
    to: usize,
    delay_ns: u64,
    /// Place in the graph's links; `None` for a wireless one.
    wired: Option<usize>,
}

impl Edge {
    /// The link's delay.
    pub fn delay_ns(&self) -> u64 {
        self.delay_ns
    }

    /// The link's place in [`HardwareGraph::links`]; `None` for a wireless one.
    pub fn wired(&self) -> Option<usize> {
        self.wired
    }
}

/// Cost of a path: the sum over its edges, then its hops.
type Cost = (u64, u32);

impl<'a> Topology<'a> {
    /// G with its wired links.
    pub fn new(graph: &'a HardwareGraph) -> Self {
        let places: HashMap<_, _> = graph.nodes.iter().enumerate().map(|(i, n)| (n.id.as_str(), i)).collect();
        let mut edges = vec![Vec::new(); graph.nodes.len()];
        for (i, link) in graph.links.iter().enumerate() {
            let [a, b] = link.ends.each_ref().map(|end| places[end.as_str()]);
            edges[a].push(Edge { to: b, delay_ns: nanos(link.forward.delay), wired: Some(i) });
            edges[b].push(Edge { to: a, delay_ns: nanos(link.backward.delay), wired: Some(i) });
        }
        Self { graph, places, edges }
    }

    /// Adds the wireless link between a robot and a radio unit of its network; nothing where they are none, or it is
    /// there already.
    pub fn attach(&mut self, robot: &NodeId, unit: &NodeId) {
        let (Some(r), Some(u)) = (self.place(robot), self.place(unit)) else { return };
        let (NodeKind::Robot(hardware), NodeKind::RadioUnit(radio)) =
            (&self.graph.nodes[r].kind, &self.graph.nodes[u].kind)
        else {
            return;
        };
        let Some(network) = self.graph.wireless.get(&hardware.network) else { return };
        if radio.network == hardware.network && !self.edges[r].iter().any(|edge| edge.to == u) {
            let delay_ns = nanos(network.delay);
            self.edges[r].push(Edge { to: u, delay_ns, wired: None });
            self.edges[u].push(Edge { to: r, delay_ns, wired: None });
        }
    }

    /// Removes a robot's wireless links.
    pub fn detach(&mut self, robot: &NodeId) {
        let Some(r) = self.place(robot) else { return };
        let (wireless, wired) = self.edges[r].drain(..).partition::<Vec<_>, _>(|edge| edge.wired.is_none());
        self.edges[r] = wired;
        for edge in wireless {
            self.edges[edge.to].retain(|back| back.to != r || back.wired.is_some());
        }
    }

    /// The place of a node among the graph's.
    pub fn place(&self, id: &NodeId) -> Option<usize> {
        self.places.get(id.as_str()).copied()
    }

    /// The nodes that a node is linked to, in order.
    pub fn neighbours(&self, at: usize) -> Vec<usize> {
        let mut all: Vec<_> = self.edges[at].iter().map(|edge| edge.to).collect();
        all.sort_unstable();
        all
    }

    /// The link of an edge, by its place among those of its node.
    fn link_id(&self, from: usize, edge: usize) -> LinkId {
        let edge = self.edges[from][edge];
        match edge.wired {
            Some(i) => self.graph.links[i].id.clone(),
            None => {
                let (a, b) = (&self.graph.nodes[from], &self.graph.nodes[edge.to]);
                if matches!(a.kind, NodeKind::Robot(_)) {
                    LinkId::wireless(&a.id, &b.id)
                } else {
                    LinkId::wireless(&b.id, &a.id)
                }
            }
        }
    }

    /// Returns the cost of the cheapest path to each node from any of the sources, each with its initial cost; `None`
    /// without a path. Paths go on from sources, and from nodes that forward.
    pub fn shortest(&self, sources: &[(usize, u64)], cost: impl Fn(&Edge) -> u64) -> Vec<Option<u64>> {
        self.search(sources, cost).into_iter().map(|reached| reached.map(|path| path.cost.0)).collect()
    }

    fn search(&self, sources: &[(usize, u64)], cost: impl Fn(&Edge) -> u64) -> Vec<Option<Arrival<Cost>>> {
        let sources: Vec<_> = sources.iter().map(|&(at, cost)| (at, (cost, 0))).collect();
        let cost = &cost;
        cheapest_paths(
            self.edges.len(),
            &sources,
            |node| self.graph.nodes[node].forwards(),
            |at, (so_far, hops): Cost| {
                let onward = move |edge: &Edge| (so_far.saturating_add(cost(edge)), hops + 1);
                self.edges[at].iter().enumerate().map(move |(i, edge)| (edge.to, i, onward(edge)))
            },
        )
    }
}
