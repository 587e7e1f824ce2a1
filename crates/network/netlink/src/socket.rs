//! A socket that sends requests to the kernel and waits for its answers.

use std::io;

use netlink_sys::Socket;

use crate::{
    answers::{Answers, State},
    attributes::DecodeError,
    message::{ACK, REQUEST, message},
};

/// The most that the kernel puts into one datagram of a dump.
const DATAGRAM: usize = 32 << 10;
/// Attempts at a dump that changes interrupt. The last one counts all the same.
const ATTEMPTS: u32 = 3;

/// A netlink socket in the calling thread's network namespace. It is opened by the first request, and again after it
/// failed.
#[derive(Debug)]
pub struct Netlink {
    protocol: isize,
    socket: Option<Socket>,
    sequence: u32,
}

/// What the kernel returned.
#[derive(Debug)]
struct Response<T> {
    answers: Answers<T>,
    result: u32,
}

impl Netlink {
    /// Returns a client of a protocol (`NETLINK_*`), without a socket yet.
    pub const fn new(protocol: isize) -> Self {
        Self { protocol, socket: None, sequence: 0 }
    }

    /// Sends a request, and returns what `decode` makes of the answers.
    ///
    /// # Errors
    /// The kernel's error code, or a failure of the socket.
    pub fn request<T>(
        &mut self,
        kind: u16,
        flags: u16,
        body: &[u8],
        decode: impl Fn(&[u8]) -> Result<Option<T>, DecodeError>,
    ) -> io::Result<Vec<T>> {
        for _ in 1..ATTEMPTS {
            let Response { answers, .. } = self.attempt(kind, flags, body, &decode)?;
            if !answers.interrupted {
                return Ok(answers.found);
            }
        }
        Ok(self.attempt(kind, flags, body, &decode)?.answers.found)
    }

    /// Sends a request that changes something, and returns the number that the kernel acknowledges it with.
    ///
    /// # Errors
    /// The kernel's error code, or a failure of the socket.
    pub fn execute(&mut self, kind: u16, flags: u16, body: &[u8]) -> io::Result<u32> {
        let none = |_: &[u8]| Ok(None::<()>);
        Ok(self.attempt(kind, flags | ACK, body, &none)?.result)
    }

    fn attempt<T>(
        &mut self,
        kind: u16,
        flags: u16,
        body: &[u8],
        decode: &impl Fn(&[u8]) -> Result<Option<T>, DecodeError>,
    ) -> io::Result<Response<T>> {
        // It comes back only if it can be used again: answers that nobody read would be in the way of the next ones.
        let socket = self.socket.take().map_or_else(|| open(self.protocol), Ok)?;
        self.sequence = self.sequence.wrapping_add(1);
        socket.send(&message(kind, flags | REQUEST, self.sequence, body), 0)?;
        let mut answers = Answers::new(self.sequence);
        let mut datagram = Vec::with_capacity(DATAGRAM);
        loop {
            datagram.clear();
            socket.recv(&mut datagram, 0)?;
            match answers.take(&datagram, decode).map_err(invalid)? {
                State::Incomplete => {}
                State::Complete(result) => {
                    self.socket = Some(socket);
                    return Ok(Response { answers, result });
                }
                State::Rejected(error) => {
                    self.socket = Some(socket);
                    return Err(error);
                }
            }
        }
    }
}

/// Opens a socket that never blocks: the kernel has answered before `send` returns.
fn open(protocol: isize) -> io::Result<Socket> {
    let mut socket = Socket::new(protocol)?;
    socket.bind_auto()?;
    socket.set_non_blocking(true)?;
    Ok(socket)
}

fn invalid(error: DecodeError) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, error)
}
