//! The interface between the middleware and a robot that moves: simulated, in ROS, or at serial ports.

use std::time::Duration;

use cotorra_graph::{
    NodeId, Pose, RobotFault, RobotModel, Sensor, SensorData, SensorKind, Timestamp, Velocity,
};

use crate::{kobuki, large::Captured, lidar::Scan, quadrotor};

/// Scales a velocity down to the limits of the robot's model and the speed limit, m/s, on the same curve.
pub(crate) fn limited(model: RobotModel, wanted: Velocity, speed_limit: f64) -> Velocity {
    match model {
        RobotModel::Turtlebot2 => kobuki::limited(wanted, speed_limit),
        RobotModel::Quadrotor => quadrotor::limited(wanted, speed_limit),
    }
}

/// Scales a velocity down to a speed limit, m/s, on the same curve. A limit of 0 also stops turns.
pub(crate) fn slowed(wanted: Velocity, limit: f64) -> Velocity {
    let speed = wanted.linear.hypot(wanted.vertical);
    if speed > limit {
        wanted.scaled(limit / speed)
    } else if limit == 0.0 && wanted.is_finite() {
        Velocity::default()
    } else {
        wanted
    }
}

/// The reason for which a robot rejects a command.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum CommandError {
    /// A velocity is NaN or infinite.
    #[error("a velocity of {} m/s, {} m/s upward and {} rad/s is no finite number", .0.linear, .0.vertical, .0.angular)]
    NotFinite(Velocity),
    /// The robot has a fault and stands still.
    #[error("it stands still until it is well again: {0}")]
    Unwell(RobotFault),
    /// The robot stands for one of another core.
    #[error("it stands for a robot of another core, which alone moves it")]
    Visitor,
}

/// A robot that can be driven.
///
/// The time in calls never falls. No call blocks: the driver of a real robot keeps its own connection and returns the last
/// data received. A robot without a command for [`Self::command_timeout`] stops by itself, so that a broken or lost driver
/// leaves no robot running.
pub trait RobotDriver: Send {
    /// Returns the robot's name.
    fn robot(&self) -> &NodeId;

    /// Returns the time for which the robot follows a command before it stops.
    fn command_timeout(&self) -> Duration;

    /// Advances the robot to `now`.
    fn advance(&mut self, now: Timestamp);

    /// Moves at this velocity until another command or the command timeout. Returns the velocity within the robot's limits,
    /// scaled down on the same curve.
    ///
    /// # Errors
    /// [`CommandError`]; the command before goes on.
    fn command(&mut self, now: Timestamp, velocity: Velocity) -> Result<Velocity, CommandError>;

    /// Stops as fast as the robot can.
    fn stop(&mut self, now: Timestamp);

    /// Limits the speed, m/s, at which programs other than the testbed drive the robot over ROS; 0 stops it for them. Has
    /// no effect where the testbed alone drives the robot, or cannot stop others.
    fn limit_others(&mut self, _limit: Option<f64>) {}

    /// Returns σ as of the last advance or command.
    fn sensors(&self) -> SensorData;

    /// Returns the last complete turn of the lidar; `None` before the first and without a lidar.
    fn scan(&self) -> Option<&Scan>;

    /// Reads a sensor of numbers as of the last advance or command. Returns the time of measurement and all components, NaN
    /// where unknown; `None` without such a sensor or a new reading. Each call draws the errors of one reading.
    fn sense(&mut self, _now: Timestamp, _sensor: &Sensor) -> Option<(Timestamp, Vec<f64>)> {
        None
    }

    /// Reads a sensor of large data as of the last advance or command; `None` without such a sensor, or without data newer
    /// than that measured at `read`.
    fn capture(&mut self, sensor: &Sensor, read: Option<Timestamp>) -> Option<Captured> {
        let is_lidar = matches!(sensor.kind, SensorKind::Lidar { .. });
        self.scan().filter(|scan| is_lidar && read != Some(scan.at)).map(Captured::from)
    }

    /// Returns the next notice to users about its sensors.
    fn poll_notice(&mut self) -> Option<String> {
        None
    }

    /// Returns the true pose as of the last advance or command; `None` where it is unknown. It is for the radio model and
    /// for reports only; nothing that makes decisions may see it.
    fn truth(&self) -> Option<Pose> {
        None
    }

    /// Returns the faults as of the last advance or command, in order and each once. With any fault, the robot stands still
    /// and rejects commands.
    fn health(&self) -> &[RobotFault] {
        &[]
    }
}
