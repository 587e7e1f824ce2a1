//! Wi-Fi interfaces of an agent's machine: access points and stations that the core wants there instead of the owner's.
//!
//! What interfaces shall be is part of the wanted state, and so are requests: each is carried out once, or refused. Events of
//! hostapd and wpa_supplicant are in the agent's reports until a beat acknowledges them.

mod agent;
mod controller;

use std::collections::BTreeMap;

use cotorra_wifi::{
    AccessPointSettings, Bss, Channel, Event, InterfaceName, MacAddress, Passphrase, Security, Ssid,
    StationSettings, Units,
    hostapd::{Neighbour, Urgency},
    wpa_supplicant::Heard,
};
use serde::{Deserialize, Serialize};

pub(crate) use self::{
    agent::AgentWifi,
    controller::{Origin, RemoteWifi},
};
use crate::encoding::MessageError;

/// Most interfaces of one machine.
pub const MOST_RADIOS: usize = 8;
/// Most virtual access points of an interface.
const MOST_VIRTUAL_APS: usize = 15;
/// Most neighbours of an access point, units of a mobility domain, and channels of a scan.
const MOST_OTHERS: usize = 256;
/// Most requests that are under way.
const MOST_REQUESTS: usize = 64;
/// Most events that wait for the core. The oldest are dropped.
pub(crate) const MOST_EVENTS: usize = 64;
/// Most access points that a station reports as heard, strongest first.
pub const MOST_HEARD: usize = 32;

/// Wanted state of the Wi-Fi interfaces of an agent's machine.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WantedWifi {
    /// Wanted role of each interface. Others stay their owner's.
    pub radios: BTreeMap<InterfaceName, WantedRadio>,
    /// Requests by their numbers. Each is carried out once.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub requests: BTreeMap<u64, WantedRequest>,
}

/// Wanted role of a Wi-Fi interface.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum WantedRadio {
    /// An access point.
    AccessPoint(Box<AccessPointSettings>),
    /// A station.
    Station(Box<StationSettings>),
    /// Nothing: its owner's access point is off, too.
    Silent,
}

/// A request to the program of a Wi-Fi interface.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WantedRequest {
    pub interface: InterfaceName,
    pub request: WifiRequest,
}

/// Something that a program does once.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum WifiRequest {
    /// A station: scan these channels, or all if there are none.
    Scan {
        channels: Vec<Channel>,
        /// Whether it stays where it is, whatever it finds.
        stays: bool,
    },
    /// A station: roam to an access point of its network.
    Roam {
        to: MacAddress,
        /// Whether by way of the present access point, over the distribution system.
        over_ds: bool,
    },
    /// A station: join this access point of its network only; any again if there is none.
    Pin { to: Option<MacAddress> },
    /// A station: use another passphrase from the next handshake on.
    SetPassphrase {
        /// The name of its network.
        ssid: Ssid,
        passphrase: Passphrase,
    },
    /// A station: leave its access point, and join one.
    Rejoin,
    /// An access point: ask a station to move to one of these, best first (802.11v).
    AskToMove { station: MacAddress, to: Vec<Neighbour>, urgency: Urgency },
    /// An access point: disconnect a station, with a reason (IEEE 802.11-2020, table 9-49).
    Disconnect { station: MacAddress, reason: u16 },
}

/// State of a wanted interface, or of one that is being put back.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RadioState {
    /// It is being changed or put back.
    Changing,
    /// It is as wanted.
    Ready,
    /// It is not, with the reason. The agent tries again.
    Failed(String),
}

/// State of a request.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RequestState {
    UnderWay,
    /// The program took it. Its events report the outcome.
    Done,
    /// It cannot do it now.
    Busy,
    /// It did not, with the reason.
    Refused(String),
}

/// Why the program of a Wi-Fi interface did not take a request.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum RequestError {
    /// It cannot do it now.
    #[error("the program is busy")]
    Busy,
    /// Another reason, for people.
    #[error("{0}")]
    Refused(String),
}

/// An event of the program of a Wi-Fi interface.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RadioEvent {
    /// Its number among those of the agent's process, from 1.
    pub number: u64,
    /// When the agent had it, on its clock.
    pub at_ns: u64,
    pub interface: InterfaceName,
    pub event: Event,
}

/// An agent's report of its Wi-Fi interfaces.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WifiReport {
    pub radios: BTreeMap<InterfaceName, RadioState>,
    /// States of the wanted requests.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub requests: BTreeMap<u64, RequestState>,
    /// Events that the core has not acknowledged, oldest first.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub events: Vec<RadioEvent>,
}

/// The last event that the core has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LastEvent {
    /// The agent's process that numbered it.
    pub boot: u64,
    pub number: u64,
}

impl WantedWifi {
    pub(crate) fn is_empty(&self) -> bool {
        self.radios.is_empty() && self.requests.is_empty()
    }

    pub(crate) fn check(&self) -> Result<(), MessageError> {
        at_most("Wi-Fi interfaces", self.radios.len(), MOST_RADIOS)?;
        at_most("requests to Wi-Fi programs", self.requests.len(), MOST_REQUESTS)?;
        self.radios.values().try_for_each(WantedRadio::check)?;
        self.requests.values().try_for_each(|wanted| match &wanted.request {
            WifiRequest::Scan { channels, .. } => at_most("channels", channels.len(), MOST_OTHERS),
            WifiRequest::AskToMove { to, .. } => at_most("neighbours", to.len(), MOST_OTHERS),
            WifiRequest::Roam { .. }
            | WifiRequest::Pin { .. }
            | WifiRequest::SetPassphrase { .. }
            | WifiRequest::Rejoin
            | WifiRequest::Disconnect { .. } => Ok(()),
        })
    }
}

impl WantedRadio {
    fn check(&self) -> Result<(), MessageError> {
        let units = |bss: &Bss| match &bss.security {
            Security::Wpa3 { fast_transition: Some((_, exchange)), .. } => match &exchange.units {
                Units::These(units) => units.len(),
                Units::Any => 0,
            },
            _ => 0,
        };
        match self {
            Self::AccessPoint(settings) => {
                let virtual_aps = &settings.virtual_aps;
                at_most("virtual access points", virtual_aps.len(), MOST_VIRTUAL_APS)?;
                at_most("neighbours", settings.neighbours.len(), MOST_OTHERS)?;
                let all = virtual_aps.iter().map(|(_, bss)| bss).chain([&settings.bss]);
                all.into_iter().try_for_each(|bss| at_most("units of a domain", units(bss), MOST_OTHERS))
            }
            Self::Station(settings) => at_most("channels", settings.network.channels.len(), MOST_OTHERS),
            Self::Silent => Ok(()),
        }
    }
}

impl WifiReport {
    pub(crate) fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    pub(crate) fn check(&self) -> Result<(), MessageError> {
        // Those that are put back, and those that are wanted instead.
        at_most("Wi-Fi interfaces", self.radios.len(), 2 * MOST_RADIOS)?;
        at_most("requests to Wi-Fi programs", self.requests.len(), MOST_REQUESTS)?;
        at_most("events of Wi-Fi programs", self.events.len(), MOST_EVENTS)
    }
}

/// Checks what the stations of a machine heard, and the addresses of its interfaces.
pub(crate) fn check_heard(
    heard: &BTreeMap<InterfaceName, Vec<Heard>>,
    addresses: &BTreeMap<InterfaceName, MacAddress>,
) -> Result<(), MessageError> {
    at_most("Wi-Fi interfaces", heard.len().max(addresses.len()), MOST_RADIOS)?;
    heard.values().try_for_each(|heard| at_most("access points that are heard", heard.len(), MOST_HEARD))
}

fn at_most(what: &'static str, number: usize, most: usize) -> Result<(), MessageError> {
    if number > most { Err(MessageError::TooMuchWifi { what, number, most }) } else { Ok(()) }
}
