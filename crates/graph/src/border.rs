//! The border of a core: where it meets the cores of other domains.

use std::net::SocketAddr;

use crate::id::NodeId;

/// The border between this core's emulated network and those of other cores.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Border {
    /// Server at which packets of a robot enter and leave the wired network while the robot is with another core.
    pub node: NodeId,
    /// Address of this machine at which other cores reach this one.
    pub address: SocketAddr,
    /// Robots that stand for robots of other cores while these are attached to radio units here.
    pub visitors: Vec<NodeId>,
}

impl Border {
    /// Most visitors.
    pub const MOST_VISITORS: usize = 64;
}
