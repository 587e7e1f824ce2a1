//! Publishers and subscribers.

use std::{
    fmt,
    marker::PhantomData,
    sync::{
        Arc, Mutex,
        atomic::{AtomicU64, Ordering},
    },
    time::Duration,
};

use rustdds::{
    RTPSEntity, Timestamp,
    bytes::Bytes,
    dds::{ReadError, WriteError},
    mio1::{Interest, Token},
};

use super::{Node, NodeError, Shared};
use crate::{
    carried::{Carried, Kind},
    dds::{self, Reader, Writer},
    graph::{Endpoint, Gid, Graph},
    names::dds_topic,
    qos::Qos,
    queue::{Inbox, RecvError, Waiting, lock},
};

/// How long a publisher that ends waits until what it published reliably has arrived.
const LAST_WORDS: Duration = Duration::from_millis(200);

/// A topic that the node publishes.
pub(super) struct Publication {
    id: usize,
    topic: String,
    kinds: Vec<Kind>,
    qos: Qos,
    output: Mutex<Output>,
}

struct Output {
    /// For each type, once it is published.
    writers: Vec<Option<Writer>>,
    /// With the number of its type.
    waiting: Waiting<(usize, Bytes)>,
    closed: bool,
}

impl Publication {
    /// Publishes as the type of that number, too.
    fn open(&self, number: usize, output: &mut Output, shared: &Shared) -> Result<(), NodeError> {
        output.writers[number] = Some(shared.open_writer(&self.topic, &self.kinds[number], self.qos)?);
        Ok(())
    }

    /// Gives to DDS what it takes. Returns whether something is left.
    fn flush_output(&self, output: &mut Output, shared: &Shared) -> bool {
        while let Some((number, body)) = output.waiting.front() {
            let (number, body) = (*number, body.clone());
            let Some(writer) = &output.writers[number] else { return false };
            match writer.write(body, Some(Timestamp::now())) {
                Ok(()) => {}
                Err(WriteError::WouldBlock { .. }) => {
                    // A subscriber of another type never acknowledges, but RustDDS waits for it. A new writer does
                    // not, for a while.
                    let gid = writer.guid().to_bytes();
                    if !lock(&shared.graph).meets_others(&gid) {
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

    /// Sends what waits. Returns whether something is left.
    pub fn flush(&self, shared: &Shared) -> bool {
        self.flush_output(&mut lock(&self.output), shared)
    }

    /// Publishes nothing any more, once what was published has arrived, or after some time.
    pub fn close(&self, shared: &Shared) {
        let mut output = lock(&self.output);
        output.closed = true;
        self.flush_output(&mut output, shared);
        for writer in output.writers.drain(..).flatten() {
            // What does not arrive in time is lost, as it would be with any other node that ends.
            let _ = writer.wait_for_acknowledgments(LAST_WORDS);
        }
    }
}

impl Shared {
    /// The endpoint of that type on a topic.
    fn endpoint(topic: &str, kind: &Kind) -> Endpoint {
        Endpoint { topic: dds_topic(topic), kind: kind.dds_name.clone(), hash: Some(kind.hash.clone()) }
    }

    fn open_writer(&self, topic: &str, kind: &Kind, qos: Qos) -> Result<Writer, NodeError> {
        self.with(|participant| {
            let endpoint = Self::endpoint(topic, kind);
            // RustDDS waits for subscribers of another type, too: let it be for as long as it can.
            let bounded = !lock(&self.graph).is_subscribed_otherwise(&endpoint);
            let topic = participant.topic(topic, kind, &qos.policies(bounded))?;
            let writer: Writer = participant.publisher.create_datawriter_no_key(&topic, None)?;
            let gid = writer.guid().to_bytes();
            lock(&self.graph).add_own(gid, endpoint);
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
            lock(&self.graph).add_own(gid, endpoint);
            participant.readers.push(gid);
            participant.announce(&self.names);
            Ok(reader)
        })
    }

    fn forget(&self, gids: &[Gid]) {
        let mut graph = lock(&self.graph);
        gids.iter().for_each(|gid| graph.remove_own(*gid));
        drop(graph);
        // A node that was shut down has told that already.
        let _ = self.with(|participant| {
            participant.readers.retain(|gid| !gids.contains(gid));
            participant.writers.retain(|gid| !gids.contains(gid));
            participant.announce(&self.names);
            Ok(())
        });
    }
}

/// Publishes to one topic. Clones publish to the same; when the last is dropped, the topic is published no more.
pub struct Publisher<M> {
    advertised: Arc<Advertised>,
    message: PhantomData<fn(&M)>,
}

struct Advertised {
    shared: Arc<Shared>,
    publication: Arc<Publication>,
}

impl Advertised {
    fn gids(&self) -> Vec<Gid> {
        let output = lock(&self.publication.output);
        output.writers.iter().flatten().map(|writer| writer.guid().to_bytes()).collect()
    }
}

impl Drop for Advertised {
    fn drop(&mut self) {
        lock(&self.shared.state).publications.remove(&self.publication.id);
        let gids = self.gids();
        self.publication.close(&self.shared);
        self.shared.forget(&gids);
    }
}

impl<M> Clone for Publisher<M> {
    fn clone(&self) -> Self {
        Self { advertised: Arc::clone(&self.advertised), message: PhantomData }
    }
}

impl<M> fmt::Debug for Publisher<M> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Publisher").field(&self.topic()).finish()
    }
}

impl<M> Publisher<M> {
    /// The topic's global name.
    pub fn topic(&self) -> &str {
        &self.advertised.publication.topic
    }

    /// How many subscribers are connected.
    pub fn subscribers(&self) -> usize {
        let gids = self.advertised.gids();
        let graph = lock(&self.advertised.shared.graph);
        gids.iter().map(|gid| graph.connected(gid)).sum()
    }

    /// How many messages were dropped because subscribers do not acknowledge them in time.
    pub fn dropped(&self) -> u64 {
        lock(&self.advertised.publication.output).waiting.dropped
    }
}

impl<M: Carried> Publisher<M> {
    /// Publishes a message. Never waits: what is not sent at once is queued.
    pub fn publish(&self, message: &M) {
        let Advertised { shared, publication } = &*self.advertised;
        let mut output = lock(&publication.output);
        if output.closed {
            return;
        }
        let numbers = match &publication.kinds[..] {
            [_] => [0].into(),
            kinds => lock(&shared.graph).wanted(&dds_topic(&publication.topic), kinds),
        };
        for number in numbers {
            if output.writers[number].is_none()
                && let Err(error) = publication.open(number, &mut output, shared)
            {
                let kind = publication.kinds[number].name;
                tracing::warn!("{}: not published as {kind}: {error}", publication.topic);
                continue;
            }
            let mut encoded = Vec::new();
            message.encode_as(number, &mut encoded);
            output.waiting.push((number, dds::body(encoded)));
        }
        if publication.flush_output(&mut output, shared) {
            shared.wake();
        }
    }
}

/// A topic that the node subscribes to.
pub(super) struct Subscription {
    topic: String,
    kinds: Vec<Kind>,
    /// For each type; none once the node was shut down.
    readers: Mutex<Vec<Reader>>,
    /// With the number of its type.
    inbox: Inbox<(usize, Vec<u8>)>,
    malformed: AtomicU64,
}

impl Subscription {
    /// Takes what came as the type of that number.
    pub fn take(&self, number: usize, graph: &Mutex<Graph>) {
        let readers = lock(&self.readers);
        let Some(reader) = readers.get(number) else { return };
        let kind = &self.kinds[number].dds_name;
        reader.drain_read_notifications();
        loop {
            match reader.try_take_one() {
                Ok(None) => return,
                Ok(Some(sample)) => {
                    // All readers of a topic are given what any of them receives.
                    if lock(graph).publishes(&sample.writer_guid().to_bytes(), kind) {
                        self.inbox.push((number, sample.into_value()));
                    }
                }
                Err(ReadError::Deserialization { reason }) => self.count_malformed(&reason),
                Err(error) => {
                    tracing::warn!("{}: {error}", self.topic);
                    return;
                }
            }
        }
    }

    fn count_malformed(&self, reason: &str) {
        self.malformed.fetch_add(1, Ordering::Relaxed);
        tracing::warn!("{}: a message cannot be read: {reason}", self.topic);
    }

    /// Nothing comes any more.
    pub fn close(&self) {
        lock(&self.readers).clear();
        self.inbox.close();
    }
}

/// Receives the messages of one topic; no longer once it is dropped.
pub struct Subscriber<M> {
    shared: Arc<Shared>,
    subscription: Arc<Subscription>,
    gids: Vec<Gid>,
    ids: Vec<usize>,
    message: PhantomData<fn() -> M>,
}

impl<M> fmt::Debug for Subscriber<M> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Subscriber").field(&self.topic()).finish()
    }
}

impl<M> Drop for Subscriber<M> {
    fn drop(&mut self) {
        lock(&self.shared.state).readers.retain(|id, _| !self.ids.contains(id));
        self.subscription.close();
        self.shared.forget(&self.gids);
    }
}

impl<M> Subscriber<M> {
    /// The topic's global name.
    pub fn topic(&self) -> &str {
        &self.subscription.topic
    }

    /// How many publishers are connected.
    pub fn publishers(&self) -> usize {
        let graph = lock(&self.shared.graph);
        self.gids.iter().map(|gid| graph.connected(gid)).sum()
    }

    /// How many messages were dropped because they were not taken.
    pub fn dropped(&self) -> u64 {
        self.subscription.inbox.dropped()
    }

    /// How many messages were none of the type that they were said to be.
    pub fn malformed(&self) -> u64 {
        self.subscription.malformed.load(Ordering::Relaxed)
    }
}

impl<M: Carried> Subscriber<M> {
    fn read(&self, (kind, bytes): (usize, Vec<u8>)) -> Option<M> {
        let message = M::decode_as(kind, &bytes);
        message.inspect_err(|error| self.subscription.count_malformed(&error.to_string())).ok()
    }

    /// The next message, once there is one; `None` if the node was shut down.
    pub fn recv(&self) -> Option<M> {
        loop {
            if let Some(message) = self.read(self.subscription.inbox.pop(None).ok()?) {
                return Some(message);
            }
        }
    }

    /// The next message, once there is one. The time begins anew after one that is malformed.
    ///
    /// # Errors
    /// [`RecvError`] if none comes in time.
    pub fn recv_timeout(&self, timeout: Duration) -> Result<M, RecvError> {
        loop {
            if let Some(message) = self.read(self.subscription.inbox.pop(Some(timeout))?) {
                return Ok(message);
            }
        }
    }

    /// The next message, if there is one.
    pub fn try_recv(&self) -> Option<M> {
        loop {
            if let Some(message) = self.read(self.subscription.inbox.try_pop()?) {
                return Some(message);
            }
        }
    }
}

impl Node {
    /// Publishes a topic. What can be of several types, such as [`Command`](crate::Command), is published as those
    /// that its subscribers have, once these are discovered.
    ///
    /// # Errors
    /// [`NodeError`] if `topic` is no name, or DDS refuses.
    pub fn publish<M: Carried>(&self, topic: &str, qos: Qos) -> Result<Publisher<M>, NodeError> {
        let (shared, topic, kinds) = (self.shared(), self.resolve(topic)?, M::kinds());
        let writers = match &kinds[..] {
            [kind] => vec![Some(shared.open_writer(&topic, kind, qos)?)],
            kinds => kinds.iter().map(|_| None).collect(),
        };
        let output = Mutex::new(Output { writers, waiting: Waiting::new(qos.depth()), closed: false });
        let publication = Arc::new(Publication { id: shared.next_id(), topic, kinds, qos, output });
        lock(&shared.state).publications.insert(publication.id, Arc::clone(&publication));
        let advertised = Arc::new(Advertised { shared: Arc::clone(shared), publication });
        Ok(Publisher { advertised, message: PhantomData })
    }

    /// Subscribes to a topic. Publishers are connected to as soon as they are discovered, whenever they come.
    ///
    /// # Errors
    /// [`NodeError`] if `topic` is no name, or DDS refuses.
    pub fn subscribe<M: Carried>(&self, topic: &str, qos: Qos) -> Result<Subscriber<M>, NodeError> {
        let (shared, topic, kinds) = (self.shared(), self.resolve(topic)?, M::kinds());
        let opened: Result<Vec<_>, _> =
            kinds.iter().map(|kind| shared.open_reader(&topic, kind, qos)).collect();
        let mut readers = opened?;
        let gids = readers.iter().map(|reader| reader.guid().to_bytes()).collect();
        let ids: Vec<_> = readers.iter().map(|_| shared.next_id()).collect();
        let subscription = Arc::new(Subscription {
            topic,
            kinds,
            readers: Mutex::default(),
            inbox: Inbox::new(qos.depth()),
            malformed: AtomicU64::new(0),
        });
        let mut state = lock(&shared.state);
        for (number, (id, reader)) in ids.iter().zip(&mut readers).enumerate() {
            state.readers.insert(*id, (Arc::clone(&subscription), number));
            shared.registry.register(reader, Token(*id), Interest::READABLE)?;
        }
        *lock(&subscription.readers) = readers;
        drop(state);
        // What came before it was registered.
        shared.wake();
        Ok(Subscriber { shared: Arc::clone(shared), subscription, gids, ids, message: PhantomData })
    }
}
