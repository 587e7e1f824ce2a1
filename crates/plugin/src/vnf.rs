//! The loop of a VNF that answers datagrams, one by one: the robot waits for the answer, so each is sent before anything
//! else is looked at, by one thread that blocks on its socket.

use std::{
    convert::Infallible,
    fmt::{Arguments, Display},
    io::{self, Write},
    net::UdpSocket,
};

/// Answers what comes to that socket until the process ends: `answer` writes the answer to a datagram, in place of what
/// the buffer held, or says why there is none, which goes to standard error now and then.
///
/// # Errors
/// Failure that the socket cannot recover from.
pub fn serve<E: Display>(
    socket: &UdpSocket,
    mut answer: impl FnMut(&[u8], &mut Vec<u8>) -> Result<(), E>,
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
            // A robot that cannot be reached now asks again soon enough.
            Ok(()) => drop(socket.send_to(&buffer, sender)),
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
