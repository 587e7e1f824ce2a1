//! The thread that moves a node's bytes: what others ask the node, what its publishers have to send still, what its
//! subscribers receive, and requests to its services. It never waits for anyone; what may take time, connecting to a
//! publisher, has a thread of its own for as long as it takes.

#![allow(clippy::disallowed_types, reason = "a shell that owns a clock")]

use std::{
    collections::{BTreeMap, HashMap, VecDeque},
    io::{self, ErrorKind, Read, Write},
    net::{self, TcpStream as StdStream},
    sync::{Arc, atomic::Ordering, mpsc},
    thread,
    time::{Duration, Instant},
};

use mio::{
    Events, Interest, Poll, Token, Waker,
    net::{TcpListener, TcpStream},
};
use socket2::{SockRef, TcpKeepalive};

use super::{
    Shared,
    keeper::Errand,
    service::{self, Offer},
    topics::{Outgoing, Publication, Subscription},
};
use crate::{
    http,
    master::{self, RpcError},
    messages::EmptyResponse,
    queue::{SendQueue, lock},
    slave::{self, Request},
    tcpros::{FrameReader, Header, MAX_HEADER_LEN, MAX_MESSAGE_LEN},
    uri::Endpoint,
    xmlrpc::{self, Call, Value},
};

const WAKER: Token = Token(0);
const SLAVE: Token = Token(1);
const TCPROS: Token = Token(2);
const FIRST: usize = 3;

/// A call of the slave API is no longer.
const MAX_CALL: usize = 1 << 20;
/// More connections are refused: each is a file descriptor and memory.
const MAX_CONNECTIONS: usize = 1024;
/// A connection says what it is for within this time.
const HANDSHAKE: Duration = Duration::from_secs(10);
/// One over which nobody asks anything for so long is closed; the next call opens another.
const IDLE: Duration = Duration::from_secs(60);
/// A publisher that could not be connected to is tried again after this time, doubled each time up to the longest.
const FIRST_RETRY: Duration = Duration::from_millis(100);
const LAST_RETRY: Duration = Duration::from_secs(2);
/// One connection gives way to others after so many reads.
const READS_A_TURN: usize = 16;
/// What the kernel holds back of a connection that does not take it: what comes after it waits in a queue that drops
/// the oldest, so that a peer gets news, not history, after its network was away.
const UNSENT: u32 = 16 << 10;

/// What the node's other threads have for this one.
#[derive(Debug)]
pub(super) enum Command {
    /// These are a subscription's publishers, says the master.
    Publishers { subscription: u64, publishers: Vec<String> },
    /// A connection to a publisher was made, with the header sent; or not.
    Connected { subscription: u64, publisher: String, stream: Result<StdStream, String> },
    /// A service answered.
    Response { client: Token, response: Vec<u8> },
    /// A subscription ended.
    Unsubscribed(u64),
    /// A service ended.
    Unserved(String),
    /// The node ends.
    Stop,
}

/// A connection, by what it is for.
enum Connection {
    /// Someone asks the node.
    Caller { stream: TcpStream, input: Vec<u8>, output: SendQueue, last: bool, heard: bool },
    /// Someone connected to TCPROS, and has not said why.
    New { stream: TcpStream, frames: FrameReader },
    /// To a subscriber.
    Subscriber { outgoing: Arc<Outgoing>, publication: Arc<Publication> },
    /// To a publisher.
    Publisher {
        stream: TcpStream,
        frames: FrameReader,
        subscription: Arc<Subscription>,
        publisher: String,
        flow: Flow,
    },
    /// To a client of a service.
    Client { stream: TcpStream, frames: FrameReader, output: SendQueue, offer: Arc<Offer>, phase: Phase },
    /// One that ends once it has been told why, or what it asked for.
    Ending { stream: TcpStream, output: SendQueue },
}

/// What came from a publisher.
#[derive(Debug, Clone, Copy, Default)]
struct Flow {
    /// Whether its connection header came.
    begun: bool,
    messages: u64,
    bytes: u64,
}

/// What a client of a service waits for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Phase {
    /// Nothing: its next request is to come.
    Idle { persistent: bool },
    /// For the service.
    Asked { persistent: bool },
    /// For the last bytes of its only response.
    Answered,
}

/// What becomes of a connection.
enum Next {
    /// It waits for events.
    Wait(Connection),
    /// It has more to do at once.
    Again(Connection),
    /// It ends.
    End(Connection),
}

/// The way to one publisher of one subscription.
#[derive(Debug)]
struct Link {
    state: LinkState,
    /// After how long to try again.
    retry: Duration,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum LinkState {
    Connecting,
    Connected(Token),
    Waiting,
}

enum Timer {
    /// Ends a connection that does not say what it is for, or nothing any more.
    Silence(Token),
    /// Connects to a publisher again.
    Retry { subscription: u64, publisher: String },
}

pub(super) struct Engine {
    poll: Poll,
    slave: TcpListener,
    tcpros: TcpListener,
    commands: mpsc::Receiver<Command>,
    connections: HashMap<Token, Connection>,
    next_token: usize,
    /// Connections that have more to do.
    again: VecDeque<Token>,
    /// Of each subscription, by the publishers' addresses.
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
        let state = std::mem::take(&mut *lock(&shared.state));
        state.publications.values().for_each(|publication| publication.close());
        state.watches.values().for_each(|watch| watch.close());
        for subscription in state.subscriptions.values() {
            subscription.connected.store(0, Ordering::Relaxed);
            subscription.inbox.close();
        }
    }

    /// Returns whether the node goes on.
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
                command => self.obey(shared, command),
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
                    Some(Connection::Caller { heard, .. }) if *heard => {
                        *heard = false;
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

    fn obey(&mut self, shared: &Arc<Shared>, command: Command) {
        match command {
            Command::Publishers { subscription, publishers } => {
                self.set_publishers(shared, subscription, &publishers);
            }
            Command::Connected { subscription, publisher, stream } => {
                self.connected(shared, subscription, publisher, stream);
            }
            Command::Response { client, response } => {
                if let Some(Connection::Client { output, phase, .. }) = self.connections.get_mut(&client) {
                    output.push(Arc::new(response));
                    *phase = match *phase {
                        Phase::Asked { persistent: true } => Phase::Idle { persistent: true },
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
            Command::Stop => unreachable!("the one who takes commands stops by itself"),
        }
    }

    fn accept(&mut self, from: Token) {
        loop {
            let listener = if from == SLAVE { &self.slave } else { &self.tcpros };
            let stream = match listener.accept() {
                Ok((stream, _)) => stream,
                Err(error) if error.kind() == ErrorKind::WouldBlock => return,
                Err(error) if error.kind() == ErrorKind::Interrupted => continue,
                Err(error) => {
                    // Such as a connection that was gone at once, or no more file descriptors.
                    tracing::warn!("a connection could not be accepted: {error}");
                    return;
                }
            };
            if self.connections.len() >= MAX_CONNECTIONS {
                tracing::warn!("a connection was refused: {MAX_CONNECTIONS} are open");
                continue;
            }
            let opened = self.open(stream, |stream| match from {
                SLAVE => {
                    let output = SendQueue::new(1, None);
                    Connection::Caller { stream, input: Vec::new(), output, last: false, heard: false }
                }
                _ => Connection::New { stream, frames: FrameReader::new(MAX_HEADER_LEN) },
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

    /// Does what there is to do for a connection.
    fn serve(&mut self, shared: &Arc<Shared>, token: Token) {
        // Out of the map, so that it can be told of all others.
        let Some(connection) = self.connections.remove(&token) else { return };
        let next = match connection {
            Connection::Caller { stream, input, output, last, heard } => {
                self.answer(shared, stream, input, output, last, heard)
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
                    // The peer ends it. If this side did, with bytes from the peer unread, the peer might lose the last.
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

    /// A connection is over; dropping it closes it.
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

    /// Connects to publishers that are new, and leaves those that are no longer.
    fn set_publishers(&mut self, shared: &Arc<Shared>, subscription: u64, publishers: &[String]) {
        if !lock(&shared.state).subscriptions.contains_key(&subscription) {
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

    /// Connects to a publisher, on a thread of its own: names are looked up, and peers may not answer.
    fn connect(&mut self, shared: &Arc<Shared>, subscription: u64, publisher: &str) {
        let Some(subscribed) = lock(&shared.state).subscriptions.get(&subscription).cloned() else { return };
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
        // It may no longer be wanted, or have been made twice.
        let wanted = self.link(id, &publisher).is_some_and(|link| link.state == LinkState::Connecting);
        let subscription = lock(&shared.state).subscriptions.get(&id).cloned();
        let Some(subscription) = subscription.filter(|_| wanted) else { return };
        let called = publisher.clone();
        let opened = stream.and_then(|stream| {
            stream.set_nonblocking(true).map_err(|error| error.to_string())?;
            let frames = FrameReader::new(MAX_HEADER_LEN);
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
                tracing::debug!("{} does not reach {called}: {error}", shared.names.node());
                self.retry(id, &called);
            }
        }
    }

    /// Messages from a publisher, behind its connection header.
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
                    subscription.inbox.push(message);
                    continue;
                }
                Ok(Some(header)) => {
                    if let Err(reason) = check_publisher(&subscription, header) {
                        tracing::warn!("{publisher} does not fit {}: {reason}", subscription.topic);
                        // Its type does not change by trying often.
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

    /// Answers calls of the slave API.
    fn answer(
        &mut self,
        shared: &Arc<Shared>,
        stream: TcpStream,
        mut input: Vec<u8>,
        mut output: SendQueue,
        mut last: bool,
        mut heard: bool,
    ) -> Next {
        let over = loop {
            if output.flush(&mut &stream).is_err() {
                break true;
            }
            if !output.is_empty() {
                break false;
            }
            if last {
                return Next::Again(Connection::Ending { stream, output });
            }
            match http::parse_request(&input, MAX_CALL) {
                Ok(Some(request)) => {
                    let answer = Call::from_xml(request.body).map_err(|error| xmlrpc::Fault::from(&error));
                    let answer = answer.and_then(Request::read).map(|request| self.fulfil(shared, request));
                    let response = http::response(&xmlrpc::answer_to_xml(&answer), request.keep_alive);
                    (last, heard) = (!request.keep_alive, true);
                    let len = request.len;
                    input.drain(..len);
                    output.push(Arc::new(response));
                }
                Ok(None) => {
                    let mut piece = [0; 4096];
                    match (&stream).read(&mut piece) {
                        Ok(0) => break true,
                        Ok(read) => input.extend_from_slice(&piece[..read]),
                        Err(error) if error.kind() == ErrorKind::WouldBlock => break false,
                        Err(error) if error.kind() == ErrorKind::Interrupted => {}
                        Err(_) => break true,
                    }
                }
                Err(error) => {
                    tracing::debug!("{} was asked in no HTTP: {error}", shared.names.node());
                    output.push(Arc::new(http::refusal()));
                    last = true;
                }
            }
        };
        let connection = Connection::Caller { stream, input, output, last, heard };
        if over { Next::End(connection) } else { Next::Wait(connection) }
    }

    /// Does what the node is asked for.
    fn fulfil(&mut self, shared: &Arc<Shared>, request: Request) -> Value {
        let state = lock(&shared.state);
        match request {
            Request::BusStats => {
                drop(state);
                slave::done(self.bus_stats(shared))
            }
            Request::BusInfo => slave::done(self.bus_info()),
            Request::MasterUri => slave::done(shared.master.endpoint().http()),
            Request::Shutdown { reason } => {
                tracing::info!("{} is told to shut down: {reason}", shared.names.node());
                shared.errand(Errand::Stop);
                slave::done(0)
            }
            Request::Pid => slave::done(i32::try_from(std::process::id()).unwrap_or_default()),
            Request::Subscriptions => {
                let topics: BTreeMap<_, _> =
                    state.subscriptions.values().map(|s| (s.topic.as_str(), s.kind.name)).collect();
                slave::done(topics.into_iter().map(|(topic, kind)| [topic, kind]).collect::<Vec<_>>())
            }
            Request::Publications => {
                let topics = state.publications.values().map(|p| [p.topic.as_str(), p.kind.name]);
                slave::done(topics.collect::<Vec<_>>())
            }
            Request::ParamUpdate { name, value } => {
                state.watches.values().for_each(|watch| watch.update(&name, &value));
                slave::done(0)
            }
            Request::PublisherUpdate { topic, publishers } => {
                let of_it = state.subscriptions.values().filter(|subscription| subscription.topic == topic);
                let told = |subscription: &Arc<Subscription>| {
                    subscription.told.store(true, Ordering::Release);
                    subscription.id
                };
                let subscriptions: Vec<_> = of_it.map(told).collect();
                drop(state);
                for subscription in subscriptions {
                    self.set_publishers(shared, subscription, &publishers);
                }
                slave::done(0)
            }
            Request::Topic { topic, protocols } => {
                let Endpoint { host, port } = &shared.tcpros;
                if !state.publications.contains_key(&topic) {
                    slave::refused(&format!("{topic} is not published here"))
                } else if !protocols.iter().any(|protocol| protocol == "TCPROS") {
                    slave::refused("only TCPROS is spoken here")
                } else {
                    slave::done([Value::from("TCPROS"), host.as_str().into(), i32::from(*port).into()])
                }
            }
        }
    }

    /// `[id, peer, direction, transport, topic, connected]` of each connection.
    fn bus_info(&self) -> Vec<Value> {
        let entry = |token: &Token, peer: &str, direction: &str, topic: &str| {
            let id = i32::try_from(token.0).unwrap_or(i32::MAX);
            let rest = [peer, direction, "TCPROS", topic].map(Value::from);
            Value::Array([Value::Int(id)].into_iter().chain(rest).chain([Value::Bool(true)]).collect())
        };
        let connection = |(token, connection): (&Token, &Connection)| match connection {
            Connection::Subscriber { outgoing, publication } => {
                Some(entry(token, &outgoing.subscriber, "o", &publication.topic))
            }
            Connection::Publisher { publisher, subscription, flow, .. } if flow.begun => {
                Some(entry(token, publisher, "i", &subscription.topic))
            }
            _ => None,
        };
        self.connections.iter().filter_map(connection).collect()
    }

    /// What went over the connections of each topic; numbers of 32 bits, as XML-RPC has them.
    fn bus_stats(&self, shared: &Shared) -> Value {
        let number = |count: u64| Value::Int(i32::try_from(count).unwrap_or(i32::MAX));
        let mut sent: BTreeMap<String, (u64, Vec<Value>)> = BTreeMap::new();
        let mut received: BTreeMap<String, Vec<Value>> = BTreeMap::new();
        {
            let state = lock(&shared.state);
            sent.extend(state.publications.keys().map(|topic| (topic.clone(), Default::default())));
            received.extend(state.subscriptions.values().map(|s| (s.topic.clone(), Vec::new())));
        }
        for (token, connection) in &self.connections {
            let id = number(token.0 as u64);
            match connection {
                Connection::Subscriber { outgoing, publication } => {
                    let (bytes, frames) = outgoing.sent();
                    let (total, entries) = sent.entry(publication.topic.clone()).or_default();
                    *total += bytes;
                    entries.push(Value::Array(vec![id, number(bytes), number(frames), true.into()]));
                }
                Connection::Publisher { subscription, flow, .. } if flow.begun => {
                    let dropped = number(subscription.inbox.dropped());
                    let entry = vec![id, number(flow.bytes), number(flow.messages), dropped, true.into()];
                    received.entry(subscription.topic.clone()).or_default().push(Value::Array(entry));
                }
                _ => {}
            }
        }
        let sent = sent.into_iter().map(|(topic, (total, entries))| {
            Value::Array(vec![topic.into(), number(total), Value::Array(entries)])
        });
        let received = received
            .into_iter()
            .map(|(topic, entries)| Value::Array(vec![topic.into(), Value::Array(entries)]));
        Value::Array(vec![
            Value::Array(sent.collect()),
            Value::Array(received.collect()),
            Value::Array(vec![0.into(), 0.into(), 0.into()]),
        ])
    }
}

impl Connection {
    /// Whether it has not said what it is for, or nothing for long, or has been told to end.
    fn is_undecided(&self) -> bool {
        match self {
            Self::Caller { heard, .. } => !heard,
            Self::New { .. } | Self::Ending { .. } => true,
            Self::Publisher { flow, .. } => !flow.begun,
            Self::Subscriber { .. } | Self::Client { .. } => false,
        }
    }
}

/// What every connection needs: no waiting for more to send (Nagle's algorithm makes 10 ms of network 20 ms), and a
/// question now and then whether a silent peer is still there.
fn prepare(stream: &TcpStream) -> io::Result<()> {
    stream.set_nodelay(true)?;
    let socket = SockRef::from(stream);
    let keepalive =
        TcpKeepalive::new().with_time(Duration::from_secs(15)).with_interval(Duration::from_secs(5));
    socket.set_tcp_keepalive(&keepalive.with_retries(3))?;
    socket.set_tcp_notsent_lowat(UNSENT)
}

/// Whether the peer ended a connection on which it has nothing to say. What it says is dropped.
fn is_over(mut stream: &TcpStream) -> bool {
    let mut piece = [0; 1024];
    for _ in 0..READS_A_TURN {
        match stream.read(&mut piece) {
            Ok(0) => return true,
            Ok(_) => {}
            Err(error) if error.kind() == ErrorKind::WouldBlock => return false,
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            Err(_) => return true,
        }
    }
    // One that talks without end, where nothing is to be said.
    true
}

/// A connection to the publisher at that address, with the connection header sent.
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

/// Whether a publisher's connection header fits.
fn check_publisher(subscription: &Subscription, header: &[u8]) -> Result<(), String> {
    let header = Header::from_bytes(header).map_err(|error| error.to_string())?;
    if let Some(error) = header.get("error") {
        return Err(error.to_owned());
    }
    subscription.kind.check(header.get("md5sum"), header.get("type"))
}

/// Learns from a connection header what a connection is for.
fn introduce(shared: &Arc<Shared>, stream: TcpStream, mut frames: FrameReader) -> Next {
    loop {
        match frames.next_frame() {
            Ok(Some(header)) => {
                let header = Header::from_bytes(header).map_err(|error| error.to_string());
                return match header.and_then(|header| Purpose::of(shared, &header)) {
                    Ok(purpose) => purpose.connection(shared, stream, frames),
                    Err(reason) => {
                        tracing::debug!("{} refuses a connection: {reason}", shared.names.node());
                        let refusal = Header::new([("error", reason.as_str())]).to_frame();
                        Next::Again(Connection::Ending { stream, output: SendQueue::new(1, Some(refusal)) })
                    }
                };
            }
            Ok(None) => {}
            Err(_) => return Next::End(Connection::New { stream, frames }),
        }
        match frames.read_from(&mut &stream) {
            Ok(0) => return Next::End(Connection::New { stream, frames }),
            Ok(_) => {}
            Err(error) if error.kind() == ErrorKind::WouldBlock => {
                return Next::Wait(Connection::New { stream, frames });
            }
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            Err(_) => return Next::End(Connection::New { stream, frames }),
        }
    }
}

/// What a connection to TCPROS is for.
enum Purpose {
    Subscribe {
        publication: Arc<Publication>,
        subscriber: String,
    },
    Call {
        offer: Arc<Offer>,
        persistent: bool,
    },
    /// Only to see what a service is.
    Probe {
        offer: Arc<Offer>,
    },
}

impl Purpose {
    fn of(shared: &Shared, header: &Header) -> Result<Self, String> {
        let state = lock(&shared.state);
        let subscriber = header.get("callerid").unwrap_or_default().to_owned();
        if let Some(name) = header.get("service") {
            let offer = state.services.get(name).ok_or_else(|| format!("{name} is not served here"))?;
            let offer = Arc::clone(offer);
            match header.get("md5sum") {
                _ if header.flag("probe") => Ok(Self::Probe { offer }),
                Some(md5sum) if md5sum == "*" || md5sum == offer.md5sum => {
                    Ok(Self::Call { offer, persistent: header.flag("persistent") })
                }
                Some(md5sum) => {
                    Err(format!("{name} is a {} with md5sum {}, not {md5sum}", offer.kind, offer.md5sum))
                }
                None => Err("the connection header has no md5sum".to_owned()),
            }
        } else if let Some(topic) = header.get("topic") {
            let publication = state.publications.get(topic);
            let publication = publication.ok_or_else(|| format!("{topic} is not published here"))?;
            publication.kind.check(header.get("md5sum"), header.get("type"))?;
            Ok(Self::Subscribe { publication: Arc::clone(publication), subscriber })
        } else {
            Err("the connection header has neither a topic nor a service".to_owned())
        }
    }

    fn connection(self, shared: &Shared, stream: TcpStream, mut frames: FrameReader) -> Next {
        let node = shared.names.node();
        match self {
            Self::Subscribe { publication, subscriber } => {
                let outgoing = publication.connect(stream, &subscriber, node);
                Next::Again(Connection::Subscriber { outgoing, publication })
            }
            Self::Call { offer, persistent } => {
                frames.set_limit(MAX_MESSAGE_LEN);
                let output = SendQueue::new(1, Some(offer.header(node).to_frame()));
                Next::Again(Connection::Client {
                    stream,
                    frames,
                    output,
                    offer,
                    phase: Phase::Idle { persistent },
                })
            }
            Self::Probe { offer } => {
                let output = SendQueue::new(1, Some(offer.header(node).to_frame()));
                Next::Again(Connection::Ending { stream, output })
            }
        }
    }
}

/// Takes requests to a service, one at a time.
fn ask_service(
    token: Token,
    stream: TcpStream,
    mut frames: FrameReader,
    mut output: SendQueue,
    offer: Arc<Offer>,
    mut phase: Phase,
) -> Next {
    let over = loop {
        if output.flush(&mut &stream).is_err() {
            break true;
        }
        let Phase::Idle { persistent } = phase else {
            break phase == Phase::Answered && output.is_empty();
        };
        match frames.next_frame() {
            Ok(Some(request)) => {
                phase = Phase::Asked { persistent };
                if offer.requests.send((token, request.to_vec())).is_err() {
                    output.push(Arc::new(service::response::<EmptyResponse>(Err(
                        "the service ended".to_owned()
                    ))));
                    phase = Phase::Answered;
                }
                continue;
            }
            Ok(None) => {}
            Err(error) => {
                tracing::debug!("a client of {} does not speak TCPROS: {error}", offer.name);
                break true;
            }
        }
        match frames.read_from(&mut &stream) {
            Ok(0) => break true,
            Ok(_) => {}
            Err(error) if error.kind() == ErrorKind::WouldBlock => break false,
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            Err(_) => break true,
        }
    };
    let connection = Connection::Client { stream, frames, output, offer, phase };
    if over { Next::End(connection) } else { Next::Wait(connection) }
}
