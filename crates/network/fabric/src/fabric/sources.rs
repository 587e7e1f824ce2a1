//! Sources of frames: hosts send from their own addresses only.

use cotorra_graph::NodeId;

use super::{Fabric, Sources};
use crate::{frame::Frame, port::PortId, port_security::ForgedFrames};

/// Frames of one host that named another sender.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ForgedSources {
    /// The host.
    pub node: NodeId,
    /// Whether they were delivered, because the host has no [port security](Fabric::disable_port_security).
    pub allowed: bool,
    /// Their number.
    pub frames: ForgedFrames,
}

impl Fabric {
    /// Delivers frames from a host's port, from now on, whatever sender they name: the host has other addresses than its own, such
    /// as those of virtual machines. Does nothing for an unknown node.
    pub fn disable_port_security(&mut self, node: &NodeId) {
        if let Some(port) = self.port(node)
            && let Sources::Own { others_pass, .. } = &mut self.ports[port.0].sources
        {
            *others_pass = true;
        }
    }

    /// Returns the frames that named another sender than the host at their port, of each host that sent some, in the graph's
    /// order.
    pub fn forged_sources(&self) -> Vec<ForgedSources> {
        let sources = |port: &super::Port| match port.sources {
            Sources::Own { others_pass, forged, .. } if forged != ForgedFrames::default() => {
                Some(ForgedSources { node: port.node.clone(), allowed: others_pass, frames: forged })
            }
            Sources::Own { .. } | Sources::Any => None,
        };
        self.ports.iter().filter_map(sources).collect()
    }

    /// Whether a frame that came to a port may enter. Counts it if it names another sender.
    pub(super) fn admits(&mut self, port: PortId, sender: PortId, frame: &Frame) -> bool {
        let identity = self.ports[sender.0].identity();
        let Some(forgery) = identity.and_then(|its| its.forgery(frame.bytes())) else { return true };
        match &mut self.ports[port.0].sources {
            Sources::Any => true,
            Sources::Own { others_pass, forged, .. } => {
                forged.count(forgery, frame.wire_packets());
                *others_pass
            }
        }
    }
}
