//! The fabric's probes for a shell that has sockets at both ends of real links: no robots, and packets that take time to
//! be read.

use cotorra_graph::{Conditions, Direction, Probed, Probing, Timestamp};
use cotorra_stamp::{BASE_LENGTH, LinkEstimate, SessionConfig};

use super::{
    packet::HEADERS,
    probes::{Crossing, ProbeTarget, Probes, probed, wired},
};
use crate::{
    frame::Frame,
    port::{RadioUnitIndex, StationIndex},
};

/// The probes of some wired links, each known by its place.
#[derive(Debug)]
pub struct WireProbes(Probes);

impl WireProbes {
    /// Octets of the Ethernet frame that a probe is.
    pub const BYTES: usize = HEADERS + BASE_LENGTH;

    /// How a link is probed of which only one end is within reach: so that probes take no more than 1 % of its rate.
    pub fn session(settings: &Probing, conditions: [&Conditions; 2]) -> SessionConfig {
        wired(settings, conditions)
    }

    /// What the probes of such a link tell of one direction.
    pub fn told(told: LinkEstimate) -> Probed {
        probed(told)
    }

    /// No probes at all.
    pub fn none() -> Self {
        Self(Probes::none())
    }

    /// Probes of links with these conditions, forward and backward. They begin one after the other, so that they do not
    /// come in bursts.
    pub fn new<'a>(
        settings: Probing,
        now: Timestamp,
        links: impl ExactSizeIterator<Item = [&'a Conditions; 2]>,
    ) -> Self {
        let nobody: [fn(usize) -> std::time::Duration; 0] = [];
        Self(Probes::new(settings, now, links, nobody.into_iter()))
    }

    /// A link has other conditions.
    pub fn change(&mut self, link: usize, conditions: [&Conditions; 2]) {
        self.0.change(link, conditions);
    }

    /// When there is something to do.
    pub fn deadline(&self) -> Option<Timestamp> {
        self.0.deadline()
    }

    /// The next probe that is due by then, and the link that it goes over, forward. Call it until there is none.
    pub fn poll(&mut self, now: Timestamp) -> Option<(usize, Frame)> {
        let no_robot = |_: StationIndex| -> Option<RadioUnitIndex> { None };
        // One that is only given up leaves no packet.
        while self.deadline().is_some_and(|at| at <= now) {
            if let Some((ProbeTarget::Wire(link), frame)) = self.0.poll(now, no_robot, Vec::with_capacity) {
                return Some((link, frame));
            }
        }
        None
    }

    /// A probe came out of a direction of a link when it was `received`, and its answer goes back `now`. `None` if it is
    /// damaged, or nobody's.
    pub fn crossed(
        &mut self,
        received: Timestamp,
        now: Timestamp,
        (link, direction): (usize, Direction),
        frame: Frame,
    ) -> Option<Crossing> {
        self.0.crossed(received, now, (ProbeTarget::Wire(link), direction), frame)
    }

    /// What the probes of a link tell, forward and backward; `None` before it is known of the first what became of it.
    pub fn probed(&self, now: Timestamp, link: usize) -> Option<[Probed; 2]> {
        self.0.probed(now, ProbeTarget::Wire(link))
    }
}
