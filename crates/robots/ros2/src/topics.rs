//! Publishers and subscribers, and what they ask of whatever carries their messages: DDS, or Zenoh.

use std::{
    fmt,
    marker::PhantomData,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    time::Duration,
};

use cotorra_ros_messages::queue::{Inbox, RecvError};

use crate::{
    carried::{Carried, Kind},
    node::NodeError,
    peers::Peers,
    qos::Qos,
};

/// A message is no longer, as in ROS 1: an image of 4096 × 4096 pixels in colour still fits.
const MAX_MESSAGE_LEN: usize = 64 << 20;

/// What carries a node's messages. Topics have their global names.
pub trait Carrier: Send + Sync {
    /// Publishes a topic as some of those types, until the outlet is dropped.
    fn publish(&self, topic: &str, kinds: Vec<Kind>, qos: Qos) -> Result<Box<dyn Outlet>, NodeError>;

    /// Has what comes as any of those types go in there, until the inlet is dropped.
    fn subscribe(
        &self,
        incoming: Arc<Incoming>,
        kinds: Vec<Kind>,
        qos: Qos,
    ) -> Result<Box<dyn Inlet>, NodeError>;

    /// Types of others on a topic.
    fn peers(&self, topic: &str) -> Peers;

    /// Leaves, once; closes all that is incoming.
    fn shut_down(&self);

    /// Whether it left.
    fn is_shut_down(&self) -> bool;
}

/// Where messages go.
pub trait Outlet: Send + Sync {
    /// Sends a message as all types that are wanted, of which `encode` makes it what travels. Never waits.
    fn send(&self, encode: &dyn Fn(usize) -> Vec<u8>);

    /// How many subscribers are connected.
    fn subscribers(&self) -> usize;

    /// How many messages were dropped on the way out.
    fn dropped(&self) -> u64;
}

/// Where messages come from.
pub trait Inlet: Send + Sync {
    /// How many publishers are connected.
    fn publishers(&self) -> usize;
}

/// What came on a topic.
#[derive(Debug)]
pub struct Incoming {
    /// The topic's global name.
    pub topic: String,
    /// Encoded, with the number of its type.
    pub inbox: Inbox<(usize, Vec<u8>)>,
    malformed: AtomicU64,
}

impl Incoming {
    /// Of a topic of that global name.
    pub fn new(topic: String, qos: Qos) -> Self {
        Self { topic, inbox: Inbox::new(qos.depth()), malformed: AtomicU64::new(0) }
    }

    /// A message came as the type of that number.
    pub fn push(&self, number: usize, message: Vec<u8>) {
        let length = message.len();
        if length > MAX_MESSAGE_LEN {
            self.count_malformed(&format!("{length} bytes are over the limit of {MAX_MESSAGE_LEN}"));
        } else {
            self.inbox.push((number, message));
        }
    }

    /// A message was none.
    pub fn count_malformed(&self, reason: &str) {
        self.malformed.fetch_add(1, Ordering::Relaxed);
        tracing::warn!("{}: a message cannot be read: {reason}", self.topic);
    }
}

/// Publishes to one topic. Clones publish to the same; when the last is dropped, the topic is published no more.
pub struct Publisher<M> {
    topic: String,
    outlet: Arc<dyn Outlet>,
    message: PhantomData<fn(&M)>,
}

impl<M> Clone for Publisher<M> {
    fn clone(&self) -> Self {
        Self { topic: self.topic.clone(), outlet: Arc::clone(&self.outlet), message: PhantomData }
    }
}

impl<M> fmt::Debug for Publisher<M> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Publisher").field(&self.topic).finish()
    }
}

impl<M> Publisher<M> {
    pub(crate) fn new(topic: String, outlet: Box<dyn Outlet>) -> Self {
        Self { topic, outlet: outlet.into(), message: PhantomData }
    }

    /// The topic's global name.
    pub fn topic(&self) -> &str {
        &self.topic
    }

    /// How many subscribers are connected.
    pub fn subscribers(&self) -> usize {
        self.outlet.subscribers()
    }

    /// How many messages were dropped because subscribers do not acknowledge them in time.
    pub fn dropped(&self) -> u64 {
        self.outlet.dropped()
    }
}

impl<M: Carried> Publisher<M> {
    /// Publishes a message. Never waits: what is not sent at once is queued.
    pub fn publish(&self, message: &M) {
        self.outlet.send(&|kind| {
            let mut encoded = Vec::new();
            message.encode_as(kind, &mut encoded);
            encoded
        });
    }
}

/// Receives the messages of one topic; no longer once it is dropped.
pub struct Subscriber<M> {
    incoming: Arc<Incoming>,
    inlet: Box<dyn Inlet>,
    message: PhantomData<fn() -> M>,
}

impl<M> fmt::Debug for Subscriber<M> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Subscriber").field(&self.topic()).finish()
    }
}

impl<M> Subscriber<M> {
    pub(crate) fn new(incoming: Arc<Incoming>, inlet: Box<dyn Inlet>) -> Self {
        Self { incoming, inlet, message: PhantomData }
    }

    /// The topic's global name.
    pub fn topic(&self) -> &str {
        &self.incoming.topic
    }

    /// How many publishers are connected.
    pub fn publishers(&self) -> usize {
        self.inlet.publishers()
    }

    /// How many messages were dropped because they were not taken.
    pub fn dropped(&self) -> u64 {
        self.incoming.inbox.dropped()
    }

    /// How many messages were none of the type that they were said to be.
    pub fn malformed(&self) -> u64 {
        self.incoming.malformed.load(Ordering::Relaxed)
    }
}

impl<M: Carried> Subscriber<M> {
    fn read(&self, (kind, bytes): (usize, Vec<u8>)) -> Option<M> {
        let message = M::decode_as(kind, &bytes);
        message.inspect_err(|error| self.incoming.count_malformed(&error.to_string())).ok()
    }

    /// The next message, once there is one; `None` if the node was shut down.
    pub fn recv(&self) -> Option<M> {
        loop {
            if let Some(message) = self.read(self.incoming.inbox.pop(None).ok()?) {
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
            if let Some(message) = self.read(self.incoming.inbox.pop(Some(timeout))?) {
                return Ok(message);
            }
        }
    }

    /// The next message, if there is one.
    pub fn try_recv(&self) -> Option<M> {
        loop {
            if let Some(message) = self.read(self.incoming.inbox.try_pop()?) {
                return Some(message);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_messages_are_not_let_in() {
        let incoming = Incoming::new("/camera".to_owned(), Qos::SENSORS);
        incoming.push(0, vec![0; MAX_MESSAGE_LEN + 1]);
        incoming.push(1, vec![7]);
        assert_eq!(incoming.inbox.try_pop(), Some((1, vec![7])));
        assert_eq!((incoming.inbox.try_pop(), incoming.malformed.load(Ordering::Relaxed)), (None, 1));
    }
}
