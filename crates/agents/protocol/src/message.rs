//! Messages between the core and its agents, as JSON.

use std::{collections::BTreeMap, time::Duration};

use cotorra_graph::{LinkId, NodeId, Reached, Vnf};
use serde::{Deserialize, Serialize};

use crate::{
    encoding::{MOST_INSTANCES, Message, MessageError, decode, message},
    link::{LinkState, WantedLink},
    machine_reading::MachineReading,
    robot::{RobotState, WantedRobot},
    run::Run,
    shipped::Shipped,
    wifi::{LastEvent, WantedWifi, WifiReport, check_heard},
};

/// Time without a message after which each end takes the other for lost.
pub const LEASE: Duration = Duration::from_secs(2);

/// Number of an instance in a run.
pub type Instance = u64;

/// All that shall run on an agent's machine.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Wanted {
    pub run: Run,
    /// Grows with each change within the run, from 1.
    pub generation: u64,
    /// Time without a beat after which instances that do not `keep` are stopped.
    pub lease_ms: u32,
    /// Files of the run that instances read: the testbed file and those that it names.
    pub files: Vec<Shipped>,
    pub instances: BTreeMap<Instance, WantedInstance>,
    /// The robot at its ports, if it has one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub robot: Option<WantedRobot>,
    /// The links over interfaces of its machine.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub links: BTreeMap<LinkId, WantedLink>,
    /// The Wi-Fi interfaces of its machine.
    #[serde(default, skip_serializing_if = "WantedWifi::is_empty")]
    pub wifi: WantedWifi,
}

/// An instance of a VNF that shall run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WantedInstance {
    pub vnf: Vnf,
    /// Its number among the VNF's instances, from 0.
    pub replica: u32,
    pub node: NodeId,
    /// Variables for its program.
    pub environment: BTreeMap<String, String>,
    /// Whether it goes on while the core is away.
    pub keep: bool,
}

/// A sign of life of the core.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Beat {
    pub run: Run,
    /// The generation that the core wants.
    pub generation: u64,
    /// Time of sending on the core's clock, nanoseconds.
    pub sent_ns: u64,
    /// The last event of a Wi-Fi program that the core has.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub last_event: Option<LastEvent>,
}

/// An agent's report of its machine.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Report {
    /// A number that each process of the agent draws at its start.
    pub boot: u64,
    pub run: Run,
    /// The last wanted generation that it has saved.
    pub generation: u64,
    /// The beat that it answers.
    pub echo: Option<Echo>,
    /// The state of each wanted instance.
    pub instances: BTreeMap<Instance, InstanceState>,
    /// Number of instances that were stopped and have not ended yet.
    #[serde(default)]
    pub stopping: usize,
    /// The state of the wanted robot.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub robot: Option<RobotState>,
    /// The state of each wanted link; empty while the agent does not hear the core.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub links: BTreeMap<LinkId, LinkState>,
    /// Wi-Fi interfaces that are not their owner's now, and what happened there.
    #[serde(default, skip_serializing_if = "WifiReport::is_empty")]
    pub wifi: WifiReport,
}

/// The answer to a beat, from which the core learns the distance of the two clocks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Echo {
    /// Time of the beat, on the core's clock.
    pub sent_ns: u64,
    /// Time of its arrival, on the agent's clock.
    pub received_ns: u64,
    /// Time of the report, on the agent's clock.
    pub replied_ns: u64,
}

/// State of a wanted instance.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum InstanceState {
    Starting,
    Ready,
    /// It ended, with the reason. The agent does not start it again.
    Died(String),
    /// It could not be started, with the reason.
    Failed(String),
}

/// Longest reason in a report, characters.
const LONGEST_REASON: usize = 256;

message!(Wanted, 1 << 20, Wanted::check_bounds);
message!(Beat, 256);
message!(Report, 512 << 10, |its: &Report| {
    few(its.instances.len(), its.links.len()).and_then(|()| its.wifi.check())
});
message!(MachineReading, 256 << 10, |its: &MachineReading| {
    few(0, its.links.len()).and_then(|()| check_heard(&its.heard, &its.addresses))
});

impl Wanted {
    fn check_bounds(&self) -> Result<(), MessageError> {
        few(self.instances.len(), self.links.len())?;
        self.wifi.check()?;
        let is_bounded = |wanted: &WantedLink| wanted.probes.is_none_or(|probes| probes.are_bounded());
        match self.links.iter().find(|(_, wanted)| !is_bounded(wanted)) {
            Some((link, _)) => Err(MessageError::Probes(link.clone())),
            None => Ok(()),
        }
    }
}

/// Checks that a machine can have so many instances and links.
fn few(instances: usize, links: usize) -> Result<(), MessageError> {
    if instances > MOST_INSTANCES {
        return Err(MessageError::TooMany(instances));
    }
    if links > Reached::MOST_VIA_AGENT { Err(MessageError::TooManyLinks(links)) } else { Ok(()) }
}

/// Cuts a reason to the length that a report takes.
pub(crate) fn short(reason: &str) -> String {
    reason.chars().take(LONGEST_REASON).collect()
}
