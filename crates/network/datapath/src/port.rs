//! A port of the fabric on a real interface: frames in and out through a descriptor that never blocks, each behind
//! its [`vnet`] header. A TAP and a packet socket differ in how they are made, not in how they are used.

use std::{
    collections::VecDeque,
    io,
    os::fd::{AsFd, BorrowedFd, OwnedFd},
    thread,
};

use cotorra_fabric::{Fabric, Frame};

use crate::{sys, vnet};

/// Frames that wait for a port that takes no more for now; what comes on top is dropped, as at a network card.
const BACKLOG: usize = 256;

/// An ordinary frame fits; what exceeds it is a super-packet.
const ORDINARY: usize = 2048;
/// Room for the largest super-packet.
pub(crate) const LARGEST: usize = 66 * 1024;

/// What became of a frame that was sent.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Sent {
    /// It is out.
    Now,
    /// It waits; tell [`Port::flush`] when the descriptor is writable.
    Waits,
    /// It is lost: the interface is down, or takes no frame like it, or too many wait.
    Dropped,
}

/// A port.
pub(crate) struct Port {
    fd: OwnedFd,
    /// How many frames to read in a row, as many as were there the last time: to find out that there is none costs
    /// as much as to read one.
    pub(crate) batch: usize,
    /// Whether the last frame was a super-packet: the next one is likely to be, and is read where it stays.
    expects_large: bool,
    backlog: VecDeque<Frame>,
}

impl Port {
    /// A port on a TAP or a packet socket that does not block and carries [`vnet`] headers.
    pub(crate) fn new(fd: OwnedFd) -> Self {
        Self { fd, batch: 1, expects_large: false, backlog: VecDeque::new() }
    }

    /// The next frame, in one of the fabric's buffers; `Ok(None)` when there is none for now. What does not fit an
    /// ordinary buffer goes through `spill`, which has room for [`LARGEST`].
    ///
    /// # Errors
    /// When a frame was there that cannot be had; the next one may be fine.
    pub(crate) fn receive(&mut self, fabric: &mut Fabric, spill: &mut [u8]) -> io::Result<Option<Frame>> {
        let mut header = [0; vnet::LENGTH];
        let mut buffer = fabric.buffer(if self.expects_large { LARGEST } else { ORDINARY });
        let length = match sys::read_frame(self.fd.as_fd(), &mut header, &mut buffer, spill) {
            Ok(length) => length,
            Err(e) => {
                fabric.recycle(Frame::new(buffer));
                return if e.kind() == io::ErrorKind::WouldBlock { Ok(None) } else { Err(e) };
            }
        };
        let (room_for_large, is_large) = (self.expects_large, length > ORDINARY);
        self.expects_large = is_large;
        if room_for_large != is_large {
            let mut right = fabric.buffer(length);
            right.extend_from_slice(&buffer);
            right.extend_from_slice(&spill[..length - buffer.len()]);
            fabric.recycle(Frame::new(std::mem::replace(&mut buffer, right)));
        }
        let Some(offload) = vnet::decode(&header) else {
            fabric.recycle(Frame::new(buffer));
            return Err(io::ErrorKind::InvalidData.into());
        };
        Ok(Some(Frame::with_offload(buffer, offload)))
    }

    /// Sends a frame, behind those that wait. What is sent or dropped goes to `spent`.
    pub(crate) fn send(&mut self, frame: Frame, spent: &mut Vec<Frame>) -> Sent {
        if self.backlog.is_empty() {
            match self.write(&frame) {
                Err(e) if is_full(&e) => {}
                result => {
                    spent.push(frame);
                    return if result.is_ok() { Sent::Now } else { Sent::Dropped };
                }
            }
        }
        if self.backlog.len() == BACKLOG {
            spent.push(frame);
            return Sent::Dropped;
        }
        self.backlog.push_back(frame);
        Sent::Waits
    }

    /// Sends what waits, as far as it goes; `true` when nothing waits any more.
    pub(crate) fn flush(&mut self, spent: &mut Vec<Frame>) -> bool {
        while let Some(frame) = self.backlog.pop_front() {
            match self.write(&frame) {
                Err(e) if is_full(&e) => {
                    self.backlog.push_front(frame);
                    return false;
                }
                _ => spent.push(frame),
            }
        }
        true
    }

    fn write(&self, frame: &Frame) -> io::Result<()> {
        sys::write_frame(self.fd.as_fd(), &vnet::encode(frame.offload()), frame.bytes())
    }
}

impl AsFd for Port {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.fd.as_fd()
    }
}

/// Closes ports on many threads: closing a packet socket waits some 10 ms for the kernel's readers (RCU), and one wait
/// does for all who wait at the same time.
pub(crate) fn close(mut ports: Vec<Port>) {
    const AT_A_TIME: usize = 64;
    let share = ports.len().div_ceil(AT_A_TIME).max(1);
    thread::scope(|scope| {
        while !ports.is_empty() {
            let some = ports.split_off(ports.len().saturating_sub(share));
            scope.spawn(|| drop(some));
        }
    });
}

/// Whether a port takes no more for now.
fn is_full(error: &io::Error) -> bool {
    matches!(error.raw_os_error(), Some(libc::EAGAIN | libc::ENOBUFS))
}
