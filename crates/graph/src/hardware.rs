//! The hardware graph G: robots, radio units, switches and servers, and the links between them.

use std::{
    collections::BTreeMap,
    net::{Ipv4Addr, Ipv6Addr},
    time::Duration,
};

use serde::{Deserialize, Serialize};

use crate::{
    accelerator::Accelerators,
    conditions::{Conditions, Loss, Scale},
    contention::Access,
    driver::Driver,
    fixed_rate::FixedRate,
    id::{AgentId, DomainId, LinkId, NodeId},
    medium::Medium,
    power::{RobotPower, ServerPower},
    queue::QueueLimit,
    real_machine::{Gateway, Machine, RealRadio, RealServer},
    sensor::Sensor,
    units::{BitRate, Dbm, Position, is_zero, millis},
    walls::Walls,
    wifi_software::RadioKind,
};

/// The hardware graph. Made by the crate `testbed-file`, which checks what this type takes for granted: names are
/// unique, ends of links exist, every server can be reached from every other node.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct HardwareGraph {
    /// Administrative domains, in the file's order.
    pub domains: Vec<DomainId>,
    /// Nodes, in the file's order.
    pub nodes: Vec<Node>,
    /// Wired links, in the file's order. Wireless ones follow from `wireless` and the nodes' radios.
    pub links: Vec<Link>,
    /// Wireless networks by SSID.
    pub wireless: BTreeMap<String, WirelessNetwork>,
}

impl HardwareGraph {
    /// Links of a testbed, at most: each host can have one, and some more.
    pub const MAX_LINKS: usize = 100_000;

    /// The node of that name.
    pub fn node(&self, id: &NodeId) -> Option<&Node> {
        self.nodes.iter().find(|n| n.id == *id)
    }

    /// The wired link of that name.
    pub fn link(&self, id: &LinkId) -> Option<&Link> {
        self.links.iter().find(|l| l.id == *id)
    }

    /// The robots, in order.
    pub fn robots(&self) -> impl Iterator<Item = (&Node, &Robot)> {
        self.nodes.iter().filter_map(|n| if let NodeKind::Robot(r) = &n.kind { Some((n, r)) } else { None })
    }

    /// The radio units, in order.
    pub fn radio_units(&self) -> impl Iterator<Item = (&Node, &RadioUnit)> {
        self.nodes
            .iter()
            .filter_map(|n| if let NodeKind::RadioUnit(r) = &n.kind { Some((n, r)) } else { None })
    }

    /// The robots and radio units of networks with real Wi-Fi software on these radios, in order.
    pub fn nodes_with(&self, radios: RadioKind) -> impl Iterator<Item = &Node> {
        self.nodes.iter().filter(move |node| {
            let network = match &node.kind {
                NodeKind::Robot(robot) => &robot.network,
                NodeKind::RadioUnit(unit) => &unit.network,
                _ => return false,
            };
            let software = self.wireless.get(network).and_then(|network| network.access.software());
            software.is_some_and(|software| software.radios == radios)
        })
    }

    /// Returns the name that a wireless network has in its beacons.
    pub fn ssid<'a>(&'a self, network: &'a str) -> &'a str {
        let software = self.wireless.get(network).and_then(|network| network.access.software());
        software.and_then(|software| software.ssid.as_deref()).unwrap_or(network)
    }

    /// The servers, in order.
    pub fn servers(&self) -> impl Iterator<Item = (&Node, &Server)> {
        self.nodes.iter().filter_map(|n| if let NodeKind::Server(s) = &n.kind { Some((n, s)) } else { None })
    }

    /// The hosts, in order: robots, radio units and servers, which run programs. The place of a host in this order is what
    /// [`HostAddress::of`] takes. That of a real server stays free, so that other hosts have the same addresses where it is
    /// emulated.
    pub fn hosts(&self) -> impl Iterator<Item = &Node> {
        self.nodes.iter().filter(|n| n.is_host())
    }

    /// The nodes at which packets enter and leave the emulated network, in the order of its ports: hosts, then gateways.
    pub fn ports(&self) -> impl Iterator<Item = &Node> {
        self.hosts().chain(self.gateways().map(|(node, _)| node))
    }

    /// The addresses of an emulated host; `None` for any other node or an unknown name.
    pub fn address(&self, id: &NodeId) -> Option<HostAddress> {
        let (place, node) = self.hosts().enumerate().find(|(_, node)| node.id == *id)?;
        node.real_server().is_none().then(|| HostAddress::of(place))
    }

    /// The IPv4 address of a host, emulated or real; `None` for any other node or an unknown name.
    pub fn ipv4(&self, id: &NodeId) -> Option<Ipv4Addr> {
        match self.node(id)?.real_server() {
            Some(real) => Some(real.address),
            None => self.address(id).map(|address| address.ipv4),
        }
    }
}

/// A node of G.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Node {
    /// Its name.
    pub id: NodeId,
    /// The domain that operates it.
    pub domain: DomainId,
    /// Position, with the height of its antenna. A robot's is its start.
    pub position: Option<Position>,
    /// Kind of node, with its hardware.
    #[serde(flatten)]
    pub kind: NodeKind,
}

impl Node {
    /// Whether it runs programs of a testbed: robots, radio units and servers do.
    pub fn is_host(&self) -> bool {
        !matches!(self.kind, NodeKind::Switch | NodeKind::Gateway(_) | NodeKind::Machine(_))
    }

    /// Whether packets enter and leave the emulated network there: hosts and gateways.
    pub fn has_port(&self) -> bool {
        self.is_host() || matches!(self.kind, NodeKind::Gateway(_))
    }

    /// Whether it passes on frames that are not for it: switches and radio units do.
    pub fn forwards(&self) -> bool {
        matches!(self.kind, NodeKind::Switch | NodeKind::RadioUnit(_))
    }

    /// Returns its capacity for VNFs; `None` for nodes that are no hosts.
    pub fn capacity(&self) -> Option<Capacity> {
        match &self.kind {
            NodeKind::Robot(r) => Some(r.capacity),
            NodeKind::RadioUnit(r) => Some(r.capacity),
            NodeKind::Server(s) => Some(s.capacity),
            NodeKind::Switch | NodeKind::Gateway(_) | NodeKind::Machine(_) => None,
        }
    }
}

/// Kind of a node.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case", tag = "kind")]
pub enum NodeKind {
    /// Moves, senses, and is attached to a radio unit.
    Robot(Robot),
    /// A radio unit (Wi-Fi access point).
    RadioUnit(RadioUnit),
    /// Forwards frames.
    Switch,
    /// Runs VNFs.
    Server(Server),
    /// Joins real machines to the emulated network.
    Gateway(Gateway),
    /// A real machine.
    Machine(Machine),
}

/// Capacity of a node for VNFs.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Capacity {
    /// CPUs.
    pub cpus: f64,
    /// Bytes of memory.
    pub memory_bytes: u64,
    /// Accelerators, if it has any.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub accelerators: Option<Accelerators>,
}

/// A robot's hardware.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Robot {
    /// Capacity for VNFs.
    pub capacity: Capacity,
    /// Model of the simulated base.
    pub model: RobotModel,
    /// SSID of the wireless network that it joins.
    pub network: String,
    /// Transmission power of its radio.
    #[serde(rename = "tx_power_dbm")]
    pub tx_power: Dbm,
    /// Heading at the start, radians from the x axis, counter-clockwise.
    pub heading: f64,
    /// Roaming policy.
    pub roaming: Roaming,
    /// Its driver.
    #[serde(default)]
    pub driver: Driver,
    /// Declared sensors, in the file's order.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub sensors: Vec<Sensor>,
    /// When its sensors and position packets are due.
    #[serde(default)]
    pub clock: RobotClock,
    /// Its real radio, in a network whose radios are hardware.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub radio: Option<RealRadio>,
    /// Its power; `None` if its energy is not counted.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub power: Option<Box<RobotPower>>,
}

/// When a robot's sensors and position packets are due.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct RobotClock {
    /// When intervals begin.
    pub phase: Phase,
    /// Largest error of the rate of each, parts per million: uniform within ± this, by the seed.
    pub drift_ppm: f64,
}

impl Default for RobotClock {
    fn default() -> Self {
        Self { phase: Phase::Random, drift_ppm: Self::DRIFT_PPM }
    }
}

impl RobotClock {
    /// The usual drift, twice the median error of clocks: 78 ppm among 20 000 hosts (Mills, Computer network time
    /// synchronization, 2006).
    pub const DRIFT_PPM: f64 = 156.0;
}

/// When the intervals of a robot's sensors and position packets begin.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Phase {
    /// Each by itself within its first interval, by the seed.
    #[default]
    Random,
    /// All when the run begins.
    Aligned,
}

/// Bases that the simulated robot knows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum RobotModel {
    /// TurtleBot 2: Kobuki base with an RPLIDAR A2.
    #[default]
    Turtlebot2,
    /// A quadrotor that flies by velocities, with the same lidar.
    Quadrotor,
}

impl RobotModel {
    /// Whether it leaves the floor.
    pub const fn flies(self) -> bool {
        matches!(self, Self::Quadrotor)
    }

    /// Fastest along its heading, m/s.
    pub const fn max_speed(self) -> f64 {
        match self {
            Self::Turtlebot2 => 0.7,
            Self::Quadrotor => 5.0,
        }
    }

    /// Returns the radius of its outline, metres.
    pub const fn radius(self) -> f64 {
        match self {
            // Half the diameter of a Kobuki base, 351.5 mm, rounded up.
            Self::Turtlebot2 => 0.177,
            Self::Quadrotor => 0.25,
        }
    }

    /// Returns its name for people.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Turtlebot2 => "TurtleBot 2",
            Self::Quadrotor => "quadrotor",
        }
    }
}

/// Roaming policy: the component that decides when a robot changes its radio unit.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Roaming {
    /// The station decides by signal, with hysteresis and time-to-trigger (see [`WirelessNetwork`]).
    Signal,
    /// Instructions from plug-ins. The station joins the strongest radio unit at the start, and scans by itself
    /// only when it lost its radio unit.
    #[default]
    Instructed,
    /// The station decides as wpa_supplicant does, by background scans. It loses beacons at random, and probes its radio
    /// unit before it gives it up, as Linux does.
    Supplicant(BackgroundScan),
}

/// Background scans of wpa_supplicant: the parameters of its module bgscan `simple`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct BackgroundScan {
    /// Signal of the own radio unit below which the short interval holds.
    #[serde(rename = "threshold_dbm")]
    pub threshold: Dbm,
    /// From scan to scan below the threshold; 1 s or more.
    #[serde(rename = "short_interval_ms", with = "millis")]
    #[schema(value_type = f64)]
    pub short_interval: Duration,
    /// From scan to scan otherwise, and after many scans below the threshold; not below the short interval.
    #[serde(rename = "long_interval_ms", with = "millis")]
    #[schema(value_type = f64)]
    pub long_interval: Duration,
}

impl Default for BackgroundScan {
    /// `bgscan="simple:30:-65:300"`: NetworkManager's setting for networks of several radio units.
    fn default() -> Self {
        Self {
            threshold: Dbm(-65.0),
            short_interval: Duration::from_secs(30),
            long_interval: Duration::from_secs(300),
        }
    }
}

/// A radio unit's hardware.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct RadioUnit {
    /// Capacity for VNFs.
    pub capacity: Capacity,
    /// SSID that it serves.
    pub network: String,
    /// Channel number; radio units on one channel share its airtime.
    pub channel: u8,
    /// Transmission power.
    #[serde(rename = "tx_power_dbm")]
    pub tx_power: Dbm,
    /// Whether it serves its network from the start: a(R) = {vAP}. One that does not is off until a vAP is deployed on it.
    #[serde(default = "yes")]
    pub serving: bool,
    /// Deployment time of a vAP, from the start to its first beacon.
    #[serde(rename = "deployment_ms", with = "millis", default)]
    #[schema(value_type = f64)]
    pub deployment: Duration,
    /// The agent of a real access point, which reports its context as that of this node.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub agent: Option<AgentId>,
    /// Its real radio, in a network whose radios are hardware.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub radio: Option<RealRadio>,
}

const fn yes() -> bool {
    true
}

/// A server's hardware.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Server {
    /// Distance from the robots.
    pub tier: Tier,
    /// Capacity for VNFs.
    pub capacity: Capacity,
    /// Price of a CPU for an hour, in the testbed's currency.
    pub cost: f64,
    /// Price of an hour of CPU time that VNFs use, in the testbed's currency.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub used_cost: f64,
    /// Price of a GB of memory for an hour, in the testbed's currency.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub memory_cost: f64,
    /// Price of each instance of a VNF that comes to it after the start, in the testbed's currency.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub migration_cost: f64,
    /// Probability that it works at any time; above 0.
    pub reliability: f64,
    /// Speed of a CPU, as a multiple of that on which demands were measured; above 0.
    #[serde(
        rename = "cpu_speed",
        default = "Server::usual_speed",
        skip_serializing_if = "Server::is_usual_speed"
    )]
    pub speed: f64,
    /// Its power; `None` if its energy is not counted.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub power: Option<Box<ServerPower>>,
    /// The real machine that it is; `None` for an emulated one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub real: Option<RealServer>,
}

impl Server {
    fn usual_speed() -> f64 {
        1.0
    }

    fn is_usual_speed(speed: &f64) -> bool {
        *speed == 1.0
    }
}

/// Distance of a server from the robots.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Tier {
    /// On the premises.
    Fog,
    /// Server at the operator's edge.
    Edge,
    /// Server in a data centre.
    Cloud,
}

/// A wired link.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Link {
    /// Its name.
    pub id: LinkId,
    /// Its two ends.
    pub ends: [NodeId; 2],
    /// Conditions from the first end to the second.
    pub forward: Conditions,
    /// Conditions from the second end to the first.
    pub backward: Conditions,
    /// ψ and δ at the start, forward and backward.
    #[serde(default)]
    pub scales: [Scale; 2],
    /// Rate of the medium itself; conditions may not exceed it.
    #[serde(rename = "medium_bps")]
    pub medium: BitRate,
    /// One-way delay of the medium itself, before emulation: see [`Medium`]. Zero where the whole link is emulated.
    #[serde(rename = "medium_delay_ms", with = "millis", default)]
    #[schema(value_type = f64)]
    pub medium_delay: Duration,
    /// Price of a GB that crosses it, in either direction, in the testbed's currency.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub cost: f64,
    /// Probability that it works at any time; above 0.
    pub reliability: f64,
}

impl Link {
    /// Returns the medium's own delay and rate.
    pub fn medium(&self) -> Medium {
        Medium { delay: self.medium_delay, rate: self.medium }
    }
}

/// One of a link's two directions.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, utoipa::ToSchema,
)]
#[serde(rename_all = "snake_case")]
pub enum Direction {
    /// The direction from the first end to the second. On a wireless link, from the robot up to the radio unit.
    Forward,
    /// The direction from the second end to the first.
    Backward,
}

impl Direction {
    /// Returns the name in JSON.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Forward => "forward",
            Self::Backward => "backward",
        }
    }
}

/// A wireless network: what radio units of one SSID and the robots that join it have in common.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct WirelessNetwork {
    /// Physical layer.
    pub standard: WifiStandard,
    /// Width of its channels.
    #[serde(default)]
    pub width: ChannelWidth,
    /// Most spatial streams of a frame, which is also the number of antennas of all stations.
    #[serde(default = "one_stream")]
    pub streams: u8,
    /// Guard interval of its frames.
    #[serde(default)]
    pub guard_interval: GuardInterval,
    /// One-way delay of a frame on an idle channel, airtime included: what is measured on the air with small
    /// frames. Queueing behind others and retries come on top.
    #[serde(rename = "delay_ms", with = "millis")]
    #[schema(value_type = f64)]
    pub delay: Duration,
    /// Highest rate of one station, whatever its signal. A frame's airtime is at least its bits over this rate.
    #[serde(rename = "rate_bps")]
    pub rate: Option<BitRate>,
    /// Loss of frames that the air would deliver, in each direction.
    #[serde(default)]
    pub loss: Loss,
    /// Fast transition (IEEE 802.11r) within the mobility domain.
    pub fast_transition: bool,
    /// The mobility domain of its radio units.
    #[serde(default)]
    pub mobility_domain: u16,
    /// Loss of signal over distance.
    pub path_loss: PathLoss,
    /// Attenuation by the walls of the map. Without it, they take nothing away.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<crate::WallLoss>)]
    pub walls: Option<Walls>,
    /// Variation of the signal around the path loss.
    pub shadowing: Shadowing,
    /// Small-scale fading of single frames. Without it, there is none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fading: Option<Fading>,
    /// Noise floor of a receiver, thermal noise over 20 MHz and noise figure together.
    #[serde(rename = "noise_floor_dbm")]
    pub noise_floor: Dbm,
    /// A station that decides by signal changes when another radio unit is stronger by so many dB …
    pub hysteresis_db: f64,
    /// … for so long.
    #[serde(rename = "time_to_trigger_ms", with = "millis")]
    #[schema(value_type = f64)]
    pub time_to_trigger: Duration,
    /// Durations of a handover's phases.
    pub handover: HandoverTimes,
    /// Treatment of frames for a station that is off its channel.
    pub gap: GapPolicy,
    /// Sharing of the channel by its senders.
    #[serde(flatten)]
    #[schema(value_type = crate::contention::AccessFields)]
    pub access: Access,
}

/// Physical layers whose rates are modelled.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum WifiStandard {
    /// IEEE 802.11g: ERP-OFDM, 20 MHz at 2.4 GHz, 6 to 54 Mbit/s.
    G,
    /// IEEE 802.11a: OFDM, 20 MHz at 5 GHz, 6 to 54 Mbit/s.
    A,
    /// IEEE 802.11n: HT at 2.4 or 5 GHz, 6.5 to 65 Mbit/s with one stream in 20 MHz.
    #[default]
    N,
    /// IEEE 802.11ac: VHT at 5 GHz, 6.5 to 78 Mbit/s with one stream in 20 MHz.
    Ac,
    /// IEEE 802.11ax: HE at 2.4 or 5 GHz, 8.6 to 143.4 Mbit/s with one stream in 20 MHz.
    Ax,
}

/// Width of a network's channels.
#[derive(
    Debug,
    Clone,
    Copy,
    PartialEq,
    Eq,
    PartialOrd,
    Ord,
    Hash,
    Default,
    Serialize,
    Deserialize,
    utoipa::ToSchema,
)]
pub enum ChannelWidth {
    /// 20 MHz.
    #[default]
    #[serde(rename = "20 MHz")]
    Mhz20,
    /// 40 MHz.
    #[serde(rename = "40 MHz")]
    Mhz40,
    /// 80 MHz.
    #[serde(rename = "80 MHz")]
    Mhz80,
}

impl ChannelWidth {
    /// Returns the width, MHz.
    pub const fn mhz(self) -> u16 {
        match self {
            Self::Mhz20 => 20,
            Self::Mhz40 => 40,
            Self::Mhz80 => 80,
        }
    }
}

/// Guard interval between symbols. The default is the longest of 802.11a, g, n and ac, and the shortest of 802.11ax.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize, utoipa::ToSchema)]
pub enum GuardInterval {
    /// 400 ns.
    #[serde(rename = "400 ns")]
    Ns400,
    /// 800 ns.
    #[default]
    #[serde(rename = "800 ns")]
    Ns800,
    /// 1.6 µs.
    #[serde(rename = "1600 ns")]
    Ns1600,
    /// 3.2 µs.
    #[serde(rename = "3200 ns")]
    Ns3200,
}

impl GuardInterval {
    /// Returns its duration, ns.
    pub const fn ns(self) -> u16 {
        match self {
            Self::Ns400 => 400,
            Self::Ns800 => 800,
            Self::Ns1600 => 1600,
            Self::Ns3200 => 3200,
        }
    }
}

/// Band of a channel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Band {
    /// 2.4 GHz.
    Ghz2,
    /// 5 GHz.
    Ghz5,
}

const fn one_stream() -> u8 {
    1
}

impl WifiStandard {
    /// Returns its name, and its band if it has only one, as people read them.
    pub const fn described(self) -> &'static str {
        match self {
            Self::G => "802.11g at 2.4 GHz",
            Self::A => "802.11a at 5 GHz",
            Self::N => "802.11n",
            Self::Ac => "802.11ac at 5 GHz",
            Self::Ax => "802.11ax",
        }
    }

    /// Returns the rates of data in channels of a width with so many streams, from the slowest to the fastest
    /// (IEEE 802.11-2020, tables 17-4, 19-27 to 19-36 and 21-30 to 21-45; IEEE 802.11ax-2021, 27.5). 802.11ac leaves out those whose
    /// symbols have no whole number of bits (21.5): of one or two streams, MCS 9 in 20 MHz.
    pub fn fixed_rates(self, width: ChannelWidth, streams: u8) -> Vec<FixedRate> {
        let mcs = |count| (0..count).map(FixedRate::Mcs).collect();
        match self {
            Self::G | Self::A => [6, 9, 12, 18, 24, 36, 48, 54]
                .into_iter()
                .filter_map(|mbps: u64| BitRate::from_bits_per_second(1_000_000 * mbps))
                .map(FixedRate::BitsPerSecond)
                .collect(),
            Self::N => mcs(8 * streams),
            Self::Ac if width == ChannelWidth::Mhz20 => mcs(9),
            Self::Ac => mcs(10),
            Self::Ax => mcs(12),
        }
    }

    /// Returns the limit of Linux's queue of a radio (mac80211): 16 MiB of memory with VHT, and 4 MiB without (`fq_init` in
    /// `include/net/fq_impl.h`, `ieee80211_txq_setup_flows` in `net/mac80211/tx.c`). A full frame takes 2304 bytes: 2048 and its
    /// `struct sk_buff`.
    pub const fn queue_limit(self) -> QueueLimit {
        let memory_mib = if matches!(self, Self::G | Self::A | Self::N) { 4 } else { 16 };
        QueueLimit::Packets((memory_mib << 20) / 2304)
    }
}

/// Path loss over distance d (metres).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case", tag = "model")]
pub enum PathLoss {
    /// Free space (ITU-R P.525): 20 log d + 20 log f - 27.55 dB, f in MHz.
    FreeSpace,
    /// Log-distance: free space up to the reference distance of 1 m, then 10·n·log d more.
    LogDistance {
        /// n: 2 in free space, 1.6 to 1.8 along a corridor, 2.7 to 3.5 among offices.
        exponent: f64,
    },
    /// ITU-R P.1238 indoor: 20 log f + N log d + L_f - 28 dB.
    ItuIndoor {
        /// N: 28 for dwellings, 30 for offices, 22 for shops, at 2.4 GHz.
        coefficient: f64,
        /// L_f: loss through floors between, dB.
        floor_loss_db: f64,
    },
}

/// Log-normal shadowing, correlated in space: exp(-Δx / correlation distance) (Gudmundson 1991).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Shadowing {
    /// Standard deviation, dB; 0 switches it off.
    pub deviation_db: f64,
    /// Distance over which the correlation falls to 1/e, metres; above 0.
    pub correlation_m: f64,
}

/// Small-scale fading by interference of paths, with a mean power of 1 and the spectrum of Clarke: Rayleigh, or Rician with
/// a line of sight.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Fading {
    /// Power of the line of sight over that of all other paths together, dB. Without it there is no line of sight.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub k_factor_db: Option<f64>,
    /// Speed of people and things around, m/s; at 0 only the robot's own movement changes the fading.
    #[serde(default)]
    pub motion_mps: f64,
}

/// Durations of a handover's phases.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct HandoverTimes {
    /// Scanning all channels, off one's own.
    #[serde(rename = "scan_ms", with = "millis")]
    #[schema(value_type = f64)]
    pub scan: Duration,
    /// Visits into which an attached station divides a scan. Without them, it is away for all of it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub visits: Option<ScanVisits>,
    /// Whether a station scans before it follows an instruction to attach to another radio unit, unless it has scanned within 5 s.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub scan_first: bool,
    /// From one scan of an attached station to the next that it begins by itself, unless its supplicant has intervals of its own.
    #[serde(
        rename = "scan_every_ms",
        default,
        skip_serializing_if = "Option::is_none",
        with = "millis::option"
    )]
    #[schema(value_type = Option<f64>)]
    pub scan_every: Option<Duration>,
    /// Authentication.
    #[serde(rename = "authenticate_ms", with = "millis")]
    #[schema(value_type = f64)]
    pub authenticate: Duration,
    /// Reassociation.
    #[serde(rename = "reassociate_ms", with = "millis")]
    #[schema(value_type = f64)]
    pub reassociate: Duration,
    /// The key handshakes (802.1X, four-way) that fast transition leaves out.
    #[serde(rename = "handshake_ms", with = "millis")]
    #[schema(value_type = f64)]
    pub handshake: Duration,
    /// Each phase varies by up to this share, uniformly; 0 to 1.
    pub variation: f64,
    /// Handovers whose phases take as long as their frames on the air, instead of the times above.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frames: Option<Frames>,
}

/// Handovers as frames on the air: those of authentication, reassociation and, unless by fast transition, the key handshake.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Frames {
    /// Interval of the timers of Linux, at whose ticks a station reassociates: 1 / HZ.
    #[serde(rename = "tick_ms", with = "millis")]
    #[schema(value_type = f64)]
    pub tick: Duration,
}

/// Visits of other channels, between which a station that scans is back on its own, as in Linux's software scan.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct ScanVisits {
    /// Time on each channel; above 0.
    #[serde(rename = "dwell_ms", with = "millis")]
    #[schema(value_type = f64)]
    pub dwell: Duration,
    /// Channels at the end of the scan that the station may only listen on.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub passive: Option<PassiveVisits>,
    /// The station visits further channels while it is away no longer than this and has no frame to send.
    #[serde(rename = "away_ms", with = "millis")]
    #[schema(value_type = f64)]
    pub away: Duration,
    /// Time back on its channel.
    #[serde(rename = "back_ms", with = "millis")]
    #[schema(value_type = f64)]
    pub back: Duration,
}

impl ScanVisits {
    /// Returns the time on the next channel of a scan, of which this much is left.
    pub fn next_dwell(&self, rest: Duration) -> Duration {
        let listened = self.passive.filter(|passive| rest <= passive.whole());
        listened.map_or(self.dwell, |passive| passive.dwell).min(rest)
    }
}

/// Visits of channels that a station may not probe, such as those of radars.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct PassiveVisits {
    /// Number of channels.
    pub channels: u8,
    /// Time on each channel; above 0.
    #[serde(rename = "dwell_ms", with = "millis")]
    #[schema(value_type = f64)]
    pub dwell: Duration,
}

impl PassiveVisits {
    /// Returns the time on all channels.
    pub fn whole(&self) -> Duration {
        self.dwell * u32::from(self.channels)
    }
}

/// Treatment of frames for or from a station that is off its channel or between two radio units.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum GapPolicy {
    /// The station's driver queues what it sends, and its radio unit buffers as for a station that sleeps; both
    /// are sent afterwards. What a former radio unit buffered goes with it to the new one.
    #[default]
    Hold,
    /// They are lost.
    Drop,
}

/// The addresses of a host, which follow from its place among the hosts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct HostAddress {
    /// Locally administered MAC address.
    pub mac: [u8; 6],
    /// IPv4 address, in 10.77.0.0/16.
    #[schema(value_type = String)]
    pub ipv4: Ipv4Addr,
    /// IPv6 address, in fd77::/64.
    #[schema(value_type = String)]
    pub ipv6: Ipv6Addr,
}

impl HostAddress {
    /// Network of all IPv4 addresses.
    pub const NETWORK: &'static str = "10.77.0.0/16";
    /// Length of the IPv4 prefix.
    pub const IPV4_PREFIX: u8 = 16;
    /// Length of the IPv6 prefix.
    pub const IPV6_PREFIX: u8 = 64;
    /// Number of hosts that addresses suffice for.
    pub const MAX_HOSTS: usize = 65_000;

    /// The addresses of the host at that place, from 0.
    ///
    /// # Panics
    /// From [`Self::MAX_HOSTS`] on, which no validated graph has.
    pub fn of(place: usize) -> Self {
        assert!(place < Self::MAX_HOSTS, "a validated graph has fewer hosts");
        let [high, low] = (place as u16 + 1).to_be_bytes();
        Self {
            mac: [0x02, 0x77, 0, 0, high, low],
            ipv4: Ipv4Addr::new(10, 77, high, low),
            ipv6: Ipv6Addr::new(0xfd77, 0, 0, 0, 0, 0, 0, place as u16 + 1),
        }
    }

    /// Returns the place of the host that a MAC address belongs to: the inverse of [`Self::of`].
    pub fn place_of(mac: [u8; 6]) -> Option<usize> {
        let place = usize::from(u16::from_be_bytes([mac[4], mac[5]])).checked_sub(1)?;
        (place < Self::MAX_HOSTS && Self::of(place).mac == mac).then_some(place)
    }

    /// Whether an IPv4 address is in the network of all hosts.
    pub fn is_near(address: Ipv4Addr) -> bool {
        address.octets()[..2] == Self::of(0).ipv4.octets()[..2]
    }
}
