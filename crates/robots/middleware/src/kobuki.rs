//! The base of a simulated TurtleBot 2: a Kobuki's motion under velocity commands, and its odometry from wheels and gyro.
//!
//! Figures are from Kobuki's driver (`kobuki_core`) and its documentation.

use std::time::Duration;

use cotorra_graph::{NodeId, Pose, PoseSource, Position, RobotModel, Velocity, wrapped_angle};
use cotorra_numbers::Draws;
pub(crate) use cotorra_turtlebot::kobuki::limited;
pub use cotorra_turtlebot::kobuki::{COMMAND_TIMEOUT, MAX_ANGULAR_SPEED, METRES_PER_TICK, WHEEL_BASE};

use crate::world::World;

/// Radius of the body, metres.
pub const RADIUS: f64 = RobotModel::Turtlebot2.radius();
/// Largest speed, m/s.
pub const MAX_SPEED: f64 = RobotModel::Turtlebot2.max_speed();

/// Acceleration and deceleration, m/s².
const LINEAR_RAMP: (f64, f64) = (0.5, 0.6);
/// Acceleration and deceleration, rad/s².
const ANGULAR_RAMP: (f64, f64) = (3.5, 4.2);
/// Distance of the wall at which a pressed bumper is released, metres.
const BUMPER_RELEASE: f64 = 0.005;

/// True state of the base: pose, velocity and bumper.
#[derive(Debug, Clone)]
pub(crate) struct Base {
    pub position: Position,
    /// Radians in (-π, π].
    pub heading: f64,
    pub velocity: Velocity,
    pub bumper: bool,
}

/// Motion of a step: forward, metres, and turned, radians.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Motion {
    pub forward: f64,
    pub turned: f64,
}

impl Base {
    pub fn new(position: Position, heading: f64) -> Self {
        Self { position, heading: wrapped_angle(heading), velocity: Velocity::default(), bumper: false }
    }

    /// Returns the true pose.
    pub fn pose(&self) -> Pose {
        let Position { x, y, z } = self.position;
        Pose { z, ..Pose::planar(x, y, self.heading, [0.0; 9], PoseSource::Simulator) }
    }

    /// Moves for a step, with the velocity ramping towards `wanted`.
    pub fn advance(&mut self, wanted: Velocity, step: Duration, world: &World) -> Motion {
        let seconds = step.as_secs_f64();
        self.velocity = Velocity::planar(
            ramp(self.velocity.linear, wanted.linear, LINEAR_RAMP, seconds),
            ramp(self.velocity.angular, wanted.angular, ANGULAR_RAMP, seconds),
        );
        let motion =
            Motion { forward: self.velocity.linear * seconds, turned: self.velocity.angular * seconds };
        let share = self.free_share(motion, world);
        let blocked = share < 1.0;
        let motion = Motion { forward: motion.forward * share, ..motion };
        if blocked {
            self.velocity.linear = 0.0;
        }
        self.position = self.after(motion);
        self.heading = wrapped_angle(self.heading + motion.turned);
        let reach = RADIUS + BUMPER_RELEASE;
        self.bumper = blocked || (self.bumper && world.distance(self.position, reach) < reach);
        motion
    }

    /// Returns the end of an arc of constant curvature: its chord is at half the turn.
    fn after(&self, motion: Motion) -> Position {
        let half = motion.turned / 2.0;
        let chord = motion.forward * if half.abs() < 1e-9 { 1.0 } else { half.sin() / half };
        let (sin, cos) = (self.heading + half).sin_cos();
        Position { x: self.position.x + chord * cos, y: self.position.y + chord * sin, ..self.position }
    }

    /// Returns the share of the way, 0 to 1, that the body can go before it touches a wall. A step is shorter than the
    /// body, so that it cannot jump over walls. A body inside a wall may only leave it.
    fn free_share(&self, motion: Motion, world: &World) -> f64 {
        let now = world.distance(self.position, RADIUS);
        let free = |share: f64| {
            let there =
                world.distance(self.after(Motion { forward: motion.forward * share, ..motion }), RADIUS);
            there >= RADIUS || there > now
        };
        if motion.forward == 0.0 || free(1.0) {
            return 1.0;
        }
        let (mut low, mut high) = (0.0, 1.0);
        // At most 14 mm, halved ten times: contact to within 14 µm.
        for _ in 0..10 {
            let middle = (low + high) / 2.0;
            if free(middle) { low = middle } else { high = middle }
        }
        low
    }
}

/// Returns the velocity after `seconds` on the ramp from `now` to `wanted`, given acceleration and deceleration.
fn ramp(now: f64, wanted: f64, (faster, slower): (f64, f64), seconds: f64) -> f64 {
    let speeds_up = wanted.abs() > now.abs() && wanted * now >= 0.0;
    let change = if speeds_up { faster } else { slower } * seconds;
    now + (wanted - now).clamp(-change, change)
}

/// Standard deviation of the wheels' scale between robots, from wear, load and floor.
const WHEEL_SCALE: f64 = 0.012;
/// Standard deviation of the scale between the two wheels of a robot.
const WHEEL_DIFFERENCE: f64 = 0.002;
/// Slip of a wheel, metres per √metre. It is a random walk: 1 mm after 1 m, 10 mm after 100 m.
const SLIP: f64 = 0.001;
/// Standard deviation of the gyro's bias between robots, after calibration, rad/s (0.004 °/s).
pub(crate) const GYRO_BIAS: f64 = 7e-5;
/// Angle random walk of the gyro (ST L3G4200D, 0.03 °/√s), rad/√s.
pub(crate) const GYRO_WALK: f64 = 5.2e-4;

/// Odometry. As in Kobuki's own node, distances come from the encoders and the heading from the gyro. Both drift.
#[derive(Debug, Clone)]
pub(crate) struct Odometer {
    noise: Draws,
    wheel_scale: [f64; 2],
    gyro_bias: f64,
    /// Way of each wheel, metres at its rim.
    turned: [f64; 2],
    ticks: [i64; 2],
    position: Position,
    heading: f64,
    velocity: Velocity,
    way: f64,
    elapsed: f64,
}

impl Odometer {
    pub fn new(seed: u64, robot: &NodeId, start: &Base) -> Self {
        let mut noise = Draws::new(seed, &format!("{robot}/odometry"));
        let common = 1.0 + WHEEL_SCALE * noise.bell();
        let wheel_scale = [(); 2].map(|()| common + WHEEL_DIFFERENCE * noise.bell());
        let gyro_bias = GYRO_BIAS * noise.bell();
        Self {
            noise,
            wheel_scale,
            gyro_bias,
            turned: [0.0; 2],
            ticks: [0; 2],
            position: start.position,
            heading: start.heading,
            velocity: Velocity::default(),
            way: 0.0,
            elapsed: 0.0,
        }
    }

    /// Reads encoders and gyro after a step.
    pub fn advance(&mut self, motion: Motion, step: Duration) {
        let seconds = step.as_secs_f64();
        let half = motion.turned * WHEEL_BASE / 2.0;
        let wheels = [motion.forward - half, motion.forward + half];
        let mut counted = [0; 2];
        for wheel in 0..2 {
            // A standing wheel does not slip.
            let way = wheels[wheel];
            let slip = if way == 0.0 { 0.0 } else { SLIP * way.abs().sqrt() * self.noise.bell() };
            self.turned[wheel] += way * self.wheel_scale[wheel] + slip;
            let ticks = (self.turned[wheel] / METRES_PER_TICK).floor() as i64;
            counted[wheel] = ticks - self.ticks[wheel];
            self.ticks[wheel] = ticks;
        }
        let forward = (counted[0] + counted[1]) as f64 * METRES_PER_TICK / 2.0;
        // With standing wheels the gyro's reading is all error, so that the heading is held.
        let moving = wheels != [0.0; 2];
        let error = self.gyro_bias * seconds + GYRO_WALK * seconds.sqrt() * self.noise.bell();
        let turned = if moving { motion.turned + error } else { 0.0 };
        let (sin, cos) = (self.heading + turned / 2.0).sin_cos();
        let Position { x, y, .. } = self.position;
        self.position = Position { x: x + forward * cos, y: y + forward * sin, ..self.position };
        self.heading = wrapped_angle(self.heading + turned);
        self.velocity = Velocity::planar(forward / seconds, turned / seconds);
        self.way += forward.abs();
        self.elapsed += if moving { seconds } else { 0.0 };
    }

    /// Returns the velocity measured in the last step.
    pub fn velocity(&self) -> Velocity {
        self.velocity
    }

    /// Returns the pose with its covariance.
    pub fn pose(&self) -> Pose {
        let Position { x, y, z } = self.position;
        let covariance = drift(self.way, self.elapsed);
        Pose { z, ..Pose::planar(x, y, self.heading, covariance, PoseSource::Odometry) }
    }
}

/// Returns an upper bound of the covariance of odometry after a way, metres, in a time of motion, seconds: as if the whole
/// way had been straight, with the full heading error from the start.
pub(crate) fn drift(way: f64, elapsed: f64) -> [f64; 9] {
    let heading = (GYRO_BIAS * elapsed).powi(2) + GYRO_WALK.powi(2) * elapsed;
    let scale = WHEEL_SCALE.powi(2) + WHEEL_DIFFERENCE.powi(2) + heading;
    let position = scale * way.powi(2) + SLIP.powi(2) * way + METRES_PER_TICK.powi(2);
    [position, 0.0, 0.0, 0.0, position, 0.0, 0.0, 0.0, heading]
}

#[cfg(test)]
mod tests;
