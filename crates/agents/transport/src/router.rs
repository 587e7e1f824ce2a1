//! The core's end: one thread for the connections of all agents.
#![allow(
    clippy::disallowed_types,
    reason = "a shell with a clock; certificates end at a time of the calendar"
)]

use std::{
    collections::BTreeMap,
    io,
    net::{IpAddr, SocketAddr},
    path::PathBuf,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread::{self, JoinHandle},
    time::{Duration, Instant, SystemTime},
};

use cotorra_admission::{Place, Strangers};
use cotorra_agent_protocol::{Report, RobotCommand, RobotReading, RobotTurn, Transmit};
use cotorra_graph::AgentId;
use mio::{Events, Interest, Poll, Token, Waker, net::TcpListener};
use parking_lot::Mutex;
use rustls::{ServerConfig, ServerConnection};

use crate::{
    connection::{Closed, Connection, TICK},
    error::TransportError,
    frame::{self, Frame, Kind},
    refusals::Refusals,
    tls::{self, Credentials, Identity},
};

/// Messages of an agent that wait for the core. Further ones are dropped, so that a flood by one agent harms no other.
const MOST_WAITING: usize = 64;
/// Longest context, bytes.
const LONGEST_CONTEXT: usize = 256 << 10;
/// Longest name of an agent, bytes.
const LONGEST_HELLO: usize = 256;
/// Connections of one agent: those of its process, and of earlier ones that are about to end.
const MOST_CONNECTIONS: usize = 4;
/// Connections that have not said whose they are. A new one replaces the oldest.
const MOST_GREETING: usize = 256;

const LISTENER: Token = Token(0);
const WAKER: Token = Token(1);

/// A certificate that may speak for an agent.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Granted {
    pub agent: AgentId,
    /// The common name of the certificate.
    pub common_name: String,
}

/// Something that arrived from an agent.
#[derive(Debug)]
pub enum FromAgent {
    /// The connection of its process with this `boot` began or ended.
    Connection {
        boot: u64,
        is_there: bool,
    },
    Report(Report),
    /// The context of its machine, encoded.
    Context(Vec<u8>),
    /// Its robot says this.
    Reading(Box<RobotReading>),
    /// A turn of its robot's lidar.
    Turn(RobotTurn),
    /// A message of it was rejected, with the reason.
    Rejected(String),
}

/// Receives what arrives: the agent, the message, and a part to keep until the message is handled. Called from the router's
/// thread.
pub type Receiver = Arc<dyn Fn(AgentId, FromAgent, Arc<()>) + Send + Sync>;

/// A connection of an agent, once it is known whose it is.
type Shared = Arc<Mutex<Connection>>;

/// State that the router's thread shares with senders.
#[derive(Debug)]
struct Agents {
    /// The connections of each agent that is granted, oldest first.
    connections: BTreeMap<AgentId, Mutex<Vec<Shared>>>,
    ends: AtomicBool,
    waker: Waker,
}

/// A router that agents connect to. Dropping it ends their connections.
#[derive(Debug)]
pub struct Router {
    agents: Arc<Agents>,
    thread: Option<JoinHandle<()>>,
}

impl Router {
    /// Listens for the agents that are granted. Passes what arrives from them to `receiver`, and sends them `files` by
    /// their SHA-256.
    ///
    /// # Errors
    /// [`TransportError`], if the address cannot be used or a credential is not valid.
    pub fn open(
        listen: SocketAddr,
        credentials: Credentials<'_>,
        granted: &[Granted],
        files: BTreeMap<String, PathBuf>,
        receiver: &Receiver,
    ) -> Result<Self, TransportError> {
        let config = tls::server(credentials)?;
        let poll = Poll::new()?;
        let mut listener =
            TcpListener::bind(listen).map_err(|source| TransportError::Listen { address: listen, source })?;
        poll.registry().register(&mut listener, LISTENER, Interest::READABLE)?;
        let agents = Arc::new(Agents {
            connections: granted.iter().map(|granted| (granted.agent.clone(), Mutex::default())).collect(),
            ends: AtomicBool::new(false),
            waker: Waker::new(poll.registry(), WAKER)?,
        });
        let waiting = agents.connections.keys().map(|agent| (agent.clone(), Arc::new(()))).collect();
        let service = Service {
            poll,
            listener,
            config,
            granted: granted.iter().map(|its| (its.common_name.clone(), its.agent.clone())).collect(),
            agents: Arc::clone(&agents),
            ends: BTreeMap::new(),
            strangers: Strangers::new(MOST_GREETING),
            last: WAKER,
            files,
            receiver: Arc::clone(receiver),
            waiting,
            refusals: Refusals::default(),
        };
        let thread = thread::Builder::new().name("agent-router".to_owned()).spawn(move || service.run())?;
        Ok(Self { agents, thread: Some(thread) })
    }

    /// Sends a message to its agent. An agent that is not connected does not get it.
    pub fn send(&self, transmit: &Transmit) {
        match transmit {
            Transmit::Wanted(agent, wanted) => self.write(agent, Kind::Wanted, wanted.encode()),
            Transmit::Beat(agent, beat) => self.write(agent, Kind::Beat, beat.encode()),
        }
    }

    /// Sends a command to the robot of an agent. An agent that is not connected does not get it.
    pub fn command(&self, agent: &AgentId, command: &RobotCommand) {
        self.write(agent, Kind::Command, command.encode());
    }

    fn write(&self, agent: &AgentId, kind: Kind, message: Vec<u8>) {
        let Some(connections) = self.agents.connections.get(agent) else { return };
        let (connections, now) = (connections.lock().clone(), Instant::now());
        for connection in connections {
            if let Err(reason) = connection.lock().send(now, Frame { kind, message: message.clone() }) {
                tracing::debug!("cannot send to agent `{agent}`: {reason}");
            }
        }
    }
}

impl Drop for Router {
    fn drop(&mut self) {
        self.agents.ends.store(true, Ordering::Relaxed);
        if let Err(error) = self.agents.waker.wake() {
            tracing::debug!("cannot wake the agents' router: {error}");
        }
        if self.thread.take().is_some_and(|thread| thread.join().is_err()) {
            tracing::error!("the agents' router panicked");
        }
    }
}

/// A connection at the router.
enum End {
    /// Not known to be of an agent.
    Greeting(Greeting),
    Agent(AgentEnd),
}

/// A connection that has not said whose it is.
struct Greeting {
    connection: Box<Connection>,
    from: IpAddr,
    /// Its number among the strangers.
    number: u64,
}

/// A connection of an agent.
struct AgentEnd {
    agent: AgentId,
    connection: Shared,
    expires: SystemTime,
    /// The number of its process, once it said so.
    boot: Option<u64>,
}

/// The router's thread.
struct Service {
    poll: Poll,
    listener: TcpListener,
    config: Arc<ServerConfig>,
    /// The agents by the common names of their certificates.
    granted: BTreeMap<String, AgentId>,
    agents: Arc<Agents>,
    ends: BTreeMap<Token, End>,
    /// Those of the ends that greet.
    strangers: Strangers<Token>,
    /// The token that was given last.
    last: Token,
    files: BTreeMap<String, PathBuf>,
    receiver: Receiver,
    /// A part of each message of an agent that waits for the core.
    waiting: BTreeMap<AgentId, Arc<()>>,
    refusals: Refusals,
}

impl Service {
    fn run(mut self) {
        let mut events = Events::with_capacity(256);
        // Connections that may have more to read.
        let mut again = Vec::new();
        let mut next_tick = Instant::now() + TICK;
        while !self.agents.ends.load(Ordering::Relaxed) {
            let wait = if again.is_empty() {
                next_tick.saturating_duration_since(Instant::now())
            } else {
                Duration::ZERO
            };
            if let Err(error) = self.poll.poll(&mut events, Some(wait))
                && error.kind() != io::ErrorKind::Interrupted
            {
                tracing::error!("agents cannot connect: {error}");
                return;
            }
            let mut ready = std::mem::take(&mut again);
            ready.extend(events.iter().map(|event| event.token()));
            ready.sort_unstable();
            ready.dedup();
            for token in ready {
                match token {
                    LISTENER => self.accept(),
                    WAKER => {}
                    token => {
                        if self.serve(token) {
                            again.push(token);
                        }
                    }
                }
            }
            if Instant::now() >= next_tick {
                next_tick = Instant::now() + TICK;
                self.advance();
                // After an error, the listener has no event for those that wait.
                self.accept();
            }
        }
        for end in self.ends.values_mut() {
            match end {
                End::Greeting(greeting) => greeting.connection.close(),
                End::Agent(end) => end.connection.lock().close(),
            }
        }
    }

    /// Accepts the connections that wait.
    fn accept(&mut self) {
        loop {
            let (mut socket, address) = match self.listener.accept() {
                Ok(accepted) => accepted,
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => return,
                Err(error) => {
                    self.refusals.warn(error.to_string());
                    // There may be no file left.
                    let oldest = self.strangers.shed();
                    self.replace(oldest);
                    return;
                }
            };
            tracing::debug!("{address} connects");
            self.last.0 += 1;
            let interests = Interest::READABLE | Interest::WRITABLE;
            let begun =
                self.poll.registry().register(&mut socket, self.last, interests).map_err(Closed::from);
            match begun.and_then(|()| Ok(ServerConnection::new(Arc::clone(&self.config))?)) {
                Ok(tls) => {
                    let connection = Box::new(Connection::new(Instant::now(), socket, tls.into()));
                    let Place { number, replaced } = self.strangers.arrive(address.ip(), self.last);
                    let greeting = Greeting { connection, from: address.ip(), number };
                    self.ends.insert(self.last, End::Greeting(greeting));
                    self.replace(replaced);
                }
                Err(error) => self.refusals.warn(error.to_string()),
            }
        }
    }

    /// Closes a connection that gave its place to another.
    fn replace(&mut self, replaced: Option<Token>) {
        if let Some(End::Greeting(mut greeting)) = replaced.and_then(|token| self.ends.remove(&token)) {
            self.refusals.warn("too many connections do not say whose they are".to_owned());
            greeting.connection.close();
        }
    }

    /// Reads and writes what a connection has and takes. Returns whether it may have more to read.
    fn serve(&mut self, token: Token) -> bool {
        let now = Instant::now();
        let exchanged = match self.ends.get_mut(&token) {
            Some(End::Greeting(greeting)) => greeting.connection.exchange(now),
            Some(End::Agent(end)) => end.connection.lock().exchange(now),
            None => return false,
        };
        // Bytes that were read before the end count.
        if let Err(reason) = self.take_all(token) {
            self.reject(token, reason);
            return false;
        }
        exchanged.unwrap_or_else(|reason| {
            self.close(token, &reason);
            false
        })
    }

    /// Takes the frames that were read.
    ///
    /// # Errors
    /// The reason for which the connection cannot go on.
    fn take_all(&mut self, token: Token) -> Result<(), String> {
        loop {
            let frame = match self.ends.get_mut(&token) {
                Some(End::Greeting(greeting)) => greeting.connection.poll(LONGEST_HELLO),
                Some(End::Agent(end)) => end.connection.lock().poll(frame::LONGEST),
                None => return Ok(()),
            };
            let Some(frame) = frame.map_err(|error| error.to_string())? else { return Ok(()) };
            match self.ends.remove(&token) {
                Some(End::Greeting(Greeting { connection, from, number })) => {
                    self.strangers.leave(number);
                    if let Some(end) = self.greet(*connection, &frame) {
                        self.strangers.know(from);
                        self.ends.insert(token, End::Agent(end));
                    }
                }
                Some(End::Agent(mut end)) => {
                    let taken = self.take(&mut end, frame);
                    self.ends.insert(token, End::Agent(end));
                    taken?;
                }
                None => {}
            }
        }
    }

    /// Makes a connection that of an agent, if its first frame and its certificate say so. Closes it otherwise.
    fn greet(&mut self, mut connection: Connection, frame: &Frame) -> Option<AgentEnd> {
        let identity = match connection.identity()? {
            Ok(identity) => identity,
            Err(reason) => {
                self.refusals.warn(reason);
                connection.close();
                return None;
            }
        };
        let Identity { common_name, expires } = identity;
        let Some(agent) = self.granted.get(&common_name).cloned() else {
            self.refusals.note(format!("`{common_name}` is revoked, or the run has no such agent"));
            connection.close();
            return None;
        };
        if frame.kind != Kind::Hello || frame.message != agent.as_str().as_bytes() {
            self.refusals.warn(format!("`{common_name}` does not say that it is `{agent}`"));
            connection.close();
            return None;
        }
        let connection = Arc::new(Mutex::new(connection));
        let mut all = self.agents.connections[&agent].lock();
        if all.len() >= MOST_CONNECTIONS {
            all.remove(0).lock().close();
        }
        all.push(Arc::clone(&connection));
        drop(all);
        Some(AgentEnd { agent, connection, expires, boot: None })
    }

    /// Takes a frame of an agent.
    fn take(&self, end: &mut AgentEnd, Frame { kind, message }: Frame) -> Result<(), String> {
        let rejected = |error: &dyn std::fmt::Display| FromAgent::Rejected(error.to_string());
        let arrived = match kind {
            Kind::Quiet => return Ok(()),
            Kind::Alive => {
                let boot = message.try_into().map_err(|_| "a number of a process that is none")?;
                let boot = u64::from_be_bytes(boot);
                end.boot = Some(boot);
                FromAgent::Connection { boot, is_there: true }
            }
            Kind::Report => Report::decode(&message).map_or_else(|e| rejected(&e), FromAgent::Report),
            Kind::Reading => RobotReading::decode(&message)
                .map_or_else(|e| rejected(&e), |reading| FromAgent::Reading(Box::new(reading))),
            Kind::Turn => RobotTurn::decode(&message).map_or_else(|e| rejected(&e), FromAgent::Turn),
            Kind::Context if message.len() > LONGEST_CONTEXT => {
                FromAgent::Rejected(format!("a context of {} bytes", message.len()))
            }
            Kind::Context => FromAgent::Context(message),
            Kind::Fetch => {
                let (number, sha256) = frame::number(&message).ok_or("a fetch without a number")?;
                let path = str::from_utf8(sha256).ok().and_then(|sha256| self.files.get(sha256));
                // The next exchange notices a connection that is closed.
                _ = end.connection.lock().send_file(Instant::now(), number, path.map(PathBuf::as_path));
                return Ok(());
            }
            Kind::Hello | Kind::Wanted | Kind::Beat | Kind::Command | Kind::Part | Kind::Missing => {
                return Err(format!("an agent does not say {kind:?}"));
            }
        };
        self.pass(&end.agent, arrived);
        Ok(())
    }

    /// Passes a message on, unless too many of its agent wait.
    fn pass(&self, agent: &AgentId, arrived: FromAgent) {
        let waiting = &self.waiting[agent];
        if Arc::strong_count(waiting) <= MOST_WAITING {
            (self.receiver)(agent.clone(), arrived, Arc::clone(waiting));
        }
    }

    /// Ends a connection whose messages are not of the protocol.
    fn reject(&mut self, token: Token, reason: String) {
        match self.ends.get(&token) {
            Some(End::Agent(end)) => self.pass(&end.agent, FromAgent::Rejected(reason)),
            _ => self.refusals.warn(reason),
        }
        self.close(token, &Closed::Ended);
    }

    /// Forgets a connection, which is closed.
    fn close(&mut self, token: Token, reason: &Closed) {
        match self.ends.remove(&token) {
            Some(End::Greeting(Greeting { mut connection, number, .. })) => {
                self.strangers.leave(number);
                match reason {
                    Closed::Tls(error) => self.refusals.warn(error.to_string()),
                    reason => tracing::debug!("a connection ended before it said whose it is: {reason}"),
                }
                connection.close();
            }
            Some(End::Agent(AgentEnd { agent, connection, boot, .. })) => {
                tracing::debug!("a connection of agent `{agent}` ended: {reason}");
                connection.lock().close();
                self.agents.connections[&agent].lock().retain(|other| !Arc::ptr_eq(other, &connection));
                let has_another = self.ends.values().any(
                    |end| matches!(end, End::Agent(other) if other.agent == agent && other.boot == boot),
                );
                if let Some(boot) = boot.filter(|_| !has_another) {
                    self.pass(&agent, FromAgent::Connection { boot, is_there: false });
                }
            }
            None => {}
        }
    }

    /// Does what is due at all connections.
    fn advance(&mut self) {
        let (now, today) = (Instant::now(), SystemTime::now());
        let mut closed = Vec::new();
        for (token, end) in &mut self.ends {
            let advanced = match end {
                End::Greeting(greeting) => greeting.connection.advance(now),
                End::Agent(end) if end.expires <= today => Err(Closed::Expired),
                End::Agent(end) => end.connection.lock().advance(now),
            };
            closed.extend(advanced.err().map(|reason| (*token, reason)));
        }
        closed.into_iter().for_each(|(token, reason)| self.close(token, &reason));
    }
}
