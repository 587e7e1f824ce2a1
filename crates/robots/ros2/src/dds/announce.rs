//! What the node tells ROS's tools of itself: which endpoints of its DDS participant are a node's, and its name.
//!
//! Source: `rmw_dds_common`'s messages, of ROS 2 Iron and later.

use serde::Serialize;

use super::graph::Gid;

/// The topic's name, which has no prefix.
pub const TOPIC: &str = "ros_discovery_info";

/// The topic's type.
pub const TYPE_NAME: &str = "rmw_dds_common/msg/ParticipantEntitiesInfo";

/// `ParticipantEntitiesInfo`: the nodes of a participant.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct ParticipantEntitiesInfo {
    /// Of the participant.
    pub gid: Gid,
    /// Its nodes.
    pub nodes: Vec<NodeEntitiesInfo>,
}

/// `NodeEntitiesInfo`: a node and what it has.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize)]
pub struct NodeEntitiesInfo {
    /// Begins with `/`.
    pub namespace: String,
    /// Without namespace.
    pub name: String,
    /// Of its subscribers.
    pub readers: Vec<Gid>,
    /// Of its publishers.
    pub writers: Vec<Gid>,
}
