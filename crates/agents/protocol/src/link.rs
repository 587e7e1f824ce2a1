//! Links over interfaces of an agent's machine.

use std::{net::IpAddr, time::Duration};

use cotorra_graph::{Conditions, IpNetwork, LinkCounters, Probed, Probing, millis};
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
    /// Probes of the link, if any.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub probes: Option<WantedProbes>,
}

/// Wanted probes of a link by STAMP.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WantedProbes {
    /// The address of the reflector.
    pub reflector: IpAddr,
    pub probing: Probing,
    /// Delay of the medium itself, one way.
    #[serde(rename = "medium_delay_ms", with = "millis")]
    pub medium_delay: Duration,
}

impl WantedProbes {
    /// Whether an agent can probe so often, and remember so much.
    pub(crate) fn are_bounded(&self) -> bool {
        let Probing { interval, window } = self.probing;
        interval >= Probing::SHORTEST && window <= interval.saturating_mul(Probing::MOST)
    }
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

/// Counters of a link since its interface was given conditions, and the results of its probes.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LinkReading {
    pub leaving: LinkCounters,
    pub arriving: LinkCounters,
    /// Results of the way there, by the interface, and of the way back; `None` without probes, or not yet.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub probed: Option<[Probed; 2]>,
}
