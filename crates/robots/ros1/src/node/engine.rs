//! The thread that moves a node's bytes: calls of the slave API, queued messages of publishers, messages to subscribers,
//! and requests to services. It never blocks on a peer: connecting to a publisher has a thread of its own.

#![allow(clippy::disallowed_types, reason = "a shell that owns a clock")]

mod answers;
mod connection;

use std::{
    collections::{BTreeMap, HashMap, VecDeque},
    io::{self, ErrorKind, Write},
    net::{self, TcpStream as StdStream},
    sync::{Arc, atomic::Ordering, mpsc},
    thread,
    time::{Duration, Instant},
};

use super::{
    shared::{Command, Shared},
    subscription::Subscription,
};
use crate::{
    buffers::{Buffers, Held},
    master::{self, RpcError},
    queue::SendQueue,
    tcpros::{FrameReader, Header, MAX_HEADER_LEN, MAX_MESSAGE_LEN},
    uri::Endpoint,
    xmlrpc::Value,
};
use connection::{Connection, Flow, Next, Phase, READS_A_TURN, ask_service, introduce, is_over, prepare};
use mio::{
    Events, Interest, Poll, Token, Waker,
    net::{TcpListener, TcpStream},
};

const WAKER: Token = Token(0);
const SLAVE: Token = Token(1);
const TCPROS: Token = Token(2);
const FIRST: usize = 3;

/// Most open connections. Each takes a file descriptor and memory.
const MAX_CONNECTIONS: usize = 1024;
/// Most bytes of messages, requests and calls that have not arrived in full.
const MOST_HELD: usize = 256 << 20;
/// Most of these of the peers at one address. A message of any length fits.
const MOST_HELD_OF_ADDRESS: usize = 160 << 20;
/// Deadline for a connection to state its purpose.
const HANDSHAKE: Duration = Duration::from_secs(10);
/// Time after which an idle connection of the slave API is closed; the next call opens another.
const IDLE: Duration = Duration::from_secs(60);
/// First retry interval for a publisher that cannot be reached, doubled each time up to the last.
const FIRST_RETRY: Duration = Duration::from_millis(100);
const LAST_RETRY: Duration = Duration::from_secs(2);
/// The connection to one publisher of one subscription.
#[derive(Debug)]
struct Link {
    state: LinkState,
    /// Interval before the next attempt.
    retry: Duration,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum LinkState {
    Connecting,
    Connected(Token),
    Waiting,
}

enum Timer {
    /// Ends a connection that stays silent.
    Silence(Token),
    /// Retries the connection to a publisher.
    Retry { subscription: u64, publisher: String },
}

pub(super) struct Engine {
    poll: Poll,
    slave: TcpListener,
    tcpros: TcpListener,
    commands: mpsc::Receiver<Command>,
    connections: HashMap<Token, Connection>,
    held: Arc<Held>,
    next_token: usize,
    /// Connections with work left in the next turn.
    again: VecDeque<Token>,
    /// Links of each subscription, by the publishers' addresses.
    links: HashMap<u64, BTreeMap<String, Link>>,
    timers: BTreeMap<(Instant, usize), Timer>,
    next_timer: usize,
}

impl Engine {
    pub fn new(
        slave: net::TcpListener,
        tcpros: net::TcpListener,
        commands: mpsc::Receiver<Command>,
    ) -> io::Result<(Self, Waker)> {
        let poll = Poll::new()?;
        let listener = |listener: net::TcpListener, token| {
            listener.set_nonblocking(true)?;
            let mut listener = TcpListener::from_std(listener);
            poll.registry().register(&mut listener, token, Interest::READABLE)?;
            io::Result::Ok(listener)
        };
        let (slave, tcpros) = (listener(slave, SLAVE)?, listener(tcpros, TCPROS)?);
        let waker = Waker::new(poll.registry(), WAKER)?;
        let engine = Self {
            poll,
            slave,
            tcpros,
            commands,
            connections: HashMap::new(),
            held: Held::new(MOST_HELD, MOST_HELD_OF_ADDRESS),
            next_token: FIRST,
            again: VecDeque::new(),
            links: HashMap::new(),
            timers: BTreeMap::new(),
            next_timer: 0,
        };
        Ok((engine, waker))
    }

    /// Runs until the node ends.
    pub fn run(mut self, shared: &Arc<Shared>) {
        let mut events = Events::with_capacity(256);
        while self.turn(shared, &mut events) {}
        let state = std::mem::take(&mut *shared.state.lock());
        state.publications.values().for_each(|publication| publication.close());
        state.watches.values().for_each(|watch| watch.close());
        for subscription in state.subscriptions.values() {
            subscription.connected.store(0, Ordering::Relaxed);
            subscription.inbox.close();
        }
    }

    /// Waits for events and handles them. Returns whether the node goes on.
    fn turn(&mut self, shared: &Arc<Shared>, events: &mut Events) -> bool {
        let due =
            self.timers.first_key_value().map(|((at, _), _)| at.saturating_duration_since(Instant::now()));
        let timeout = if self.again.is_empty() { due } else { Some(Duration::ZERO) };
        match self.poll.poll(events, timeout) {
            Err(error) if error.kind() != ErrorKind::Interrupted => {
                tracing::error!("{} cannot wait for events: {error}", shared.names.node());
                return false;
            }
            _ => {}
        }
        let again = std::mem::take(&mut self.again);
        for event in events.iter() {
            match event.token() {
                WAKER => {}
                SLAVE => self.accept(SLAVE),
                TCPROS => self.accept(TCPROS),
                token => self.serve(shared, token),
            }
        }
        again.into_iter().for_each(|token| self.serve(shared, token));
        while let Ok(command) = self.commands.try_recv() {
            match command {
                Command::Stop => return false,
                command => self.run_command(shared, command),
            }
        }
        self.ring(shared);
        true
    }

    fn set_timer(&mut self, after: Duration, timer: Timer) {
        self.next_timer += 1;
        self.timers.insert((Instant::now() + after, self.next_timer), timer);
    }

    fn ring(&mut self, shared: &Arc<Shared>) {
        let now = Instant::now();
        while let Some(entry) = self.timers.first_entry().filter(|entry| entry.key().0 <= now) {
            match entry.remove() {
                Timer::Silence(token) => match self.connections.get_mut(&token) {
                    Some(Connection::Caller { active, .. }) if *active => {
                        *active = false;
                        self.set_timer(IDLE, Timer::Silence(token));
                    }
                    Some(connection) if connection.is_undecided() => self.end(shared, token),
                    _ => {}
                },
                Timer::Retry { subscription, publisher } => {
                    let link = self.link(subscription, &publisher);
                    if link.is_some_and(|link| link.state == LinkState::Waiting) {
                        self.connect(shared, subscription, &publisher);
                    }
                }
            }
        }
    }

    fn run_command(&mut self, shared: &Arc<Shared>, command: Command) {
        match command {
            Command::Publishers { subscription, publishers } => {
                let subscribed = shared.state.lock().subscriptions.get(&subscription).cloned();
                if subscribed.is_some_and(|subscribed| !subscribed.notified.load(Ordering::Acquire)) {
                    self.set_publishers(shared, subscription, &publishers);
                }
            }
            Command::Connected { subscription, publisher, stream } => {
                self.connected(shared, subscription, publisher, stream);
            }
            Command::Response { client, response } => {
                if let Some(Connection::Client { output, phase, .. }) = self.connections.get_mut(&client) {
                    output.push(Arc::new(response));
                    *phase = match *phase {
                        Phase::Pending { persistent: true } => Phase::Idle { persistent: true },
                        _ => Phase::Answered,
                    };
                    self.serve(shared, client);
                }
            }
            Command::Unsubscribed(subscription) => {
                for link in self.links.remove(&subscription).unwrap_or_default().into_values() {
                    self.unlink(shared, &link);
                }
            }
            Command::Unserved(name) => {
                let of_it = |connection: &Connection| matches!(connection, Connection::Client { offer, .. } if offer.name == name);
                let clients = self.connections.iter().filter(|(_, connection)| of_it(connection));
                for token in clients.map(|(token, _)| *token).collect::<Vec<_>>() {
                    self.end(shared, token);
                }
            }
            Command::Stop => unreachable!("the caller handles it"),
        }
    }

    fn accept(&mut self, from: Token) {
        loop {
            let listener = if from == SLAVE { &self.slave } else { &self.tcpros };
            let (stream, peer) = match listener.accept() {
                Ok(accepted) => accepted,
                Err(error) if error.kind() == ErrorKind::WouldBlock => return,
                Err(error) if error.kind() == ErrorKind::Interrupted => continue,
                Err(error) => {
                    // The peer is gone already, or file descriptors ran out, for example.
                    tracing::warn!("a connection could not be accepted: {error}");
                    return;
                }
            };
            if self.connections.len() >= MAX_CONNECTIONS {
                tracing::warn!("a connection was rejected: {MAX_CONNECTIONS} are open");
                continue;
            }
            let held = Buffers::new(&self.held, peer.ip().to_canonical());
            let opened = self.open(stream, |stream| match from {
                SLAVE => {
                    let output = SendQueue::new(1, None);
                    Connection::Caller { stream, input: Vec::new(), held, output, last: false, active: false }
                }
                _ => Connection::New { stream, frames: FrameReader::new(MAX_HEADER_LEN, held) },
            });
            if let Err(error) = opened {
                tracing::debug!("a connection was lost at once: {error}");
            }
        }
    }

    fn open(
        &mut self,
        mut stream: TcpStream,
        connection: impl FnOnce(TcpStream) -> Connection,
    ) -> io::Result<Token> {
        prepare(&stream)?;
        let token = Token(self.next_token);
        self.poll.registry().register(&mut stream, token, Interest::READABLE | Interest::WRITABLE)?;
        self.next_token += 1;
        self.connections.insert(token, connection(stream));
        self.set_timer(HANDSHAKE, Timer::Silence(token));
        Ok(token)
    }

    /// Handles the events of a connection.
    fn serve(&mut self, shared: &Arc<Shared>, token: Token) {
        // Out of the map, so that the handler can use the other connections.
        let Some(connection) = self.connections.remove(&token) else { return };
        let next = match connection {
            Connection::Caller { stream, input, held, output, last, active } => {
                self.answer(shared, stream, (input, held), output, last, active)
            }
            Connection::New { stream, frames } => introduce(shared, stream, frames),
            Connection::Publisher { stream, frames, subscription, publisher, flow } => {
                self.receive(stream, frames, subscription, publisher, flow)
            }
            Connection::Subscriber { outgoing, publication } => {
                let ended = outgoing.flush().is_err() || is_over(&outgoing.stream);
                let connection = Connection::Subscriber { outgoing, publication };
                if ended { Next::End(connection) } else { Next::Wait(connection) }
            }
            Connection::Client { stream, frames, output, offer, phase } => {
                ask_service(token, stream, frames, output, offer, phase)
            }
            Connection::Ending { stream, mut output } => {
                let mut ended = output.flush(&mut &stream).is_err();
                if output.is_empty() {
                    // The peer closes it. If this side did, with unread bytes, the peer might lose the last ones.
                    ended |= stream.shutdown(net::Shutdown::Write).is_err() || is_over(&stream);
                }
                let connection = Connection::Ending { stream, output };
                if ended { Next::End(connection) } else { Next::Wait(connection) }
            }
        };
        match next {
            Next::Wait(connection) => drop(self.connections.insert(token, connection)),
            Next::Again(connection) => {
                self.connections.insert(token, connection);
                self.again.push_back(token);
            }
            Next::End(connection) => self.ended(shared, token, connection),
        }
    }

    fn end(&mut self, shared: &Arc<Shared>, token: Token) {
        if let Some(connection) = self.connections.remove(&token) {
            self.ended(shared, token, connection);
        }
    }

    /// Cleans up after a connection. Dropping it closes it.
    fn ended(&mut self, shared: &Arc<Shared>, token: Token, connection: Connection) {
        match connection {
            Connection::Subscriber { outgoing, publication } => publication.disconnect(&outgoing),
            Connection::Publisher { subscription, publisher, flow, .. } => {
                if flow.begun {
                    subscription.connected.fetch_sub(1, Ordering::Relaxed);
                }
                let link = self.link(subscription.id, &publisher);
                if link.is_some_and(|link| link.state == LinkState::Connected(token)) {
                    tracing::debug!("{} lost {publisher} of {}", shared.names.node(), subscription.topic);
                    self.retry(subscription.id, &publisher);
                }
            }
            _ => {}
        }
    }

    fn link(&mut self, subscription: u64, publisher: &str) -> Option<&mut Link> {
        self.links.get_mut(&subscription)?.get_mut(publisher)
    }

    fn unlink(&mut self, shared: &Arc<Shared>, link: &Link) {
        if let LinkState::Connected(token) = link.state {
            self.end(shared, token);
        }
    }

    /// Connects to new publishers, and leaves those that are gone.
    fn set_publishers(&mut self, shared: &Arc<Shared>, subscription: u64, publishers: &[String]) {
        if !shared.state.lock().subscriptions.contains_key(&subscription) {
            return;
        }
        let links = self.links.entry(subscription).or_default();
        let gone: Vec<_> = links.extract_if(.., |publisher, _| !publishers.contains(publisher)).collect();
        let new: Vec<_> = publishers.iter().filter(|publisher| !links.contains_key(*publisher)).collect();
        gone.iter().for_each(|(_, link)| self.unlink(shared, link));
        for publisher in new {
            self.connect(shared, subscription, publisher);
        }
    }

    /// Connects to a publisher, on a thread of its own: name resolution and silent peers block.
    fn connect(&mut self, shared: &Arc<Shared>, subscription: u64, publisher: &str) {
        let Some(subscribed) = shared.state.lock().subscriptions.get(&subscription).cloned() else { return };
        let links = self.links.entry(subscription).or_default();
        let link = links.entry(publisher.to_owned());
        link.or_insert(Link { state: LinkState::Connecting, retry: FIRST_RETRY }).state =
            LinkState::Connecting;
        let (dialler, publisher) = (Arc::clone(shared), publisher.to_owned());
        let called = publisher.clone();
        let dial = move || {
            let stream = dial(&dialler, &subscribed, &publisher);
            dialler.command(Command::Connected { subscription, publisher, stream });
        };
        if let Err(error) = thread::Builder::new().name("ros1-connect".to_owned()).spawn(dial) {
            tracing::warn!("no thread to connect to {called}: {error}");
            self.retry(subscription, &called);
        }
    }

    fn retry(&mut self, subscription: u64, publisher: &str) {
        let Some(link) = self.link(subscription, publisher) else { return };
        link.state = LinkState::Waiting;
        let after = link.retry;
        link.retry = (2 * after).min(LAST_RETRY);
        self.set_timer(after, Timer::Retry { subscription, publisher: publisher.to_owned() });
    }

    fn connected(
        &mut self,
        shared: &Arc<Shared>,
        id: u64,
        publisher: String,
        stream: Result<StdStream, String>,
    ) {
        // The connection may be obsolete, or made twice.
        let wanted = self.link(id, &publisher).is_some_and(|link| link.state == LinkState::Connecting);
        let subscription = shared.state.lock().subscriptions.get(&id).cloned();
        let Some(subscription) = subscription.filter(|_| wanted) else { return };
        let called = publisher.clone();
        let opened = stream.and_then(|stream| {
            stream.set_nonblocking(true).map_err(|error| error.to_string())?;
            let peer = stream.peer_addr().map_err(|error| error.to_string())?;
            let held = Buffers::new(&self.held, peer.ip().to_canonical());
            let frames = FrameReader::new(MAX_HEADER_LEN, held);
            let connection = |stream| Connection::Publisher {
                stream,
                frames,
                subscription,
                publisher,
                flow: Flow::default(),
            };
            self.open(TcpStream::from_std(stream), connection).map_err(|error| error.to_string())
        });
        match opened {
            Ok(token) => {
                if let Some(link) = self.link(id, &called) {
                    link.state = LinkState::Connected(token);
                }
            }
            Err(error) => {
                tracing::debug!("{} cannot reach {called}: {error}", shared.names.node());
                self.retry(id, &called);
            }
        }
    }

    /// Receives the connection header and the messages of a publisher.
    fn receive(
        &mut self,
        stream: TcpStream,
        mut frames: FrameReader,
        subscription: Arc<Subscription>,
        publisher: String,
        mut flow: Flow,
    ) -> Next {
        let mut reads = 0;
        let over = loop {
            match frames.next_frame() {
                Ok(Some(message)) if flow.begun => {
                    flow.messages += 1;
                    flow.bytes += message.len() as u64;
                    subscription.inbox.push_with(|oldest| {
                        let mut buffer = oldest.unwrap_or_default();
                        buffer.clear();
                        buffer.extend_from_slice(message);
                        buffer
                    });
                    continue;
                }
                Ok(Some(header)) => {
                    if let Err(reason) = check_publisher(&subscription, header) {
                        tracing::warn!("{publisher} does not fit {}: {reason}", subscription.topic);
                        // Frequent retries do not change its type.
                        self.link(subscription.id, &publisher)
                            .into_iter()
                            .for_each(|link| link.retry = LAST_RETRY);
                        break Some(true);
                    }
                    frames.set_limit(MAX_MESSAGE_LEN);
                    flow.begun = true;
                    subscription.connected.fetch_add(1, Ordering::Relaxed);
                    self.link(subscription.id, &publisher)
                        .into_iter()
                        .for_each(|link| link.retry = FIRST_RETRY);
                    continue;
                }
                Ok(None) => {}
                Err(error) => {
                    tracing::warn!("{publisher} does not speak TCPROS on {}: {error}", subscription.topic);
                    break Some(true);
                }
            }
            if reads == READS_A_TURN {
                break None;
            }
            reads += 1;
            match frames.read_from(&mut &stream) {
                Ok(0) => break Some(true),
                Ok(_) => {}
                Err(error) if error.kind() == ErrorKind::WouldBlock => break Some(false),
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(_) => break Some(true),
            }
        };
        let connection = Connection::Publisher { stream, frames, subscription, publisher, flow };
        match over {
            None => Next::Again(connection),
            Some(false) => Next::Wait(connection),
            Some(true) => Next::End(connection),
        }
    }
}

/// Connects to the publisher at an address, and sends the connection header.
fn dial(shared: &Shared, subscription: &Subscription, publisher: &str) -> Result<StdStream, String> {
    let node: Endpoint = publisher.parse().map_err(|error| format!("{error}"))?;
    let protocols = Value::Array(vec![vec!["TCPROS"].into()]);
    let arguments = vec![shared.names.node().into(), subscription.topic.as_str().into(), protocols];
    let answer = master::ask(&node, "requestTopic", arguments).map_err(|error| error.to_string())?;
    let endpoint = match answer.as_array() {
        Some([protocol, host, port, ..]) if protocol.as_str() == Some("TCPROS") => host
            .as_str()
            .zip(port.as_int().and_then(|port| u16::try_from(port).ok()))
            .map(|(host, port)| Endpoint { host: host.to_owned(), port }),
        _ => None,
    };
    let expected = RpcError::Answer { method: "requestTopic", expected: "[\"TCPROS\", host, port]" };
    let endpoint = endpoint.ok_or_else(|| expected.to_string())?;
    let mut stream = master::connect(&endpoint).map_err(|error| format!("{endpoint}: {error}"))?;
    let header = Header::new([
        ("callerid", shared.names.node()),
        ("topic", &subscription.topic),
        ("type", subscription.kind.name),
        ("md5sum", &subscription.kind.md5sum),
        ("message_definition", &subscription.kind.definition),
        ("tcp_nodelay", "1"),
    ]);
    stream.write_all(&header.to_frame()).map_err(|error| format!("{endpoint}: {error}"))?;
    Ok(stream)
}

/// Checks that a publisher's connection header fits the subscription.
fn check_publisher(subscription: &Subscription, header: &[u8]) -> Result<(), String> {
    let header = Header::from_bytes(header).map_err(|error| error.to_string())?;
    if let Some(error) = header.get("error") {
        return Err(error.to_owned());
    }
    subscription.kind.check(header.get("md5sum"), header.get("type"))
}
