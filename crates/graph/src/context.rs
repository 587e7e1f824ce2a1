//! The embeddings of G: what is known about its nodes and links at a time.

use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::{
    active::{Probed, Tested},
    conditions::{ConditionChange, Conditions, Scale},
    hardware::Direction,
    id::{LinkId, NodeId, ServiceId, VnfId},
    lost_at::LostAt,
    nodes::Nodes,
    time_parts::TimeParts,
    units::{Dbm, Position, Timestamp, is_zero, millis},
};

/// A robot's position and orientation with their covariance; σ_p(r).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Pose {
    /// Metres.
    pub x: f64,
    /// Metres.
    pub y: f64,
    /// Metres above the floor; 0 where it is left out.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub z: f64,
    /// Turn about the axis forward, radians, in (-π, π]; 0 where it is left out.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub roll: f64,
    /// Turn about the axis to the left, radians, in [-π/2, π/2]: positive with the nose down; 0 where it is left out.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub pitch: f64,
    /// Yaw: radians from the x axis, counter-clockwise, in (-π, π].
    pub heading: f64,
    /// Row-major covariance of (x, y, heading); m², m·rad, rad².
    pub covariance: [f64; 9],
    /// Source of the pose.
    pub source: PoseSource,
}

impl Pose {
    /// On the floor, and upright.
    pub const fn planar(x: f64, y: f64, heading: f64, covariance: [f64; 9], source: PoseSource) -> Self {
        Self { x, y, z: 0.0, roll: 0.0, pitch: 0.0, heading, covariance, source }
    }

    /// Returns the position alone.
    pub const fn position(&self) -> Position {
        Position { x: self.x, y: self.y, z: self.z }
    }

    /// Whether position and orientation are finite numbers.
    pub fn is_finite(&self) -> bool {
        [self.x, self.y, self.z, self.roll, self.pitch, self.heading].into_iter().all(f64::is_finite)
    }
}

/// Source of a pose.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum PoseSource {
    /// The simulator knows it exactly.
    Simulator,
    /// Wheel odometry, which drifts.
    Odometry,
    /// Localization from sensors.
    Localization,
}

/// Velocity of a robot: along its heading, upwards, and about the vertical axis.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Velocity {
    /// Forward, m/s.
    pub linear: f64,
    /// Upward, m/s; 0 where it is left out.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub vertical: f64,
    /// Counter-clockwise, rad/s.
    pub angular: f64,
}

impl Velocity {
    /// Returns the velocity of a robot on the floor.
    pub const fn planar(linear: f64, angular: f64) -> Self {
        Self { linear, vertical: 0.0, angular }
    }

    /// Whether all parts are finite numbers.
    pub fn is_finite(self) -> bool {
        [self.linear, self.vertical, self.angular].into_iter().all(f64::is_finite)
    }

    /// The same direction and curve, so many times as fast.
    pub fn scaled(self, factor: f64) -> Self {
        Self {
            linear: self.linear * factor,
            vertical: self.vertical * factor,
            angular: self.angular * factor,
        }
    }
}

/// σ(r): what a robot senses.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct SensorData {
    /// Best estimate of its pose.
    pub pose: Pose,
    /// Pose by wheel odometry alone, from the same start.
    pub odometry: Pose,
    /// Velocity by its wheels.
    pub velocity: Velocity,
    /// Whether it touches something.
    pub bumper: bool,
    /// Nearest thing that its lidar sees, metres; `None` if nothing is in range.
    pub nearest_obstacle_m: Option<f64>,
}

/// φ(r,R) and what the robot knows of that radio unit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Attachment {
    /// R.
    pub radio_unit: NodeId,
    /// φ(r,R) = 1.
    pub attached: bool,
    /// Received signal at the last scan or frame; `None` before the first.
    #[serde(rename = "signal_dbm")]
    pub signal: Option<Dbm>,
    /// Time since the signal was received; `None` without a signal, or if that is unknown.
    #[serde(
        rename = "signal_age_ms",
        default,
        skip_serializing_if = "Option::is_none",
        with = "millis::option"
    )]
    #[schema(value_type = Option<f64>)]
    pub age: Option<Duration>,
}

impl Attachment {
    /// Whether the signal may have been received since the robot's context before: it is that of the own radio unit, or its
    /// age is small or unknown.
    pub fn is_news(&self) -> bool {
        self.attached || self.age.is_none_or(|age| age <= RobotContext::INTERVAL)
    }
}

/// κ(r): (φ(r,R_1)…φ(r,R_N), σ(r)).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct RobotContext {
    /// r.
    pub robot: NodeId,
    /// φ(r,R) for every R that serves its network; at most one is attached.
    pub attachments: Vec<Attachment>,
    /// σ(r).
    pub sensors: SensorData,
    /// The next waypoint of its walk, from 0; equals the walk's length at its end.
    pub waypoint: u32,
    /// Faults, in the order of [`RobotFault`]; empty for a healthy robot. A faulty robot stands still and rejects
    /// instructions to move.
    #[serde(default)]
    pub health: Vec<RobotFault>,
    /// The speed, m/s, that an instruction limits it to; left out where none does.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub speed_limit_mps: Option<f64>,
    /// Distance between the pose that localization believes and the true one, metres; only where a VNF localizes the robot
    /// and the truth is known, as of a simulated robot. For evaluation: no robot knows it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub localization_error_m: Option<f64>,
}

/// Packets that came to a robot as answers and that it did not follow, counted since the run began.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct AnswersRejected {
    /// r.
    pub robot: NodeId,
    /// Answers that came after the robot's command timeout.
    pub late: u64,
    /// Answers with a nonce that the robot did not send, or from another address than that of its request.
    pub forged: u64,
    /// Answers that came again.
    pub repeated: u64,
    /// Answers to a packet that went to several instances, of which another had answered first.
    #[serde(default)]
    pub redundant: u64,
    /// Answers to no packet that the robot remembers.
    pub unknown: u64,
    /// Not packets of the service, or with what cannot be.
    pub invalid: u64,
}

impl AnswersRejected {
    /// None of this robot yet.
    pub const fn none(robot: NodeId) -> Self {
        Self { robot, late: 0, forged: 0, repeated: 0, redundant: 0, unknown: 0, invalid: 0 }
    }
}

/// Fault of a robot. Simulated ones have none.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, utoipa::ToSchema,
)]
#[serde(rename_all = "snake_case")]
pub enum RobotFault {
    /// No message has ever arrived.
    Absent,
    /// Messages have stopped.
    Silent,
    /// Messages hold NaN or infinity in place of a number.
    NotFinite,
    /// Time stamps go back, or far ahead.
    TimeJump,
    /// Messages arrive far too often.
    Flood,
    /// Messages make no sense.
    Malformed,
    /// A cliff is below its edge.
    Cliff,
    /// A wheel hangs in the air.
    WheelDrop,
}

impl RobotFault {
    /// All of them, in order.
    pub const ALL: [Self; 8] = [
        Self::Absent,
        Self::Silent,
        Self::NotFinite,
        Self::TimeJump,
        Self::Flood,
        Self::Malformed,
        Self::Cliff,
        Self::WheelDrop,
    ];

    /// Returns the name in JSON.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Absent => "absent",
            Self::Silent => "silent",
            Self::NotFinite => "not_finite",
            Self::TimeJump => "time_jump",
            Self::Flood => "flood",
            Self::Malformed => "malformed",
            Self::Cliff => "cliff",
            Self::WheelDrop => "wheel_drop",
        }
    }
}

impl std::fmt::Display for RobotFault {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Absent => "it was never heard",
            Self::Silent => "it is silent",
            Self::NotFinite => "it says what is no finite number",
            Self::TimeJump => "its time jumps",
            Self::Flood => "it floods",
            Self::Malformed => "it says what makes no sense",
            Self::Cliff => "a cliff is below its edge",
            Self::WheelDrop => "a wheel hangs in the air",
        })
    }
}

impl RobotContext {
    /// Time from one context of a robot to the next.
    pub const INTERVAL: Duration = Duration::from_millis(100);

    /// The radio unit that it is attached to.
    pub fn attached_to(&self) -> Option<&NodeId> {
        self.attachments.iter().find(|a| a.attached).map(|a| &a.radio_unit)
    }
}

/// ι(R): what a radio unit knows.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct RadioContext {
    /// R.
    pub radio_unit: NodeId,
    /// Channel number.
    pub channel: u8,
    /// Share of the last second in which the channel was busy; `None` if the driver of a real radio does not report it.
    #[serde(default)]
    pub load: Option<f64>,
    /// Its stations.
    pub stations: Vec<StationContext>,
}

/// A radio unit's view of one station.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct StationContext {
    /// The robot.
    pub robot: NodeId,
    /// Signal received from it.
    #[serde(rename = "signal_dbm")]
    pub signal: Dbm,
    /// PHY rate to it, bit/s.
    pub downlink_bps: f64,
    /// PHY rate from it, bit/s.
    pub uplink_bps: f64,
    /// Counters of the radio unit's kernel for it.
    #[serde(flatten)]
    pub counted: StationCounts,
}

/// Retries and airtime of a station since it joined. Each figure is `None` if the driver does not report it, and for radios that no
/// agent drives.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, utoipa::ToSchema)]
pub struct StationCounts {
    /// Retransmissions to it.
    #[serde(default)]
    pub retransmissions: Option<u32>,
    /// Frames to it that were lost after the last retransmission.
    #[serde(default)]
    pub transmissions_failed: Option<u32>,
    /// Airtime of frames sent to it.
    #[serde(rename = "transmit_airtime_ms", default, with = "millis::option")]
    #[schema(value_type = Option<f64>)]
    pub transmit_airtime: Option<Duration>,
    /// Airtime of frames received from it.
    #[serde(rename = "receive_airtime_ms", default, with = "millis::option")]
    #[schema(value_type = Option<f64>)]
    pub receive_airtime: Option<Duration>,
}

/// d, λ and the effective conditions of one direction of a link, with what it did since the run began.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct LinkContext {
    /// The link.
    pub link: LinkId,
    /// The direction.
    pub direction: Direction,
    /// d: mean time that packets took over the last second, queueing included; `None` if none crossed.
    #[serde(rename = "delay_ms", with = "millis::option")]
    #[schema(value_type = Option<f64>)]
    pub delay: Option<Duration>,
    /// λ: what crossed over the last second, bit/s.
    pub throughput_bps: f64,
    /// The most packets that waited in the queue of this direction at a time over the last second; `None` where the queue
    /// cannot be seen.
    #[serde(default)]
    pub queued_packets: Option<u64>,
    /// Results of probes; `None` for a link that is not probed, or not yet.
    #[serde(default)]
    pub probed: Option<Probed>,
    /// Result of the last throughput test; `None` before the first.
    #[serde(default)]
    pub tested: Option<Tested>,
    /// Configured conditions.
    pub asked: Conditions,
    /// ψ and δ.
    pub scale: Scale,
    /// Effective conditions: `asked`, scaled. Where the medium has a delay of its own, the sum of that and `asked`,
    /// scaled.
    pub effective: Conditions,
    /// Packets and bytes so far.
    pub counters: LinkCounters,
}

impl LinkContext {
    /// The change that makes any link do what was asked of this one, scaled as it was.
    pub fn again(&self) -> ConditionChange {
        let asked = self.asked.clone();
        ConditionChange {
            delay_ms: Some(asked.delay.as_secs_f64() * 1e3),
            jitter: Some(asked.jitter.unwrap_or_default()),
            loss: Some(asked.loss),
            duplication: Some(asked.duplication),
            corruption: Some(asked.corruption),
            reordering: Some(asked.reordering),
            rate: Some(asked.rate),
            queue: Some(asked.queue),
            queue_discipline: Some(asked.queue_discipline),
            delay_scale: Some(self.scale.delay_scale),
            drop_scale: Some(self.scale.drop_scale),
        }
    }
}

/// Counters of one direction of a link, in packets as they are on the wire.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, utoipa::ToSchema)]
pub struct LinkCounters {
    /// Packets delivered.
    pub packets: u64,
    /// Bytes delivered.
    pub bytes: u64,
    /// Packets lost by the loss model, or by the radio after its last retry.
    pub lost: u64,
    /// Packets dropped by the queue: because it was full, or by its discipline.
    pub overflowed: u64,
    /// Packets that arrived twice.
    pub duplicated: u64,
    /// Packets with a flipped bit.
    pub corrupted: u64,
}

/// a(n): where a VNF runs. Its instances are known by their nodes.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Placement {
    /// The VNF.
    pub vnf: VnfId,
    /// The node, or those of its instances.
    pub node: Nodes,
}

/// a(n1,n2): the hardware links that carry one direction of a virtual link.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct VirtualLinkMapping {
    /// VNF at which packets start.
    pub from: VnfId,
    /// VNF at which they end.
    pub to: VnfId,
    /// Links of the path, in order.
    pub links: Vec<LinkId>,
    /// Reason for this path.
    #[serde(default)]
    pub path: PathKind,
    /// Paths of the other pairs of instances, where one of the two VNFs has several. The fields above are those of the
    /// first pair.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub others: Vec<InstancePath>,
}

/// The hardware links between two instances.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct InstancePath {
    /// Node of the instance at which packets start.
    pub from: NodeId,
    /// Node of the instance at which they end.
    pub to: NodeId,
    /// Links of the path, in order.
    pub links: Vec<LinkId>,
    /// Reason for this path.
    pub path: PathKind,
}

/// Reason why packets take a path.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum PathKind {
    /// The path of least delay. No other is mapped.
    #[default]
    Shortest,
    /// An instruction mapped it.
    Mapped,
    /// Another is mapped, which cannot be used now; this one has the least delay.
    Fallback,
}

impl PathKind {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Shortest, Self::Mapped, Self::Fallback];

    /// Returns the name in JSON.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Shortest => "shortest",
            Self::Mapped => "mapped",
            Self::Fallback => "fallback",
        }
    }
}

/// One measured service time: from the emission of a robot's position packet to the reception of the navigation
/// packet that answers it, both read on the robot's clock. Of a service that localizes, from a scan to the pose; of one with a
/// `flow`, from a request to its answer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct ServiceTime {
    /// The service.
    pub service: ServiceId,
    /// The robot.
    pub robot: NodeId,
    /// Number of the position packet, scan or request, from 0.
    pub sequence: u32,
    /// Time of emission.
    #[serde(rename = "emitted_ns")]
    pub emitted: Timestamp,
    /// Service time; `None` if no answer came in time: within the robot's command timeout, or 3 s for a scan.
    #[serde(rename = "service_time_ms", with = "millis::option")]
    #[schema(value_type = Option<f64>)]
    pub took: Option<Duration>,
    /// The radio unit that the robot was attached to when it was emitted.
    pub attachment: Option<NodeId>,
    /// The node of the VNF that answered; without an answer, of the one that it was sent to.
    pub server: NodeId,
    /// Parts of the service time; `None` without an answer, or if the fabric did not carry the packets.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<TimeParts>)]
    pub parts: Option<Box<TimeParts>>,
    /// Place at which its packets ended, of one without an answer; `None` if unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<LostAt>)]
    pub lost_at: Option<Box<LostAt>>,
}

/// A finished change of attachment.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Handover {
    /// The robot.
    pub robot: NodeId,
    /// The radio unit before; `None` if it had none.
    pub from: Option<NodeId>,
    /// The radio unit after.
    pub to: NodeId,
    /// Whether fast transition was used.
    pub fast: bool,
    /// Time for which no frame could pass.
    #[serde(rename = "gap_ms", with = "millis")]
    #[schema(value_type = f64)]
    pub gap: Duration,
}

/// Lateness of the emulator: actual against due delivery times.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Lateness {
    /// Frames delivered.
    pub frames: u64,
    /// Median, µs.
    pub p50_us: f64,
    /// 99th percentile, µs.
    pub p99_us: f64,
    /// Worst, µs.
    pub max_us: f64,
}
