//! Packets of tests.

use cotorra_graph::Timestamp;

use super::{ClassKey, Queued};
use crate::port::PortId;

/// A packet of a flow, with its number in it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct TestPacket {
    pub flow: u64,
    pub number: u32,
    pub bytes: u64,
    pub entered: Timestamp,
    pub is_capable: bool,
    pub is_marked: bool,
}

impl Queued for TestPacket {
    fn entered(&self) -> Timestamp {
        self.entered
    }
    fn packets(&self) -> u32 {
        1
    }
    fn bytes(&self) -> u64 {
        self.bytes
    }
    fn flow(&self) -> u64 {
        self.flow
    }
    /// Flows from 100 on have a class each.
    fn class(&self) -> Option<ClassKey> {
        (self.flow >= 100).then_some([PortId(self.flow as usize); 2])
    }
    fn mark(&mut self) -> bool {
        self.is_marked |= self.is_capable;
        self.is_capable
    }
}

/// Returns a packet of 1000 bytes of flow 0.
pub(super) fn packet(number: u32, entered: Timestamp) -> TestPacket {
    TestPacket { flow: 0, number, bytes: 1000, entered, is_capable: false, is_marked: false }
}

pub(super) fn ms(ms: f64) -> Timestamp {
    Timestamp::from_nanos((ms * 1e6).round() as u64)
}
