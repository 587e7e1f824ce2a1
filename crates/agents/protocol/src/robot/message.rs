//! Messages about a robot.

use std::{fmt, time::Duration};

use cotorra_graph::{Kobuki, NodeId, Timestamp, Velocity};
use cotorra_turtlebot::{
    Readings,
    rplidar::{Sample, Turn},
};
use serde::{Deserialize, Serialize};

use crate::{
    encoding::{Message, MessageError, decode, message},
    run::Run,
};

/// A robot that the agent shall drive.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WantedRobot {
    pub node: NodeId,
    /// Its ports on the agent's machine.
    pub kobuki: Kobuki,
}

/// State of a wanted robot.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RobotState {
    /// Its ports are open.
    Driven,
    /// They cannot be opened, with the reason. The agent tries again.
    Failed(String),
}

/// The time in which an agent has the ports of a robot open. Odometry begins with it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RobotSession {
    pub run: Run,
    /// The agent's process, as in its reports.
    pub boot: u64,
    /// Number of times that this process opened the ports.
    pub opening: u64,
}

/// Readings of a robot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RobotReading {
    pub session: RobotSession,
    /// Time of sending on the agent's clock, nanoseconds. It grows with each reading.
    pub sent_ns: u64,
    /// The readings, with times on the agent's clock.
    pub readings: Readings,
}

/// Message of the core to a robot's agent.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RobotCommand {
    pub session: RobotSession,
    /// Grows with each command of the run.
    pub sequence: u64,
    /// Time of sending of the newest reading that arrived, on the agent's clock, nanoseconds.
    pub heard_ns: u64,
    /// The robot's new orders, if there are any.
    pub motion: Option<Motion>,
}

/// Orders of a robot.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Motion {
    Drive {
        velocity: Velocity,
        /// Time of sending of the newest reading that the core had when it gave this velocity, on the agent's clock,
        /// nanoseconds.
        given_ns: u64,
    },
    Stop,
}

/// A turn of a robot's lidar.
#[derive(Debug, Clone, PartialEq)]
pub struct RobotTurn {
    pub session: RobotSession,
    /// Time of sending on the agent's clock, nanoseconds.
    pub sent_ns: u64,
    /// The turn, with times on the agent's clock.
    pub turn: Turn,
}

message!(RobotReading, 4096, |its: &RobotReading| {
    if its.readings.are_possible() { Ok(()) } else { Err(MessageError::Impossible) }
});
message!(RobotCommand, 1024);

impl RobotTurn {
    /// Numbers before the samples: run, boot, opening, time of sending, time of the turn, and its duration in nanoseconds.
    const NUMBERS: usize = 6;
    /// Angle and range of a sample, 32 bits each. A range that was not measured is NaN.
    const SAMPLE: usize = 8;
    /// Longest encoding, bytes: of the most samples that a lidar's turn can have.
    const LONGEST: usize = 8 * Self::NUMBERS + Self::SAMPLE * Turn::MOST_SAMPLES;

    /// Encodes it, all numbers in little-endian order.
    pub fn encode(&self) -> Vec<u8> {
        let Self { session: RobotSession { run, boot, opening }, sent_ns, turn } = self;
        let period = u64::try_from(turn.period.as_nanos()).unwrap_or(u64::MAX);
        let numbers = [run.0, *boot, *opening, *sent_ns, turn.at.as_nanos(), period];
        let mut bytes: Vec<u8> = numbers.into_iter().flat_map(u64::to_le_bytes).collect();
        for sample in &turn.samples {
            bytes.extend((sample.angle as f32).to_le_bytes());
            bytes.extend(sample.range.unwrap_or(f32::NAN).to_le_bytes());
        }
        bytes
    }

    /// Decodes a received message.
    ///
    /// # Errors
    /// The reason, for people.
    pub fn decode(bytes: &[u8]) -> Result<Self, TurnError> {
        let (numbers, samples) = bytes.split_at_checked(8 * Self::NUMBERS).ok_or(TurnError)?;
        if bytes.len() > Self::LONGEST || !samples.len().is_multiple_of(Self::SAMPLE) {
            return Err(TurnError);
        }
        let number = |place: usize| {
            let bytes = numbers[8 * place..][..8].try_into();
            u64::from_le_bytes(bytes.expect("a number has 8 bytes"))
        };
        let float =
            |bytes: &[u8]| f32::from_le_bytes(bytes.try_into().expect("half of a sample has 4 bytes"));
        let sample = |bytes: &[u8]| {
            let (angle, range) = bytes.split_at(Self::SAMPLE / 2);
            let (angle, range) = (float(angle), float(range));
            let is_valid =
                (0.0..=std::f32::consts::TAU).contains(&angle) && !(range <= 0.0 || range.is_infinite());
            let sample = Sample { angle: angle.into(), range: (!range.is_nan()).then_some(range) };
            is_valid.then_some(sample).ok_or(TurnError)
        };
        let period = Duration::from_nanos(number(5));
        if period > Turn::LONGEST_PERIOD {
            return Err(TurnError);
        }
        Ok(Self {
            session: RobotSession { run: Run(number(0)), boot: number(1), opening: number(2) },
            sent_ns: number(3),
            turn: Turn {
                at: Timestamp::from_nanos(number(4)),
                period,
                samples: samples.chunks_exact(Self::SAMPLE).map(sample).collect::<Result<_, _>>()?,
            },
        })
    }
}

/// A message is no turn of a lidar.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TurnError;

impl fmt::Display for TurnError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("what no turn of a lidar can be")
    }
}
