//! Radios that are not the fabric's, at the antennas of its robots and radio units.

use cotorra_graph::{NodeId, Timestamp};

use super::{ByAir, Fabric, Reach};
use crate::{
    frame::Frame,
    port::PortId,
    radio::{Antenna, Association, Report, Transmission},
    routes::Target,
    settings::FabricError,
};

impl Fabric {
    /// Lends the antenna of a robot or a radio unit to a radio that is not the fabric's, for good. The fabric's own radio
    /// there is silent from then on: it attaches to nothing, and nothing attaches to it.
    ///
    /// The fabric does not read the frames of the radios. A program that bridges a radio unit's radio to
    /// its port brings the robot's packets there. A packet that comes to the port of a radio unit whose antenna is lent, from
    /// the address of a robot whose antenna is lent, is the robot's. Packets to the robot leave at the port at which its own
    /// came in last, or of the radio unit that it was [associated](Self::associate) with since.
    ///
    /// # Errors
    /// [`FabricError`] for a node without an antenna, one that is lent already, or a network whose senders take turns.
    pub fn lend_antenna(&mut self, now: Timestamp, node: &NodeId) -> Result<Antenna, FabricError> {
        let now = self.advance(now);
        let done = self.radio.lend(now, node);
        self.radio_deadline = self.radio.deadline();
        if let (Ok(_), Some(port)) = (&done, self.port(node)) {
            self.ports[port.0].lend_antenna();
        }
        done
    }

    /// Records that a robot is associated with a radio unit, both of which have lent antennas: the event `Handover` reports it.
    /// The robot counts as attached to it in all that the fabric reports. Does nothing if it is associated with it
    /// already.
    ///
    /// # Errors
    /// [`FabricError`] for an unknown robot or radio unit, antennas that are not lent, or two networks.
    pub fn associate(
        &mut self,
        now: Timestamp,
        robot: &NodeId,
        radio_unit: &NodeId,
        association: Association,
    ) -> Result<(), FabricError> {
        let now = self.advance(now);
        self.radio.associate_lent(now, robot, radio_unit, association)?;
        self.set_behind(robot, self.port(radio_unit));
        Ok(())
    }

    /// Records that a robot whose antenna is lent has lost its radio unit: the event `Detached` reports it. Packets to it are
    /// dropped until it is associated, or sends. Does nothing if it has none.
    ///
    /// # Errors
    /// [`FabricError`] for an unknown robot, or an antenna that is not lent.
    pub fn disassociate(&mut self, now: Timestamp, robot: &NodeId) -> Result<(), FabricError> {
        let now = self.advance(now);
        self.radio.disassociate_lent(now, robot)?;
        self.set_behind(robot, None);
        Ok(())
    }

    /// Records that the radio of a robot whose antenna is lent has scanned: the event `Scanned` reports it. Its attachments
    /// have the present signals of all radio units that are on.
    ///
    /// # Errors
    /// [`FabricError`] for an unknown robot, or an antenna that is not lent.
    pub fn scanned(&mut self, now: Timestamp, robot: &NodeId) -> Result<(), FabricError> {
        let now = self.advance(now);
        self.radio.scanned_lent(now, robot)
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
    /// antennas are lent: reports count for the next deadline. How late frames are reported is part of [`Self::lateness`].
    pub fn next_report(&mut self) -> Option<Report> {
        let report = self.radio.next_report(self.now)?;
        if let Report::Received { at, .. } = report {
            self.lateness.record(self.now.since(at));
        }
        Some(report)
    }

    /// Returns the sender of a frame that comes to the port of a node whose antenna is lent: the robot that has its source
    /// address, which is behind this port then.
    pub(super) fn sender(&self, port: PortId, frame: &Frame) -> PortId {
        let robot = frame.source().and_then(|source| self.assigned(source)).filter(|owner| *owner != port);
        let Some(robot) = robot else { return port };
        match self.ports[robot.0].reach {
            Reach::Robot { by: ByAir::Lent { .. }, .. } => robot,
            _ => port,
        }
    }

    /// Whether the target of a frame is behind the port that it came to.
    pub(super) fn is_back(&self, port: PortId, target: &Target) -> bool {
        matches!(target, Target::Port { port: to, .. } if self.ports[to.0].behind() == Some(port))
    }

    /// Records that nothing is behind a radio unit's port any more.
    pub(super) fn forget_behind(&mut self, radio_unit: &NodeId) {
        let gone = self.port(radio_unit);
        self.ports.iter_mut().filter(|port| port.behind() == gone).for_each(|port| port.set_behind(None));
    }

    fn set_behind(&mut self, robot: &NodeId, port: Option<PortId>) {
        if let Some(PortId(robot)) = self.port(robot) {
            self.ports[robot].set_behind(port);
        }
    }
}
