//! Topics of encoded messages: names by ROS 2's rules, types, and quality of service.

use std::{
    collections::{BTreeMap, BTreeSet},
    fmt,
};

use cotorra_graph::Timestamp;
use cotorra_ros_messages::Message;

/// Quality of service with which a topic would be offered.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Qos {
    /// Reliable, to current subscribers.
    Default,
    /// Best effort, as for sensors.
    Sensor,
    /// Reliable, and the last message is kept for later subscribers: transient local.
    Latched,
}

impl Qos {
    /// Returns `ros2 bag`'s metadata of a channel, in the form that all distributions read (rmw's own numbers).
    fn to_yaml(self) -> String {
        let (depth, reliability, durability) = match self {
            Self::Default => (10, 1, 2),
            Self::Sensor => (5, 2, 2),
            Self::Latched => (1, 1, 1),
        };
        // rmw's infinite duration.
        let never = "    sec: 9223372036\n    nsec: 854775807\n";
        format!(
            "- history: 1\n  depth: {depth}\n  reliability: {reliability}\n  durability: {durability}\n  \
             deadline:\n{never}  lifespan:\n{never}  liveliness: 1\n  liveliness_lease_duration:\n{never}  \
             avoid_ros_namespace_conventions: false\n"
        )
    }
}

/// A topic and the type of its messages.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Channel {
    /// Index among the channels of its encoder, from 0, without gaps.
    pub index: usize,
    /// The name, such as `/robot/scan`.
    pub topic: String,
    /// The ROS name of its type, such as `sensor_msgs/msg/LaserScan`.
    pub type_name: &'static str,
    /// The type's `.msg` text and those of all types in it (`ros2msg`).
    pub schema: String,
    /// The type's hash (RIHS01).
    pub type_hash: String,
    /// Quality of service with which it would be offered.
    pub qos: Qos,
}

impl Channel {
    /// Returns `ros2 bag`'s metadata of the channel.
    pub fn metadata(&self) -> BTreeMap<String, String> {
        let notes =
            [("offered_qos_profiles", self.qos.to_yaml()), ("topic_type_hash", self.type_hash.clone())];
        notes.into_iter().map(|(key, note)| (key.to_owned(), note)).collect()
    }
}

/// An encoded message for a sink.
#[derive(Debug, Clone, Copy)]
pub struct Encoded<'a> {
    /// Its topic.
    pub channel: &'a Channel,
    /// Time of the event, in the run.
    pub at: Timestamp,
    /// CDR with its encapsulation header.
    pub payload: &'a [u8],
}

/// The channels that have messages.
#[derive(Debug, Default)]
pub(crate) struct Channels {
    all: Vec<Channel>,
    by_topic: BTreeMap<String, usize>,
    buffer: Vec<u8>,
}

impl Channels {
    /// Encodes a message for a topic. The first message of a topic adds its channel.
    pub fn encode<M: Message>(&mut self, topic: &str, qos: Qos, at: Timestamp, message: &M) -> Encoded<'_> {
        let index = match self.by_topic.get(topic) {
            Some(index) => *index,
            None => {
                let index = self.all.len();
                let (topic, description) = (topic.to_owned(), M::description());
                let (schema, type_hash) = (description.ros2_text(), description.type_hash());
                self.by_topic.insert(topic.clone(), index);
                self.all.push(Channel { index, topic, type_name: M::ROS2_NAME, schema, type_hash, qos });
                index
            }
        };
        self.buffer.clear();
        message.encode_cdr(&mut self.buffer);
        Encoded { channel: &self.all[index], at, payload: &self.buffer }
    }
}

/// Unique topic parts for names of a testbed: letters, digits and single `_`, without a leading digit.
#[derive(Debug)]
pub(crate) struct Names {
    by_name: BTreeMap<String, String>,
    taken: BTreeSet<String>,
}

impl Names {
    /// No names yet, and some that are reserved.
    pub fn without(reserved: &[&str]) -> Self {
        let taken = reserved.iter().map(|name| (*name).to_owned()).collect();
        Self { by_name: BTreeMap::new(), taken }
    }

    /// Returns the topic part of a name, the same each time.
    pub fn token(&mut self, name: impl fmt::Display) -> &str {
        let name = name.to_string();
        if !self.by_name.contains_key(&name) {
            let wanted = token(&name);
            let numbered = (2..).map(|number| format!("{wanted}_{number}"));
            let free = std::iter::once(wanted.clone()).chain(numbered).find(|t| !self.taken.contains(t));
            let free = free.expect("there are more numbers than names");
            self.taken.insert(free.clone());
            self.by_name.insert(name.clone(), free);
        }
        &self.by_name[&name]
    }
}

/// Converts a name to a topic part: `robot~R1` to `robot_R1`, `2nd` to `n2nd`.
fn token(name: &str) -> String {
    let parts = name.split(|c: char| !c.is_ascii_alphanumeric()).filter(|part| !part.is_empty());
    let joined = parts.collect::<Vec<_>>().join("_");
    if joined.starts_with(|c: char| c.is_ascii_digit()) { format!("n{joined}") } else { joined }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn topic_parts_follow_the_rules_of_ros_and_are_unique() {
        let mut names = Names::without(&["tf"]);
        assert_eq!(names.token("tb2"), "tb2");
        assert_eq!(names.token("robot~R1"), "robot_R1");
        assert_eq!(names.token("robot__R1"), "robot_R1_2");
        assert_eq!(names.token("robot~R1"), "robot_R1");
        assert_eq!(names.token("2nd.floor-"), "n2nd_floor");
        assert_eq!(names.token("tf"), "tf_2");
    }
}
