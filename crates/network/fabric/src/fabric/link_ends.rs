//! Ends of wired links as ports of their own, for traffic that loads a link whatever nodes are there.

use cotorra_graph::{LinkId, Timestamp};

use super::Fabric;
use crate::{
    frame::Frame,
    pipe::{Packet, Purpose},
    port::PortId,
};

impl Fabric {
    /// Returns the ports of a wired link's first and second end. A frame that is pushed at one of them crosses the link as all
    /// others do, is in its counters, and is delivered at the other. No node sees it.
    pub fn link_ends(&self, link: &LinkId) -> Option<[PortId; 2]> {
        let first = self.ports.len() + 2 * self.link_by_name.get(link)?;
        Some([PortId(first), PortId(first + 1)])
    }

    /// Returns the edge that leaves an end of a link; `None` for other ports.
    pub(super) fn edge_from(&self, port: PortId) -> Option<usize> {
        port.0.checked_sub(self.ports.len()).filter(|edge| *edge < self.pipes.len())
    }

    /// Sends a checked frame over an edge.
    pub(super) fn push_at_end(&mut self, now: Timestamp, edge: usize, frame: Frame) {
        self.balance.sent += u64::from(frame.wire_packets());
        self.cross(now, edge, Packet::new(frame, Purpose::FromEndToEnd, now));
    }

    /// Delivers a frame at the end of the edge that it crossed.
    pub(super) fn deliver_at_end(&mut self, now: Timestamp, edge: usize, frame: Frame) {
        // The edge of the other direction leaves there.
        self.outbox.push_back((now, PortId(self.ports.len() + (edge ^ 1)), frame));
    }
}
