//! Driver of a TurtleBot 2: a Kobuki base, and an RPLIDAR A2 if it has one.

use std::{collections::VecDeque, time::Duration};

use cotorra_graph::{
    NodeId, Pose, PoseSource, Position, RobotFault, RobotModel, Sensor, SensorData, SensorKind, Timestamp,
    Velocity, Walk,
};
use cotorra_turtlebot::{
    Body, Readings,
    kobuki::{COMMAND_TIMEOUT, Odometry},
    rplidar::{Health, Turn},
};

use crate::{
    driver::{CommandError, RobotDriver},
    kobuki::{drift, limited},
    lidar::{RANGE_MAX, RANGE_MIN, RAYS, Scan},
    planar::Planar,
};

/// Number of corrupt frames or answers at which users are warned. A few come when the port is opened.
const CORRUPT: u64 = 10;

/// Drives a TurtleBot 2, wherever its ports are.
///
/// Its pose is its odometry, from the start that the testbed file gives: localization is a service. It has a fault until base
/// and lidar were heard.
pub struct TurtlebotDriver {
    id: NodeId,
    speed_limit: f64,
    start: Planar,
    body: Box<dyn Body>,
    /// The pose of its lidar on the robot.
    mount: Option<Planar>,
    /// State as of the last advance or command.
    readings: Readings,
    sensors: SensorData,
    scan: Option<Scan>,
    /// Times of the readings that were taken last: of the battery, and of the gyro.
    taken: [Option<Timestamp>; 2],
    notices: VecDeque<String>,
    told: Told,
}

/// Warnings that users have had.
#[derive(Default)]
struct Told {
    firmware: bool,
    corrupt_base: bool,
    corrupt_lidar: bool,
    health: Option<Health>,
}

impl TurtlebotDriver {
    /// Drives a robot that stands at `start`. The limits of a TurtleBot 2 and of its walk apply.
    pub fn new(id: NodeId, start: Position, heading: f64, walk: Option<&Walk>, body: Box<dyn Body>) -> Self {
        let fastest = RobotModel::Turtlebot2.max_speed();
        let start = Planar { x: start.x, y: start.y, z: start.z, heading };
        let pose = placed(start, &Odometry::default());
        let sensors = SensorData {
            pose,
            odometry: pose,
            velocity: Velocity::default(),
            bumper: false,
            nearest_obstacle_m: None,
        };
        Self {
            id,
            speed_limit: walk.map_or(fastest, |walk| walk.speed_limit.clamp(0.0, fastest)),
            start,
            body,
            mount: None,
            readings: Readings::default(),
            sensors,
            scan: None,
            taken: [None; 2],
            notices: VecDeque::new(),
            told: Told::default(),
        }
    }

    /// Tells where its lidar is: at this position, metres forward and to the left of the robot's middle, and with this heading
    /// of its front on the robot, radians.
    pub fn with_lidar(mut self, position: Position, heading: f64) -> Self {
        self.mount = Some(Planar { x: position.x, y: position.y, z: position.z, heading });
        self
    }

    /// Reads both devices.
    fn look(&mut self, now: Timestamp) {
        self.readings = self.body.read(now);
        let Self { readings, sensors, .. } = self;
        sensors.odometry = placed(self.start, &readings.odometry);
        sensors.pose = sensors.odometry;
        sensors.velocity = readings.odometry.velocity;
        if let Some((_, basic)) = readings.basic {
            sensors.bumper = basic.bumper != 0;
        }
        if let Some(mount) = self.mount
            && let Some(turn) = self.body.turn(self.scan.as_ref().map(|scan| scan.at))
        {
            self.scan = Some(scan(&turn, mount));
        }
        sensors.nearest_obstacle_m = self.scan.as_ref().and_then(Scan::nearest);
        self.tell();
    }

    /// Notes what users should know.
    fn tell(&mut self) {
        let Self { id, readings, told, notices, .. } = self;
        if let Some(version) = readings.firmware
            && !std::mem::replace(&mut told.firmware, true)
        {
            notices.push_back(format!("robot {id}: its Kobuki has firmware {version}"));
        }
        if readings.rejected_frames >= CORRUPT && !std::mem::replace(&mut told.corrupt_base, true) {
            notices.push_back(format!("robot {id}: frames of its base are corrupt; check its cable"));
        }
        if readings.rejected_answers >= CORRUPT && !std::mem::replace(&mut told.corrupt_lidar, true) {
            notices.push_back(format!("robot {id}: answers of its lidar are corrupt; check its cable"));
        }
        let health = readings.lidar_health;
        if let Some(Health::Warning(code) | Health::Error(code)) = health
            && told.health != health
        {
            notices.push_back(format!("robot {id}: its lidar is not well, with code {code:#x}"));
        }
        told.health = health;
    }

    /// Takes a reading unless it was taken before.
    fn take<const N: usize>(
        &mut self,
        what: usize,
        reading: Option<(Timestamp, [f64; N])>,
    ) -> Option<(Timestamp, [f64; N])> {
        let (at, _) = reading?;
        (self.taken[what].replace(at) != Some(at)).then_some(reading?)
    }
}

/// Returns the pose on the map by the odometry since the start.
fn placed(start: Planar, odometry: &Odometry) -> Pose {
    let (x, y) = odometry.position;
    let covariance = drift(odometry.way, odometry.moved.as_secs_f64());
    let pose = Pose { z: 0.0, ..Pose::planar(x, y, odometry.heading, covariance, PoseSource::Odometry) };
    start.place(&pose)
}

/// Returns a turn as seen from the middle of the robot, a ray per degree, in the order in which the lidar measured. A ray
/// has the smallest range of its samples, and NaN if none of them hit anything: the lidar gives no reason.
fn scan(turn: &Turn, mount: Planar) -> Scan {
    let step = std::f64::consts::TAU / RAYS as f64;
    let mut ranges = vec![f32::NAN; RAYS];
    for sample in &turn.samples {
        let Some(measured) = sample.range else { continue };
        let direction = mount.heading - sample.angle;
        let (sin, cos) = direction.sin_cos();
        let (x, y) = (mount.x + f64::from(measured) * cos, mount.y + f64::from(measured) * sin);
        let clockwise = (mount.heading - y.atan2(x)) / step;
        let ray = clockwise.round().rem_euclid(RAYS as f64) as usize % RAYS;
        let range = match f64::from(measured) {
            near if near < RANGE_MIN => f32::NEG_INFINITY,
            far if far > RANGE_MAX => f32::INFINITY,
            _ => x.hypot(y) as f32,
        };
        // The smaller of two, whichever is NaN.
        ranges[ray] = ranges[ray].min(range);
    }
    Scan {
        at: turn.at,
        first_angle: mount.heading,
        angle_step: -step,
        ray_interval: turn.period / RAYS as u32,
        turn: turn.period,
        range_min: RANGE_MIN,
        range_max: RANGE_MAX,
        ranges,
    }
}

impl RobotDriver for TurtlebotDriver {
    fn robot(&self) -> &NodeId {
        &self.id
    }

    fn command_timeout(&self) -> Duration {
        COMMAND_TIMEOUT
    }

    fn advance(&mut self, now: Timestamp) {
        self.look(now);
    }

    fn command(&mut self, now: Timestamp, velocity: Velocity) -> Result<Velocity, CommandError> {
        if !velocity.is_finite() {
            return Err(CommandError::NotFinite(velocity));
        }
        self.look(now);
        if let Some(fault) = self.readings.faults.first() {
            return Err(CommandError::Unwell(*fault));
        }
        let velocity = limited(velocity, self.speed_limit);
        self.body.drive(now, velocity).map_err(CommandError::Unwell)?;
        Ok(velocity)
    }

    fn stop(&mut self, now: Timestamp) {
        self.body.stop(now);
    }

    fn sensors(&self) -> SensorData {
        self.sensors.clone()
    }

    fn scan(&self) -> Option<&Scan> {
        self.scan.as_ref()
    }

    fn sense(&mut self, _now: Timestamp, sensor: &Sensor) -> Option<(Timestamp, Vec<f64>)> {
        match sensor.kind {
            SensorKind::Battery { .. } => {
                let charge = self.readings.basic.map(|(at, basic)| (at, [basic.charge(), basic.volts()]));
                self.take(0, charge).map(|(at, values)| (at, values.to_vec()))
            }
            // A Kobuki has a gyro, and no accelerometer.
            SensorKind::Imu => self
                .take(1, self.readings.angular_velocity)
                .map(|(at, [x, y, z])| (at, vec![x, y, z, f64::NAN, f64::NAN, f64::NAN])),
            _ => None,
        }
    }

    fn poll_notice(&mut self) -> Option<String> {
        self.notices.pop_front()
    }

    fn health(&self) -> &[RobotFault] {
        &self.readings.faults
    }
}

#[cfg(test)]
mod tests;
