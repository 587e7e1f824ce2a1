//! Publishers and subscribers in DDS.

use std::{sync::Arc, time::Duration};

use cotorra_ros_messages::queue::Waiting;
use parking_lot::Mutex;
use rustdds::{
    RTPSEntity, Timestamp,
    bytes::Bytes,
    dds::{ReadError, WriteError},
    mio1::{Interest, Token},
};

use super::{
    codec::{self, Reader, Writer},
    engine::RETRY,
    graph::{Gid, Graph},
    participant::Shared,
};
use crate::{
    carried::Kind,
    names::dds_topic,
    node::NodeError,
    peers::Endpoint,
    qos::Qos,
    topics::{Incoming, Inlet, Outlet},
};

/// Deadline for reliable messages to arrive when their publisher ends. Only a busy or lost peer takes longer than some
/// milliseconds.
pub const LAST_WORDS: Duration = Duration::from_secs(2);

/// A topic that the node publishes.
pub struct Publication {
    id: usize,
    topic: String,
    kinds: Vec<Kind>,
    qos: Qos,
    output: Mutex<Output>,
}

struct Output {
    /// Writer of each type, once the type is published.
    writers: Vec<Option<Writer>>,
    /// Queued messages, each with the index of its type.
    waiting: Waiting<(usize, Bytes)>,
    closed: bool,
}

impl Publication {
    /// Starts publishing as the type with that index, too.
    fn open(&self, number: usize, output: &mut Output, shared: &Shared) -> Result<(), NodeError> {
        output.writers[number] = Some(shared.open_writer(&self.topic, &self.kinds[number], self.qos)?);
        Ok(())
    }

    /// Passes queued messages to DDS. Returns whether some are left.
    fn flush_output(&self, output: &mut Output, shared: &Shared) -> bool {
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

    fn open_writer(&self, topic: &str, kind: &Kind, qos: Qos) -> Result<Writer, NodeError> {
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

    fn open_reader(&self, topic: &str, kind: &Kind, qos: Qos) -> Result<Reader, NodeError> {
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

    fn forget(&self, gids: &[Gid]) {
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

/// Publishes a topic until it is dropped.
pub struct Advertised {
    shared: Arc<Shared>,
    publication: Arc<Publication>,
}

impl Advertised {
    pub fn new(shared: &Arc<Shared>, topic: &str, kinds: Vec<Kind>, qos: Qos) -> Result<Self, NodeError> {
        let writers = match &kinds[..] {
            [kind] => vec![Some(shared.open_writer(topic, kind, qos)?)],
            kinds => kinds.iter().map(|_| None).collect(),
        };
        let output = Mutex::new(Output { writers, waiting: Waiting::new(qos.depth()), closed: false });
        let topic = topic.to_owned();
        let publication = Arc::new(Publication { id: shared.next_id(), topic, kinds, qos, output });
        shared.state.lock().publications.insert(publication.id, Arc::clone(&publication));
        Ok(Self { shared: Arc::clone(shared), publication })
    }

    fn gids(&self) -> Vec<Gid> {
        let output = self.publication.output.lock();
        output.writers.iter().flatten().map(|writer| writer.guid().to_bytes()).collect()
    }
}

impl Outlet for Advertised {
    fn send(&self, encode: &dyn Fn(usize) -> Vec<u8>) {
        let Self { shared, publication } = self;
        let mut output = publication.output.lock();
        if output.closed {
            return;
        }
        let numbers = match &publication.kinds[..] {
            [_] => [0].into(),
            kinds => shared.graph.lock().wanted(&dds_topic(&publication.topic), kinds),
        };
        for number in numbers {
            if output.writers[number].is_none()
                && let Err(error) = publication.open(number, &mut output, shared)
            {
                let kind = publication.kinds[number].name;
                tracing::warn!("{}: not published as {kind}: {error}", publication.topic);
                continue;
            }
            output.waiting.push((number, codec::body(encode(number))));
        }
        if publication.flush_output(&mut output, shared) {
            shared.wake();
        }
    }

    fn subscribers(&self) -> usize {
        let gids = self.gids();
        let graph = self.shared.graph.lock();
        gids.iter().map(|gid| graph.connected(gid)).sum()
    }

    fn dropped(&self) -> u64 {
        self.publication.output.lock().waiting.dropped()
    }
}

impl Drop for Advertised {
    fn drop(&mut self) {
        self.shared.state.lock().publications.remove(&self.publication.id);
        let gids = self.gids();
        self.publication.close(&self.shared, LAST_WORDS);
        self.shared.forget(&gids);
    }
}

/// A topic that the node subscribes to.
pub struct Subscription {
    kinds: Vec<Kind>,
    /// Reader of each type; none after shutdown.
    readers: Mutex<Vec<Reader>>,
    incoming: Arc<Incoming>,
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

/// Subscribes to a topic until it is dropped.
pub struct Subscribed {
    shared: Arc<Shared>,
    subscription: Arc<Subscription>,
    gids: Vec<Gid>,
    ids: Vec<usize>,
}

impl Subscribed {
    pub fn new(
        shared: &Arc<Shared>,
        incoming: Arc<Incoming>,
        kinds: Vec<Kind>,
        qos: Qos,
    ) -> Result<Self, NodeError> {
        let opened: Result<Vec<_>, _> =
            kinds.iter().map(|kind| shared.open_reader(&incoming.topic, kind, qos)).collect();
        let mut readers = opened?;
        let gids = readers.iter().map(|reader| reader.guid().to_bytes()).collect();
        let ids: Vec<_> = readers.iter().map(|_| shared.next_id()).collect();
        let subscription = Arc::new(Subscription { kinds, readers: Mutex::default(), incoming });
        let mut state = shared.state.lock();
        for (number, (id, reader)) in ids.iter().zip(&mut readers).enumerate() {
            state.readers.insert(*id, (Arc::clone(&subscription), number));
            shared.registry.register(reader, Token(*id), Interest::READABLE)?;
        }
        *subscription.readers.lock() = readers;
        drop(state);
        // Messages that arrived before the registration.
        shared.wake();
        Ok(Self { shared: Arc::clone(shared), subscription, gids, ids })
    }
}

impl Inlet for Subscribed {
    fn publishers(&self) -> usize {
        let graph = self.shared.graph.lock();
        self.gids.iter().map(|gid| graph.connected(gid)).sum()
    }
}

impl Drop for Subscribed {
    fn drop(&mut self) {
        self.shared.state.lock().readers.retain(|id, _| !self.ids.contains(id));
        self.subscription.close();
        self.shared.forget(&self.gids);
    }
}
