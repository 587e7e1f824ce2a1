//! The seam between the middleware and whatever moves: simulated here, real robots behind ROS elsewhere.

use std::time::Duration;

use cotorra_graph::{
    NodeId, Pose, RobotFault, RobotModel, Sensor, SensorData, SensorKind, Timestamp, Velocity,
};

use crate::{kobuki, large::Captured, lidar::Scan, quadrotor};

/// The part of a velocity that a robot of that model and speed limit, m/s, does, on the same curve.
pub(crate) fn limited(model: RobotModel, wanted: Velocity, speed_limit: f64) -> Velocity {
    match model {
        RobotModel::Turtlebot2 => kobuki::limited(wanted, speed_limit),
        RobotModel::Quadrotor => quadrotor::limited(wanted, speed_limit),
    }
}

/// Returns the part of a velocity that a speed limit, m/s, allows, on the same curve. A limit of 0 also stops turns.
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

/// Why a robot does not follow a command.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum CommandError {
    /// A velocity is NaN or infinite.
    #[error("a velocity of {} m/s, {} m/s upward and {} rad/s is no finite number", .0.linear, .0.vertical, .0.angular)]
    NotFinite(Velocity),
    /// Something is wrong with the robot, so that it had better stand still.
    #[error("it stands still until it is well again: {0}")]
    Unwell(RobotFault),
}

/// A robot that can be driven.
///
/// Calls come with a time that never falls. None of them blocks: a driver of a real robot keeps its own connection,
/// and answers with what it last heard. A robot that gets no command for [`Self::command_timeout`] stops by itself,
/// so that a broken driver or a lost one leaves no robot running.
pub trait RobotDriver: Send {
    /// Which robot.
    fn robot(&self) -> &NodeId;

    /// How long the robot follows a command before it stops.
    fn command_timeout(&self) -> Duration;

    /// Time has come to `now`: does what was due until then.
    fn advance(&mut self, now: Timestamp);

    /// Moves at that velocity until another command or the command timeout. Returns what the robot does of it: what
    /// is over its limits is scaled down, on the same curve.
    ///
    /// # Errors
    /// [`CommandError`]; the command counts as not given, and the one before goes on.
    fn command(&mut self, now: Timestamp, velocity: Velocity) -> Result<Velocity, CommandError>;

    /// Stops as fast as the robot can.
    fn stop(&mut self, now: Timestamp);

    /// Limits the speed, m/s, at which others than the testbed drive the robot: programs that it is offered to over ROS. 0
    /// lets it stand still for them. Nothing, where the testbed alone drives it, or cannot stop others.
    fn limit_others(&mut self, _limit: Option<f64>) {}

    /// σ as of the last advance or command.
    fn sensors(&self) -> SensorData;

    /// The last complete turn of its lidar; `None` before the first, and without one.
    fn scan(&self) -> Option<&Scan>;

    /// Reads one of its sensors of numbers at `now`, as of the last advance or command: when that was measured, and all components,
    /// NaN if they are not known. `None` if it has none such, or nothing new. Each call draws the errors of one reading.
    fn sense(&mut self, _now: Timestamp, _sensor: &Sensor) -> Option<(Timestamp, Vec<f64>)> {
        None
    }

    /// Reads one of its sensors of large data, as of the last advance or command; `None` if it has none such,
    /// or nothing but what was measured at `read`, which the sensor told last.
    fn capture(&mut self, sensor: &Sensor, read: Option<Timestamp>) -> Option<Captured> {
        let is_lidar = matches!(sensor.kind, SensorKind::Lidar { .. });
        self.scan().filter(|scan| is_lidar && read != Some(scan.at)).map(Captured::from)
    }

    /// What users are to be told about its sensors, each once.
    fn poll_notice(&mut self) -> Option<String> {
        None
    }

    /// Where it really is, as of the last advance or command; `None` where nobody knows. For the radio, which goes by where
    /// things are, and for reports: nobody who decides is told.
    fn truth(&self) -> Option<Pose> {
        None
    }

    /// What is wrong with it as of the last advance or command, in order and each once. While there is anything, the
    /// robot stands still and refuses commands.
    fn health(&self) -> &[RobotFault] {
        &[]
    }
}
