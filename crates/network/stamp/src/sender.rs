//! Runs a session over a UDP socket and this machine's clock.
#![allow(clippy::disallowed_types, reason = "another machine answers on the wall clock")]

use std::{
    io::{self, ErrorKind},
    net::{SocketAddr, UdpSocket},
    time::{Duration, Instant, SystemTime},
};

use crate::{
    session::{Session, SessionConfig},
    utc::Utc,
};

/// Larger than any datagram.
const LARGEST: usize = 65_536;

/// UTC that never steps: the system's time at the start, advanced by the monotonic clock.
#[derive(Debug, Clone, Copy)]
pub struct Clock {
    began: Instant,
    began_at: Utc,
}

impl Clock {
    /// Starts the clock at the system's time.
    pub fn start() -> Self {
        let since_1970 = SystemTime::UNIX_EPOCH.elapsed().unwrap_or_default();
        Self { began: Instant::now(), began_at: Utc::UNIX_EPOCH + since_1970 }
    }

    /// Returns the time.
    pub fn now(&self) -> Utc {
        self.began_at + self.began.elapsed()
    }
}

/// A session over a socket of its own.
#[derive(Debug)]
pub struct Sender {
    socket: UdpSocket,
    clock: Clock,
    session: Session,
    buffer: Vec<u8>,
}

impl Sender {
    /// Starts a session with a reflector. The first packet is due at once.
    ///
    /// # Errors
    /// The error of the system if it has no socket, or no route to the reflector.
    pub fn connect(reflector: SocketAddr, config: SessionConfig) -> io::Result<Self> {
        let any: SocketAddr = if reflector.is_ipv4() { ([0; 4], 0).into() } else { ([0_u16; 8], 0).into() };
        let socket = UdpSocket::bind(any)?;
        socket.connect(reflector)?;
        let clock = Clock::start();
        let session = Session::new(config, clock.now());
        Ok(Self { socket, clock, session, buffer: vec![0; LARGEST] })
    }

    /// Returns the session.
    pub fn session(&self) -> &Session {
        &self.session
    }

    /// Returns the session, to pace or stop it.
    pub fn session_mut(&mut self) -> &mut Session {
        &mut self.session
    }

    /// Returns the clock.
    pub fn clock(&self) -> Clock {
        self.clock
    }

    /// Sends the packet that is due, and waits for a reply until the session's deadline, for at most `no_longer`. Returns
    /// the reply's round-trip time as [`Session::receive`] does.
    ///
    /// # Errors
    /// The error of the system. A refused connection is none: its packets count as lost.
    pub fn step(&mut self, no_longer: Duration) -> io::Result<Option<Duration>> {
        if let Some(probe) = self.session.poll(self.clock.now()) {
            match self.socket.send(&probe) {
                // The refusal of an earlier packet.
                Err(error) if error.kind() == ErrorKind::ConnectionRefused => {}
                sent => drop(sent?),
            }
        }
        let Some(deadline) = self.session.deadline() else { return Ok(None) };
        let wait = deadline.since(self.clock.now()).min(no_longer);
        let Some((length, _)) = receive(&self.socket, &mut self.buffer, wait)? else { return Ok(None) };
        // Ignores datagrams that are no reply.
        Ok(self.session.receive(&self.buffer[..length], self.clock.now()).ok().flatten())
    }
}

/// Waits for a datagram. Returns its length and sender; `None` if none comes in time.
///
/// # Errors
/// The error of the system.
pub fn receive(
    socket: &UdpSocket,
    buffer: &mut [u8],
    wait: Duration,
) -> io::Result<Option<(usize, SocketAddr)>> {
    // A read timeout of zero is invalid.
    socket.set_read_timeout(Some(wait.max(Duration::from_micros(1))))?;
    match socket.recv_from(buffer) {
        Ok(received) => Ok(Some(received)),
        Err(error) => match error.kind() {
            ErrorKind::WouldBlock
            | ErrorKind::TimedOut
            | ErrorKind::Interrupted
            | ErrorKind::ConnectionRefused => Ok(None),
            _ => Err(error),
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Reflector;

    #[test]
    fn a_reflector_is_measured_and_silence_is_loss() {
        let there = UdpSocket::bind("127.0.0.1:0").unwrap();
        let address = there.local_addr().unwrap();
        let config = SessionConfig {
            interval: Duration::from_millis(1),
            patience: Duration::from_millis(100),
            ..SessionConfig::default()
        };
        let mut sender = Sender::connect(address, config).unwrap();
        let clock = sender.clock();
        let mut reflector = Reflector::default();
        let mut buffer = [0; 100];
        let mut answered = 0;
        while answered < 5 {
            let sent = sender.session().sent();
            answered += u32::from(sender.step(Duration::ZERO).unwrap().is_some());
            if sender.session().sent() > sent {
                let (length, from) = there.recv_from(&mut buffer).unwrap();
                let reply = reflector.reflect(from, &buffer[..length], clock.now(), None).unwrap();
                there.send_to(&reply.sent_at(clock.now()), from).unwrap();
            }
        }
        drop(there);
        let sent = sender.session().sent();
        while sender.session().sent() < sent + 3 {
            sender.step(Duration::from_millis(1)).unwrap();
        }
        sender.session_mut().stop();
        while sender.session().deadline().is_some() {
            sender.step(Duration::from_millis(1)).unwrap();
        }
        let measured = sender.session().measurement(clock.now()).unwrap();
        assert!(measured.lost >= 3 && measured.round_trip.is_some(), "{measured:?}");
    }
}
