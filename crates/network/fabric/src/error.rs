//! The errors of building a fabric and of choosing paths through it.

use cotorra_graph::{HostAddress, LinkId, NodeId};

use crate::settings::FabricError;

/// An error in a graph that a fabric is built from.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum GraphError {
    /// A link whose end is no node of the graph.
    #[error("link `{link}` ends at `{node}`, which is no node of the graph")]
    UnknownEnd {
        /// The link.
        link: LinkId,
        /// The node that does not exist.
        node: NodeId,
    },
    /// A wired link to a robot.
    #[error("link `{link}` ends at robot `{robot}`, but a robot is reached by its radio alone")]
    WiredRobot {
        /// The link.
        link: LinkId,
        /// The robot.
        robot: NodeId,
    },
    /// Two nodes or two links with the same name.
    #[error("`{0}` names two things: names are unique")]
    Duplicate(String),
    /// More hosts than there are addresses.
    #[error("{0} hosts are too many: there are addresses for {max}", max = HostAddress::MAX_HOSTS)]
    TooManyHosts(usize),
    /// Impossible conditions.
    #[error("`{link}`: {error}")]
    Conditions {
        /// The link, or the wireless network by its SSID.
        link: String,
        /// The error.
        error: FabricError,
    },
}

/// An error in the links of a path between two hosts.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum NoPath {
    /// A switch or a real machine as an end of the path.
    #[error("`{0}` is no host of the emulated network")]
    NotAHost(NodeId),
    /// An unknown link.
    #[error("there is no link `{0}`")]
    UnknownLink(LinkId),
    /// A link that does not begin where the one before it ends.
    #[error("the link `{link}` does not go on from `{at}`")]
    Apart {
        /// The link.
        link: LinkId,
        /// The node that the path has reached.
        at: NodeId,
    },
    /// A path through a server or a robot, which do not forward.
    #[error("the path leads through `{0}`, which forwards nothing")]
    NotForwarding(NodeId),
    /// A path that visits a node twice.
    #[error("the path comes to `{0}` twice")]
    Loop(NodeId),
    /// A path that ends at another node.
    #[error("the path ends at `{at}`, not at `{to}`")]
    WrongEnd {
        /// The node where it ends.
        at: NodeId,
        /// The node where it should end.
        to: NodeId,
    },
}
