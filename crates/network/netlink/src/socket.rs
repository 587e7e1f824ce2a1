//! A socket that sends requests to the kernel and waits for its answers.

use std::{
    hash::{BuildHasher, RandomState},
    io,
};

use netlink_sys::{Socket, SocketAddr};

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
    is_alone: bool,
    socket: Option<Socket>,
    sequence: u32,
}

/// The kernel's answer.
#[derive(Debug)]
struct Response<T> {
    answers: Answers<T>,
    result: u32,
}

impl Netlink {
    /// Returns a client of a protocol (`NETLINK_*`), without a socket yet.
    pub const fn new(protocol: isize) -> Self {
        Self { protocol, is_alone: false, socket: None, sequence: 0 }
    }

    /// Returns a client of a protocol whose socket will be [alone](bind_alone) with its number.
    pub const fn alone(protocol: isize) -> Self {
        Self { protocol, is_alone: true, socket: None, sequence: 0 }
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

    /// Opens a socket that never blocks: the kernel has answered before `send` returns.
    fn open(&self) -> io::Result<Socket> {
        let mut socket = Socket::new(self.protocol)?;
        if self.is_alone { bind_alone(&mut socket) } else { socket.bind_auto().map(drop) }?;
        socket.set_non_blocking(true)?;
        Ok(socket)
    }

    fn attempt<T>(
        &mut self,
        kind: u16,
        flags: u16,
        body: &[u8],
        decode: &impl Fn(&[u8]) -> Result<Option<T>, DecodeError>,
    ) -> io::Result<Response<T>> {
        // It comes back only if it can be used again: unread answers would precede the next ones.
        let socket = self.socket.take().map_or_else(|| self.open(), Ok)?;
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

/// Binds a socket to a number that no other has, whatever its protocol and its network namespace.
///
/// The kernel chooses numbers (`nl_pid`) per protocol and network namespace, and begins with the process's. Some users of netlink
/// tell sockets apart by their numbers alone, so that they take the end of any for that of all with the same.
///
/// # Errors
/// The failure of the socket.
pub fn bind_alone(socket: &mut Socket) -> io::Result<()> {
    socket.bind(&SocketAddr::new(lonely_number(), 0))
}

/// Returns a random number which is neither a process's, as the kernel's first choice is, nor negative, as the others are.
fn lonely_number() -> u32 {
    const NO_PROCESS: u32 = 1 << 30;
    let random = RandomState::new().hash_one(0_u8) as u32;
    random % NO_PROCESS + NO_PROCESS
}

fn invalid(error: DecodeError) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, error)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sockets_that_are_alone_have_numbers_of_no_process() {
        const ROUTES: isize = 0;
        let mut numbers = Vec::new();
        for _ in 0..3 {
            let mut socket = Socket::new(ROUTES).unwrap();
            bind_alone(&mut socket).unwrap();
            let mut address = SocketAddr::new(0, 0);
            socket.get_address(&mut address).unwrap();
            numbers.push(address.port_number());
        }
        assert!(numbers.iter().all(|number| (1 << 30..1 << 31).contains(number)), "{numbers:?}");
        numbers.dedup();
        assert_eq!(numbers.len(), 3);
    }
}
