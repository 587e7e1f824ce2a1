//! Conservation of packets: the outcomes of all packets that hosts sent.

use std::ops::AddAssign;

/// The outcome of all packets that hosts sent, counted as they are on the wire. Packets that only measure are left out. A
/// frame to many hosts becomes many packets, which makes the balance uneven.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Balance {
    /// Packets that hosts sent.
    pub sent: u64,
    /// Packets that links duplicated.
    pub duplicated: u64,
    /// Packets that hosts received.
    pub delivered: u64,
    /// Packets that links lost.
    pub lost: u64,
    /// Packets that queues dropped.
    pub overflowed: u64,
    /// Packets without a path, or from a sender without a carrier.
    pub stranded: u64,
    /// Packets in queues and on links.
    pub under_way: u64,
}

impl Balance {
    /// Whether every packet has an outcome, and none was invented.
    pub const fn is_even(&self) -> bool {
        let ended = self.delivered + self.lost + self.overflowed + self.stranded;
        self.sent + self.duplicated == ended + self.under_way
    }
}

impl AddAssign for Balance {
    fn add_assign(&mut self, other: Self) {
        self.sent += other.sent;
        self.duplicated += other.duplicated;
        self.delivered += other.delivered;
        self.lost += other.lost;
        self.overflowed += other.overflowed;
        self.stranded += other.stranded;
        self.under_way += other.under_way;
    }
}

impl From<cotorra_graph::LinkCounters> for Balance {
    /// Counts the packets that one direction of a link lost, dropped or duplicated.
    fn from(counters: cotorra_graph::LinkCounters) -> Self {
        let cotorra_graph::LinkCounters { lost, overflowed, duplicated, .. } = counters;
        Self { lost, overflowed, duplicated, ..Self::default() }
    }
}
