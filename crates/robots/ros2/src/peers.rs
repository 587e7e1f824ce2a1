//! Who else publishes and subscribes, and what they mean by it, whatever carries the messages.

use std::collections::{BTreeMap, BTreeSet};

use crate::carried::{Kind, shown};

/// A publisher or subscriber somewhere.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Endpoint {
    /// As the middleware calls it.
    pub topic: String,
    /// As DDS calls it.
    pub kind: String,
    /// Of its type, if it announces one.
    pub hash: Option<String>,
}

/// Types of a topic's publishers and subscribers elsewhere, by their ROS names.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Peers {
    /// Of publishers.
    pub published: BTreeSet<String>,
    /// Of subscribers.
    pub subscribed: BTreeSet<String>,
}

/// The numbers of those types as which a topic is to be published: of each participant elsewhere that subscribes to some
/// of them, the last one.
pub fn wanted<'a, P: Ord>(
    subscribers: impl Iterator<Item = (P, &'a Endpoint)>,
    topic: &str,
    kinds: &[Kind],
) -> BTreeSet<usize> {
    let mut wanted = BTreeMap::new();
    for (participant, subscriber) in subscribers.filter(|(_, subscriber)| subscriber.topic == topic) {
        if let Some(number) = kinds.iter().position(|kind| kind.dds_name == subscriber.kind) {
            let last: &mut usize = wanted.entry(participant).or_default();
            *last = number.max(*last);
        }
    }
    wanted.into_values().collect()
}

/// The types of endpoints on a topic.
pub fn types<'a>(endpoints: impl Iterator<Item = &'a Endpoint>, topic: &str) -> BTreeSet<String> {
    endpoints.filter(|other| other.topic == topic).map(|other| shown(&other.kind)).collect()
}

/// Two types of one name whose fields differ are misread, or their peers not connected.
pub fn warn_of_other_fields(own: &Endpoint, other: &Endpoint) {
    let same = own.hash == other.hash || own.hash.is_none() || other.hash.is_none();
    if own.topic == other.topic && own.kind == other.kind && !same {
        let kind = shown(&own.kind);
        tracing::warn!("{}: a peer's {kind} has other fields than this node's, from another ROS?", own.topic);
    }
}
