//! Publishers and subscribers of other nodes, and their types, over either middleware.

use std::collections::{BTreeMap, BTreeSet};

use crate::carried::{Kind, shown};

/// A publisher or subscriber.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Endpoint {
    /// The topic's name in the middleware.
    pub topic: String,
    /// The type's name in DDS.
    pub kind: String,
    /// Hash of its type, if it announces one.
    pub hash: Option<String>,
}

/// Types of a topic's remote publishers and subscribers, by their ROS names.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Peers {
    /// Types of publishers.
    pub published: BTreeSet<String>,
    /// Types of subscribers.
    pub subscribed: BTreeSet<String>,
}

/// Returns the indices of the types to publish a topic as: for each remote participant that subscribes to some of them,
/// the last one.
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

/// Returns the types of endpoints on a topic.
pub fn types<'a>(endpoints: impl Iterator<Item = &'a Endpoint>, topic: &str) -> BTreeSet<String> {
    endpoints.filter(|other| other.topic == topic).map(|other| shown(&other.kind)).collect()
}

/// Warns of two types of one name with different fields: messages are misread, or peers are not connected.
pub fn warn_of_other_fields(own: &Endpoint, other: &Endpoint) {
    let same = own.hash == other.hash || own.hash.is_none() || other.hash.is_none();
    if own.topic == other.topic && own.kind == other.kind && !same {
        let kind = shown(&own.kind);
        tracing::warn!(
            "{}: a peer's {kind} has other fields than this node's; is it from another version of ROS?",
            own.topic
        );
    }
}
