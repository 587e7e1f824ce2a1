//! A port of the fabric on a real interface: a non-blocking descriptor that carries frames behind their [`vnet`]
//! headers. TAPs and packet sockets differ only in their creation.

use std::{
    collections::VecDeque,
    io,
    os::fd::{AsFd, BorrowedFd, OwnedFd},
    sync::Arc,
    thread,
    time::Duration,
};

use cotorra_fabric::{Fabric, Frame};
use parking_lot::Mutex;

use crate::{gateway::gate::Gate, sys, vnet};

/// Most frames queued for a port that takes no more. The excess is dropped, as at a network card.
const BACKLOG: usize = 256;

/// Size of an ordinary frame's buffer, bytes. A larger frame is a super-packet.
const ORDINARY: usize = 2048;
/// Size of the largest super-packet, bytes.
pub(crate) const LARGEST: usize = 66 * 1024;

/// Outcome of sending a frame.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Sent {
    /// The frame was sent.
    Now,
    /// The frame is queued. Call [`Port::flush`] when the descriptor is writable.
    Waits,
    /// The frame was dropped: the interface is down or rejects it, or the queue is full.
    Dropped,
}

/// When a frame came to a port.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Arrival {
    /// The kernel says how long ago.
    Ago(Duration),
    /// A TAP does not say.
    Unknown,
}

pub(crate) struct Port {
    fd: OwnedFd,
    /// Whether the kernel stamps arrivals of frames.
    is_stamped: bool,
    /// Number of frames to read in a row, as many as the last time. Finding no further frame costs as much as reading
    /// one.
    pub(crate) batch: usize,
    /// Longest possible wait of the frames that were left when it was last read.
    pub(crate) left: Duration,
    /// Whether the last frame was a super-packet. The next probably is one, too, and is then read without a copy.
    expects_large: bool,
    backlog: VecDeque<Frame>,
    /// The rules of a gateway, if this is one's port.
    pub(crate) gate: Option<Arc<Mutex<Gate>>>,
}

impl Port {
    /// Makes a port from a non-blocking TAP with [`vnet`] headers.
    pub(crate) fn of_tap(fd: OwnedFd) -> Self {
        Self {
            fd,
            is_stamped: false,
            batch: 1,
            left: Duration::ZERO,
            expects_large: false,
            backlog: VecDeque::new(),
            gate: None,
        }
    }

    /// Makes a port from a non-blocking packet socket with [`vnet`] headers and times of arrival.
    pub(crate) fn of_packet_socket(fd: OwnedFd) -> Self {
        Self { is_stamped: true, ..Self::of_tap(fd) }
    }

    /// Makes a gateway's port from its packet socket.
    pub(crate) fn of_gateway(fd: OwnedFd, gate: Arc<Mutex<Gate>>) -> Self {
        Self { gate: Some(gate), ..Self::of_packet_socket(fd) }
    }

    /// Reads the next frame into one of the fabric's buffers; `Ok(None)` if there is none now. The part beyond an
    /// ordinary buffer goes through `spill`, which has room for [`LARGEST`] bytes. Returns when the frame came, too.
    ///
    /// # Errors
    /// If a frame was unreadable; the next one may be fine.
    pub(crate) fn receive(
        &mut self,
        fabric: &mut Fabric,
        spill: &mut [u8],
    ) -> io::Result<Option<(Frame, Arrival)>> {
        let mut header = [0; vnet::LENGTH];
        let mut buffer = fabric.buffer(if self.expects_large { LARGEST } else { ORDINARY });
        let read = if self.is_stamped {
            sys::read_frame_with_age(self.fd.as_fd(), &mut header, &mut buffer, spill)
                .map(|(length, age)| (length, Arrival::Ago(age)))
        } else {
            sys::read_frame(self.fd.as_fd(), &mut header, &mut buffer, spill)
                .map(|length| (length, Arrival::Unknown))
        };
        let (length, arrival) = match read {
            Ok(read) => read,
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
        Ok(Some((Frame::with_offload(buffer, offload), arrival)))
    }

    /// Sends a frame behind those queued. Sent and dropped frames go to `spent`.
    pub(crate) fn send(&mut self, frame: Frame, spent: &mut Vec<Frame>) -> Sent {
        if self.backlog.is_empty() {
            match self.write(&frame) {
                Err(e) if self.is_full(&e) => {}
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

    /// Sends queued frames as far as possible. Returns whether the queue is empty.
    pub(crate) fn flush(&mut self, spent: &mut Vec<Frame>) -> bool {
        while let Some(frame) = self.backlog.pop_front() {
            match self.write(&frame) {
                Err(e) if self.is_full(&e) => {
                    self.backlog.push_front(frame);
                    return false;
                }
                _ => spent.push(frame),
            }
        }
        true
    }

    /// Whether an error means that the port takes no more for now. A real interface answers `ENOBUFS` for a frame that its
    /// queue has dropped, as it does without a carrier.
    fn is_full(&self, error: &io::Error) -> bool {
        match error.raw_os_error() {
            Some(libc::EAGAIN) => true,
            Some(libc::ENOBUFS) => self.gate.is_none(),
            _ => false,
        }
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

/// Closes ports on many threads. Closing a packet socket waits some 10 ms for an RCU grace period, which parallel
/// closes share.
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
