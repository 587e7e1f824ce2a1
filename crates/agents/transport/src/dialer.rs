//! An agent's end: one thread, which connects again whenever the connection was lost.
#![allow(clippy::disallowed_types, reason = "a shell with a clock")]

use std::{
    collections::BTreeMap,
    convert::Infallible,
    io,
    net::{self, ToSocketAddrs},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
        mpsc,
    },
    thread,
    time::{Duration, Instant},
};

use cotorra_agent_protocol::{Beat, LEASE, Report, RobotCommand, RobotReading, RobotTurn, Run, Wanted};
use cotorra_graph::AgentId;
use mio::{Events, Interest, Poll, Token, Waker, net::TcpStream};
use parking_lot::Mutex;
use rustls::{ClientConfig, ClientConnection, pki_types::ServerName};

use crate::{
    connection::{Closed, Connection, TICK},
    error::TransportError,
    frame::{self, Frame, Kind, numbered},
    tls::{self, Credentials},
};

/// Pauses between attempts to connect: the first, the longest, and how each grows.
const PAUSE: Duration = Duration::from_millis(200);
const LONGEST_PAUSE: Duration = Duration::from_secs(2);
const GROWTH: f64 = 1.5;
/// Time without a part of a file.
const FILE_TIMEOUT: Duration = Duration::from_secs(10);
/// Attempts to fetch a file over connections that are lost meanwhile.
const ATTEMPTS: u32 = 10;
/// Why a file may be fetched again.
const LOST: &str = "the connection is lost";

const SOCKET: Token = Token(0);
const WAKER: Token = Token(1);

/// Something that arrived from the core.
#[derive(Debug)]
pub enum FromCore {
    Wanted(Box<Wanted>),
    Beat(Beat),
    /// A command to its robot.
    Command(RobotCommand),
    /// A message was rejected, with the reason.
    Rejected(String),
}

/// A part of a file; none at its end.
type Part = Option<Vec<u8>>;

/// State that the dialer's thread shares with senders.
#[derive(Debug)]
struct Shared {
    /// The connection, once the core is known to be at its other end.
    connection: Mutex<Option<Connection>>,
    /// The number of the agent's process, once it reported.
    alive: Mutex<Option<(Run, u64)>>,
    fetches: Mutex<Fetches>,
    ends: AtomicBool,
    waker: Waker,
}

/// Files that are being fetched, by the numbers of the fetches.
#[derive(Debug, Default)]
struct Fetches {
    last: u32,
    waiting: BTreeMap<u32, mpsc::Sender<Part>>,
}

impl Shared {
    /// Sends a message. Returns whether there is a connection; without one, the message is lost.
    fn send(&self, kind: Kind, message: Vec<u8>) -> bool {
        let mut connection = self.connection.lock();
        let Some(open) = &mut *connection else { return false };
        if let Err(reason) = open.send(Instant::now(), Frame { kind, message }) {
            tracing::debug!("cannot send to the core: {reason}");
        }
        true
    }
}

/// A connection to the core, which returns by itself when it was lost. Dropping it ends the connection.
#[derive(Debug)]
pub struct Dialer(Arc<Shared>);

impl Dialer {
    /// Begins to connect to the core at `core`, such as `192.168.1.2:7448`, whose certificate has this common name. Passes what
    /// arrives to `receiver`, from a thread of its own.
    ///
    /// # Errors
    /// [`TransportError`] if the address or a credential is not valid.
    pub fn open(
        core: &str,
        core_common_name: &str,
        agent: AgentId,
        credentials: Credentials<'_>,
        receiver: impl Fn(FromCore) + Send + 'static,
    ) -> Result<Self, TransportError> {
        let config = tls::client(credentials)?;
        let host = server_name(core)?;
        let poll = Poll::new()?;
        let shared = Arc::new(Shared {
            connection: Mutex::default(),
            alive: Mutex::default(),
            fetches: Mutex::default(),
            ends: AtomicBool::new(false),
            waker: Waker::new(poll.registry(), WAKER)?,
        });
        let service = Service {
            core: core.to_owned(),
            host,
            core_common_name: core_common_name.to_owned(),
            agent,
            config,
            poll,
            shared: Arc::clone(&shared),
            receiver,
        };
        thread::Builder::new().name("agent-dialer".to_owned()).spawn(move || service.run())?;
        Ok(Self(shared))
    }

    /// Sends a report. Without a connection it is lost.
    pub fn report(&mut self, report: &Report) {
        let alive = Some((report.run, report.boot));
        if std::mem::replace(&mut *self.0.alive.lock(), alive) != alive {
            self.0.send(Kind::Alive, report.boot.to_be_bytes().to_vec());
        }
        self.0.send(Kind::Report, report.encode());
    }

    /// Sends the context of the machine, encoded. Without a connection it is lost.
    pub fn context(&self, context: Vec<u8>) {
        self.0.send(Kind::Context, context);
    }

    /// Returns a way to send what the agent's robot says on another thread.
    pub fn robot_sender(&self) -> RobotSender {
        RobotSender(Arc::clone(&self.0))
    }

    /// Returns a way to fetch files on another thread.
    pub fn fetcher(&self) -> Fetcher {
        Fetcher(Arc::clone(&self.0))
    }
}

impl Drop for Dialer {
    fn drop(&mut self) {
        self.0.ends.store(true, Ordering::Relaxed);
        if let Some(connection) = &mut *self.0.connection.lock() {
            connection.close();
        }
        if let Err(error) = self.0.waker.wake() {
            tracing::debug!("cannot wake the connection to the core: {error}");
        }
    }
}

/// Sends what a robot says. Without a connection it is lost.
#[derive(Debug, Clone)]
pub struct RobotSender(Arc<Shared>);

impl RobotSender {
    /// Sends a reading.
    pub fn reading(&self, reading: &RobotReading) {
        self.0.send(Kind::Reading, reading.encode());
    }

    /// Sends a turn of its lidar.
    pub fn turn(&self, turn: &RobotTurn) {
        self.0.send(Kind::Turn, turn.encode());
    }
}

/// Fetches files of a run from the core.
#[derive(Debug, Clone)]
pub struct Fetcher(Arc<Shared>);

impl Fetcher {
    /// Fetches a file of at most `most` bytes by its SHA-256. Blocks until it is there. The bytes are not verified.
    ///
    /// # Errors
    /// [`TransportError::NoFile`], also if no part of it arrives for ten seconds, or the connection stays lost.
    pub fn fetch(&self, sha256: &str, most: u64) -> Result<Vec<u8>, TransportError> {
        let mut fetched = self.attempt(sha256, most);
        for _ in 1..ATTEMPTS {
            if fetched != Err(LOST) {
                break;
            }
            pause();
            fetched = self.attempt(sha256, most);
        }
        fetched.map_err(|reason| TransportError::NoFile { sha256: sha256.to_owned(), reason })
    }

    fn attempt(&self, sha256: &str, most: u64) -> Result<Vec<u8>, &'static str> {
        let (sender, parts) = mpsc::channel();
        let number = {
            let mut fetches = self.0.fetches.lock();
            fetches.last = fetches.last.wrapping_add(1);
            let number = fetches.last;
            fetches.waiting.insert(number, sender);
            number
        };
        let is_sent = self.0.send(Kind::Fetch, numbered(number, sha256.as_bytes()));
        let fetched = if is_sent { collect(&parts, most) } else { Err(LOST) };
        self.0.fetches.lock().waiting.remove(&number);
        fetched
    }
}

#[allow(clippy::disallowed_methods, reason = "waits for the other end on a thread that does nothing else")]
fn pause() {
    thread::sleep(PAUSE);
}

/// Returns the parts of a file as one.
fn collect(parts: &mpsc::Receiver<Part>, most: u64) -> Result<Vec<u8>, &'static str> {
    let mut file = Vec::new();
    loop {
        match parts.recv_timeout(FILE_TIMEOUT) {
            Ok(Some(part)) if part.is_empty() => return Ok(file),
            Ok(Some(part)) if (file.len() + part.len()) as u64 > most => {
                return Err("it is longer than announced");
            }
            Ok(Some(part)) => file.extend_from_slice(&part),
            Ok(None) => return Err("it has no such file"),
            Err(mpsc::RecvTimeoutError::Timeout) => return Err("nothing arrives"),
            Err(mpsc::RecvTimeoutError::Disconnected) => return Err(LOST),
        }
    }
}

/// Returns the host of an address as its certificate has it.
pub(crate) fn server_name(core: &str) -> Result<ServerName<'static>, TransportError> {
    let invalid = || TransportError::Address(core.to_owned());
    let (host, _) = core.rsplit_once(':').ok_or_else(invalid)?;
    ServerName::try_from(host.trim_matches(['[', ']']).to_owned()).map_err(|_| invalid())
}

/// The dialer's thread.
struct Service<R> {
    core: String,
    host: ServerName<'static>,
    core_common_name: String,
    agent: AgentId,
    config: Arc<ClientConfig>,
    poll: Poll,
    shared: Arc<Shared>,
    receiver: R,
}

impl<R: Fn(FromCore)> Service<R> {
    fn run(mut self) {
        let mut pause = PAUSE;
        while !self.ends() {
            match self.connect() {
                Ok(connection) => {
                    let (reason, was_accepted) = self.serve(connection);
                    tracing::debug!("the connection to {} ended: {reason}", self.core);
                    if was_accepted {
                        pause = PAUSE;
                    }
                }
                Err(error) => tracing::debug!("cannot connect to {}: {error}", self.core),
            }
            self.wait(pause);
            pause = pause.mul_f64(GROWTH).min(LONGEST_PAUSE);
        }
    }

    fn ends(&self) -> bool {
        self.shared.ends.load(Ordering::Relaxed)
    }

    /// Waits so long, or until the end.
    fn wait(&mut self, pause: Duration) {
        let mut events = Events::with_capacity(4);
        let until = Instant::now() + pause;
        while !self.ends() {
            let left = until.saturating_duration_since(Instant::now());
            if left.is_zero() || self.poll.poll(&mut events, Some(left)).is_err_and(|e| !is_interrupted(&e)) {
                return;
            }
        }
    }

    fn connect(&self) -> Result<Connection, Closed> {
        let mut failed = io::Error::other("its host has no address");
        for address in self.core.to_socket_addrs()? {
            match net::TcpStream::connect_timeout(&address, LEASE) {
                Ok(socket) => {
                    socket.set_nonblocking(true)?;
                    let mut socket = TcpStream::from_std(socket);
                    let interests = Interest::READABLE | Interest::WRITABLE;
                    self.poll.registry().register(&mut socket, SOCKET, interests)?;
                    let tls = ClientConnection::new(Arc::clone(&self.config), self.host.clone())?;
                    return Ok(Connection::new(Instant::now(), socket, tls.into()));
                }
                Err(error) => failed = error,
            }
        }
        Err(failed.into())
    }

    /// Serves a connection until it ends. Returns the reason, and whether the core said anything.
    fn serve(&mut self, mut connection: Connection) -> (Closed, bool) {
        let mut was_accepted = false;
        let greeted = self.greet(&mut connection).and_then(|()| {
            // A process that reports now says its number on this connection, or finds it there.
            let mut shared = self.shared.connection.lock();
            if let Some((_, boot)) = *self.shared.alive.lock() {
                let message = boot.to_be_bytes().to_vec();
                connection.send(Instant::now(), Frame { kind: Kind::Alive, message })?;
            }
            *shared = Some(connection);
            Ok(())
        });
        let Err(reason) = greeted.and_then(|()| self.follow(&mut was_accepted));
        if let Some(mut connection) = self.shared.connection.lock().take() {
            connection.close();
        }
        // Those that fetch notice it.
        self.shared.fetches.lock().waiting.clear();
        (reason, was_accepted)
    }

    /// Waits until something can be read or written, or for a tick.
    fn poll(&mut self, wait: Duration) -> Result<(), Closed> {
        match self.poll.poll(&mut Events::with_capacity(4), Some(wait)) {
            Err(error) if !is_interrupted(&error) => Err(error.into()),
            _ if self.ends() => Err(Closed::Ended),
            _ => Ok(()),
        }
    }

    /// Makes the handshake, and says which agent this is, if the core is there.
    fn greet(&mut self, connection: &mut Connection) -> Result<(), Closed> {
        loop {
            let now = Instant::now();
            connection.exchange(now)?;
            if let Some(identity) = connection.identity() {
                let common_name = identity.map_err(Closed::Stranger)?.common_name;
                if common_name != self.core_common_name {
                    return Err(Closed::Stranger(format!("`{common_name}` is there, and not the core")));
                }
                let message = self.agent.as_str().as_bytes().to_vec();
                return connection.send(now, Frame { kind: Kind::Hello, message });
            }
            connection.advance(now)?;
            self.poll(TICK)?;
        }
    }

    /// Passes on what the core says, until the connection ends.
    fn follow(&mut self, was_accepted: &mut bool) -> Result<Infallible, Closed> {
        let mut frames = Vec::new();
        loop {
            let exchanged = {
                let mut shared = self.shared.connection.lock();
                let connection = shared.as_mut().ok_or(Closed::Ended)?;
                let now = Instant::now();
                let exchanged = connection.exchange(now);
                while let Some(frame) = connection.poll(frame::LONGEST)? {
                    frames.push(frame);
                }
                exchanged.and_then(|more| connection.advance(now).map(|()| more))
            };
            *was_accepted |= !frames.is_empty();
            frames.drain(..).for_each(|frame| self.take(frame));
            self.poll(if exchanged? { Duration::ZERO } else { TICK })?;
        }
    }

    fn take(&self, Frame { kind, message }: Frame) {
        let rejected = |error: &dyn std::fmt::Display| FromCore::Rejected(error.to_string());
        (self.receiver)(match kind {
            Kind::Quiet => return,
            Kind::Wanted => Wanted::decode(&message)
                .map_or_else(|e| rejected(&e), |wanted| FromCore::Wanted(Box::new(wanted))),
            Kind::Beat => Beat::decode(&message).map_or_else(|e| rejected(&e), FromCore::Beat),
            Kind::Command => RobotCommand::decode(&message).map_or_else(|e| rejected(&e), FromCore::Command),
            Kind::Part | Kind::Missing => {
                if let Some((number, part)) = frame::number(&message)
                    && let Some(fetch) = self.shared.fetches.lock().waiting.get(&number)
                {
                    // The receiver gives up a file that is longer than announced.
                    _ = fetch.send((kind == Kind::Part).then(|| part.to_vec()));
                }
                return;
            }
            kind => FromCore::Rejected(format!("the core does not say {kind:?}")),
        });
    }
}

fn is_interrupted(error: &io::Error) -> bool {
    error.kind() == io::ErrorKind::Interrupted
}
