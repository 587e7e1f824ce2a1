//! Sources of frames: hosts send from their own addresses only.

use cotorra_graph::NodeId;

use super::Fabric;
use crate::{frame::Frame, port::PortId, port_security::ForgedFrames};

/// Frames of one host that named another sender.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ForgedSources {
    /// The host.
    pub node: NodeId,
    /// Whether they were delivered, because the host has no [port security](Fabric::disable_port_security).
    pub allowed: bool,
    /// How many.
    pub frames: ForgedFrames,
}

impl Fabric {
    /// Delivers frames from a host's port, from now on, whatever sender they name: the host has other addresses than its own, such
    /// as those of virtual machines. Does nothing for an unknown node.
    pub fn disable_port_security(&mut self, node: &NodeId) {
        if let Some(port) = self.port(node) {
            self.ports[port.0].is_secure = false;
        }
    }

    /// Returns the frames that named another sender than the host at their port, of each host that sent some, in the graph's
    /// order.
    pub fn forged_sources(&self) -> Vec<ForgedSources> {
        let forging = self.ports.iter().filter(|port| port.forged != ForgedFrames::default());
        let sources = |port: &super::Port| ForgedSources {
            node: port.node.clone(),
            allowed: !port.is_secure,
            frames: port.forged,
        };
        forging.map(sources).collect()
    }

    /// Whether a frame that came to a port may enter. Counts it if it names another sender.
    pub(super) fn admits(&mut self, port: PortId, sender: PortId, frame: &Frame) -> bool {
        let Some(identity) = &self.ports[sender.0].identity else { return true };
        let Some(forgery) = identity.forgery(frame.bytes()) else { return true };
        let port = &mut self.ports[port.0];
        port.forged.count(forgery, frame.wire_packets());
        !port.is_secure
    }
}
