//! The loop of a VNF that answers datagrams, one by one. With [`at_once`], each answer is sent before anything else is looked
//! at, by one thread that blocks on its socket, because the robot waits for it.

use std::{
    convert::Infallible,
    fmt::{Arguments, Display},
    io::{self, Write},
    net::{SocketAddr, UdpSocket},
};

/// An answer to a datagram.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Answer<'a> {
    /// Bytes of the datagram that it answers.
    pub request_bytes: usize,
    /// Its content.
    pub bytes: &'a [u8],
    /// The sender of the datagram.
    pub to: SocketAddr,
}

/// Returns a function that sends answers from a socket.
pub fn at_once(socket: &UdpSocket) -> impl FnMut(Answer<'_>) + use<'_> {
    // A robot that cannot be reached now asks again soon enough.
    |answer| drop(socket.send_to(answer.bytes, answer.to))
}

/// Answers what comes to that socket until the process ends: `answer` writes the answer to a datagram, in place of what
/// the buffer held, or says why there is none, which goes to standard error now and then. `send` sends it.
///
/// # Errors
/// Failure that the socket cannot recover from.
pub fn serve<E: Display>(
    socket: &UdpSocket,
    mut answer: impl FnMut(&[u8], &mut Vec<u8>) -> Result<(), E>,
    mut send: impl FnMut(Answer<'_>),
) -> io::Result<Infallible> {
    let mut datagram = [0; 2048];
    let mut buffer = Vec::with_capacity(128);
    let mut rejected = 0u64;
    loop {
        let (length, sender) = match socket.recv_from(&mut datagram) {
            Ok(received) => received,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
            Err(error) => return Err(error),
        };
        match answer(&datagram[..length], &mut buffer) {
            Ok(()) => send(Answer { request_bytes: length, bytes: &buffer, to: sender }),
            Err(reason) => {
                rejected += 1;
                if rejected.is_power_of_two() {
                    log(format_args!("ignored a packet from {sender}, number {rejected} so far: {reason}"));
                }
            }
        }
    }
}

/// Writes a line to standard error, which is a VNF's log. What a full disk does not take is lost; the VNF goes on.
pub fn log(line: Arguments<'_>) {
    let _ = writeln!(io::stderr().lock(), "{line}");
}
