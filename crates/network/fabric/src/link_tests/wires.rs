//! The fabric's probes for a shell with sockets at both ends of real links. There are no robots, and reading a packet takes
//! time.

use cotorra_graph::{Conditions, Direction, Probed, Probing, Timestamp};

use super::probes::{Crossing, ProbeTarget, Probes};
use crate::{
    frame::Frame,
    port::{RadioUnitIndex, StationIndex},
};

/// The probes of some wired links, by index.
#[derive(Debug)]
pub struct WireProbes(Probes);

impl WireProbes {
    /// Creates a component that probes nothing.
    pub fn none() -> Self {
        Self(Probes::none())
    }

    /// Probes links with these conditions, forward and backward. The first probes are spread over an interval, so that they
    /// do not come in bursts.
    pub fn new<'a>(
        settings: Probing,
        now: Timestamp,
        links: impl ExactSizeIterator<Item = [&'a Conditions; 2]>,
    ) -> Self {
        let nobody: [fn(usize) -> std::time::Duration; 0] = [];
        Self(Probes::new(settings, now, links, nobody.into_iter()))
    }

    /// Adapts the probes of a link to new conditions.
    pub fn change(&mut self, link: usize, conditions: [&Conditions; 2]) {
        self.0.change(link, conditions);
    }

    /// Returns when a probe is due, or given up.
    pub fn deadline(&self) -> Option<Timestamp> {
        self.0.deadline()
    }

    /// Returns the next probe due by `now`, and the link that it crosses, forward. Call it until it returns `None`.
    pub fn poll(&mut self, now: Timestamp) -> Option<(usize, Frame)> {
        let no_robot = |_: StationIndex| -> Option<RadioUnitIndex> { None };
        // A probe that is only given up leaves no packet.
        while self.deadline().is_some_and(|at| at <= now) {
            if let Some((ProbeTarget::Wire(link), frame)) = self.0.poll(now, no_robot, Vec::with_capacity) {
                return Some((link, frame));
            }
        }
        None
    }

    /// Records a probe that left one direction of a link at `received`, and builds the answer as of `now`. `None` if the
    /// probe is damaged or of no current session.
    pub fn crossed(
        &mut self,
        received: Timestamp,
        now: Timestamp,
        (link, direction): (usize, Direction),
        frame: Frame,
    ) -> Option<Crossing> {
        self.0.crossed(received, now, (ProbeTarget::Wire(link), direction), frame)
    }

    /// Returns the estimates of a link's probes, forward and backward; `None` until the first probe was answered or given
    /// up.
    pub fn probed(&self, now: Timestamp, link: usize) -> Option<[Probed; 2]> {
        self.0.probed(now, ProbeTarget::Wire(link))
    }
}
