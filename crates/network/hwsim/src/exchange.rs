//! A medium at its socket.

use std::{
    fmt, io,
    os::fd::{AsFd, BorrowedFd},
};

use cotorra_fabric::{Fabric, FabricError};
use cotorra_graph::{NodeId, Timestamp};

use crate::{
    address::MacAddress,
    medium::{Medium, TryCounts},
    message::Message,
    socket::{Incoming, MediumSocket},
};

/// Most messages that are taken at a time.
const BATCH: usize = 64;

/// Carries messages between the kernel's radios and the fabric's air, with few system calls.
///
/// Wait until the socket is readable or the fabric's deadline has come. Then [take](Self::receive) what the kernel has sent, or
/// record that [nothing waits](Self::nothing_waits); poll the fabric; and [deliver](Self::deliver) what it reports.
pub struct Exchange {
    socket: MediumSocket,
    medium: Medium,
    /// Number of messages to take before the socket is waited for again. It grows while the socket stays readable.
    batch: usize,
}

impl Exchange {
    /// Returns a medium without radios at a socket.
    pub fn new(socket: MediumSocket) -> Self {
        Self { socket, medium: Medium::new(), batch: 1 }
    }

    /// Gives a radio the antenna of a robot or a radio unit, as [`Medium::join`] does.
    ///
    /// # Errors
    /// Those of [`Fabric::lend_antenna`].
    pub fn join(
        &mut self,
        now: Timestamp,
        fabric: &mut Fabric,
        node: &NodeId,
        hardware: MacAddress,
    ) -> Result<(), FabricError> {
        self.medium.join(now, fabric, node, hardware)
    }

    /// Returns the counts of a radio's frames, as [`Medium::counts`] does.
    pub fn counts(&self, hardware: MacAddress) -> Option<TryCounts> {
        self.medium.counts(hardware)
    }

    /// Takes messages that the kernel has sent; perhaps not all of them, so that the socket stays readable. Returns the number of
    /// bursts of messages that were lost.
    ///
    /// # Errors
    /// The failure of the socket.
    pub fn receive(&mut self, now: Timestamp, fabric: &mut Fabric) -> io::Result<u64> {
        self.take(now, fabric, self.batch)
    }

    /// Records that the socket was not readable after the last delivery: the kernel has accepted all its messages.
    pub fn nothing_waits(&mut self) {
        self.batch = 1;
        self.medium.confirm();
    }

    /// Sends the kernel what the fabric reports. Returns the number of bursts of messages that were lost. If frames were refused,
    /// the fabric's deadline may be another afterwards.
    ///
    /// # Errors
    /// The failure of the socket to receive.
    pub fn deliver(&mut self, now: Timestamp, fabric: &mut Fabric) -> io::Result<u64> {
        let mut lost = 0;
        loop {
            while let Some(outgoing) = self.medium.poll(fabric) {
                if !self.socket.queue(outgoing.number, &outgoing.message) {
                    self.flush(now, fabric);
                    self.socket.queue(outgoing.number, &outgoing.message);
                }
            }
            self.flush(now, fabric);
            if !self.medium.awaits_refusals() {
                return Ok(lost);
            }
            lost += self.take(now, fabric, usize::MAX)?;
            self.medium.confirm();
        }
    }

    fn take(&mut self, now: Timestamp, fabric: &mut Fabric, most: usize) -> io::Result<u64> {
        let mut lost = 0;
        for _ in 0..most {
            let Some(incoming) = self.socket.receive()? else {
                self.medium.confirm();
                self.batch = 1;
                return Ok(lost);
            };
            match incoming {
                Incoming::Message(message) => self.handle(now, fabric, &message),
                Incoming::Refused { number, .. } => self.medium.refused(now, fabric, number),
                Incoming::Overrun => lost += 1,
                Incoming::Unknown => {}
            }
        }
        self.batch = (self.batch * 2).min(BATCH);
        Ok(lost)
    }

    fn handle(&mut self, now: Timestamp, fabric: &mut Fabric, message: &Message) {
        if let Some(answer) = self.medium.handle(now, fabric, message) {
            // Without room, the kernel drops the frame that waits for this status by itself.
            self.socket.queue(answer.number, &answer.message);
        }
    }

    fn flush(&mut self, now: Timestamp, fabric: &mut Fabric) {
        for number in self.socket.flush() {
            self.medium.refused(now, fabric, number);
        }
    }
}

impl AsFd for Exchange {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.socket.as_fd()
    }
}

impl fmt::Debug for Exchange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Exchange").field("medium", &self.medium).finish_non_exhaustive()
    }
}
