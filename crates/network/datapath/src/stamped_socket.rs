//! A UDP socket whose datagrams the kernel stamps when they arrive, so that the wait of their reader is known.

use std::{
    io,
    net::{SocketAddrV4, UdpSocket},
    os::fd::AsFd,
    time::Duration,
};

use crate::sys;

/// An IPv4 socket that measures the waits of its datagrams.
#[derive(Debug)]
pub struct StampedSocket(UdpSocket);

impl StampedSocket {
    /// Lets the kernel stamp the datagrams of an IPv4 socket.
    ///
    /// # Errors
    /// The error of the system.
    pub fn new(socket: UdpSocket) -> io::Result<Self> {
        sys::stamp_arrivals(socket.as_fd())?;
        Ok(Self(socket))
    }

    /// Receives a datagram, truncated to the buffer. Returns its length, its sender, and for how long it has waited in the
    /// socket.
    ///
    /// # Errors
    /// As [`UdpSocket::recv_from`].
    pub fn receive(&self, buffer: &mut [u8]) -> io::Result<(usize, SocketAddrV4, Duration)> {
        sys::read_datagram_with_age(self.0.as_fd(), buffer)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn datagrams_have_their_sender_and_the_time_that_they_have_waited() {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        let (to, sender) = (socket.local_addr().unwrap(), UdpSocket::bind("127.0.0.1:0").unwrap());
        let stamped = StampedSocket::new(socket).unwrap();
        sender.send_to(b"first", to).unwrap();
        sender.send_to(b"second", to).unwrap();
        let mut buffer = [0; 16];
        let (length, from, waited) = stamped.receive(&mut buffer).unwrap();
        assert_eq!(
            (&buffer[..length], from.to_string()),
            (&b"first"[..], sender.local_addr().unwrap().to_string())
        );
        // The clock is the kernel's: the other one has waited since later.
        assert!(stamped.receive(&mut buffer).unwrap().0 == 6 && waited < Duration::from_secs(3600));
    }
}
