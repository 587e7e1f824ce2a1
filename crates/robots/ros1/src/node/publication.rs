//! Topics that a node publishes, and their connections to subscribers.

use std::{io, net::Shutdown, sync::Arc};

use mio::net::TcpStream;
use parking_lot::Mutex;

use super::kind::Kind;
use crate::{queue::SendQueue, tcpros::Header};

/// Options of a published topic.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PublishOptions {
    /// Messages that are queued for a slow subscriber. If there are more, the oldest are dropped.
    pub queue: usize,
    /// Whether new subscribers get the last message at once, such as a map.
    pub latch: bool,
}

impl Default for PublishOptions {
    /// Eight messages, not latched.
    fn default() -> Self {
        Self { queue: 8, latch: false }
    }
}

/// A topic that the node publishes.
#[derive(Debug)]
pub(super) struct Publication {
    pub topic: String,
    pub kind: Kind,
    pub options: PublishOptions,
    pub connections: Mutex<Connections>,
}

/// Connections to the subscribers of a topic.
#[derive(Debug, Default)]
pub(super) struct Connections {
    pub open: Vec<Arc<Outgoing>>,
    /// The last frame, if the topic is latched.
    pub latched: Option<Arc<Vec<u8>>>,
    pub closed: bool,
}

/// A connection to a subscriber.
#[derive(Debug)]
pub(super) struct Outgoing {
    pub stream: TcpStream,
    pub subscriber: String,
    pub queue: Mutex<SendQueue>,
}

impl Outgoing {
    /// Sends a frame, or queues it.
    pub fn send(&self, frame: &Arc<Vec<u8>>) {
        let mut queue = self.queue.lock();
        queue.push(Arc::clone(frame));
        if queue.flush(&mut &self.stream).is_err() {
            // The engine sees that, and removes the connection.
            let _ = self.stream.shutdown(Shutdown::Both);
        }
    }

    /// Sends queued frames.
    pub fn flush(&self) -> io::Result<()> {
        self.queue.lock().flush(&mut &self.stream)
    }

    /// Returns the number of sent bytes and frames.
    pub fn sent(&self) -> (u64, u64) {
        let queue = self.queue.lock();
        (queue.bytes, queue.frames)
    }
}

impl Publication {
    /// Adds a subscriber whose connection header fits. It gets the answer to its header, the latched message, and all
    /// messages from now on.
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
        // The next event reports a failure.
        let _ = queue.flush(&mut &stream);
        let outgoing =
            Arc::new(Outgoing { stream, subscriber: subscriber.to_owned(), queue: Mutex::new(queue) });
        if connections.closed {
            // The engine sees that, and removes the connection.
            let _ = outgoing.stream.shutdown(Shutdown::Both);
        } else {
            connections.open.push(Arc::clone(&outgoing));
        }
        outgoing
    }

    /// Removes a connection.
    pub fn disconnect(&self, outgoing: &Arc<Outgoing>) {
        self.connections.lock().open.retain(|open| !Arc::ptr_eq(open, outgoing));
    }

    /// Ends all connections. Bytes that the kernel has taken still arrive.
    pub fn close(&self) {
        let mut connections = self.connections.lock();
        connections.closed = true;
        for outgoing in connections.open.drain(..) {
            let _ = outgoing.stream.shutdown(Shutdown::Both);
        }
    }
}
