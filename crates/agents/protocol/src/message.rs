//! Messages between the core and its agents, as JSON.

use std::{collections::BTreeMap, time::Duration};

use cotorra_graph::{LinkId, NodeId, Reached, Vnf};
use serde::{Deserialize, Serialize, de::DeserializeOwned};

use crate::{
    link::{LinkState, WantedLink},
    machine_reading::MachineReading,
    robot::{RobotState, WantedRobot},
    shipped::Shipped,
    wifi::{LastEvent, WantedWifi, WifiReport, check_heard},
};

/// Time without a message after which each end takes the other for lost.
pub const LEASE: Duration = Duration::from_secs(2);

/// Number of an instance in a run.
pub type Instance = u64;

/// A run: the time of its start, nanoseconds since 1970. A later run replaces an earlier one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Run(pub u64);

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

/// What runs on an agent's machine.
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

/// Error of a received message.
#[derive(Debug, thiserror::Error)]
pub enum MessageError {
    /// It is longer than this kind of message can be.
    #[error("{bytes} bytes, of at most {most}")]
    TooLong { bytes: usize, most: usize },
    /// It is not of this protocol.
    #[error(transparent)]
    Malformed(#[from] serde_json::Error),
    /// It is more than a machine can run.
    #[error("{0} instances, of at most {MOST_INSTANCES}")]
    TooMany(usize),
    /// It is more than a core can want.
    #[error("{0} links, of at most {most}", most = Reached::MOST_VIA_AGENT)]
    TooManyLinks(usize),
    /// A link would be probed too often, or over too long a time.
    #[error("probes of `{0}` beyond the bounds")]
    Probes(LinkId),
    /// It is more than Wi-Fi interfaces can have.
    #[error("{number} {what}, of at most {most}")]
    TooMuchWifi { what: &'static str, number: usize, most: usize },
    /// No robot can say it.
    #[error("readings beyond those of a robot")]
    Impossible,
}

/// Most instances on one machine.
const MOST_INSTANCES: usize = 1024;
/// Longest reason in a report, characters.
const LONGEST_REASON: usize = 256;

/// A message with a longest encoding.
pub(crate) trait Message: Serialize + DeserializeOwned {
    /// Longest encoding, bytes.
    const LONGEST: usize;

    /// Checks what its type does not say.
    fn check(&self) -> Result<(), MessageError> {
        Ok(())
    }
}

macro_rules! message {
    ($name:ident, $longest:expr $(, $check:expr)?) => {
        impl Message for $name {
            const LONGEST: usize = $longest;
            $(fn check(&self) -> Result<(), MessageError> {
                $check(self)
            })?
        }

        impl $name {
            /// Encodes it.
            pub fn encode(&self) -> Vec<u8> {
                serde_json::to_vec(self).expect("it has text keys and finite numbers")
            }

            /// Decodes a received message.
            ///
            /// # Errors
            /// [`MessageError`].
            pub fn decode(bytes: &[u8]) -> Result<Self, MessageError> {
                decode(bytes)
            }
        }
    };
}

pub(crate) use message;

message!(Wanted, 1 << 20, Wanted::check_bounds);
message!(Beat, 256);
message!(Report, 512 << 10, |its: &Report| {
    few(its.instances.len(), its.links.len()).and_then(|()| its.wifi.check())
});
message!(MachineReading, 256 << 10, |its: &MachineReading| {
    few(0, its.links.len()).and_then(|()| check_heard(&its.heard, &its.addresses))
});

pub(crate) fn decode<M: Message>(bytes: &[u8]) -> Result<M, MessageError> {
    if bytes.len() > M::LONGEST {
        return Err(MessageError::TooLong { bytes: bytes.len(), most: M::LONGEST });
    }
    let message: M = serde_json::from_slice(bytes)?;
    message.check()?;
    Ok(message)
}

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
