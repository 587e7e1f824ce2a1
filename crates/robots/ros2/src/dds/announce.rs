//! The node's announcement to ROS's tools: its name, and the endpoints of its DDS participant.
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
    /// Identifier of the participant.
    pub gid: Gid,
    /// Its nodes.
    pub nodes: Vec<NodeEntitiesInfo>,
}

/// `NodeEntitiesInfo`: a node and its endpoints.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize)]
pub struct NodeEntitiesInfo {
    /// Begins with `/`.
    pub namespace: String,
    /// Without namespace.
    pub name: String,
    /// Identifiers of its subscribers.
    pub readers: Vec<Gid>,
    /// Identifiers of its publishers.
    pub writers: Vec<Gid>,
}
