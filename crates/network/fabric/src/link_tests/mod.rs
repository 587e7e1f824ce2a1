//! Active measurement of links: STAMP probes and throughput tests. Their packets cross links as any others do, and are in
//! no counter.

mod packet;
mod probes;
mod throughput;
mod wires;

use std::time::Duration;

use cotorra_graph::{
    Conditions, Direction, LinkId, Probed, Probing, Rate, Tested, ThroughputTest, Timestamp,
};

use self::probes::Probes;
use crate::{
    frame::Frame,
    port::{RadioUnitIndex, StationIndex},
    settings::FabricError,
};

pub(crate) use self::probes::ProbeTarget;
pub use self::{
    packet::MEASURING_ETHERTYPE, probes::Crossing, throughput::ThroughputTests, wires::WireProbes,
};

/// The probes and throughput tests of all links.
#[derive(Debug)]
pub(crate) struct LinkTests {
    probes: Probes,
    throughput: ThroughputTests,
}

impl LinkTests {
    /// Creates the tests of `edges` directions of wired links. Nothing is probed before [`Self::probe`].
    pub(crate) fn new(edges: usize) -> Self {
        Self { probes: Probes::none(), throughput: ThroughputTests::new(edges) }
    }

    /// Probes all links from now on. `stations` give how long a frame of a size keeps the channel of each robot busy if
    /// every robot sends one.
    pub(crate) fn probe<'a, T: FnOnce(usize) -> Duration>(
        &mut self,
        settings: Probing,
        now: Timestamp,
        wires: impl ExactSizeIterator<Item = [&'a Conditions; 2]>,
        stations: impl ExactSizeIterator<Item = T>,
    ) {
        self.probes = Probes::new(settings, now, wires, stations);
    }

    /// Adapts the probes of a wired link to new conditions, forward and backward.
    pub(crate) fn change(&mut self, link: usize, conditions: [&Conditions; 2]) {
        self.probes.change(link, conditions);
    }

    /// Starts a throughput test; see [`ThroughputTests::begin`].
    pub(crate) fn begin_test(
        &mut self,
        now: Timestamp,
        edge: (usize, &LinkId),
        test: ThroughputTest,
        rate: &Rate,
    ) -> Result<(), FabricError> {
        self.throughput.begin(now, edge, test, rate)
    }

    /// Returns when the next packet is due, or a probe is given up.
    pub(crate) fn deadline(&self) -> Option<Timestamp> {
        self.probes.deadline().into_iter().chain(self.throughput.deadline()).min()
    }

    /// Returns the next probe due by `now` and the link that it crosses, forward. `linked` gives the radio unit of a
    /// robot's present link.
    pub(crate) fn poll_probe(
        &mut self,
        now: Timestamp,
        linked: impl FnOnce(StationIndex) -> Option<RadioUnitIndex>,
        buffer: impl FnOnce(usize) -> Vec<u8>,
    ) -> Option<(ProbeTarget, Frame)> {
        self.probes.poll(now, linked, buffer)
    }

    /// Returns the next packet of a throughput test due by `now`, and the edge that it crosses.
    pub(crate) fn poll_test(
        &mut self,
        now: Timestamp,
        buffer: impl FnOnce(usize) -> Vec<u8>,
    ) -> Option<(usize, Frame)> {
        self.throughput.poll(now, buffer)
    }

    /// Records a probe that crossed one direction of a link, and returns the answer to send back if it was on its way
    /// there.
    pub(crate) fn probe_crossed(
        &mut self,
        now: Timestamp,
        way: (ProbeTarget, Direction),
        frame: Frame,
    ) -> Option<Frame> {
        self.probes.crossed(now, now, way, frame)?.answer
    }

    /// Records a packet of a throughput test that crossed an edge.
    pub(crate) fn test_crossed(&mut self, now: Timestamp, edge: usize) {
        self.throughput.crossed(now, edge);
    }

    /// Returns the estimates of a link's probes, forward and backward; see [`Probes::probed`].
    pub(crate) fn probed(&self, now: Timestamp, target: ProbeTarget) -> Option<[Probed; 2]> {
        self.probes.probed(now, target)
    }

    /// Returns the result of the last throughput test of an edge.
    pub(crate) fn tested(&self, now: Timestamp, edge: usize) -> Option<Tested> {
        self.throughput.tested(now, edge)
    }
}
