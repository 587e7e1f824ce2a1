//! Packets in the order in which they came, and their bytes.

use std::collections::VecDeque;

use super::Queued;

/// Packets in the order in which they came.
#[derive(Debug)]
pub(super) struct Fifo<P> {
    packets: VecDeque<P>,
    bytes: u64,
}

impl<P> Default for Fifo<P> {
    fn default() -> Self {
        Self { packets: VecDeque::new(), bytes: 0 }
    }
}

impl<P: Queued> Fifo<P> {
    /// Returns the bytes of all packets.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    pub fn push(&mut self, packet: P) {
        self.bytes += packet.bytes();
        self.packets.push_back(packet);
    }

    pub fn pop(&mut self) -> Option<P> {
        let packet = self.packets.pop_front()?;
        self.bytes -= packet.bytes();
        Some(packet)
    }

    pub fn iter(&self) -> impl Iterator<Item = &P> {
        self.packets.iter()
    }

    /// Takes all packets out.
    pub fn drain(&mut self) -> impl Iterator<Item = P> {
        self.bytes = 0;
        self.packets.drain(..)
    }
}
