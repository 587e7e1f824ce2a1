//! Publishers and subscribers, and the traits of the middleware that carries their messages: DDS or Zenoh.

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
    error::NodeError,
    peers::Peers,
    qos::Qos,
};

/// Longest message, bytes, as in ROS 1. A colour image of 4096 × 4096 pixels fits.
const MAX_MESSAGE_LEN: usize = 64 << 20;

/// Middleware of a node. Topic names are global.
pub trait Carrier: Send + Sync {
    /// Publishes a topic as some of the types, until the outlet is dropped.
    fn publish(&self, topic: &str, kinds: Vec<Kind>, qos: Qos) -> Result<Box<dyn Outlet>, NodeError>;

    /// Passes messages of any of the types to `incoming`, until the inlet is dropped.
    fn subscribe(
        &self,
        incoming: Arc<Incoming>,
        kinds: Vec<Kind>,
        qos: Qos,
    ) -> Result<Box<dyn Inlet>, NodeError>;

    /// Returns the types of peers on a topic.
    fn peers(&self, topic: &str) -> Peers;

    /// Leaves the network, once, and closes all subscriptions.
    fn shut_down(&self);

    /// Whether it left the network.
    fn is_shut_down(&self) -> bool;
}

/// Sends the messages of a topic.
pub trait Outlet: Send + Sync {
    /// Sends a message as every type that is wanted. `encode` returns its bytes as a type. Never blocks.
    fn send(&self, encode: &dyn Fn(usize) -> Vec<u8>);

    /// Returns the number of connected subscribers.
    fn subscribers(&self) -> usize;

    /// Returns the number of messages that were dropped before sending.
    fn dropped(&self) -> u64;
}

/// Receives the messages of a topic.
pub trait Inlet: Send + Sync {
    /// Returns the number of connected publishers.
    fn publishers(&self) -> usize;
}

/// Received messages of a topic.
#[derive(Debug)]
pub struct Incoming {
    /// Returns the topic's global name.
    pub topic: String,
    /// Encoded messages, each with the index of its type.
    pub inbox: Inbox<(usize, Vec<u8>)>,
    malformed: AtomicU64,
}

impl Incoming {
    /// An empty queue for the topic of a global name.
    pub fn new(topic: String, qos: Qos) -> Self {
        Self { topic, inbox: Inbox::new(qos.depth()), malformed: AtomicU64::new(0) }
    }

    /// Adds a message of the type with that index.
    pub fn push(&self, number: usize, message: Vec<u8>) {
        let length = message.len();
        if length > MAX_MESSAGE_LEN {
            self.count_malformed(&format!("{length} bytes are over the limit of {MAX_MESSAGE_LEN}"));
        } else {
            self.inbox.push((number, message));
        }
    }

    /// Counts and logs a malformed message.
    pub fn count_malformed(&self, reason: &str) {
        self.malformed.fetch_add(1, Ordering::Relaxed);
        tracing::warn!("{}: a message cannot be read: {reason}", self.topic);
    }
}

/// Publishes to one topic. Clones share the topic, which ends when the last is dropped.
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

    /// Returns the topic's global name.
    pub fn topic(&self) -> &str {
        &self.topic
    }

    /// Returns the number of connected subscribers.
    pub fn subscribers(&self) -> usize {
        self.outlet.subscribers()
    }

    /// Returns the number of messages that were dropped because subscribers acknowledge too slowly.
    pub fn dropped(&self) -> u64 {
        self.outlet.dropped()
    }
}

impl<M: Carried> Publisher<M> {
    /// Publishes a message. Never blocks: a message that cannot be sent at once is queued.
    pub fn publish(&self, message: &M) {
        self.outlet.send(&|kind| {
            let mut encoded = Vec::new();
            message.encode_as(kind, &mut encoded);
            encoded
        });
    }
}

/// Receives the messages of one topic until it is dropped.
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

    /// Returns the topic's global name.
    pub fn topic(&self) -> &str {
        &self.incoming.topic
    }

    /// Returns the number of connected publishers.
    pub fn publishers(&self) -> usize {
        self.inlet.publishers()
    }

    /// Returns the number of messages that were dropped because the program is too slow.
    pub fn dropped(&self) -> u64 {
        self.incoming.inbox.dropped()
    }

    /// Returns the number of messages that could not be decoded.
    pub fn malformed(&self) -> u64 {
        self.incoming.malformed.load(Ordering::Relaxed)
    }
}

impl<M: Carried> Subscriber<M> {
    fn read(&self, (kind, bytes): (usize, Vec<u8>)) -> Option<M> {
        let message = M::decode_as(kind, &bytes);
        message.inspect_err(|error| self.incoming.count_malformed(&error.to_string())).ok()
    }

    /// Waits for the next message. Returns `None` if the node was shut down.
    pub fn recv(&self) -> Option<M> {
        loop {
            if let Some(message) = self.read(self.incoming.inbox.pop(None).ok()?) {
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
            if let Some(message) = self.read(self.incoming.inbox.pop(Some(timeout))?) {
                return Ok(message);
            }
        }
    }

    /// Returns the next message, if there is one.
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
    fn long_messages_are_rejected() {
        let incoming = Incoming::new("/camera".to_owned(), Qos::SENSORS);
        incoming.push(0, vec![0; MAX_MESSAGE_LEN + 1]);
        incoming.push(1, vec![7]);
        assert_eq!(incoming.inbox.try_pop(), Some((1, vec![7])));
        assert_eq!((incoming.inbox.try_pop(), incoming.malformed.load(Ordering::Relaxed)), (None, 1));
    }
}
