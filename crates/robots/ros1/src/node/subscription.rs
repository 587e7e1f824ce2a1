//! Topics that a node subscribes to.

use std::sync::atomic::{AtomicBool, AtomicUsize};

use cotorra_ros_messages::queue::Inbox;

use super::kind::Kind;

/// Options of a subscription.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SubscribeOptions {
    /// Messages that are queued for the program. If there are more, the oldest are dropped.
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
    /// Number of connected publishers.
    pub connected: AtomicUsize,
    /// Whether the master sent its publishers since the registration. That is newer than the answer to it.
    pub notified: AtomicBool,
}
