//! Why a graph makes no fabric.

use cotorra_graph::{HostAddress, LinkId, NodeId};

use crate::settings::FabricError;

/// Why a graph makes no fabric.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum GraphError {
    /// A link ends nowhere.
    #[error("link `{link}` ends at `{node}`, which is no node of the graph")]
    UnknownEnd {
        /// The link.
        link: LinkId,
        /// The node that does not exist.
        node: NodeId,
    },
    /// A robot with a wire.
    #[error("link `{link}` ends at robot `{robot}`, but a robot is reached by its radio alone")]
    WiredRobot {
        /// The link.
        link: LinkId,
        /// The robot.
        robot: NodeId,
    },
    /// Two nodes or two links of one name.
    #[error("`{0}` names two things: names are unique")]
    Duplicate(String),
    /// More hosts than there are addresses.
    #[error("{0} hosts are too many: there are addresses for {max}", max = HostAddress::MAX_HOSTS)]
    TooManyHosts(usize),
    /// Conditions that cannot be.
    #[error("`{link}`: {refusal}")]
    Conditions {
        /// The link, or the wireless network by its SSID.
        link: String,
        /// What is wrong.
        refusal: FabricError,
    },
}

/// Why links make no path between two hosts.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum NoPath {
    /// Switches and machines neither send nor receive.
    #[error("`{0}` is no host of the emulated network")]
    NotAHost(NodeId),
    /// No link of that name.
    #[error("there is no link `{0}`")]
    UnknownLink(LinkId),
    /// A link does not go on where the one before it ended.
    #[error("the link `{link}` does not go on from `{at}`")]
    Apart {
        /// The link.
        link: LinkId,
        /// Where the path has come to.
        at: NodeId,
    },
    /// Servers and robots send on nothing that is for others.
    #[error("the path leads through `{0}`, which forwards nothing")]
    NotForwarding(NodeId),
    /// A node is passed twice.
    #[error("the path comes to `{0}` twice")]
    Loop(NodeId),
    /// It ends elsewhere.
    #[error("the path ends at `{at}`, not at `{to}`")]
    WrongEnd {
        /// Where it ends.
        at: NodeId,
        /// Where it should.
        to: NodeId,
    },
}
