//! Publishers and subscribers of other nodes, by discovery. DDS matches by topic, quality of service and type. RustDDS
//! does not compare the type, which this module does.

use std::collections::{BTreeMap, BTreeSet};

use rustdds::DomainParticipantStatusEvent as Event;

use crate::{
    carried::Kind,
    peers::{Endpoint, Peers, types, wanted, warn_of_other_fields},
};

/// Identifies an endpoint: twelve bytes of its participant, four of its own.
pub type Gid = [u8; 16];
/// Bytes that identify the participant.
const PARTICIPANT: usize = 12;

/// Discovered endpoints, and their matches with those of the node.
#[derive(Debug, Default)]
pub struct Graph {
    publishers: BTreeMap<Gid, Endpoint>,
    subscribers: BTreeMap<Gid, Endpoint>,
    /// Remote endpoints that each local one matches, whatever their type.
    matches: BTreeMap<Gid, BTreeSet<Gid>>,
    /// Local endpoints.
    own: BTreeMap<Gid, Endpoint>,
}

impl Graph {
    /// Adds an endpoint of the node itself.
    pub fn add_own(&mut self, gid: Gid, endpoint: Endpoint) {
        let others = self.publishers.values().chain(self.subscribers.values());
        others.for_each(|other| warn_of_other_fields(&endpoint, other));
        self.own.insert(gid, endpoint);
    }

    /// Removes an endpoint of the node itself.
    pub fn remove_own(&mut self, gid: Gid) {
        self.own.remove(&gid);
        self.matches.remove(&gid);
    }

    /// Applies a discovery event of RustDDS.
    pub fn apply(&mut self, event: Event) {
        match event {
            Event::ReaderDetected { reader } => {
                let gid = reader.guid.to_bytes();
                let found = endpoint(reader.topic_name, reader.type_name, &reader.user_data);
                self.check(&gid, &found);
                self.subscribers.insert(gid, found);
            }
            Event::WriterDetected { writer } => {
                let gid = writer.guid.to_bytes();
                let found = endpoint(writer.topic_name, writer.type_name, &writer.user_data);
                self.check(&gid, &found);
                self.publishers.insert(gid, found);
            }
            Event::RemoteReaderMatched { local_writer: local, remote_reader: remote }
            | Event::RemoteWriterMatched { local_reader: local, remote_writer: remote } => {
                self.matches.entry(local.to_bytes()).or_default().insert(remote.to_bytes());
            }
            Event::ReaderLost { guid, .. } | Event::WriterLost { guid, .. } => {
                let gid = guid.to_bytes();
                self.forget(|other| *other == gid);
            }
            Event::ParticipantLost { id, .. } => self.forget(|other| &other[..PARTICIPANT] == id.as_ref()),
            Event::RemoteReaderQosIncompatible { local_writer: local, .. }
            | Event::RemoteWriterQosIncompatible { local_reader: local, .. } => {
                if let Some(Endpoint { topic, .. }) = self.own.get(&local.to_bytes()) {
                    let problem =
                        "a publisher offers less than a subscriber asks for: reliability or durability";
                    tracing::warn!("{topic}: a peer is not connected, because {problem}");
                }
            }
            _ => {}
        }
    }

    fn check(&self, gid: &Gid, found: &Endpoint) {
        if !self.publishers.contains_key(gid) && !self.subscribers.contains_key(gid) {
            self.own.values().for_each(|own| warn_of_other_fields(own, found));
        }
    }

    fn forget(&mut self, lost: impl Fn(&Gid) -> bool) {
        self.publishers.retain(|gid, _| !lost(gid));
        self.subscribers.retain(|gid, _| !lost(gid));
        self.matches.values_mut().for_each(|matched| matched.retain(|gid| !lost(gid)));
    }

    /// Whether messages of a publisher can be of a type: the publisher has that type, or is unknown.
    pub fn publishes(&self, gid: &Gid, kind: &str) -> bool {
        self.publishers.get(gid).is_none_or(|publisher| publisher.kind == kind)
    }

    /// Returns the number of remote endpoints that match a local one and have its type.
    pub fn connected(&self, gid: &Gid) -> usize {
        let Some(own) = self.own.get(gid) else { return 0 };
        let same = |remote: &&Gid| {
            let known = self.publishers.get(*remote).or_else(|| self.subscribers.get(*remote));
            known.is_some_and(|endpoint| endpoint.kind == own.kind)
        };
        self.matches.get(gid).map_or(0, |matched| matched.iter().filter(same).count())
    }

    /// Returns the indices of the types to publish a topic as: for each remote node that subscribes to some of them, the
    /// last one.
    pub fn wanted(&self, topic: &str, kinds: &[Kind]) -> BTreeSet<usize> {
        let others = self.subscribers.iter().filter(|(gid, _)| !self.own.contains_key(*gid));
        wanted(others.map(|(gid, other)| (&gid[..PARTICIPANT], other)), topic, kinds)
    }

    /// Whether a peer subscribes to an endpoint's topic as another type.
    pub fn is_subscribed_otherwise(&self, own: &Endpoint) -> bool {
        self.subscribers
            .values()
            .any(|subscriber| subscriber.topic == own.topic && subscriber.kind != own.kind)
    }

    /// Whether RustDDS matched a local endpoint with one of another type.
    pub fn meets_others(&self, gid: &Gid) -> bool {
        self.matches.get(gid).is_some_and(|matched| matched.len() > self.connected(gid))
    }

    /// Returns the types of peers on a topic.
    pub fn peers(&self, topic: &str) -> Peers {
        let kinds = |endpoints: &BTreeMap<Gid, Endpoint>| {
            let others = endpoints.iter().filter(|(gid, _)| !self.own.contains_key(*gid));
            types(others.map(|(_, other)| other), topic)
        };
        Peers { published: kinds(&self.publishers), subscribed: kinds(&self.subscribers) }
    }
}

fn endpoint(topic: String, kind: String, user_data: &[u8]) -> Endpoint {
    // In rmw's form, `key=value;` for each entry.
    let text = String::from_utf8_lossy(user_data);
    let hash = text.split(';').find_map(|item| item.strip_prefix("typehash="));
    Endpoint { topic, kind, hash: hash.map(str::to_owned) }
}

#[cfg(test)]
mod tests {
    use rustdds::{EndpointDescription, GUID, LostReason, QosPolicyBuilder};

    use super::*;
    use crate::carried::{Carried, Command};

    fn guid(participant: u8, entity: u8) -> GUID {
        let mut bytes = [participant; 16];
        bytes[12..].copy_from_slice(&[0, 0, entity, 4]);
        GUID::from_bytes(bytes)
    }

    fn own(kind: &str) -> Endpoint {
        Endpoint { topic: "rt/cmd_vel".to_owned(), kind: kind.to_owned(), hash: Some("RIHS01_a".to_owned()) }
    }

    fn description(guid: GUID, kind: &str) -> EndpointDescription {
        EndpointDescription {
            updated_time: Default::default(),
            guid,
            topic_name: "rt/cmd_vel".to_owned(),
            type_name: kind.to_owned(),
            qos: QosPolicyBuilder::new().build(),
            user_data: b"enclave=/;typehash=RIHS01_b;".to_vec(),
        }
    }

    const TWIST: &str = "geometry_msgs::msg::dds_::Twist_";
    const STAMPED: &str = "geometry_msgs::msg::dds_::TwistStamped_";

    fn graph() -> (Graph, GUID, [GUID; 2]) {
        let (mut graph, local, remote) = (Graph::default(), guid(1, 1), [guid(2, 1), guid(2, 2)]);
        graph.add_own(local.to_bytes(), own(TWIST));
        for (remote, kind) in remote.into_iter().zip([TWIST, STAMPED]) {
            graph.apply(Event::ReaderDetected { reader: description(remote, kind) });
            graph.apply(Event::RemoteReaderMatched { local_writer: local, remote_reader: remote });
        }
        (graph, local, remote)
    }

    #[test]
    fn only_peers_of_the_same_type_are_connected() {
        let (graph, local, _) = graph();
        assert_eq!(graph.connected(&local.to_bytes()), 1);
        assert!(graph.meets_others(&local.to_bytes()) && graph.is_subscribed_otherwise(&own(TWIST)));
        let kinds = Command::kinds();
        assert_eq!(graph.wanted("rt/cmd_vel", &kinds), [1].into(), "one node understands both");
        assert!(graph.wanted("rt/scan", &kinds).is_empty());
        let kinds = ["geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"].map(str::to_owned);
        assert_eq!(graph.peers("rt/cmd_vel").subscribed, kinds.into());
        assert!(graph.peers("rt/cmd_vel").published.is_empty());
    }

    #[test]
    fn lost_peers_are_removed() {
        let reason = LostReason::Disposed;
        let (mut one, local, remote) = graph();
        one.apply(Event::ReaderLost { guid: remote[0], reason: reason.clone() });
        assert_eq!(one.connected(&local.to_bytes()), 0);
        assert_eq!(one.wanted("rt/cmd_vel", &Command::kinds()), [1].into());
        one.apply(Event::ParticipantLost { id: remote[0].prefix, reason });
        assert_eq!(one.peers("rt/cmd_vel"), Peers::default());
    }

    #[test]
    fn each_node_gets_the_type_that_it_subscribes_to() {
        let mut graph = Graph::default();
        for (guid, kind) in [(guid(2, 1), TWIST), (guid(3, 1), TWIST), (guid(3, 2), STAMPED)] {
            graph.apply(Event::ReaderDetected { reader: description(guid, kind) });
        }
        assert_eq!(graph.wanted("rt/cmd_vel", &Command::kinds()), [0, 1].into());
    }

    #[test]
    fn hashes_are_read_from_announcements() {
        let found = endpoint(String::new(), String::new(), b"a=b;typehash=RIHS01_ff;");
        assert_eq!(found.hash.as_deref(), Some("RIHS01_ff"));
        assert_eq!(endpoint(String::new(), String::new(), b"\xff;").hash, None);
    }

    #[test]
    fn messages_of_another_type_are_recognized_by_their_publisher() {
        let mut graph = Graph::default();
        let writer = guid(3, 1);
        assert!(graph.publishes(&writer.to_bytes(), TWIST));
        graph.apply(Event::WriterDetected { writer: description(writer, STAMPED) });
        assert!(!graph.publishes(&writer.to_bytes(), TWIST) && graph.publishes(&writer.to_bytes(), STAMPED));
    }
}
