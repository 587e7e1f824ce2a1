//! A whole TurtleBot 2: its base and its lidar as one robot.

use std::f64::consts::TAU;

use cotorra_graph::{Kobuki, RobotFault, Timestamp, Velocity};
use serde::{Deserialize, Serialize};

use crate::{
    device::{Clock, Device, SILENCE},
    kobuki::{Base, Basic, Odometry, Version},
    port::{PortError, PortSettings},
    rplidar::{Health, Lidar, LidarSettings, Turn},
};

/// Speed of a Kobuki's port, bits per second.
const KOBUKI_BAUD: u32 = 115_200;

/// Longest way of a robot, metres.
const FARTHEST: f64 = 1e7;
/// Bound of speeds, m/s and rad/s: beyond those that the base's clock of milliseconds makes of one jump of its encoders.
const FASTEST: f64 = 1e5;

/// Reports of a robot's base and lidar, but for the lidar's turns.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Readings {
    /// Odometry since its first feedback.
    pub odometry: Odometry,
    /// The last basic sensor data with its time.
    pub basic: Option<(Timestamp, Basic)>,
    /// The last angular velocity about the robot's axes, rad/s, with its time.
    pub angular_velocity: Option<(Timestamp, [f64; 3])>,
    /// Version of the base's firmware, once it has answered.
    pub firmware: Option<Version>,
    /// The lidar's own judgement of its health, once it has answered.
    pub lidar_health: Option<Health>,
    /// Number of the base's frames that were torn or corrupt.
    pub rejected_frames: u64,
    /// Number of the lidar's answers that were torn or corrupt.
    pub rejected_answers: u64,
    /// Faults of both, in order and each once.
    pub faults: Vec<RobotFault>,
}

impl Readings {
    /// Whether a robot can say so. Everything that a robot of this crate says is.
    pub fn are_possible(&self) -> bool {
        let within = |value: f64, most: f64| value.abs() <= most;
        let Odometry { position: (x, y), heading, velocity, way, .. } = &self.odometry;
        within(*x, FARTHEST)
            && within(*y, FARTHEST)
            && within(*heading, TAU)
            && within(velocity.linear, FASTEST)
            && velocity.vertical == 0.0
            && within(velocity.angular, FASTEST)
            && (0.0..=FARTHEST).contains(way)
            && self.angular_velocity.is_none_or(|(_, turns)| turns.iter().all(|turn| within(*turn, FASTEST)))
            && self.faults.len() <= RobotFault::ALL.len()
    }
}

impl Default for Readings {
    /// Those of a robot that was never heard.
    fn default() -> Self {
        Self {
            odometry: Odometry::default(),
            basic: None,
            angular_velocity: None,
            firmware: None,
            lidar_health: None,
            rejected_frames: 0,
            rejected_answers: 0,
            faults: vec![RobotFault::Absent],
        }
    }
}

/// A TurtleBot 2 to drive: at ports of this machine, or at another machine.
///
/// The time in calls never falls, and no call blocks. A robot stops 600 ms after the last command, and at a fault.
pub trait Body: Send {
    /// Returns what the robot says by `now`.
    fn read(&mut self, now: Timestamp) -> Readings;

    /// Returns the lidar's last complete turn if it is not the one that began at `known`.
    fn turn(&self, known: Option<Timestamp>) -> Option<Turn>;

    /// Moves at this velocity until another one or the command timeout.
    ///
    /// # Errors
    /// The first fault. The robot stands still then.
    fn drive(&mut self, now: Timestamp, velocity: Velocity) -> Result<(), RobotFault>;

    /// Stops the robot.
    fn stop(&mut self, now: Timestamp);
}

/// A TurtleBot 2 at ports of this machine. When it is dropped, its devices are left at rest.
pub struct Turtlebot {
    base: Device<Base>,
    lidar: Option<Device<Lidar>>,
    is_well: bool,
}

impl Turtlebot {
    /// Opens the ports of a robot of this name.
    ///
    /// # Errors
    /// [`PortError`] if one of them cannot be used.
    pub fn open(name: &str, kobuki: &Kobuki, clock: &Clock) -> Result<Self, PortError> {
        let port = PortSettings { path: kobuki.port.clone(), baud: KOBUKI_BAUD };
        let base = Device::open(&format!("base-{name}"), port, Base::default(), Clock::clone(clock))?;
        let Some(its) = &kobuki.lidar else { return Ok(Self::on(base, None)) };
        let port = PortSettings { path: its.port.clone(), baud: its.baud };
        let lidar = Lidar::new(LidarSettings { motor_pwm: its.motor_pwm });
        let lidar = Device::open(&format!("lidar-{name}"), port, lidar, Clock::clone(clock))?;
        Ok(Self::on(base, Some(lidar)))
    }

    /// Joins a base and a lidar.
    pub fn on(base: Device<Base>, lidar: Option<Device<Lidar>>) -> Self {
        Self { base, lidar, is_well: false }
    }

    /// Moves at a velocity that was given at an earlier time, from which on the command timeout counts. One that is too old
    /// changes nothing.
    ///
    /// # Errors
    /// The first fault. The robot stands still then.
    pub fn follow(&mut self, now: Timestamp, given: Timestamp, velocity: Velocity) -> Result<(), RobotFault> {
        if let Some(fault) = self.read(now).faults.first() {
            return Err(*fault);
        }
        self.base.with(now, |base, now| base.follow(now, given, velocity))
    }
}

impl Body for Turtlebot {
    fn read(&mut self, now: Timestamp) -> Readings {
        let mut readings = self.base.with(now, |base, now| {
            base.advance(now);
            Readings {
                odometry: base.odometry().clone(),
                basic: base.basic(),
                angular_velocity: base.angular_velocity(),
                firmware: base.firmware(),
                rejected_frames: base.rejected(),
                faults: base.faults().to_vec(),
                ..Readings::default()
            }
        });
        if let Some(lidar) = &self.lidar {
            let fault = lidar.with(now, |lidar, now| {
                readings.lidar_health = lidar.health();
                readings.rejected_answers = lidar.rejected();
                match lidar.heard() {
                    None => Some(RobotFault::Absent),
                    Some(heard) => (now.since(heard) >= SILENCE).then_some(RobotFault::Silent),
                }
            });
            if let Some(fault) = fault.filter(|fault| !readings.faults.contains(fault)) {
                readings.faults.push(fault);
                readings.faults.sort_unstable();
            }
        }
        // The base does not know of the lidar's faults.
        if std::mem::replace(&mut self.is_well, readings.faults.is_empty()) && !self.is_well {
            self.stop(now);
        }
        readings
    }

    fn turn(&self, known: Option<Timestamp>) -> Option<Turn> {
        // It was read with the rest.
        self.lidar.as_ref()?.peek(|lidar| lidar.turn().filter(|turn| known != Some(turn.at)).cloned())
    }

    fn drive(&mut self, now: Timestamp, velocity: Velocity) -> Result<(), RobotFault> {
        self.follow(now, now, velocity)
    }

    fn stop(&mut self, now: Timestamp) {
        self.base.with(now, |base, now| base.stop(now));
    }
}
