//! State that a node's thread, publishers and subscribers share: the participant, its endpoints and their queues.

use std::{
    collections::BTreeMap,
    net::IpAddr,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicUsize, Ordering},
    },
    time::Duration,
};

use cotorra_ros_messages::queue::Waiting;
use parking_lot::Mutex;
use rustdds::{
    DomainParticipant, DomainParticipantBuilder, QosPolicies, RTPSEntity, Timestamp, Topic, TopicKind,
    bytes::Bytes,
    dds::{CreateError, ReadError, WriteError},
    mio1 as mio,
    no_key::DataWriterCdr,
};

use super::{
    announce::{self, NodeEntitiesInfo, ParticipantEntitiesInfo},
    codec::{Reader, Writer},
    graph::{Gid, Graph},
};
use crate::{
    carried::Kind,
    error::NodeError,
    names::{Names, dds_topic, dds_type},
    peers::Endpoint,
    qos::Qos,
    topics::Incoming,
};

/// Retry interval for queued messages, no longer than the interval of commands.
pub const RETRY: Duration = Duration::from_millis(20);

/// Deadline for reliable messages to arrive when their publisher ends. Only a busy or lost peer takes longer than some
/// milliseconds.
pub const LAST_WORDS: Duration = Duration::from_secs(2);

/// State of a node that its thread, publishers and subscribers share.
pub struct Shared {
    pub names: Names,
    /// `None` after shutdown.
    pub participant: Mutex<Option<Participant>>,
    pub state: Mutex<State>,
    pub graph: Mutex<Graph>,
    pub registry: mio::Registry,
    pub waker: mio::Waker,
    pub next_id: AtomicUsize,
    pub stopped: AtomicBool,
}

/// Topics of a node.
#[derive(Default)]
pub struct State {
    pub publications: BTreeMap<usize, Arc<Publication>>,
    /// Subscription of each reader, with the index of its type.
    pub readers: BTreeMap<usize, (Arc<Subscription>, usize)>,
}

/// A DDS participant with its endpoints.
pub struct Participant {
    pub dds: DomainParticipant,
    pub publisher: rustdds::Publisher,
    pub subscriber: rustdds::Subscriber,
    /// Announces the endpoints of the node.
    announcer: DataWriterCdr<ParticipantEntitiesInfo>,
    pub readers: Vec<Gid>,
    pub writers: Vec<Gid>,
}

impl Participant {
    pub fn new(domain: u16, interface: Option<IpAddr>) -> Result<Self, CreateError> {
        let builder = DomainParticipantBuilder::new(domain);
        let builder = match interface {
            Some(interface) => builder.with_only_networks([interface]),
            None => builder,
        };
        let dds = builder.build()?;
        let none = QosPolicies::qos_none();
        let (publisher, subscriber) = (dds.create_publisher(&none)?, dds.create_subscriber(&none)?);
        let (topic, kind) = (announce::TOPIC.to_owned(), dds_type(announce::TYPE_NAME));
        let topic = dds.create_topic(topic, kind, &Qos::LATCHED.policies(true), TopicKind::NoKey)?;
        let announcer = publisher.create_datawriter_no_key(&topic, None)?;
        Ok(Self { dds, publisher, subscriber, announcer, readers: Vec::new(), writers: Vec::new() })
    }

    pub fn topic(&self, global: &str, kind: &Kind, policies: &QosPolicies) -> Result<Topic, CreateError> {
        self.dds.create_topic(dds_topic(global), kind.dds_name.clone(), policies, TopicKind::NoKey)
    }

    pub fn announce(&self, names: &Names) {
        let node = NodeEntitiesInfo {
            namespace: names.namespace().to_owned(),
            name: names.name().to_owned(),
            readers: self.readers.clone(),
            writers: self.writers.clone(),
        };
        let info = ParticipantEntitiesInfo { gid: self.dds.guid().to_bytes(), nodes: vec![node] };
        if let Err(error) = self.announcer.write(info, None) {
            tracing::warn!("{} is not announced: {}", names.node(), error.forget_data());
        }
    }
}

impl Shared {
    /// Runs `act` with the node's participant.
    pub fn with<T>(
        &self,
        act: impl FnOnce(&mut Participant) -> Result<T, NodeError>,
    ) -> Result<T, NodeError> {
        self.participant.lock().as_mut().map_or(Err(NodeError::ShutDown), act)
    }

    pub fn wake(&self) {
        // Without a thread, the node has ended.
        let _ = self.waker.wake();
    }

    pub fn next_id(&self) -> usize {
        self.next_id.fetch_add(1, Ordering::Relaxed)
    }

    pub fn is_stopped(&self) -> bool {
        self.stopped.load(Ordering::Acquire)
    }
}

/// A topic that the node publishes.
pub struct Publication {
    pub id: usize,
    pub topic: String,
    pub kinds: Vec<Kind>,
    pub qos: Qos,
    pub output: Mutex<Output>,
}

pub struct Output {
    /// Writer of each type, once the type is published.
    pub writers: Vec<Option<Writer>>,
    /// Queued messages, each with the index of its type.
    pub waiting: Waiting<(usize, Bytes)>,
    pub closed: bool,
}

impl Publication {
    /// Starts publishing as the type with that index, too.
    pub fn open(&self, number: usize, output: &mut Output, shared: &Shared) -> Result<(), NodeError> {
        output.writers[number] = Some(shared.open_writer(&self.topic, &self.kinds[number], self.qos)?);
        Ok(())
    }

    /// Passes queued messages to DDS. Returns whether some are left.
    pub fn flush_output(&self, output: &mut Output, shared: &Shared) -> bool {
        while let Some((number, body)) = output.waiting.front() {
            let (number, body) = (*number, body.clone());
            let Some(writer) = &output.writers[number] else { return false };
            match writer.write(body, Some(Timestamp::now())) {
                Ok(()) => {}
                Err(WriteError::WouldBlock { .. }) => {
                    // A subscriber of another type never acknowledges, but RustDDS waits for it. A new writer does
                    // not wait for it, for a while.
                    let gid = writer.guid().to_bytes();
                    if !shared.graph.lock().meets_others(&gid) {
                        return true;
                    }
                    shared.forget(&[gid]);
                    if let Err(error) = self.open(number, output, shared) {
                        tracing::warn!("{}: {error}", self.topic);
                        return false;
                    }
                    continue;
                }
                Err(error) => {
                    tracing::warn!("{}: a message is not sent: {}", self.topic, error.forget_data())
                }
            }
            output.waiting.pop();
        }
        false
    }

    /// Sends queued messages. Returns whether some are left.
    pub fn flush(&self, shared: &Shared) -> bool {
        self.flush_output(&mut self.output.lock(), shared)
    }

    /// Ends the publication as soon as all messages arrived, or after `patience`. Returns whether all arrived. Others
    /// are lost, as with any other node that ends.
    pub fn close(&self, shared: &Shared, mut patience: Duration) -> bool {
        let mut output = self.output.lock();
        output.closed = true;
        // Queued messages are sent as soon as earlier ones are acknowledged.
        while self.flush_output(&mut output, shared) && !patience.is_zero() {
            for writer in output.writers.iter().flatten() {
                let _ = writer.wait_for_acknowledgments(patience.min(RETRY));
            }
            patience = patience.saturating_sub(RETRY);
        }
        let mut arrived = output.waiting.front().is_none();
        for writer in output.writers.drain(..).flatten() {
            if !writer.wait_for_acknowledgments(patience).unwrap_or(false) {
                arrived = false;
                patience = Duration::ZERO;
            }
        }
        arrived
    }
}

impl Shared {
    /// Returns the endpoint of a type on a topic.
    fn endpoint(topic: &str, kind: &Kind) -> Endpoint {
        Endpoint { topic: dds_topic(topic), kind: kind.dds_name.clone(), hash: Some(kind.hash.clone()) }
    }

    pub fn open_writer(&self, topic: &str, kind: &Kind, qos: Qos) -> Result<Writer, NodeError> {
        self.with(|participant| {
            let endpoint = Self::endpoint(topic, kind);
            // RustDDS waits for subscribers of another type, too. Without a bound, that takes longest to block.
            let bounded = !self.graph.lock().is_subscribed_otherwise(&endpoint);
            let topic = participant.topic(topic, kind, &qos.policies(bounded))?;
            let writer: Writer = participant.publisher.create_datawriter_no_key(&topic, None)?;
            let gid = writer.guid().to_bytes();
            self.graph.lock().add_own(gid, endpoint);
            participant.writers.push(gid);
            participant.announce(&self.names);
            Ok(writer)
        })
    }

    pub fn open_reader(&self, topic: &str, kind: &Kind, qos: Qos) -> Result<Reader, NodeError> {
        self.with(|participant| {
            let endpoint = Self::endpoint(topic, kind);
            let topic = participant.topic(topic, kind, &qos.policies(true))?;
            let reader: Reader = participant.subscriber.create_simple_datareader_no_key(&topic, None)?;
            let gid = reader.guid().to_bytes();
            self.graph.lock().add_own(gid, endpoint);
            participant.readers.push(gid);
            participant.announce(&self.names);
            Ok(reader)
        })
    }

    pub fn forget(&self, gids: &[Gid]) {
        let mut graph = self.graph.lock();
        gids.iter().for_each(|gid| graph.remove_own(*gid));
        drop(graph);
        // After shutdown, the node has announced that already.
        let _ = self.with(|participant| {
            participant.readers.retain(|gid| !gids.contains(gid));
            participant.writers.retain(|gid| !gids.contains(gid));
            participant.announce(&self.names);
            Ok(())
        });
    }
}

/// A topic that the node subscribes to.
pub struct Subscription {
    pub kinds: Vec<Kind>,
    /// Reader of each type; none after shutdown.
    pub readers: Mutex<Vec<Reader>>,
    pub incoming: Arc<Incoming>,
}

impl Subscription {
    /// Receives messages of the type with that index.
    pub fn take(&self, number: usize, graph: &Mutex<Graph>) {
        let readers = self.readers.lock();
        let Some(reader) = readers.get(number) else { return };
        let kind = &self.kinds[number].dds_name;
        reader.drain_read_notifications();
        loop {
            match reader.try_take_one() {
                Ok(None) => return,
                Ok(Some(sample)) => {
                    // RustDDS passes each message to all readers of a topic.
                    if graph.lock().publishes(&sample.writer_guid().to_bytes(), kind) {
                        self.incoming.push(number, sample.into_value());
                    }
                }
                Err(ReadError::Deserialization { reason }) => self.incoming.count_malformed(&reason),
                Err(error) => {
                    tracing::warn!("{}: {error}", self.incoming.topic);
                    return;
                }
            }
        }
    }

    /// Ends the subscription.
    pub fn close(&self) {
        self.readers.lock().clear();
        self.incoming.inbox.close();
    }
}
