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
