//! Robots that are attached to a radio unit of another core. Their frames leave this fabric there, and those to them leave at
//! the border: a host of the wired network. The other core carries both, and returns them at the other end.

use cotorra_graph::{Dbm, Direction, LostCause, NodeId, Timestamp};

use super::Fabric;
use crate::{frame::Frame, port::PortId, routes::Target, settings::FabricError};

/// A packet for the core whose radio unit a robot is attached to.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Departure {
    /// The robot.
    pub robot: NodeId,
    /// Forward from the robot, backward to it.
    pub direction: Direction,
    /// An Ethernet frame without offloads.
    pub bytes: Vec<u8>,
}

impl Fabric {
    /// Records that a robot went to a radio unit elsewhere, of that mobility domain, until it attaches to one of this graph.
    /// With a border, its frames depart from now on, and those to it depart at the border. Without one, it is silent.
    ///
    /// # Errors
    /// [`FabricError`] for an unknown robot or border, or a robot that scans or changes its radio unit.
    pub fn depart(
        &mut self,
        now: Timestamp,
        robot: &NodeId,
        mobility_domain: u16,
        border: Option<&NodeId>,
    ) -> Result<(), FabricError> {
        let now = self.advance(now);
        let port = self.port(robot).ok_or_else(|| FabricError::UnknownRobot(robot.clone()))?;
        let border = border.map(|border| {
            self.vertices.get(border).copied().ok_or_else(|| FabricError::UnknownBorder(border.clone()))
        });
        let border = border.transpose()?;
        let done = self.radio.depart(now, robot, mobility_domain);
        self.radio_deadline = self.radio.deadline();
        done?;
        self.ports[port.0].set_border(border);
        Ok(())
    }

    /// Records that a robot lost its radio unit elsewhere. It scans for one of this graph.
    ///
    /// # Errors
    /// [`FabricError`] for an unknown robot, or one that is not elsewhere.
    pub fn come_back(&mut self, now: Timestamp, robot: &NodeId) -> Result<(), FabricError> {
        let now = self.advance(now);
        let done = self.radio.come_back(now, robot);
        self.radio_deadline = self.radio.deadline();
        done?;
        self.leave_border(robot);
        Ok(())
    }

    /// Returns the signal of a radio unit at a robot; `None` if it is off, or out of reach.
    ///
    /// # Errors
    /// [`FabricError`] for an unknown robot or radio unit.
    pub fn reach(&self, robot: &NodeId, radio_unit: &NodeId) -> Result<Option<Dbm>, FabricError> {
        self.radio.reach(robot, radio_unit)
    }

    /// Returns the next packet for another core, oldest first. Call it after [`Self::poll`] if robots depart.
    pub fn next_departure(&mut self) -> Option<Departure> {
        self.departures.pop_front()
    }

    /// Takes a packet that another core carried: forward from a robot to the border, backward to the robot. Call
    /// [`Self::poll`] afterwards. It is dropped if the robot is not there any more, or is not its sender or receiver: the
    /// other core speaks for that robot only.
    pub fn arrive(&mut self, now: Timestamp, Departure { robot, direction, bytes }: Departure) {
        let now = self.advance(now);
        self.balance.sent += 1;
        let frame = Frame::new(bytes);
        let port = self.port(&robot).and_then(|port| Some((port, self.ports[port.0].border()?)));
        let Some((port, border)) = port else { return self.drop_unroutable(frame) };
        let is_of = |address: Option<[u8; 6]>| address.and_then(|own| self.owner(own)) == Some(port);
        match direction {
            Direction::Forward if self.is_from(&frame, port) => {
                self.cross_border(now, port, border, frame);
            }
            Direction::Backward
                if is_of(frame.destination()) || frame.destination().is_some_and(|to| to[0] & 1 == 1) =>
            {
                self.outbox.push_back((now, port, frame));
            }
            _ => self.drop_unroutable(frame),
        }
    }

    /// Forwards a frame from the border on.
    fn cross_border(&mut self, now: Timestamp, port: PortId, border: usize, frame: Frame) {
        let Some(target) = self.target(port, border, &frame) else { return self.drop_unroutable(frame) };
        let here = self.port_of_vertex[border];
        match &target {
            Target::Port { port, .. } if here == Some(*port) => self.outbox.push_back((now, *port, frame)),
            Target::Port { .. } => self.leave(now, border, frame, target),
            Target::All { .. } => {
                if let Some(here) = here {
                    let copy = frame.copy(&mut self.pool);
                    self.outbox.push_back((now, here, copy));
                }
                self.depart_copies(border, port, &frame);
                self.leave(now, border, frame, target);
            }
        }
        self.settle(now);
    }

    /// Hands a robot's frame to the other core, as single packets.
    pub(super) fn depart_frame(&mut self, port: PortId, direction: Direction, mut frame: Frame) {
        frame.end(None, LostCause::OtherCore);
        if let Some(trace) = frame.take_trace() {
            self.pool.ended(trace);
        }
        let (departures, balance) = (&mut self.departures, &mut self.balance);
        let robot = &self.ports[port.0].node;
        let each = |mut packet: Frame| {
            balance.delivered += 1;
            packet.complete_checksum().expect("a frame's offload is checked where it enters the fabric");
            departures.push_back(Departure { robot: robot.clone(), direction, bytes: packet.into_bytes() });
        };
        frame
            .segment_with(&mut self.pool, each)
            .expect("a frame's offload is checked where it enters the fabric");
    }

    /// Hands copies of a frame to all hosts to the robots that are reached over a border.
    pub(super) fn depart_copies(&mut self, vertex: usize, source: PortId, frame: &Frame) {
        for port in (0..self.hosts).map(PortId) {
            if port != source && self.ports[port.0].border() == Some(vertex) {
                let copy = frame.copy(&mut self.pool);
                self.depart_frame(port, Direction::Backward, copy);
            }
        }
    }

    /// Whether a frame names a host as its sender, by each address in it. Other protocols than IP and ARP name none.
    fn is_from(&self, frame: &Frame, host: PortId) -> bool {
        let is_named = matches!(frame.bytes().get(12..14), Some([0x08, 0x00 | 0x06] | [0x86, 0xdd]));
        let identity = self.ports[host.0].identity();
        is_named && identity.is_some_and(|host| host.forgery(frame.bytes()).is_none())
    }

    /// Records that a robot is reached by radio again.
    pub(super) fn leave_border(&mut self, robot: &NodeId) {
        if let Some(port) = self.port(robot) {
            self.ports[port.0].set_border(None);
        }
    }
}
