//! One end of a connection: frames over TLS over a socket that never blocks.
#![allow(clippy::disallowed_types, reason = "its shells read the clock")]

use std::{
    io::{self, Read, Write},
    net::Shutdown,
    path::Path,
    time::{Duration, Instant},
};

use cotorra_agent_protocol::LEASE;
use mio::net::TcpStream;

use crate::{
    frame::{Decoder, Frame, FrameError, Kind, numbered},
    outbox::Outbox,
    tls::{self, Identity},
    transfers::Transfers,
};

/// Bytes that are read, or encrypted, before others have their turn.
const TURN: usize = 64 << 10;
/// Interval at which a shell calls [`Connection::advance`].
pub(crate) const TICK: Duration = LEASE.checked_div(8).expect("not by 0");
/// Signs of life in a lease, if nothing else is written.
const QUIETS: u32 = 4;

/// Why a connection ended.
#[derive(Debug, thiserror::Error)]
pub(crate) enum Closed {
    #[error("the other end closed it")]
    ByPeer,
    #[error("nothing was heard for {LEASE:?}")]
    Silent,
    #[error("its certificate has expired")]
    Expired,
    #[error("this end closed it")]
    Ended,
    /// The handshake succeeded with another than the one that was expected.
    #[error("{0}")]
    Stranger(String),
    #[error(transparent)]
    Frame(#[from] FrameError),
    #[error(transparent)]
    Tls(#[from] rustls::Error),
    #[error(transparent)]
    Io(#[from] io::Error),
}

#[derive(Debug)]
pub(crate) struct Connection {
    socket: TcpStream,
    tls: rustls::Connection,
    decoder: Decoder,
    outbox: Outbox,
    transfers: Transfers,
    /// Times at which something was read and written last.
    heard: Instant,
    said: Instant,
}

impl Connection {
    /// Begins the handshake over a connected socket.
    pub(crate) fn new(now: Instant, socket: TcpStream, mut tls: rustls::Connection) -> Self {
        // The outbox has the bound. A frame is given to TLS whole.
        tls.set_buffer_limit(None);
        if let Err(error) = socket.set_nodelay(true) {
            tracing::debug!("messages to the other end may be delayed: {error}");
        }
        Self {
            socket,
            tls,
            decoder: Decoder::default(),
            outbox: Outbox::default(),
            transfers: Transfers::default(),
            heard: now,
            said: now,
        }
    }

    /// Returns who the other end is; `None` during the handshake.
    pub(crate) fn identity(&self) -> Option<Result<Identity, String>> {
        (!self.tls.is_handshaking()).then(|| tls::identity(&self.tls))
    }

    /// Reads what is there, at most about one turn, and writes what waits. Returns whether there may be more to read.
    pub(crate) fn exchange(&mut self, now: Instant) -> Result<bool, Closed> {
        let more = self.read(now)?;
        self.flush(now)?;
        Ok(more)
    }

    fn read(&mut self, now: Instant) -> Result<bool, Closed> {
        let mut read = 0;
        while read < TURN {
            match self.tls.read_tls(&mut self.socket) {
                Ok(0) => return Err(Closed::ByPeer),
                Ok(bytes) => read += bytes,
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => return Ok(false),
                Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
                Err(error) => return Err(error.into()),
            }
            self.heard = now;
            let state = self.tls.process_new_packets().inspect_err(|_| {
                // The alert says the reason to the other end.
                _ = self.tls.write_tls(&mut self.socket);
            })?;
            let mut plain = vec![0; state.plaintext_bytes_to_read()];
            self.tls.reader().read_exact(&mut plain)?;
            self.decoder.push(&plain);
            if state.peer_has_closed() {
                return Err(Closed::ByPeer);
            }
        }
        Ok(true)
    }

    /// Returns the next frame that was read, whose message may have so many bytes.
    pub(crate) fn poll(&mut self, longest: usize) -> Result<Option<Frame>, FrameError> {
        self.decoder.poll(longest)
    }

    /// Writes a frame as soon as the socket takes it. Drops it if too many wait. After an error the connection is closed, which
    /// the thread that reads it notices.
    pub(crate) fn send(&mut self, now: Instant, frame: Frame) -> Result<(), Closed> {
        self.outbox.push(frame);
        self.flush(now).inspect_err(|_| self.close())
    }

    /// Answers the fetch with this number by a file, if there is one.
    pub(crate) fn send_file(&mut self, now: Instant, number: u32, path: Option<&Path>) -> Result<(), Closed> {
        if !path.is_some_and(|path| self.transfers.begin(number, path)) {
            self.outbox.push(Frame { kind: Kind::Missing, message: numbered(number, &[]) });
        }
        self.flush(now)
    }

    /// Writes what waits, as far as the socket takes it.
    fn flush(&mut self, now: Instant) -> Result<(), Closed> {
        loop {
            if !self.tls.wants_write() && !self.tls.is_handshaking() {
                self.encrypt()?;
            }
            if !self.tls.wants_write() {
                return Ok(());
            }
            match self.tls.write_tls(&mut self.socket) {
                Ok(_) => self.said = now,
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => return Ok(()),
                Err(error) => return Err(error.into()),
            }
        }
    }

    /// Gives TLS frames for one turn, most urgent first.
    fn encrypt(&mut self) -> io::Result<()> {
        let mut plain = Vec::new();
        while plain.len() < TURN
            && let Some(frame) = self.outbox.pop().or_else(|| self.transfers.poll())
        {
            frame.write(&mut plain)?;
        }
        self.tls.writer().write_all(&plain)
    }

    /// Does what is due: says that this end is there, and notices that the other is not.
    pub(crate) fn advance(&mut self, now: Instant) -> Result<(), Closed> {
        if now.saturating_duration_since(self.heard) >= LEASE {
            return Err(Closed::Silent);
        }
        if now.saturating_duration_since(self.said) >= LEASE / QUIETS && self.outbox.is_empty() {
            self.outbox.push(Frame { kind: Kind::Quiet, message: Vec::new() });
        }
        self.flush(now)
    }

    /// Says goodbye as far as the socket takes it, and ends the connection.
    pub(crate) fn close(&mut self) {
        _ = self.flush(self.said);
        self.tls.send_close_notify();
        _ = self.tls.write_tls(&mut self.socket);
        _ = self.socket.shutdown(Shutdown::Both);
    }
}

#[cfg(test)]
mod tests {
    use std::net::TcpListener;

    use chrono::{DateTime, Utc};
    use cotorra_enrolment::Authority;
    use cotorra_graph::AgentId;
    use rustls::{ClientConnection, ServerConnection};

    use super::*;
    use crate::{dialer::server_name, frame::LONGEST, tls::Credentials};

    /// The two ends of a connection after the handshake, and the time.
    struct Pair {
        agent: Connection,
        core: Connection,
        now: Instant,
    }

    impl Pair {
        fn new() -> Self {
            let folder = tempfile::tempdir().unwrap();
            let today = DateTime::<Utc>::from(std::time::SystemTime::now());
            let authority = Authority::create_or_open(folder.path().join("authority"), today).unwrap();
            let listener = TcpListener::bind("127.0.0.1:0").unwrap();
            let address = listener.local_addr().unwrap().to_string();
            let name = AgentId::new("edge").unwrap();
            let bundle =
                authority.enrol(&name, &address.parse().unwrap(), Duration::from_hours(1), today).unwrap();
            let core = authority.core(today).unwrap();
            let of_agent = Credentials {
                authority: bundle.authority_pem(),
                certificate: bundle.certificate_pem(),
                key: bundle.key_pem(),
            };
            let of_core = Credentials {
                authority: &core.authority_pem,
                certificate: &core.certificate_pem,
                key: &core.key_pem,
            };
            let dialed = std::net::TcpStream::connect(&address).unwrap();
            let accepted = listener.accept().unwrap().0;
            let [dialed, accepted] = [dialed, accepted].map(|socket| {
                socket.set_nonblocking(true).unwrap();
                TcpStream::from_std(socket)
            });
            let now = Instant::now();
            let host = server_name(&address).unwrap();
            let client = ClientConnection::new(tls::client(of_agent).unwrap(), host).unwrap();
            let server = ServerConnection::new(tls::server(of_core).unwrap()).unwrap();
            let agent = Connection::new(now, dialed, client.into());
            let core = Connection::new(now, accepted, server.into());
            let mut pair = Self { agent, core, now };
            while pair.agent.identity().is_none() || pair.core.identity().is_none() {
                pair.exchange();
            }
            pair
        }

        fn exchange(&mut self) {
            self.agent.exchange(self.now).unwrap();
            self.core.exchange(self.now).unwrap();
        }

        /// Lets both ends do what is due, and waits until each has the next frame.
        fn frames(&mut self) -> [Frame; 2] {
            let (mut at_agent, mut at_core) = (None, None);
            while at_agent.is_none() || at_core.is_none() {
                self.exchange();
                at_agent = at_agent.or(self.agent.poll(LONGEST).unwrap());
                at_core = at_core.or(self.core.poll(LONGEST).unwrap());
            }
            [at_agent, at_core].map(Option::unwrap)
        }
    }

    #[test]
    fn ends_know_each_other_by_their_certificates() {
        let pair = Pair::new();
        assert_eq!(pair.core.identity().unwrap().unwrap().common_name, "edge.1");
        assert_eq!(pair.agent.identity().unwrap().unwrap().common_name, cotorra_enrolment::CORE_COMMON_NAME);
        let left =
            pair.core.identity().unwrap().unwrap().expires.duration_since(std::time::SystemTime::now());
        assert!(left.unwrap() <= Duration::from_hours(1));
    }

    #[test]
    fn quiet_ends_say_that_they_are_there() {
        let mut pair = Pair::new();
        for _ in 0..3 * QUIETS {
            pair.now += LEASE / QUIETS;
            pair.agent.advance(pair.now).unwrap();
            pair.core.advance(pair.now).unwrap();
            assert!(pair.frames().iter().all(|frame| frame.kind == Kind::Quiet));
        }
    }

    #[test]
    fn silent_end_is_noticed_after_a_lease() {
        let mut pair = Pair::new();
        pair.now += LEASE - Duration::from_millis(1);
        pair.core.advance(pair.now).unwrap();
        pair.now += Duration::from_millis(1);
        assert!(matches!(pair.core.advance(pair.now), Err(Closed::Silent)));
    }

    #[test]
    fn urgent_messages_overtake_a_file() {
        let mut pair = Pair::new();
        let file = tempfile::NamedTempFile::new().unwrap();
        let contents: Vec<_> = (0..8_000_000_u32).map(|n| (n % 251) as u8).collect();
        std::fs::write(&file, &contents).unwrap();
        pair.core.send_file(pair.now, 7, Some(file.path())).unwrap();
        // The socket is full.
        pair.core.send(pair.now, Frame { kind: Kind::Beat, message: b"beat".to_vec() }).unwrap();
        let (mut received, mut before_beat) = (Vec::new(), None);
        loop {
            pair.exchange();
            while let Some(Frame { kind, message }) = pair.agent.poll(LONGEST).unwrap() {
                match (kind, crate::frame::number(&message)) {
                    (Kind::Beat, _) => before_beat = Some(received.len()),
                    (Kind::Part, Some((7, []))) => {
                        assert!(received == contents);
                        assert!(before_beat.unwrap() < contents.len());
                        return;
                    }
                    (Kind::Part, Some((7, part))) => received.extend_from_slice(part),
                    other => panic!("{other:?}"),
                }
            }
        }
    }
}
