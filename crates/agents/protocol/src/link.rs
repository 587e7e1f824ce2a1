//! Links over interfaces of an agent's machine.

use cotorra_graph::{Conditions, IpNetwork, LinkCounters};
use serde::{Deserialize, Serialize};

/// Conditions that the packets of an interface shall have.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WantedLink {
    /// The interface, as `ip link` names it.
    pub interface: String,
    /// Packets to and from these addresses; `None` for all that belong to no other link of the interface.
    pub addresses: Option<IpNetwork>,
    /// Conditions of leaving packets, less what the medium does itself.
    pub leaving: Conditions,
    /// Conditions of arriving packets, less what the medium does itself.
    pub arriving: Conditions,
}

/// State of a wanted link.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LinkState {
    /// The interface has its conditions.
    Applied,
    /// It has not, with the reason. The agent tries again.
    Failed(String),
}

/// What crossed a link since its interface was given conditions.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LinkReading {
    pub leaving: LinkCounters,
    pub arriving: LinkCounters,
}
