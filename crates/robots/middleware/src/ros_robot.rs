//! A robot in ROS as a state machine: its ROS messages go in with the time, and velocities for it come out. ROS 1 and ROS 2
//! share it; a [`crate::RosLink`] carries the messages.

use std::{
    collections::{BTreeMap, BTreeSet, VecDeque},
    time::Duration,
};

use cotorra_graph::{
    NodeId, Pose, PoseSource, Position, RobotFault, RobotModel, SensorData, SensorId, Timestamp, Velocity,
    Walk,
};
use cotorra_plugin::convert::{from_pose, from_twist};
use cotorra_ros_messages::{
    Header, LaserScan, Odometry, PoseWithCovariance, PoseWithCovarianceStamped, Quaternion, TFMessage,
};

use crate::{
    driver::{CommandError, limited},
    kobuki::COMMAND_TIMEOUT,
    large::{Captured, Content},
    lidar::Scan,
    picture::Picture,
    planar::Planar,
    ros::MAP_FRAME,
    watch::{Topic, Watch},
};

/// Interval at which a velocity is repeated, because a base stops without one.
const REPEAT: Duration = Duration::from_millis(100);
/// Number of stop commands in a row, because messages may be lost.
pub(crate) const STOPS: u32 = 5;
/// Largest coordinate, metres, and velocity, m/s or rad/s, that count as valid.
const FARTHEST: f64 = 1e6;
const FASTEST: f64 = 1e3;
/// Cap of variances, which keeps sums finite.
const GREATEST_VARIANCE: f64 = 1e12;

/// A robot in ROS.
///
/// Its pose on the map comes from localization: the frame `map` → `odom`, else the last `amcl_pose`, moved on by odometry.
/// Without either, odometry continues from the start that the testbed file gives.
///
/// A velocity is repeated every 100 ms until [`Self::COMMAND_TIMEOUT`]. Then, or on a fault, the robot is commanded to
/// stop. Invalid messages are ignored, so that all readings are finite.
#[derive(Debug, Clone)]
pub struct RosRobot {
    id: NodeId,
    model: RobotModel,
    speed_limit: f64,
    start: Planar,
    watch: Watch,
    health: Vec<RobotFault>,
    odometry: Option<Odometer>,
    /// Frame of the odometry on the map, by localization.
    correction: Option<Correction>,
    /// Pose of localization from before the first odometry. It may be the only one until the robot moves.
    waiting: Option<Pose>,
    velocity: Velocity,
    scan: Option<Scan>,
    /// Newest reading of each sensor that was not taken, with its time of arrival.
    readings: BTreeMap<SensorId, (Timestamp, Vec<f64>)>,
    images: BTreeMap<SensorId, (Timestamp, Picture)>,
    /// Sensors with a rejected message, and the notices to poll.
    refused: BTreeSet<SensorId>,
    notices: VecDeque<String>,
    motion: Motion,
}

#[derive(Debug, Clone)]
struct Odometer {
    /// Pose in the frame of the odometry.
    pose: Pose,
    frame: String,
    /// Frame of the odometry on the map, if the robot began at the testbed file's start.
    origin: Planar,
}

#[derive(Debug, Clone)]
struct Correction {
    origin: Planar,
    /// Covariance of localization's last pose; 0 before the first.
    covariance: [f64; 9],
    /// Whether it comes from the robot's frames, which take precedence over `amcl_pose`.
    of_frames: bool,
}

/// State of the commands to the robot.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Motion {
    Standing,
    Driving { velocity: Velocity, until: Timestamp, next: Timestamp },
    Stopping { left: u32, next: Timestamp },
}

impl RosRobot {
    /// Time for which a velocity is valid.
    pub const COMMAND_TIMEOUT: Duration = COMMAND_TIMEOUT;

    /// Creates a robot without messages so far, with this start on the map. The limits of its model and its walk apply.
    pub fn new(id: NodeId, model: RobotModel, start: Position, heading: f64, walk: Option<&Walk>) -> Self {
        let watch = Watch::default();
        let fastest = model.max_speed();
        Self {
            id,
            model,
            speed_limit: walk.map_or(fastest, |walk| walk.speed_limit.clamp(0.0, fastest)),
            start: Planar { x: start.x, y: start.y, z: start.z, heading },
            health: watch.faults(Timestamp::ZERO),
            watch,
            odometry: None,
            correction: None,
            waiting: None,
            velocity: Velocity::default(),
            scan: None,
            readings: BTreeMap::new(),
            images: BTreeMap::new(),
            refused: BTreeSet::new(),
            notices: VecDeque::new(),
            motion: Motion::Standing,
        }
    }

    /// Returns the robot's name.
    pub fn id(&self) -> &NodeId {
        &self.id
    }

    /// Returns the faults as of the last call with a time.
    pub fn health(&self) -> &[RobotFault] {
        &self.health
    }

    /// Returns the last valid turn of the lidar.
    pub fn scan(&self) -> Option<&Scan> {
        self.scan.as_ref()
    }

    /// Returns σ.
    pub fn sensors(&self) -> SensorData {
        let Planar { x, y, z, heading } = self.start;
        let at_start = Pose { z, ..Pose::planar(x, y, heading, [0.0; 9], PoseSource::Odometry) };
        let odometry =
            self.odometry.as_ref().map_or(at_start, |odometer| odometer.origin.place(&odometer.pose));
        let pose = match (&self.correction, &self.odometry) {
            (Some(correction), Some(odometer)) => Pose {
                covariance: correction.covariance,
                source: PoseSource::Localization,
                ..correction.origin.place(&odometer.pose)
            },
            _ => odometry,
        };
        SensorData {
            pose,
            odometry,
            velocity: self.velocity,
            bumper: false,
            nearest_obstacle_m: self.scan.as_ref().and_then(Scan::nearest),
        }
    }

    /// Takes an odometry message.
    pub fn odometry(&mut self, now: Timestamp, message: &Odometry) {
        self.watch.count(now, Topic::Odometry, 1);
        let twist = &message.twist.twist;
        let velocity = from_twist(twist);
        let all = [velocity.linear, velocity.vertical, velocity.angular, twist.linear.y];
        if let Some(pose) = self.pose(now, &message.pose, PoseSource::Odometry)
            && self.is_finite(now, &all)
            && self.makes_sense(now, all.iter().all(|speed| speed.abs() <= FASTEST))
        {
            let origin = match &self.odometry {
                Some(odometer) => odometer.origin,
                None => self.start.then(Planar::of(&pose).inverse()),
            };
            let frame = bare(&message.header.frame_id).to_owned();
            self.odometry = Some(Odometer { pose, frame, origin });
            self.velocity = velocity;
            self.heard(now, Topic::Odometry, &message.header);
            if let Some(pose) = self.waiting.take() {
                self.correct(pose);
            }
        }
        self.advance(now);
    }

    /// Takes a turn of the lidar.
    pub fn scanned(&mut self, now: Timestamp, message: LaserScan) {
        self.watch.count(now, Topic::Scan, 1);
        let angles = [message.angle_min, message.angle_max, message.angle_increment];
        let others = [message.range_min, message.range_max, message.time_increment, message.scan_time];
        // NaN is a failed measurement (REP 117). A scan in which all failed is a fault.
        let blind = !message.ranges.is_empty() && message.ranges.iter().all(|range| range.is_nan());
        let figures: Vec<_> = angles.into_iter().chain(others).map(f64::from).collect();
        if self.is_finite(now, &figures)
            && self.is_finite(now, if blind { &[f64::NAN] } else { &[] })
            && self.makes_sense(now, is_a_turn(&message))
        {
            self.heard(now, Topic::Scan, &message.header);
            self.scan = Some(Scan {
                at: now,
                first_angle: message.angle_min.into(),
                angle_step: message.angle_increment.into(),
                ray_interval: Duration::from_secs_f32(message.time_increment.clamp(0.0, 1e3)),
                turn: Duration::from_secs_f32(message.scan_time.clamp(0.0, 1e3)),
                range_min: message.range_min.into(),
                range_max: message.range_max.into(),
                ranges: message.ranges,
            });
        }
        self.advance(now);
    }

    /// Takes numbers of a sensor. They are ignored while the robot has a fault.
    pub fn sensed(&mut self, now: Timestamp, sensor: &SensorId, values: Vec<f64>) {
        self.advance(now);
        if self.health.is_empty() {
            self.readings.insert(sensor.clone(), (now, values));
        }
    }

    /// Takes an image of a sensor. It is ignored while the robot has a fault.
    pub fn pictured(&mut self, now: Timestamp, sensor: &SensorId, picture: Picture) {
        self.advance(now);
        if self.health.is_empty() {
            self.images.insert(sensor.clone(), (now, picture));
        }
    }

    /// Records that a sensor's message cannot be read. The first one of each sensor becomes a notice.
    pub fn refuse(&mut self, sensor: &SensorId, reason: &str) {
        if self.refused.insert(sensor.clone()) {
            self.notices.push_back(format!("robot {}, sensor {sensor}: {reason}", self.id));
        }
    }

    /// Takes the newest numbers of a sensor, with their time of arrival.
    pub fn take_reading(&mut self, sensor: &SensorId) -> Option<(Timestamp, Vec<f64>)> {
        self.readings.remove(sensor)
    }

    /// Takes the newest image of a sensor.
    pub fn take_image(&mut self, sensor: &SensorId) -> Option<Captured> {
        let (measured, Picture { format, width, height, bytes }) = self.images.remove(sensor)?;
        Some(Captured { measured, format, width, height, content: Content::Bytes(bytes) })
    }

    /// Returns the next notice to users.
    pub fn poll_notice(&mut self) -> Option<String> {
        self.notices.pop_front()
    }

    /// Takes a pose of localization (`amcl_pose`).
    pub fn localized(&mut self, now: Timestamp, message: &PoseWithCovarianceStamped) {
        self.watch.count(now, Topic::Localization, 1);
        if let Some(pose) = self.pose(now, &message.pose, PoseSource::Localization) {
            self.heard(now, Topic::Localization, &message.header);
            self.correct(pose);
        }
        self.advance(now);
    }

    /// Applies a pose of localization. It waits until the first odometry.
    fn correct(&mut self, pose: Pose) {
        let Some(odometer) = &self.odometry else {
            self.waiting = Some(pose);
            return;
        };
        let of_frames = self.correction.as_ref().filter(|correction| correction.of_frames);
        let origin = match of_frames {
            Some(correction) => correction.origin,
            None => Planar::of(&pose).then(Planar::of(&odometer.pose).inverse()),
        };
        let of_frames = of_frames.is_some();
        self.correction = Some(Correction { origin, covariance: pose.covariance, of_frames });
    }

    /// Takes coordinate frames, of this robot or others.
    pub fn frames(&mut self, now: Timestamp, message: &TFMessage) {
        self.watch.count(now, Topic::Frames, 1);
        for transform in &message.transforms {
            let is_ours = self.odometry.as_ref().is_some_and(|odometer| {
                bare(&transform.child_frame_id) == odometer.frame
                    && bare(&transform.header.frame_id).rsplit('/').next() == Some(MAP_FRAME)
            });
            if !is_ours {
                continue;
            }
            let translation = &transform.transform.translation;
            let place = [translation.x, translation.y, translation.z];
            if let Some(origin) = self.planar(now, place, &transform.transform.rotation) {
                self.heard(now, Topic::Frames, &transform.header);
                let covariance =
                    self.correction.as_ref().map_or([0.0; 9], |correction| correction.covariance);
                self.correction = Some(Correction { origin, covariance, of_frames: true });
            }
        }
        self.advance(now);
    }

    /// Records messages of a topic that were dropped because too many came.
    pub fn missed(&mut self, now: Timestamp, topic: Topic, messages: u64) {
        self.watch.count(now, topic, messages);
        self.advance(now);
    }

    /// Records a malformed message.
    pub fn malformed(&mut self, now: Timestamp) {
        self.watch.record(now, RobotFault::Malformed);
        self.advance(now);
    }

    /// Updates the faults to `now`.
    pub fn advance(&mut self, now: Timestamp) {
        self.health = self.watch.faults(now);
        if !self.health.is_empty() && matches!(self.motion, Motion::Driving { .. }) {
            self.stop(now);
        }
    }

    /// Moves the robot at this velocity. Returns the velocity within its limits.
    ///
    /// # Errors
    /// [`CommandError`]; the command before goes on, unless the robot has a fault and stands still.
    pub fn command(&mut self, now: Timestamp, velocity: Velocity) -> Result<Velocity, CommandError> {
        if !velocity.is_finite() {
            return Err(CommandError::NotFinite(velocity));
        }
        self.advance(now);
        if let Some(fault) = self.health.first() {
            return Err(CommandError::Unwell(*fault));
        }
        let velocity = limited(self.model, velocity, self.speed_limit);
        self.motion = Motion::Driving { velocity, until: now + Self::COMMAND_TIMEOUT, next: now };
        Ok(velocity)
    }

    /// Stops the robot.
    pub fn stop(&mut self, now: Timestamp) {
        self.motion = Motion::Stopping { left: STOPS, next: now };
    }

    /// Returns the velocity to send at `now`, if any.
    pub fn poll_velocity(&mut self, now: Timestamp) -> Option<Velocity> {
        self.advance(now);
        if let Motion::Driving { until, .. } = self.motion
            && now >= until
        {
            self.stop(now);
        }
        match &mut self.motion {
            Motion::Driving { velocity, next, .. } if now >= *next => {
                *next = now + REPEAT;
                Some(*velocity)
            }
            Motion::Stopping { left, next } if now >= *next => {
                (*left, *next) = (*left - 1, now + REPEAT);
                if *left == 0 {
                    self.motion = Motion::Standing;
                }
                Some(Velocity::default())
            }
            _ => None,
        }
    }

    /// Returns the time of the next velocity or change of faults; `None` before the first message.
    pub fn next_deadline(&self, now: Timestamp) -> Option<Timestamp> {
        let motion = match self.motion {
            Motion::Standing => None,
            Motion::Driving { until, next, .. } => Some(until.min(next)),
            Motion::Stopping { next, .. } => Some(next),
        };
        motion.into_iter().chain(self.watch.next_deadline(now)).min()
    }

    fn heard(&mut self, now: Timestamp, topic: Topic, header: &Header) {
        self.watch.heard(now, topic, &header.stamp);
    }

    /// Checks that all figures are finite, and records a fault if not.
    fn is_finite(&mut self, now: Timestamp, figures: &[f64]) -> bool {
        let finite = figures.iter().all(|figure| figure.is_finite());
        if !finite {
            self.watch.record(now, RobotFault::NotFinite);
        }
        finite
    }

    /// Records a fault unless the content of a message makes sense.
    fn makes_sense(&mut self, now: Timestamp, sense: bool) -> bool {
        if !sense {
            self.watch.record(now, RobotFault::Malformed);
        }
        sense
    }

    /// Returns a message's pose if it is valid, and records a fault if not.
    fn pose(&mut self, now: Timestamp, message: &PoseWithCovariance, source: PoseSource) -> Option<Pose> {
        let position = &message.pose.position;
        self.planar(now, [position.x, position.y, position.z], &message.pose.orientation)?;
        let covariance = message.covariance.planar();
        let finite = self.is_finite(now, &covariance);
        let covariance = covariance.map(|c| c.clamp(-GREATEST_VARIANCE, GREATEST_VARIANCE));
        finite.then_some(Pose { covariance, ..from_pose(&message.pose, source) })
    }

    fn planar(&mut self, now: Timestamp, place: [f64; 3], rotation: &Quaternion) -> Option<Planar> {
        let [x, y, z] = place;
        let turned = [rotation.x, rotation.y, rotation.z, rotation.w];
        // The squares of a rotation add up to 1, apart from rounding.
        let is_rotation = (turned.iter().map(|q| q * q).sum::<f64>() - 1.0).abs() < 0.1;
        let is_near = place.iter().all(|metres| metres.abs() <= FARTHEST);
        let is_pose = self.is_finite(now, &place)
            && self.is_finite(now, &turned)
            && self.makes_sense(now, is_rotation && is_near);
        is_pose.then(|| Planar { x, y, z, heading: rotation.heading() })
    }
}

/// Whether a scan's angles and ranges are possible.
fn is_a_turn(scan: &LaserScan) -> bool {
    let full_turn = std::f32::consts::TAU * 1.01;
    let swept = scan.angle_increment.abs() * scan.ranges.len().saturating_sub(1) as f32;
    !scan.ranges.is_empty()
        && (scan.angle_increment != 0.0 || scan.ranges.len() == 1)
        && swept <= full_turn
        && scan.angle_min.abs() <= full_turn
        && 0.0 <= scan.range_min
        && scan.range_min < scan.range_max
}

/// Returns a frame's name as in tf2, without the leading slash of older versions.
fn bare(frame: &str) -> &str {
    frame.trim_start_matches('/')
}

#[cfg(test)]
mod tests;
