//! The containers of a testbed.

use std::collections::BTreeMap;

use crate::{container::EngineKind, id::NodeId, service::Vnf};

/// The containers of a testbed: the engines of its nodes, and the nodes that are containers as a whole.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Containers {
    /// Engine of all nodes without one of their own.
    pub engine: EngineKind,
    /// Engines of nodes that have one of their own.
    pub engines: BTreeMap<NodeId, EngineKind>,
    /// The images of nodes that are containers as a whole. Each is a VNF of the program [`Host`](crate::Program::Host) that is
    /// pinned to its node and has the node's name.
    pub hosts: Vec<Vnf>,
}

impl Containers {
    /// Returns the engine that runs images on a node.
    pub fn engine(&self, node: &NodeId) -> EngineKind {
        self.engines.get(node).copied().unwrap_or(self.engine)
    }
}
