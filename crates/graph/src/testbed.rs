//! A whole testbed, as a testbed file describes it and validation let it pass.

use std::{collections::HashSet, fmt, path::PathBuf, time::Duration};

use cotorra_numbers::Distribution;
use serde::{Deserialize, Serialize};

use crate::{
    active::Probing,
    border::Border,
    containers::Containers,
    exposure::WaisSettings,
    hardware::{HardwareGraph, Node, NodeKind},
    id::{AgentId, DomainId, NodeId, PluginId},
    map::OccupancyGrid,
    plugin_distance::PluginDistance,
    reservation::Reservations,
    schedule::Script,
    service::{Service, Vnf},
    traffic::TrafficSource,
    units::{Position, millis},
};

/// Names of the plug-ins that come with cotorra, and run in process. A testbed file can name no others.
pub const BUNDLED_PLUGINS: &[&str] = &["federation", "okpi", "pace", "probing"];

/// Content of a testbed file, checked as a whole.
#[derive(Debug, Clone, PartialEq)]
pub struct Testbed {
    /// Name, also of the run's folder.
    pub name: String,
    /// One sentence on it; may be empty.
    pub description: String,
    /// Currency of its prices, such as `EUR`; `None` without a bill.
    pub currency: Option<String>,
    /// Absolute folder of the file, from which relative paths in it start; empty if unknown.
    pub folder: PathBuf,
    /// G.
    pub graph: HardwareGraph,
    /// Its services.
    pub services: Vec<Service>,
    /// Map on which robots move; without one, open space.
    pub map: Option<OccupancyGrid>,
    /// One walk a robot at most.
    pub walks: Vec<Walk>,
    /// Plug-ins that run with it, in the file's order.
    pub plugins: Vec<PluginSpec>,
    /// The run's seed unless another is given.
    pub seed: u64,
    /// Its WLAN Access Information Service.
    pub wais: WaisSettings,
    /// Emulated server on which the core stands, for plug-ins and applications on nodes; `None` if they do not reach it there.
    pub core: Option<NodeId>,
    /// Emulator of wired links in real time.
    pub emulation: Emulation,
    /// Scripted conditions of its links.
    pub script: Script,
    /// Probing of its links; `None` without probes.
    pub probes: Option<Probing>,
    /// Retention of samples in its history.
    pub retention: Retentions,
    /// Its containers.
    pub containers: Containers,
    /// Its border to the cores of other domains, if it has one.
    pub border: Option<Border>,
    /// Hosts whose frames pass whatever sender they name.
    pub without_port_security: Vec<NodeId>,
    /// Sources of traffic that need no program, in the file's order.
    pub traffic: Vec<TrafficSource>,
    /// How wired links keep the reservations of mappings.
    pub reservations: Reservations,
}

/// Emulator of links.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Emulation {
    /// cotorra's own fabric: everything, on every kernel.
    #[default]
    Fabric,
    /// The kernel: bridges, and NetEm on each link. No radio, no traces, no circles; where it cannot, the fabric does.
    NetEm,
}

impl Testbed {
    /// Returns all VNFs: those of services, in the file's order, and then nodes that are containers as a whole.
    pub fn vnfs(&self) -> impl Iterator<Item = &Vnf> {
        self.services.iter().flat_map(|service| &service.vnfs).chain(&self.containers.hosts)
    }

    /// The walk of a robot.
    pub fn walk(&self, robot: &NodeId) -> Option<&Walk> {
        self.walks.iter().find(|w| w.robot == *robot)
    }

    /// The nodes whose agents the testbed cannot run without: real servers on which a VNF starts, robots, real radios, and
    /// machines on whose interfaces links are emulated, in order.
    pub fn agents_at_start(&self) -> impl Iterator<Item = (&Node, &AgentId)> {
        let carriers: HashSet<_> =
            self.graph.real_links().filter_map(|real| real.reached.via.as_ref()).collect();
        let starts_on = |node| self.vnfs().any(|vnf| vnf.node.all().contains(node));
        self.graph.agents().filter(move |(node, agent)| match &node.kind {
            NodeKind::Robot(_) => true,
            NodeKind::RadioUnit(unit) => unit.radio.is_some(),
            NodeKind::Server(_) => starts_on(&node.id),
            NodeKind::Machine(_) => carriers.contains(agent),
            _ => false,
        })
    }

    /// Returns the services that figures of several services together cover: all but those that localize, unless there are
    /// no others.
    pub fn services_in_total(&self) -> impl Iterator<Item = &Service> {
        let all_localize = self.services.iter().all(Service::localizes);
        self.services.iter().filter(move |service| all_localize || !service.localizes())
    }
}

/// Retention of samples of each embedding; `None` keeps them for ever.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Retentions {
    /// κ of robots.
    pub robots: Option<Retention>,
    /// ι of radio units.
    pub radio_units: Option<Retention>,
    /// d, λ, ψ and δ of links.
    pub links: Option<Retention>,
    /// Readings of sensors.
    pub sensors: Option<Retention>,
    /// Contexts of machines.
    pub machines: Option<Retention>,
}

/// Retention of samples. Their age counts to the present of their run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Retention {
    /// Time for which samples are kept as recorded.
    pub raw: Duration,
    /// Older ones become one point for each step of time, of each series: [`Self::is_step`].
    pub step: Duration,
    /// Time for which rolled-up points are kept; `None` for ever.
    pub keep: Option<Duration>,
}

impl Retention {
    /// Whether samples can be rolled up to points so far apart: from 10 ms on, what a minute is a multiple of.
    pub fn is_step(step: Duration) -> bool {
        let minute = Duration::from_secs(60).as_nanos();
        step >= Duration::from_millis(10) && minute.checked_rem(step.as_nanos()) == Some(0)
    }
}

/// Walk of a robot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Walk {
    /// The robot.
    pub robot: NodeId,
    /// The waypoints, in order, the way back included when the file asks for it. The robot starts at the first.
    pub waypoints: Vec<Position>,
    /// Index of the first waypoint that it heads for, if it starts on its way, at its node's position.
    #[serde(skip)]
    pub next: Option<u32>,
    /// Speed that it does not exceed, m/s.
    #[serde(rename = "speed_limit_mps")]
    pub speed_limit: f64,
    /// Interval of the robot's position packets, or its mean.
    #[serde(rename = "position_interval_ms", with = "millis")]
    #[schema(value_type = f64)]
    pub position_interval: Duration,
    /// Distribution of the intervals, seconds; `None` if all are alike.
    #[serde(skip)]
    pub random_intervals: Option<Distribution>,
}

/// A plug-in that runs with the testbed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct PluginSpec {
    /// Name in this testbed.
    pub id: PluginId,
    /// The program.
    pub program: PluginProgram,
    /// The one domain that it sees and changes; without one it is the operator's, and sees and changes all.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub domain: Option<DomainId>,
    /// Whether the run's figures stay valid if it is cut off.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub optional: bool,
    /// Instructions that it may give.
    #[serde(default, skip_serializing_if = "InstructionLimit::is_default")]
    pub instructions_per_second: InstructionLimit,
    /// Distance from the core.
    #[serde(default, skip_serializing_if = "PluginDistance::is_none")]
    pub distance: PluginDistance,
    /// Variables that a program gets beside the usual ones: `NAME` with its value in cotorra's own environment, or
    /// `NAME=VALUE`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub env: Vec<String>,
    /// Settings, as the file has them.
    pub settings: serde_json::Map<String, serde_json::Value>,
}

/// Number of instructions that a plug-in may give in a second, also all at once: from 1 to 100000, 1000 by default.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, utoipa::ToSchema)]
#[schema(value_type = u32, minimum = 1, maximum = 100_000)]
#[serde(try_from = "u32", into = "u32")]
pub struct InstructionLimit(u32);

impl InstructionLimit {
    /// The highest limit. More would keep a core from its other work.
    pub const MOST: u32 = 100_000;

    /// Returns `None` for 0, and above [`Self::MOST`].
    pub fn new(per_second: u32) -> Option<Self> {
        (1..=Self::MOST).contains(&per_second).then_some(Self(per_second))
    }

    /// Instructions in a second.
    pub const fn get(self) -> u32 {
        self.0
    }

    fn is_default(&self) -> bool {
        *self == Self::default()
    }
}

impl Default for InstructionLimit {
    fn default() -> Self {
        Self(1000)
    }
}

impl fmt::Display for InstructionLimit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

impl From<InstructionLimit> for u32 {
    fn from(limit: InstructionLimit) -> Self {
        limit.0
    }
}

impl TryFrom<u32> for InstructionLimit {
    type Error = String;
    fn try_from(per_second: u32) -> Result<Self, Self::Error> {
        Self::new(per_second).ok_or_else(|| format!("instructions per second are from 1 to {}", Self::MOST))
    }
}

/// Program of a plug-in.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum PluginProgram {
    /// One of the bundled, by name, in process.
    Bundled(String),
    /// A program and its arguments, which uses the HTTP API at `COTORRA_API`.
    Command(Vec<String>),
}
