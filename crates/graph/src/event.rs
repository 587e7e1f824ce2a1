//! What happens in a testbed, told once. The terminal, the recorder, the API's stream and the report read these
//! events and nothing else; plug-ins receive them as their contexts, and answer with instructions.

use std::time::Duration;

use serde::{Deserialize, Serialize};

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
    nodes::Nodes,
    sensor::SensorReading,
    units::{Position, Timestamp, millis},
};

/// An event and when it happened.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Stamped {
    /// Nanoseconds since the run began.
    #[serde(rename = "at_ns")]
    pub at: Timestamp,
    /// What happened.
    #[serde(flatten)]
    pub event: Event,
}

/// What can happen.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
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
    /// A VNF's process began, ended or was begun again.
    Vnf(VnfEvent),
    /// A plug-in asked for something.
    Decision(Decision),
    /// A plug-in was cut off.
    PluginFault {
        /// Which.
        plugin: PluginId,
        /// What it did.
        reason: String,
    },
    /// The emulator's lateness since the run began, periodically.
    Lateness(Lateness),
    /// Something became of a goal that a robot was given.
    Goal(GoalEvent),
    /// A robot reached the end of its walk.
    WalkFinished {
        /// The robot.
        robot: NodeId,
    },
    /// A sensor that a robot declares was read, at its rate.
    Sensor(SensorReading),
    /// Something that a user should know, and that nothing else tells.
    Notice {
        /// What.
        message: String,
    },
}

/// What became of a VNF's process.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct VnfEvent {
    /// The VNF.
    pub vnf: VnfId,
    /// Its node.
    pub node: NodeId,
    /// What became of it.
    pub state: VnfState,
    /// Exit status or error, for people.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub detail: Option<String>,
}

/// The life of a VNF's process.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum VnfState {
    /// It runs.
    Started,
    /// It ended by itself and will be started again.
    Died,
    /// It was stopped.
    Stopped,
    /// It cannot be started.
    Failed,
}

/// What a plug-in asked for, why, and what came of it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Decision {
    /// Which plug-in.
    pub plugin: PluginId,
    /// What it asked for.
    pub instruction: Instruction,
    /// Why, in its words.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
    /// Why it was refused; `None` if it was done.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub refused: Option<String>,
}

/// What a plug-in can ask for.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case", tag = "instruction", deny_unknown_fields)]
pub enum Instruction {
    /// Move a robot at this velocity, until another comes or its command timeout ends it.
    Move {
        /// The robot.
        robot: NodeId,
        /// How.
        velocity: Velocity,
        /// The next waypoint of its walk, for whoever navigates it next.
        waypoint: u32,
    },
    /// Limit a robot's speed, whoever moves it: what is faster is slowed on the same curve, from its next velocity on.
    LimitSpeed {
        /// The robot.
        robot: NodeId,
        /// The limit, m/s; with 0 it stands at once, and null takes the limit back.
        speed_limit_mps: Option<f64>,
    },
    /// Let a robot leave its walk for a goal, and stand there; [`Event::Goal`] tells what becomes of that.
    NavigateTo {
        /// The robot.
        robot: NodeId,
        /// The goal, which takes the place of the one before; null lets the robot go on with its walk.
        goal: Option<Position>,
    },
    /// Report what a sensor of kind `vector` measures. The sensor's next reading tells it, the last report of several.
    Report {
        /// The robot.
        robot: NodeId,
        /// Its sensor.
        sensor: SensorId,
        /// As many finite numbers as the sensor has components.
        values: Vec<f64>,
    },
    /// Let a robot's radio leave its channel and scan all others.
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
    /// Run a VNF on a node, or an instance of it on each of several: started there first, then packets go over, then old
    /// ones stop. Instances that are there already stay.
    Place {
        /// The VNF.
        vnf: VnfId,
        /// The node, or one for each instance.
        node: Nodes,
    },
    /// Map the virtual links between two nodes, a(n1,n2): packets from one node to the other take this path, and the rate
    /// of these virtual links is reserved on it in that direction. It stays for these nodes, whatever runs on them.
    Map {
        /// The node at which the path begins.
        from: NodeId,
        /// The node at which it ends.
        to: NodeId,
        /// The path's links, in order; none takes the mapping back.
        links: Vec<LinkId>,
    },
    /// Change what a link does.
    Condition {
        /// The link.
        link: LinkId,
        /// One direction, or both.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        direction: Option<Direction>,
        /// The change.
        change: ConditionChange,
    },
    /// Deploy the VNF `vAP` on a radio unit that is off, a(R) = {vAP}: it serves once that is done, which
    /// [`Event::Vnf`] tells.
    Deploy {
        /// The radio unit.
        radio_unit: NodeId,
        /// What it serves.
        access_point: AccessPoint,
    },
    /// Take the VNF `vAP` of a radio unit down, a(R) = {}: it is off, and its stations lose it.
    Remove {
        /// The radio unit.
        radio_unit: NodeId,
    },
    /// Give a robot what it needs to attach to a radio unit of another domain.
    Provision {
        /// The robot.
        robot: NodeId,
        /// The radio unit.
        radio_unit: NodeId,
        /// What that one was deployed with.
        access_point: AccessPoint,
    },
    /// Let a robot stand still, whatever its navigation says, until it is to [`Instruction::Go`].
    Halt {
        /// The robot.
        robot: NodeId,
    },
    /// Let a robot that was halted follow its navigation again.
    Go {
        /// The robot.
        robot: NodeId,
    },
    /// Change nothing, and keep with the decisions that a step was reached of something that the plug-in conducts.
    Note {
        /// Of what: a name of at most 128 characters.
        process: String,
        /// The step: a name of at most 128 characters.
        step: String,
        /// So long before now it was reached, where that is not now: a run that goes on after another keeps so what
        /// that one noted.
        #[serde(
            rename = "ago_ms",
            default,
            skip_serializing_if = "Option::is_none",
            with = "millis::option"
        )]
        #[cfg_attr(feature = "openapi", schema(value_type = Option<f64>))]
        ago: Option<Duration>,
    },
    /// Test what one direction of a wired link carries; what came of it is in the link's context when the test is over.
    TestThroughput {
        /// The link.
        link: LinkId,
        /// The direction.
        direction: Direction,
        /// How long and how fast.
        test: ThroughputTest,
    },
}

impl Instruction {
    /// Its name, as in JSON.
    pub const fn name(&self) -> &'static str {
        match self {
            Self::Move { .. } => "move",
            Self::LimitSpeed { .. } => "limit_speed",
            Self::NavigateTo { .. } => "navigate_to",
            Self::Report { .. } => "report",
            Self::Scan { .. } => "scan",
            Self::Attach { .. } => "attach",
            Self::Place { .. } => "place",
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
