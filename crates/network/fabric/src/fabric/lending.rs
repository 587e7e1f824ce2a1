//! Radios that are none of the fabric's, at the antennas of its robots and radio units.

use cotorra_graph::{NodeId, Timestamp};

use super::Fabric;
use crate::{
    radio::{Antenna, Report, Transmission},
    settings::FabricError,
};

impl Fabric {
    /// Lends the antenna of a robot or a radio unit to a radio that is none of the fabric's, for good. The fabric's own radio
    /// there is silent from then on: it attaches to nothing, and nothing attaches to it.
    ///
    /// What the radios carry in their frames is none of the fabric's business. A program that bridges a radio unit's radio to
    /// its port brings the robot's packets there: the fabric learns the address of a robot whose antenna is lent from the
    /// packets that ports send, as it learns foreign ones. No path is [pinned](Self::pin) for them.
    ///
    /// # Errors
    /// [`FabricError`] for a node without an antenna, one that is lent already, or a network whose senders take turns.
    pub fn lend_antenna(&mut self, now: Timestamp, node: &NodeId) -> Result<Antenna, FabricError> {
        let now = self.advance(now);
        let done = self.radio.lend(now, node);
        self.radio_deadline = self.radio.deadline();
        if let (Ok(_), Some(port)) = (&done, self.port(node)) {
            self.ports[port.0].is_lent = true;
        }
        done
    }

    /// Sends a frame from a lent antenna. [`Self::next_report`] reports who received it, and that its last try is over.
    ///
    /// The antenna listens on the channel of the last frame that it sent. Frames for another channel wait until all before
    /// them are settled.
    pub fn transmit(&mut self, now: Timestamp, from: Antenna, transmission: Transmission) {
        let now = self.advance(now);
        self.radio.transmit(now, from, transmission);
        self.radio_deadline = self.radio.deadline();
    }

    /// Records that a lent antenna does not listen on its channel: its radio is off, or on another channel. It acknowledges
    /// nothing until it sends again.
    pub fn stop_listening(&mut self, now: Timestamp, antenna: Antenna) {
        let now = self.advance(now);
        self.radio.stop_listening(now, antenna);
        self.radio_deadline = self.radio.deadline();
    }

    /// Returns the next report of lent antennas, oldest first. Call it until there is none after each [`Self::poll`] if
    /// antennas are lent: reports count for the next deadline.
    pub fn next_report(&mut self) -> Option<Report> {
        self.radio.next_report(self.now)
    }
}
