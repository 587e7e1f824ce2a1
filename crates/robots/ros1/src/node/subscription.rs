//! Topics that a node subscribes to.

use std::sync::atomic::{AtomicBool, AtomicUsize};

use cotorra_ros_messages::queue::Inbox;

use super::kind::Kind;

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
