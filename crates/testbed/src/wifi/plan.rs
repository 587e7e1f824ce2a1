//! The configurations of hostapd and wpa_supplicant that a testbed's graph asks for.

use std::collections::BTreeMap;

use cotorra_datapath::wifi::{BRIDGE, WLAN};
use cotorra_graph as graph;
use cotorra_graph::{
    HardwareGraph, Node, NodeId, RadioKind, RadioUnit, Roaming, WifiSoftware, WifiStandard, WirelessNetwork,
};
use cotorra_wifi::{
    AccessPoint, AccessPointDriver, BackgroundScan, BackgroundScanMethod, Band, Bss, Channel, ChannelError,
    Credentials, DomainKey, FastTransition, Generation, InterfaceName, KeyExchange, KeyHolder, MacAddress,
    MobilityDomain, NameError, Network, Passphrase, PassphraseError, Protection, Radio, Security, Ssid,
    Station, StationDriver, Units, Width, hostapd::Neighbour,
};

/// Tasks of a testbed's Wi-Fi programs.
#[derive(Debug, Clone)]
pub(crate) struct Plan {
    /// The radio units.
    pub(super) units: BTreeMap<NodeId, PlannedUnit>,
    /// The robots.
    pub(super) robots: BTreeMap<NodeId, PlannedRobot>,
}

/// A radio unit with a hostapd.
#[derive(Debug, Clone)]
pub(super) struct PlannedUnit {
    /// Its access point, as the testbed file describes it.
    pub(super) access_point: AccessPoint,
    pub(super) bssid: MacAddress,
    /// The same settings in the graph's terms: the SSID is the name of its wireless network there.
    pub(super) settings: graph::AccessPoint,
    /// Whether it serves from the start.
    pub(super) serves: bool,
    /// Its greatest power, dBm.
    pub(super) power_dbm: f64,
}

/// A robot with a wpa_supplicant.
#[derive(Debug, Clone)]
pub(super) struct PlannedRobot {
    pub(super) station: Station,
    pub(super) address: MacAddress,
    /// Its wireless network in the graph.
    pub(super) network_name: String,
    /// Whether it changes its radio unit on instruction only.
    pub(super) is_instructed: bool,
    /// Its greatest power, dBm.
    pub(super) power_dbm: f64,
}

/// A graph that real Wi-Fi programs cannot serve.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PlanError {
    /// An SSID that is too long.
    #[error("wireless network `{network}` cannot have real Wi-Fi software: {source}")]
    Name {
        /// The network.
        network: String,
        /// The reason.
        source: NameError,
    },
    /// A passphrase of the wrong length, or with other characters.
    #[error("the passphrase of wireless network `{network}` is none: {source}")]
    Passphrase {
        /// The network.
        network: String,
        /// The reason.
        source: PassphraseError,
    },
    /// A channel that the network's standard does not have.
    #[error("radio unit `{unit}` cannot have real Wi-Fi software: {source}")]
    Channel {
        /// The radio unit.
        unit: NodeId,
        /// The reason.
        source: ChannelError,
    },
    /// An interface that these programs cannot have.
    #[error("the radio of `{node}` cannot have real Wi-Fi software: {source}")]
    Interface {
        /// The robot or radio unit.
        node: NodeId,
        /// The reason.
        source: NameError,
    },
}

impl Plan {
    /// Makes the plan of a graph's simulated radios; `None` if it has none. The units of mobility domains encrypt what they send
    /// each other by `key`.
    ///
    /// # Errors
    /// [`PlanError`].
    pub(crate) fn new(graph: &HardwareGraph, key: &DomainKey) -> Result<Option<Self>, PlanError> {
        let address = |node: &NodeId| graph.address(node).map(|address| MacAddress(address.mac));
        Self::with(graph, RadioKind::Hwsim, &address, key)
    }

    /// Makes the plan of a graph's real radios; `None` if it has none. All of them have these addresses.
    ///
    /// # Errors
    /// [`PlanError`].
    pub(crate) fn of_hardware(
        graph: &HardwareGraph,
        addresses: &BTreeMap<NodeId, MacAddress>,
        key: &DomainKey,
    ) -> Result<Option<Self>, PlanError> {
        Self::with(graph, RadioKind::Hardware, &|node| addresses.get(node).copied(), key)
    }

    fn with(
        graph: &HardwareGraph,
        radios: RadioKind,
        address: &dyn Fn(&NodeId) -> Option<MacAddress>,
        key: &DomainKey,
    ) -> Result<Option<Self>, PlanError> {
        let mut plan = Self { units: BTreeMap::new(), robots: BTreeMap::new() };
        let networks = graph.wireless.iter().filter_map(|(name, network)| {
            let software = network.access.software().filter(|software| software.radios == radios)?;
            Some(PlannedNetwork { graph, name, network, software, address, key })
        });
        for network in networks.clone() {
            network.add_units(&mut plan)?;
        }
        // A robot looks on the channels of all radio units that have its network's SSID, whatever their network.
        for network in networks {
            network.add_robots(&mut plan)?;
        }
        Ok((!plan.units.is_empty() || !plan.robots.is_empty()).then_some(plan))
    }

    /// Returns a radio unit's access point with these settings. One with a key has a passphrase of its
    /// own, and therefore no fast transition.
    pub(super) fn access_point(&self, unit: &NodeId, settings: &graph::AccessPoint) -> Option<AccessPoint> {
        let mut access_point = self.units.get(unit)?.access_point.clone();
        let fast = match &mut access_point.bss.security {
            Security::Open => None,
            Security::Wpa2 { passphrase, fast_transition, .. } => {
                if let Some(key) = &settings.key {
                    *passphrase = Passphrase::of_key(&key.0);
                    *fast_transition = None;
                }
                fast_transition.as_mut()
            }
            Security::Wpa3 { fast_transition, .. } => fast_transition.as_mut().map(|(fast, _)| fast),
        };
        if let Some(fast) = fast {
            fast.domain = MobilityDomain(settings.mobility_domain);
        }
        Some(access_point)
    }

    /// Returns the radio unit of a robot's network with an address.
    pub(super) fn unit_of(&self, robot: &NodeId, bssid: MacAddress) -> Option<&NodeId> {
        let network = &self.robots.get(robot)?.network_name;
        self.unit_with(bssid).filter(|unit| self.units[*unit].network_name() == network)
    }

    /// Returns the radio unit with an address, whatever its network.
    pub(super) fn unit_with(&self, bssid: MacAddress) -> Option<&NodeId> {
        self.units.iter().find(|(_, unit)| unit.bssid == bssid).map(|(id, _)| id)
    }

    /// Returns the neighbours that a radio unit announces to stations: all others of its network.
    pub(super) fn neighbours(&self, unit: &NodeId) -> Vec<Neighbour> {
        let Some(own) = self.units.get(unit) else { return Vec::new() };
        let others = self.units.iter();
        let others = others.filter(|(id, other)| *id != unit && other.network_name() == own.network_name());
        others.map(|(_, other)| other.as_neighbour()).collect()
    }
}

impl PlannedUnit {
    pub(super) fn ssid(&self) -> &Ssid {
        &self.access_point.bss.ssid
    }

    /// Returns its wireless network in the graph.
    pub(super) fn network_name(&self) -> &str {
        &self.settings.ssid
    }

    /// Returns its announcement to stations.
    pub(super) fn as_neighbour(&self) -> Neighbour {
        Neighbour::new(self.bssid, &self.access_point.bss, &self.access_point.radio)
    }

    pub(super) fn channel(&self) -> Channel {
        self.access_point.radio.channel
    }

    /// Whether it can have a key of its own.
    pub(super) fn takes_keys(&self) -> bool {
        matches!(self.access_point.bss.security, Security::Wpa2 { .. })
    }

    /// Returns its part in a mobility domain; `None` if stations do not roam fast.
    pub(super) fn fast_transition(&self) -> Option<&FastTransition> {
        self.access_point.bss.security.fast_transition()
    }
}

impl PlannedRobot {
    /// Returns the network that it joins.
    pub(super) fn network(&self) -> &Network {
        &self.station.networks[0]
    }

    /// Returns its passphrase of WPA2.
    pub(super) fn passphrase(&self) -> Option<&Passphrase> {
        match &self.network().credentials {
            Credentials::Wpa2 { passphrase, .. } => Some(passphrase),
            Credentials::Open | Credentials::Wpa3 { .. } => None,
        }
    }
}

/// A wireless network with real Wi-Fi software.
struct PlannedNetwork<'a> {
    graph: &'a HardwareGraph,
    name: &'a String,
    network: &'a WirelessNetwork,
    software: &'a WifiSoftware,
    address: &'a dyn Fn(&NodeId) -> Option<MacAddress>,
    key: &'a DomainKey,
}

impl PlannedNetwork<'_> {
    fn ssid(&self) -> Result<Ssid, PlanError> {
        let name = self.graph.ssid(self.name);
        Ssid::new(name.as_bytes()).map_err(|source| PlanError::Name { network: self.name.clone(), source })
    }

    fn units(&self) -> impl Iterator<Item = (&Node, &RadioUnit)> {
        self.graph.radio_units().filter(|(_, unit)| unit.network == *self.name)
    }

    /// Returns the radio units of its mobility domain.
    fn members(&self) -> Vec<(MacAddress, KeyHolder)> {
        let addresses = self.units().map(|(node, _)| self.address(&node.id));
        addresses.map(|bssid| (bssid, holder(bssid))).collect()
    }

    fn add_units(&self, plan: &mut Plan) -> Result<(), PlanError> {
        let (ssid, members) = (self.ssid()?, self.members());
        for (node, unit) in self.units() {
            let band = match self.network.standard.band(unit.channel) {
                graph::Band::Ghz2 => Band::Ghz2,
                graph::Band::Ghz5 => Band::Ghz5,
            };
            let generation = match self.network.standard {
                WifiStandard::A | WifiStandard::G => Generation::Ofdm,
                WifiStandard::N => Generation::Wifi4,
                // The testbed file has no 802.11ax with this software.
                WifiStandard::Ac | WifiStandard::Ax => Generation::Wifi5,
            };
            let channel = Channel::new(band, unit.channel, Width::Mhz20)
                .map_err(|source| PlanError::Channel { unit: node.id.clone(), source })?;
            let bssid = self.address(&node.id);
            let bridge = match node.radio() {
                None => Some(interface(BRIDGE)),
                Some(radio) => radio.bridge.as_deref().map(|bridge| named(node, bridge)).transpose()?,
            };
            let bss = Bss { bridge, ..Bss::new(ssid.clone(), self.security(bssid, &members)?) };
            let access_point = AccessPoint {
                interface: interface_of(node)?,
                driver: AccessPointDriver::Nl80211,
                radio: Radio { generation, ..Radio::new(channel) },
                bss,
                virtual_aps: Vec::new(),
            };
            let settings = graph::AccessPoint {
                ssid: self.name.clone(),
                mobility_domain: self.network.mobility_domain,
                key: None,
                core: None,
            };
            let (serves, power_dbm) = (unit.serving, unit.tx_power.0);
            let planned = PlannedUnit { access_point, bssid, settings, serves, power_dbm };
            plan.units.insert(node.id.clone(), planned);
        }
        Ok(())
    }

    fn add_robots(&self, plan: &mut Plan) -> Result<(), PlanError> {
        let (ssid, members) = (self.ssid()?, self.members());
        let mut channels: Vec<Channel> = Vec::new();
        for (node, _) in self.graph.radio_units() {
            let unit = plan.units.get(&node.id).filter(|unit| *unit.ssid() == ssid);
            if let Some(unit) = unit.filter(|unit| !channels.contains(&unit.channel())) {
                channels.push(unit.channel());
            }
        }
        for (node, robot) in self.graph.robots().filter(|(_, robot)| robot.network == *self.name) {
            let address = self.address(&node.id);
            let credentials = self.security(address, &members)?.credentials();
            let network = Network {
                channels: channels.clone(),
                background_scan: background_scan(robot.roaming),
                ..Network::new(ssid.clone(), credentials)
            };
            let station = Station {
                interface: interface_of(node)?,
                driver: StationDriver::Nl80211,
                country: None,
                networks: vec![network],
            };
            let is_instructed = robot.roaming == Roaming::Instructed;
            let network_name = self.name.clone();
            let power_dbm = robot.tx_power.0;
            let planned = PlannedRobot { station, address, network_name, is_instructed, power_dbm };
            plan.robots.insert(node.id.clone(), planned);
        }
        Ok(())
    }

    /// Returns the security of the access point with an address, among the members of its mobility domain.
    fn security(
        &self,
        bssid: MacAddress,
        members: &[(MacAddress, KeyHolder)],
    ) -> Result<Security, PlanError> {
        let passphrase = |text: &str| {
            text.parse::<Passphrase>()
                .map_err(|source| PlanError::Passphrase { network: self.name.clone(), source })
        };
        let fast = |over_ds| {
            let domain = MobilityDomain(self.network.mobility_domain);
            let fast = FastTransition { domain, holder: holder(bssid), over_ds };
            self.network.fast_transition.then_some(fast)
        };
        Ok(match &self.software.security {
            graph::Security::Open => Security::Open,
            graph::Security::Wpa2 { passphrase: text, management_frames, over_ds } => Security::Wpa2 {
                passphrase: passphrase(text)?,
                protection: match management_frames {
                    graph::Protection::Off => Protection::Off,
                    graph::Protection::Optional => Protection::Optional,
                    graph::Protection::Required => Protection::Required,
                },
                fast_transition: fast(*over_ds),
            },
            graph::Security::Wpa3 { passphrase: text, over_ds } => {
                let exchange = KeyExchange { key: self.key.clone(), units: Units::These(members.to_vec()) };
                Security::Wpa3 {
                    passphrase: passphrase(text)?,
                    fast_transition: fast(*over_ds).zip(Some(exchange)),
                }
            }
        })
    }

    /// Returns the address of a node's radio.
    fn address(&self, node: &NodeId) -> MacAddress {
        (self.address)(node).expect("all radios have addresses")
    }
}

/// Returns the name of a radio unit in its mobility domain: its address, which is always one.
fn holder(bssid: MacAddress) -> KeyHolder {
    bssid.to_string().parse().expect("an address is made of digits and colons")
}

/// Returns the interface of a node's radio.
pub(super) fn interface_of(node: &Node) -> Result<InterfaceName, PlanError> {
    node.radio().map_or_else(|| Ok(interface(WLAN)), |radio| named(node, &radio.interface))
}

/// Returns an interface of a node's machine.
fn named(node: &Node, name: &str) -> Result<InterfaceName, PlanError> {
    name.parse().map_err(|source| PlanError::Interface { node: node.id.clone(), source })
}

fn interface(name: &str) -> InterfaceName {
    name.parse().expect("the datapath names interfaces as Linux does")
}

/// Returns the background scans of a roaming policy. A station that decides by signal has those that NetworkManager asks
/// wpa_supplicant for: wpa_supplicant knows neither a hysteresis nor a time to trigger.
fn background_scan(roaming: Roaming) -> Option<BackgroundScan> {
    let graph::BackgroundScan { threshold, short_interval, long_interval } = match roaming {
        Roaming::Instructed => return None,
        Roaming::Signal => graph::BackgroundScan::default(),
        Roaming::Supplicant(scan) => scan,
    };
    // wpa_supplicant counts in whole seconds, and takes 0 for none.
    let seconds = |interval: std::time::Duration| {
        let seconds = interval.as_secs_f64().round().clamp(1.0, f64::from(u16::MAX));
        seconds as u16
    };
    let threshold_dbm = threshold.0.round().clamp(f64::from(i8::MIN), f64::from(i8::MAX)) as i8;
    Some(BackgroundScan {
        method: BackgroundScanMethod::Simple,
        threshold_dbm,
        short_s: seconds(short_interval),
        long_s: seconds(long_interval),
    })
}

#[cfg(test)]
mod tests;
