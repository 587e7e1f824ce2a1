//! A machine's context on its way to the core.

use std::collections::BTreeMap;

use cotorra_graph::{LinkId, MachineContext};
use cotorra_wifi::{InterfaceName, MacAddress, wpa_supplicant::Heard};
use serde::{Deserialize, Serialize};

use crate::link::LinkReading;

/// An agent's reading of its machine.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MachineReading {
    /// That of the agent's process, by whose clock it was read.
    pub boot: u64,
    /// Time at which the reading began, on the agent's clock.
    pub read_ns: u64,
    /// The core knows the node and the time of the reading on its own clock.
    pub context: MachineContext,
    /// The links that have their conditions.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub links: BTreeMap<LinkId, LinkReading>,
    /// Access points that each wanted station heard lately, strongest first.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub heard: BTreeMap<InterfaceName, Vec<Heard>>,
    /// Addresses of the Wi-Fi interfaces that the machine's owner lends.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub addresses: BTreeMap<InterfaceName, MacAddress>,
}
