//! Services: the VNFs that make one up, the virtual links between them, and the KPIs that it must keep.

use std::{path::PathBuf, time::Duration};

use serde::{Deserialize, Serialize};

use crate::{
    accelerator::{Policy, PolicyServer},
    computing::Computing,
    container::Image,
    figure::{Bound, Total},
    flow::Flow,
    hardware::WifiStandard,
    id::{NodeId, ServiceId, VnfId},
    nodes::Nodes,
    state_transfer::StateTransfer,
    units::{BitRate, Position, Probability, millis},
};

/// A service that robots use.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Service {
    /// Its name.
    pub id: ServiceId,
    /// The robot that it serves.
    pub robot: NodeId,
    /// Its VNFs, in the order in which packets visit them.
    pub vnfs: Vec<Vnf>,
    /// Links between its VNFs.
    pub virtual_links: Vec<VirtualLink>,
    /// KPIs that it must keep.
    pub kpis: Kpis,
    /// Destination of a robot's requests, where a bundled VNF has several instances.
    #[serde(default, skip_serializing_if = "Requests::are_usual")]
    pub requests: Requests,
    /// How its robot follows actions of a model, in virtual time; `None` if it does not. Its service times are then those from
    /// observations to chunks.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub policy: Option<Box<Policy>>,
}

impl Service {
    /// Whether its service times are those of localization, from scans to poses.
    pub fn localizes(&self) -> bool {
        self.runs(&Program::Localization)
    }

    /// Whether its service times are those of navigation, from position packets to their answers.
    pub fn navigates(&self) -> bool {
        self.runs(&Program::RobotDriver) && !self.localizes()
    }

    fn runs(&self, program: &Program) -> bool {
        self.vnfs.iter().any(|vnf| vnf.program == *program)
    }
}

/// Destination of requests to a VNF that has several instances.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Requests {
    /// Sent to the first that serves.
    #[default]
    One,
    /// Sent to the serving instance with the least delay from the robot.
    Nearest,
    /// Sent to all that serve; the first answer wins.
    All,
}

impl Requests {
    fn are_usual(&self) -> bool {
        *self == Self::default()
    }
}

/// A virtual network function.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Vnf {
    /// Its name, unique in the testbed.
    pub id: VnfId,
    /// The program.
    pub program: Program,
    /// CPUs that it takes of its node.
    pub cpus: f64,
    /// Most CPUs that it uses; `None` for those that it takes of its node.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cpu_limit: Option<f64>,
    /// Memory that it takes of its node, bytes.
    pub memory_bytes: u64,
    /// The one node that can carry it, if it cannot move.
    pub pinned_to: Option<NodeId>,
    /// Nodes of its instances at the start, all different. A pinned VNF starts on its pinned node.
    pub node: Nodes,
    /// Variables that a command gets beside the usual ones: `NAME` with its value in cotorra's own environment, or
    /// `NAME=VALUE`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub env: Vec<String>,
    /// Rights of a command on the machine that runs the testbed.
    #[serde(default, skip_serializing_if = "Rights::are_usual")]
    pub rights: Rights,
    /// Whether it goes on while the core is away, if an agent runs it.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub keep: bool,
    /// The image in whose containers it runs; `None` for a process. A container of a bundled VNF's image runs the image's own
    /// command in the bundled VNF's place.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub image: Option<Box<Image>>,
    /// Time from the start of a process until it serves, in virtual time. An image has its own.
    #[serde(rename = "start_ms", with = "millis", default, skip_serializing_if = "Duration::is_zero")]
    #[schema(value_type = f64)]
    pub start: Duration,
    /// How it computes its answers; `None` if that takes no time of a CPU.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub computing: Option<Box<Computing>>,
    /// Its state, which is copied when it moves in virtual time; `None` if another instance starts without.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub state: Option<Box<StateTransfer>>,
}

impl Vnf {
    /// Returns the most CPUs that an instance uses.
    pub fn most_cpus(&self) -> f64 {
        self.cpu_limit.unwrap_or(self.cpus)
    }

    /// Returns the time from a start until it serves, in virtual time.
    pub fn start_time(&self) -> Duration {
        self.image.as_ref().map_or(self.start, |image| image.start)
    }

    /// Returns the model that it serves on an accelerator, if it does.
    pub fn policy_server(&self) -> Option<&PolicyServer> {
        match &self.program {
            Program::PolicyServer(server) => Some(server),
            _ => None,
        }
    }

    /// Returns the bytes of memory that it takes of an accelerator; 0 if it needs none.
    pub fn accelerator_bytes(&self) -> u64 {
        self.policy_server().map_or(0, |server| server.accelerator_bytes)
    }
}

/// Rights of a VNF's command on the machine that runs the testbed.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Rights {
    /// Confined to the node, with these rights besides.
    Confined(Granted),
    /// Unconfined: the command may do whatever cotorra may.
    Trusted,
}

/// Rights of a confined VNF beyond its own node and folder.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Granted {
    /// Capabilities over its node's network and its own threads.
    #[serde(default)]
    pub capabilities: Vec<LinuxCapability>,
    /// Files and folders that it may read beside programs, libraries and the testbed file's folder; from that folder.
    #[serde(default)]
    #[schema(value_type = Vec<String>)]
    pub readable: Vec<PathBuf>,
}

impl Rights {
    fn are_usual(&self) -> bool {
        *self == Self::default()
    }
}

impl Default for Rights {
    fn default() -> Self {
        Self::Confined(Granted::default())
    }
}

/// A capability of Linux (capabilities(7)) that reaches no further than a node.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum LinuxCapability {
    /// Ports below 1024.
    NetBindService,
    /// Broadcasts, and multicast groups.
    NetBroadcast,
    /// Interfaces, addresses, routes, filters.
    NetAdmin,
    /// Raw and packet sockets.
    NetRaw,
    /// Memory that is never swapped out.
    IpcLock,
    /// Real-time priority.
    SysNice,
}

/// Program of a VNF.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Program {
    /// The robot's own driver: position packets out, navigation packets in. Runs in the Robot Middleware.
    RobotDriver,
    /// The bundled brain, as the navigation VNF.
    Navigation,
    /// Monte Carlo localization of the service's robot: scans in, poses with their covariance out.
    Localization,
    /// The bundled brain as a ROS node: poses of the service's robot in on one topic, velocities out on another.
    RosNavigation,
    /// A model on an accelerator: observations of robots in, chunks of actions out. Runs in virtual time only.
    PolicyServer(PolicyServer),
    /// Any program and its arguments, in the node's namespace. With an image they are those of its containers, and may be
    /// empty for the image's own.
    Command(Vec<String>),
    /// An image that is its node as a whole, with these words or the image's own. It takes no room of the node.
    Host(Vec<String>),
}

impl Program {
    /// Whether it answers requests of robots as the bundled VNFs do: navigation or localization.
    pub const fn serves_robots(&self) -> bool {
        matches!(self, Self::Navigation | Self::Localization)
    }
}

/// A link between two VNFs of a service.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct VirtualLink {
    /// VNF at one end.
    pub from: VnfId,
    /// VNF at the other end.
    pub to: VnfId,
    /// Highest rate that it needs.
    #[serde(rename = "rate_bps")]
    pub rate: BitRate,
}

/// KPIs that a service must keep.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Kpis {
    /// Target of the service time: from the emission of a position packet to the reception of the navigation
    /// packet that answers it. Of a service that localizes, from a scan to the pose; of one with a `flow`, from its requests
    /// to their answers.
    #[serde(rename = "service_time_target_ms", with = "millis")]
    #[schema(value_type = f64)]
    pub service_time: Duration,
    /// Share of samples that must be within the target; `None` if any share will do.
    #[serde(rename = "keep", default, skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<f64>)]
    pub kept: Option<Probability>,
    /// Probability that all nodes and links in use work; 0 to 1.
    pub reliability: Option<f64>,
    /// Area of the service: a polygon of three places or more.
    pub area: Option<Vec<Position>>,
    /// The radio technology that it needs.
    pub radio: Option<WifiStandard>,
    /// The flow whose time is the service's, in place of navigation's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub flow: Option<Flow>,
    /// Further bounds on figures, such as `answered >= 99.9 %`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[schema(value_type = Vec<String>)]
    pub require: Vec<Bound>,
}

impl Kpis {
    /// Returns all KPIs that are bounds on figures of a run: the demanded share and the reliability, then the further bounds.
    pub fn bounds(&self) -> Vec<Bound> {
        let kept = self.kept.map(|kept| Bound::at_least(Total::Kept, kept.get()));
        let reliability = self.reliability.map(|share| Bound::at_least(Total::Reliability, share));
        kept.into_iter().chain(reliability).chain(self.require.iter().cloned()).collect()
    }
}
