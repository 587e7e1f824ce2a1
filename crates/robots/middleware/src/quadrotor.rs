//! A simulated quadrotor under velocity commands: its motion and its odometry.
//!
//! Each velocity follows its command with a first-order lag, within limits of speed and acceleration. The limits are the
//! defaults of PX4's position control (`MPC_XY_CRUISE`, `MPC_ACC_HOR`, `MPC_Z_VEL_MAX_UP`, `MPC_Z_VEL_MAX_DN`). Roll and
//! pitch follow from the horizontal acceleration: a = g tan(tilt).

use std::time::Duration;

use cotorra_graph::{NodeId, Pose, PoseSource, Position, RobotModel, Velocity, wrapped_angle};
use cotorra_numbers::Draws;

use crate::world::World;

/// Radius of the outline with propellers, metres.
const RADIUS: f64 = RobotModel::Quadrotor.radius();
/// Largest speed upward and downward, m/s.
const CLIMB: (f64, f64) = (3.0, 1.5);
/// Largest angular velocity, rad/s.
const MAX_TURN: f64 = 1.0;
/// Time constant of each velocity, seconds.
const LAG: f64 = 0.25;
/// Largest horizontal acceleration, m/s².
const ACCELERATION: f64 = 3.0;
/// Largest vertical acceleration, m/s².
const LIFT: f64 = 3.0;
/// m/s².
const GRAVITY: f64 = 9.81;
/// Velocity below which it stands still, m/s or rad/s, because a lag alone never ends.
const STILL: f64 = 1e-3;

/// Scales a velocity down to the quadrotor's limits and the speed limit, m/s, on the same curve.
pub(crate) fn limited(wanted: Velocity, speed_limit: f64) -> Velocity {
    let climb = if wanted.vertical > 0.0 { CLIMB.0 } else { CLIMB.1 };
    let shares = [
        wanted.linear.abs() / speed_limit.min(RobotModel::Quadrotor.max_speed()),
        wanted.vertical.abs() / climb,
        wanted.angular.abs() / MAX_TURN,
    ];
    let over = shares.into_iter().fold(1.0, f64::max);
    if over > 1.0 { wanted.scaled(1.0 / over) } else { wanted }
}

/// True state of the quadrotor: pose and velocity.
#[derive(Debug, Clone)]
pub(crate) struct Airframe {
    pub position: Position,
    /// Radians in (-π, π].
    pub heading: f64,
    roll: f64,
    pitch: f64,
    /// Velocity on the map, m/s.
    velocity: [f64; 3],
    turn: f64,
    pub bumper: bool,
}

/// Motion of a step: way on the map, metres, and turn, radians.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Flown {
    way: [f64; 2],
    turned: f64,
}

impl Airframe {
    pub fn new(position: Position, heading: f64) -> Self {
        Self {
            position,
            heading: wrapped_angle(heading),
            roll: 0.0,
            pitch: 0.0,
            velocity: [0.0; 3],
            turn: 0.0,
            bumper: false,
        }
    }

    pub fn pose(&self) -> Pose {
        let Position { x, y, z } = self.position;
        let level = Pose::planar(x, y, self.heading, [0.0; 9], PoseSource::Simulator);
        Pose { z, roll: self.roll, pitch: self.pitch, ..level }
    }

    /// Flies for a step under this command. It hovers at a command of 0. On the floor, only taking off has an effect.
    pub fn advance(&mut self, commanded: Velocity, step: Duration, world: &World) -> Flown {
        let lands = self.position.z <= 0.0 && commanded.vertical <= 0.0;
        let wanted = if lands { Velocity::default() } else { commanded };
        let seconds = step.as_secs_f64();
        let (sin, cos) = self.heading.sin_cos();

        let [ax, ay] = [wanted.linear * cos - self.velocity[0], wanted.linear * sin - self.velocity[1]];
        let share = (ACCELERATION * LAG / ax.hypot(ay)).min(1.0) / LAG;
        let [ax, ay] = [ax * share, ay * share];
        let az = ((wanted.vertical - self.velocity[2]) / LAG).clamp(-LIFT, LIFT);
        let [vx, vy, vz] = [
            self.velocity[0] + ax * seconds,
            self.velocity[1] + ay * seconds,
            self.velocity[2] + az * seconds,
        ];
        let turn = self.turn + (wanted.angular - self.turn) * (seconds / LAG).min(1.0);
        let stops = wanted.linear == 0.0 && vx.hypot(vy) < STILL;
        let ends =
            |velocity: f64, wanted: f64| if wanted == 0.0 && velocity.abs() < STILL { 0.0 } else { velocity };
        let [vx, vy] = if stops { [0.0; 2] } else { [vx, vy] };
        self.velocity = [vx, vy, ends(vz, wanted.vertical)];
        self.turn = ends(turn, wanted.angular);
        // Acceleration forward and to the left.
        let [ahead, left] = if stops { [0.0; 2] } else { [ax * cos + ay * sin, ay * cos - ax * sin] };
        [self.pitch, self.roll] = [(ahead / GRAVITY).atan(), -(left / GRAVITY).atan()];

        let way = [self.velocity[0] * seconds, self.velocity[1] * seconds];
        let there = Position { x: self.position.x + way[0], y: self.position.y + way[1], ..self.position };
        // Inside a wall, it may only leave it.
        let (clear, before) = (world.distance(there, RADIUS), world.distance(self.position, RADIUS));
        self.bumper = way != [0.0; 2] && clear < RADIUS && clear <= before;
        let way = if self.bumper { [0.0; 2] } else { way };
        if self.bumper {
            (self.velocity[0], self.velocity[1]) = (0.0, 0.0);
        }
        let z = self.position.z + self.velocity[2] * seconds;
        if z <= 0.0 {
            self.velocity = [0.0; 3];
        }
        self.position = Position { x: self.position.x + way[0], y: self.position.y + way[1], z: z.max(0.0) };
        let turned = self.turn * seconds;
        self.heading = wrapped_angle(self.heading + turned);
        Flown { way, turned }
    }

    /// Returns the velocity along the heading, upward, and about the vertical axis.
    pub fn velocity(&self) -> Velocity {
        let (sin, cos) = self.heading.sin_cos();
        let [x, y, vertical] = self.velocity;
        Velocity { linear: x * cos + y * sin, vertical, angular: self.turn }
    }
}

/// Standard deviation of the measured scale between quadrotors.
const SCALE: f64 = 0.01;
/// Position random walk, metres per √metre.
const DRIFT: f64 = 0.01;
/// Heading random walk, rad/√s.
const TURN_WALK: f64 = 5.2e-4;
/// Standard deviation of the measured height, metres.
const HEIGHT: f64 = 0.01;

/// Odometry: visual-inertial in the plane, which drifts, and the height from a range finder.
#[derive(Debug, Clone)]
pub(crate) struct FlightOdometer {
    noise: Draws,
    scale: f64,
    /// Error of the measured heading, radians.
    off: f64,
    pose: Pose,
    velocity: Velocity,
    way: f64,
    elapsed: f64,
}

impl FlightOdometer {
    pub fn new(seed: u64, robot: &NodeId, start: &Airframe) -> Self {
        let mut noise = Draws::new(seed, &format!("{robot}/odometry"));
        Self {
            scale: 1.0 + SCALE * noise.bell(),
            noise,
            off: 0.0,
            pose: Pose { source: PoseSource::Odometry, ..start.pose() },
            velocity: Velocity::default(),
            way: 0.0,
            elapsed: 0.0,
        }
    }

    /// Measures a step.
    pub fn advance(&mut self, truth: &Airframe, flown: Flown, step: Duration) {
        let seconds = step.as_secs_f64();
        let length = flown.way[0].hypot(flown.way[1]);
        self.way += length;
        self.elapsed += seconds;
        self.off += TURN_WALK * seconds.sqrt() * self.noise.bell();
        let (sin, cos) = self.off.sin_cos();
        let mut drift = || DRIFT * length.sqrt() * self.noise.bell();
        let [x, y] = flown.way.map(|metres| metres * self.scale);
        let (x, y) = (x * cos - y * sin + drift(), x * sin + y * cos + drift());
        let height = if truth.position.z > 0.0 { HEIGHT * self.noise.bell() } else { 0.0 };
        let Pose { roll, pitch, .. } = truth.pose();
        self.pose = Pose {
            x: self.pose.x + x,
            y: self.pose.y + y,
            z: (truth.position.z + height).max(0.0),
            roll,
            pitch,
            heading: wrapped_angle(truth.heading + self.off),
            ..self.pose
        };
        self.velocity = Velocity { angular: flown.turned / seconds, ..truth.velocity() };
    }

    pub fn velocity(&self) -> Velocity {
        self.velocity
    }

    /// Returns the pose, with an upper bound of its covariance, like that of wheels.
    pub fn pose(&self) -> Pose {
        let heading = TURN_WALK.powi(2) * self.elapsed;
        let position = (SCALE.powi(2) + heading) * self.way.powi(2) + DRIFT.powi(2) * self.way;
        Pose { covariance: [position, 0.0, 0.0, 0.0, position, 0.0, 0.0, 0.0, heading], ..self.pose }
    }
}

#[cfg(test)]
mod tests;
