//! Events of a run, each reported once. The terminal, the recorder, the API's stream and the report read events and
//! nothing else. Plug-ins receive them as their contexts, and answer with instructions.

use std::time::Duration;

use serde::{Deserialize, Deserializer, Serialize, Serializer, de};

use crate::{
    access::AccessPoint,
    active::ThroughputTest,
    conditions::ConditionChange,
    context::{
        AnswersRejected, Handover, Lateness, LinkContext, Placement, RadioContext, RobotContext, ServiceTime,
        Velocity, VirtualLinkMapping,
    },
    goal::GoalEvent,
    hardware::Direction,
    id::{LinkId, NodeId, PluginId, SensorId, VnfId},
    machine_context::MachineContext,
    nodes::Nodes,
    sensor::SensorReading,
    service::Vnf,
    units::{Position, Timestamp, millis},
};

/// An event and when it happened.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Stamped {
    /// Nanoseconds since the run began.
    #[serde(rename = "at_ns")]
    pub at: Timestamp,
    /// The event.
    #[serde(flatten)]
    pub event: Event,
}

/// Anything that happens in a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case", tag = "event")]
pub enum Event {
    /// κ(r), periodically.
    Robot(RobotContext),
    /// ι(R), periodically.
    Radio(RadioContext),
    /// d, λ and conditions of a link, periodically and at every change.
    Link(LinkContext),
    /// A VNF runs on another node now, or on others; a(n) changed.
    Placement(Placement),
    /// One direction of a virtual link is carried by other links now; a(n1,n2) changed.
    VirtualLink(VirtualLinkMapping),
    /// A service time was measured.
    ServiceTime(ServiceTime),
    /// A robot rejected answers since it was told last; once a second at most.
    AnswersRejected(AnswersRejected),
    /// A robot changed its radio unit.
    Handover(Handover),
    /// A robot has no radio unit any more.
    Detached {
        /// The robot.
        robot: NodeId,
        /// The radio unit that it lost.
        from: NodeId,
    },
    /// A robot finished a scan: its attachments' signals are fresh.
    Scanned {
        /// The robot.
        robot: NodeId,
    },
    /// A robot answered its radio unit's suggestion to move to another one ([`Instruction::Suggest`]).
    SuggestionAnswered {
        /// The robot.
        robot: NodeId,
        /// The radio unit that was suggested.
        radio_unit: NodeId,
        /// Status of the BSS transition (IEEE 802.11-2020, table 9-428): 0 if the robot moves there; otherwise it stays, e.g. 7
        /// if it hears the radio unit too weakly.
        status: u8,
    },
    /// A VNF's process began, ended or was begun again.
    Vnf(VnfEvent),
    /// A plug-in gave an instruction.
    Decision(Decision),
    /// A plug-in was cut off.
    PluginFault {
        /// The plug-in.
        plugin: PluginId,
        /// Reason why it was cut off.
        reason: String,
    },
    /// The emulator's lateness since the run began, periodically.
    Lateness(Lateness),
    /// The state of a robot's goal changed.
    Goal(GoalEvent),
    /// A robot reached the end of its walk.
    WalkFinished {
        /// The robot.
        robot: NodeId,
    },
    /// A sensor that a robot declares was read, at its rate.
    Sensor(SensorReading),
    /// CPU, memory and interfaces of a node's machine, periodically.
    Machine(MachineContext),
    /// A message for the user that no other event carries.
    Notice {
        /// The message.
        message: String,
    },
}

/// Change of a VNF's process.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct VnfEvent {
    /// The VNF.
    pub vnf: VnfId,
    /// Its node.
    pub node: NodeId,
    /// Its new state.
    pub state: VnfState,
    /// Exit status or error, for people.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub detail: Option<String>,
}

/// State of a VNF's process.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum VnfState {
    /// The process runs.
    Started,
    /// The process ended by itself, and will be started again.
    Died,
    /// The process was stopped.
    Stopped,
    /// The process cannot be started.
    Failed,
}

/// An instruction of a plug-in, its reason and its outcome.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Decision {
    /// The plug-in.
    pub plugin: PluginId,
    /// The instruction.
    pub instruction: Instruction,
    /// The plug-in's reason.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
    /// Reason for its rejection; `None` if it was applied.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub refused: Option<String>,
}

/// Instruction that a plug-in can give. Its texts and lists are bounded, each and all together.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(remote = "Self", rename_all = "snake_case", tag = "instruction", deny_unknown_fields)]
pub enum Instruction {
    /// Move a robot at this velocity, until another comes or its command timeout ends it.
    Move {
        /// The robot.
        robot: NodeId,
        /// The velocity.
        velocity: Velocity,
        /// The next waypoint of its walk, for whoever navigates it next.
        waypoint: u32,
    },
    /// Limit a robot's speed, whoever moves it. From its next velocity on, faster ones are slowed along the same curve.
    LimitSpeed {
        /// The robot.
        robot: NodeId,
        /// The limit, m/s; 0 stops the robot at once, null removes the limit.
        speed_limit_mps: Option<f64>,
    },
    /// Send a robot from its walk to a goal, where it stops. [`Event::Goal`] reports its progress.
    NavigateTo {
        /// The robot.
        robot: NodeId,
        /// The goal, which replaces an earlier one; null sends the robot back to its walk.
        goal: Option<Position>,
    },
    /// Report the values of a sensor of kind `vector`. The sensor's next reading has those of the last report.
    Report {
        /// The robot.
        robot: NodeId,
        /// Its sensor.
        sensor: SensorId,
        /// As many finite numbers as the sensor has components.
        values: Vec<f64>,
    },
    /// Scan all channels with a robot's radio, which leaves its own meanwhile.
    Scan {
        /// The robot.
        robot: NodeId,
    },
    /// Attach a robot to a radio unit: φ(r,R) = 1. Does nothing where it is attached already.
    Attach {
        /// The robot.
        robot: NodeId,
        /// The radio unit.
        radio_unit: NodeId,
    },
    /// Let a robot's radio unit suggest that it moves to another radio unit (802.11v), which the robot decides.
    /// [`Event::SuggestionAnswered`] reports its answer. Does nothing where it is attached there already.
    Suggest {
        /// The robot.
        robot: NodeId,
        /// The other radio unit.
        radio_unit: NodeId,
    },
    /// Run a VNF on a node, or an instance of it on each of several. New instances start first, then packets go to them, then
    /// old instances stop. Instances that run there already stay.
    Place {
        /// The VNF.
        vnf: VnfId,
        /// The node, or one for each instance.
        node: Nodes,
    },
    /// Add a VNF that belongs to no service, and start its instances. It is a command or an image with the rights of a
    /// confined command, and ends with the run.
    AddVnf {
        /// The VNF. Its name is new in the testbed.
        vnf: Box<Vnf>,
    },
    /// Remove a VNF that was added. Its instances stop once packets in flight to them have arrived.
    RemoveVnf {
        /// The VNF.
        vnf: VnfId,
    },
    /// Map the virtual links between two nodes, a(n1,n2). Packets from one node to the other take this path, and the rate of
    /// these virtual links is reserved on it in that direction. The mapping stays, whatever runs on the nodes.
    Map {
        /// The node at which the path begins.
        from: NodeId,
        /// The node at which it ends.
        to: NodeId,
        /// The path's links, in order; an empty list removes the mapping.
        links: Vec<LinkId>,
    },
    /// Change the conditions of a link.
    Condition {
        /// The link.
        link: LinkId,
        /// One direction, or both.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        direction: Option<Direction>,
        /// The change.
        change: ConditionChange,
    },
    /// Deploy the VNF `vAP` on a radio unit that is off, a(R) = {vAP}. [`Event::Vnf`] reports when it serves.
    Deploy {
        /// The radio unit.
        radio_unit: NodeId,
        /// Settings of the access point.
        access_point: AccessPoint,
    },
    /// Remove the VNF `vAP` from a radio unit, a(R) = {}. The radio unit is off, and its stations lose it.
    Remove {
        /// The radio unit.
        radio_unit: NodeId,
    },
    /// Give a robot the settings and the key with which it attaches to a radio unit of another domain. Without a key, take
    /// them back.
    Provision {
        /// The robot.
        robot: NodeId,
        /// The radio unit.
        radio_unit: NodeId,
        /// Settings with which it was deployed.
        access_point: AccessPoint,
    },
    /// Stop a robot until [`Instruction::Go`], whatever its navigation answers.
    Halt {
        /// The robot.
        robot: NodeId,
    },
    /// Let a halted robot follow its navigation again.
    Go {
        /// The robot.
        robot: NodeId,
    },
    /// Record a step of a process that the plug-in conducts. Changes nothing else.
    Note {
        /// Name of the process that the note is about, of at most 128 characters.
        process: String,
        /// The step: a name of at most 128 characters.
        step: String,
        /// Time since the step was reached, where that was earlier: a run that goes on after another repeats the
        /// other's notes.
        #[serde(
            rename = "ago_ms",
            default,
            skip_serializing_if = "Option::is_none",
            with = "millis::option"
        )]
        #[schema(value_type = Option<f64>)]
        ago: Option<Duration>,
    },
    /// Test the throughput of one direction of a wired link. The link's context has the result when the test is over.
    TestThroughput {
        /// The link.
        link: LinkId,
        /// The direction.
        direction: Direction,
        /// Its duration and rate.
        test: ThroughputTest,
    },
}

impl Serialize for Instruction {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        Self::serialize(self, serializer)
    }
}

impl<'de> Deserialize<'de> for Instruction {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let read = Self::deserialize(deserializer)?;
        read.measure().map_err(de::Error::custom)?;
        Ok(read)
    }
}

impl Instruction {
    /// Returns the name in JSON.
    pub const fn name(&self) -> &'static str {
        match self {
            Self::Move { .. } => "move",
            Self::LimitSpeed { .. } => "limit_speed",
            Self::NavigateTo { .. } => "navigate_to",
            Self::Report { .. } => "report",
            Self::Scan { .. } => "scan",
            Self::Attach { .. } => "attach",
            Self::Suggest { .. } => "suggest",
            Self::Place { .. } => "place",
            Self::AddVnf { .. } => "add_vnf",
            Self::RemoveVnf { .. } => "remove_vnf",
            Self::Map { .. } => "map",
            Self::Condition { .. } => "condition",
            Self::Deploy { .. } => "deploy",
            Self::Remove { .. } => "remove",
            Self::Provision { .. } => "provision",
            Self::Halt { .. } => "halt",
            Self::Go { .. } => "go",
            Self::Note { .. } => "note",
            Self::TestThroughput { .. } => "test_throughput",
        }
    }

    /// The same without secrets, as all may know it.
    #[must_use]
    pub fn public(&self) -> Self {
        match self.clone() {
            Self::Deploy { radio_unit, access_point } => {
                Self::Deploy { radio_unit, access_point: access_point.public() }
            }
            Self::Provision { robot, radio_unit, access_point } => {
                Self::Provision { robot, radio_unit, access_point: access_point.public() }
            }
            other => other,
        }
    }
}
