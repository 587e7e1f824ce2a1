//! Publishers and subscribers.

use std::{
    fmt, io,
    marker::PhantomData,
    net::Shutdown,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering},
    },
    time::Duration,
};

use cotorra_ros_messages::{Message, queue::Inbox};
use mio::net::TcpStream;
use parking_lot::Mutex;

use super::{Kind, Node, NodeError, RecvError, Shared, engine::Command, keeper::Errand};
use crate::{
    queue::SendQueue,
    tcpros::{self, Header},
};

/// How a topic is published.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PublishOptions {
    /// How many messages wait for each subscriber that takes them too slowly; then the oldest are dropped.
    pub queue: usize,
    /// Whether who subscribes later gets the last message at once: for maps, say.
    pub latch: bool,
}

impl Default for PublishOptions {
    /// Eight messages, not latched.
    fn default() -> Self {
        Self { queue: 8, latch: false }
    }
}

/// How a topic is subscribed to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SubscribeOptions {
    /// How many messages wait to be taken; then the oldest are dropped.
    pub queue: usize,
}

impl Default for SubscribeOptions {
    /// Eight messages.
    fn default() -> Self {
        Self { queue: 8 }
    }
}

/// A topic that the node publishes.
#[derive(Debug)]
pub(super) struct Publication {
    pub topic: String,
    pub kind: Kind,
    options: PublishOptions,
    connections: Mutex<Connections>,
}

#[derive(Debug, Default)]
struct Connections {
    open: Vec<Arc<Outgoing>>,
    latched: Option<Arc<Vec<u8>>>,
    closed: bool,
}

/// A connection to a subscriber.
#[derive(Debug)]
pub(super) struct Outgoing {
    pub stream: TcpStream,
    pub subscriber: String,
    queue: Mutex<SendQueue>,
}

impl Outgoing {
    fn send(&self, frame: &Arc<Vec<u8>>) {
        let mut queue = self.queue.lock();
        queue.push(Arc::clone(frame));
        if queue.flush(&mut &self.stream).is_err() {
            // The engine sees that, and forgets the connection.
            let _ = self.stream.shutdown(Shutdown::Both);
        }
    }

    /// Sends what waits, once there is room.
    pub fn flush(&self) -> io::Result<()> {
        self.queue.lock().flush(&mut &self.stream)
    }

    /// How many bytes and frames were sent.
    pub fn sent(&self) -> (u64, u64) {
        let queue = self.queue.lock();
        (queue.bytes, queue.frames)
    }
}

impl Publication {
    /// Takes in a subscriber, whose connection header fits. It gets the header's answer, what is latched, and all
    /// that is published from now on.
    pub fn connect(&self, stream: TcpStream, subscriber: &str, node: &str) -> Arc<Outgoing> {
        let header = Header::new([
            ("callerid", node),
            ("topic", &self.topic),
            ("type", self.kind.name),
            ("md5sum", &self.kind.md5sum),
            ("message_definition", &self.kind.definition),
            ("latching", if self.options.latch { "1" } else { "0" }),
            ("tcp_nodelay", "1"),
        ]);
        let mut connections = self.connections.lock();
        let mut queue = SendQueue::new(self.options.queue, Some(header.to_frame()));
        connections.latched.iter().for_each(|latched| queue.push(Arc::clone(latched)));
        // A failure shows at the next event.
        let _ = queue.flush(&mut &stream);
        let outgoing =
            Arc::new(Outgoing { stream, subscriber: subscriber.to_owned(), queue: Mutex::new(queue) });
        if connections.closed {
            // The engine sees that, and forgets the connection.
            let _ = outgoing.stream.shutdown(Shutdown::Both);
        } else {
            connections.open.push(Arc::clone(&outgoing));
        }
        outgoing
    }

    /// Forgets a connection.
    pub fn disconnect(&self, outgoing: &Arc<Outgoing>) {
        self.connections.lock().open.retain(|open| !Arc::ptr_eq(open, outgoing));
    }

    /// Ends all connections. What the kernel has taken still arrives.
    pub fn close(&self) {
        let mut connections = self.connections.lock();
        connections.closed = true;
        for outgoing in connections.open.drain(..) {
            let _ = outgoing.stream.shutdown(Shutdown::Both);
        }
    }
}

/// Publishes messages of one type to one topic. Clones publish to the same; when the last is dropped, the topic is
/// unregistered.
pub struct Publisher<M> {
    advertised: Arc<Advertised>,
    message: PhantomData<fn(&M)>,
}

struct Advertised {
    shared: Arc<Shared>,
    publication: Arc<Publication>,
}

impl Drop for Advertised {
    fn drop(&mut self) {
        let topic = &self.publication.topic;
        self.shared.state.lock().publications.remove(topic);
        self.publication.close();
        self.shared.errand(Errand::Unpublished(topic.clone()));
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
        self.advertised.publication.connections.lock().open.len()
    }

    /// How many messages were dropped because a connected subscriber takes them too slowly.
    pub fn dropped(&self) -> u64 {
        let connections = self.advertised.publication.connections.lock();
        connections.open.iter().map(|outgoing| outgoing.queue.lock().dropped()).sum()
    }
}

impl<M: Message> Publisher<M> {
    /// Publishes a message. Never waits: what a subscriber's connection does not take at once is queued.
    pub fn publish(&self, message: &M) {
        let publication = &self.advertised.publication;
        let mut connections = publication.connections.lock();
        if connections.closed || (connections.open.is_empty() && !publication.options.latch) {
            return;
        }
        let frame = Arc::new(tcpros::frame(|buffer| message.encode_ros1(buffer)));
        for outgoing in &connections.open {
            outgoing.send(&frame);
        }
        connections.latched = publication.options.latch.then_some(frame);
    }
}

/// A topic that the node subscribes to.
#[derive(Debug)]
pub(super) struct Subscription {
    pub id: u64,
    pub topic: String,
    pub kind: Kind,
    pub inbox: Inbox<Vec<u8>>,
    /// How many publishers are connected.
    pub connected: AtomicUsize,
    /// Whether the master told of its publishers since it was asked to: that is newer than its answer.
    pub told: AtomicBool,
}

/// Receives the messages of one topic; no longer once it is dropped.
pub struct Subscriber<M> {
    shared: Arc<Shared>,
    subscription: Arc<Subscription>,
    malformed: AtomicU64,
    message: PhantomData<fn() -> M>,
}

impl<M> fmt::Debug for Subscriber<M> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Subscriber").field(&self.topic()).finish()
    }
}

impl<M> Drop for Subscriber<M> {
    fn drop(&mut self) {
        self.shared.state.lock().subscriptions.remove(&self.subscription.id);
        self.shared.command(Command::Unsubscribed(self.subscription.id));
        self.shared.errand(Errand::Unsubscribed(self.subscription.topic.clone()));
    }
}

impl<M> Subscriber<M> {
    /// The topic's global name.
    pub fn topic(&self) -> &str {
        &self.subscription.topic
    }

    /// How many publishers are connected.
    pub fn publishers(&self) -> usize {
        self.subscription.connected.load(Ordering::Relaxed)
    }

    /// How many messages were dropped because they were not taken.
    pub fn dropped(&self) -> u64 {
        self.subscription.inbox.dropped()
    }

    /// How many messages were none of the type that they were said to be.
    pub fn malformed(&self) -> u64 {
        self.malformed.load(Ordering::Relaxed)
    }
}

impl<M: Message> Subscriber<M> {
    fn read(&self, bytes: &[u8]) -> Option<M> {
        let message = M::decode_ros1(bytes);
        if let Err(error) = &message {
            self.malformed.fetch_add(1, Ordering::Relaxed);
            tracing::warn!("a message on {} is no {}: {error}", self.topic(), M::ROS1_NAME);
        }
        message.ok()
    }

    /// The next message, once there is one; `None` if the node was shut down.
    pub fn recv(&self) -> Option<M> {
        loop {
            if let Some(message) = self.read(&self.subscription.inbox.pop(None).ok()?) {
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
            if let Some(message) = self.read(&self.subscription.inbox.pop(Some(timeout))?) {
                return Ok(message);
            }
        }
    }

    /// The next message, if there is one.
    pub fn try_recv(&self) -> Option<M> {
        loop {
            if let Some(message) = self.read(&self.subscription.inbox.try_pop()?) {
                return Some(message);
            }
        }
    }
}

impl Node {
    /// Publishes a topic.
    ///
    /// # Errors
    /// [`NodeError`] if `topic` is no name, the node publishes it already, or the master fails.
    pub fn publish<M: Message>(
        &self,
        topic: &str,
        options: PublishOptions,
    ) -> Result<Publisher<M>, NodeError> {
        let (shared, topic) = (self.shared(), self.resolve(topic)?);
        let publication = Arc::new(Publication {
            topic: topic.clone(),
            kind: Kind::of::<M>(),
            options,
            connections: Mutex::default(),
        });
        shared.register(
            |state| {
                if state.publications.contains_key(&topic) {
                    return Err(NodeError::Taken(topic.clone()));
                }
                state.publications.insert(topic.clone(), Arc::clone(&publication));
                Ok(())
            },
            |master| master.register_publisher(&topic, M::ROS1_NAME, &shared.api),
            |state| drop(state.publications.remove(&topic)),
        )?;
        let advertised = Arc::new(Advertised { shared: Arc::clone(shared), publication });
        Ok(Publisher { advertised, message: PhantomData })
    }

    /// Subscribes to a topic. Publishers are connected to in the background, and again whenever they return. Each
    /// subscriber has connections of its own.
    ///
    /// # Errors
    /// [`NodeError`] if `topic` is no name, or the master fails.
    pub fn subscribe<M: Message>(
        &self,
        topic: &str,
        options: SubscribeOptions,
    ) -> Result<Subscriber<M>, NodeError> {
        let (shared, topic) = (self.shared(), self.resolve(topic)?);
        let subscription = Arc::new(Subscription {
            id: shared.next_id(),
            topic,
            kind: Kind::of::<M>(),
            inbox: Inbox::new(options.queue),
            connected: AtomicUsize::new(0),
            told: AtomicBool::new(false),
        });
        let (id, topic) = (subscription.id, &subscription.topic);
        let publishers = shared.register(
            |state| {
                state.subscriptions.insert(id, Arc::clone(&subscription));
                Ok(())
            },
            |master| master.register_subscriber(topic, M::ROS1_NAME, &shared.api),
            |state| drop(state.subscriptions.remove(&id)),
        )?;
        shared.command(Command::Publishers { subscription: id, publishers });
        Ok(Subscriber {
            shared: Arc::clone(shared),
            subscription,
            malformed: AtomicU64::new(0),
            message: PhantomData,
        })
    }
}
