//! Publishers and subscribers.

use std::{
    fmt,
    marker::PhantomData,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering},
    },
    time::Duration,
};

use cotorra_ros_messages::{
    Message,
    queue::{Inbox, RecvError},
};
use parking_lot::Mutex;

use super::{
    kind::Kind,
    publication::{Publication, PublishOptions},
    shared::{Command, Errand, NodeError, Shared},
    subscription::{SubscribeOptions, Subscription},
};
use crate::tcpros;

/// Publishes messages of one type to one topic. Clones share the topic, which is unregistered when the last is dropped.
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
    /// Returns the topic's global name.
    pub fn topic(&self) -> &str {
        &self.advertised.publication.topic
    }

    /// Returns the number of connected subscribers.
    pub fn subscribers(&self) -> usize {
        self.advertised.publication.connections.lock().open.len()
    }

    /// Returns the number of messages that were dropped because a connected subscriber is too slow.
    pub fn dropped(&self) -> u64 {
        let connections = self.advertised.publication.connections.lock();
        connections.open.iter().map(|outgoing| outgoing.queue.lock().dropped()).sum()
    }
}

impl<M: Message> Publisher<M> {
    /// Publishes a topic under a global name.
    pub(super) fn advertise(
        shared: &Arc<Shared>,
        topic: String,
        options: PublishOptions,
    ) -> Result<Self, NodeError> {
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
        Ok(Self { advertised, message: PhantomData })
    }

    /// Publishes a message. Never blocks: bytes that a connection does not take at once are queued.
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

/// Receives the messages of one topic until it is dropped.
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
    /// Returns the topic's global name.
    pub fn topic(&self) -> &str {
        &self.subscription.topic
    }

    /// Returns the number of connected publishers.
    pub fn publishers(&self) -> usize {
        self.subscription.connected.load(Ordering::Relaxed)
    }

    /// Returns the number of messages that were dropped because the program is too slow.
    pub fn dropped(&self) -> u64 {
        self.subscription.inbox.dropped()
    }

    /// Returns the number of messages that could not be decoded.
    pub fn malformed(&self) -> u64 {
        self.malformed.load(Ordering::Relaxed)
    }
}

impl<M: Message> Subscriber<M> {
    /// Subscribes to the topic of a global name.
    pub(super) fn subscribe(
        shared: &Arc<Shared>,
        topic: String,
        options: SubscribeOptions,
    ) -> Result<Self, NodeError> {
        let subscription = Arc::new(Subscription {
            id: shared.next_id(),
            topic,
            kind: Kind::of::<M>(),
            inbox: Inbox::new(options.queue),
            connected: AtomicUsize::new(0),
            notified: AtomicBool::new(false),
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
        Ok(Self {
            shared: Arc::clone(shared),
            subscription,
            malformed: AtomicU64::new(0),
            message: PhantomData,
        })
    }

    fn read(&self, bytes: &[u8]) -> Option<M> {
        let message = M::decode_ros1(bytes);
        if let Err(error) = &message {
            self.malformed.fetch_add(1, Ordering::Relaxed);
            tracing::warn!("a message on {} is not a {}: {error}", self.topic(), M::ROS1_NAME);
        }
        message.ok()
    }

    /// Waits for the next message. Returns `None` if the node was shut down.
    pub fn recv(&self) -> Option<M> {
        loop {
            if let Some(message) = self.read(&self.subscription.inbox.pop(None).ok()?) {
                return Some(message);
            }
        }
    }

    /// Waits for the next message. The timeout begins again after a malformed one.
    ///
    /// # Errors
    /// [`RecvError`] if none arrives in time, or the node was shut down.
    pub fn recv_timeout(&self, timeout: Duration) -> Result<M, RecvError> {
        loop {
            if let Some(message) = self.read(&self.subscription.inbox.pop(Some(timeout))?) {
                return Ok(message);
            }
        }
    }

    /// Returns the next message, if there is one.
    pub fn try_recv(&self) -> Option<M> {
        loop {
            if let Some(message) = self.read(&self.subscription.inbox.try_pop()?) {
                return Some(message);
            }
        }
    }
}
