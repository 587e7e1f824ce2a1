//! A simulated robot that moves through a [`World`]: a TurtleBot 2, which is a Kobuki base with an RPLIDAR A2, or a
//! quadrotor with the same lidar.
//!
//! It depends on time, seed and commands alone. Physics has fixed steps of [`SimulatedRobot::STEP`], so that the times of
//! calls to `advance` do not matter.

use std::{sync::Arc, time::Duration};

use cotorra_graph::{
    Node, NodeId, NodeKind, Pose, RobotModel, Sensor, SensorData, SensorKind, Timestamp, Velocity, Walk,
};

use crate::{
    battery::Battery,
    camera::View,
    driver::{CommandError, RobotDriver, limited},
    imu::Imu,
    kobuki::{Base, COMMAND_TIMEOUT, Odometer},
    large::{Captured, Content},
    lidar::{Lidar, RAYS, Scan},
    quadrotor::{Airframe, FlightOdometer},
    world::World,
};

/// The reason for which a node cannot be simulated.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum SimulationError {
    /// The node is not a robot.
    #[error("`{0}` is not a robot")]
    NotARobot(NodeId),
    /// The robot has no start position.
    #[error("robot `{0}` has neither a walk nor a position to start from")]
    NoStart(NodeId),
}

/// The true state with its odometry.
#[derive(Debug, Clone)]
enum Body {
    Turtlebot2(Base, Odometer),
    Quadrotor(Airframe, FlightOdometer),
}

impl Body {
    fn advance(&mut self, wanted: Velocity, step: Duration, world: &World) {
        match self {
            Self::Turtlebot2(base, odometer) => {
                let motion = base.advance(wanted, step, world);
                odometer.advance(motion, step);
            }
            Self::Quadrotor(airframe, odometer) => {
                let flown = airframe.advance(wanted, step, world);
                odometer.advance(airframe, flown, step);
            }
        }
    }

    fn pose(&self) -> Pose {
        match self {
            Self::Turtlebot2(base, _) => base.pose(),
            Self::Quadrotor(airframe, _) => airframe.pose(),
        }
    }
}

/// A simulated robot.
#[derive(Debug, Clone)]
pub struct SimulatedRobot {
    id: NodeId,
    model: RobotModel,
    world: Arc<World>,
    speed_limit: f64,
    /// Time of the last step of physics.
    at: Timestamp,
    body: Body,
    /// The last command, and the time until which it is followed.
    wanted: (Velocity, Timestamp),
    lidar: Lidar,
    battery: Option<Battery>,
    imu: Option<Imu>,
}

impl SimulatedRobot {
    /// Step of physics: 50 Hz, at which Kobuki itself reports. Readings are as of the last step.
    pub const STEP: Duration = Duration::from_millis(20);
    /// The lidar turns ten times a second.
    const STEPS_A_TURN: usize = 5;

    /// Creates the robot of a node, standing at the start of its walk, or at the node's position without a walk. The walk's
    /// speed limit applies.
    ///
    /// # Errors
    /// [`SimulationError`] if the node is not a robot or has no start.
    pub fn new(
        node: &Node,
        walk: Option<&Walk>,
        world: Arc<World>,
        seed: u64,
    ) -> Result<Self, SimulationError> {
        let NodeKind::Robot(robot) = &node.kind else {
            return Err(SimulationError::NotARobot(node.id.clone()));
        };
        let from_the_first = walk.filter(|walk| walk.next.is_none());
        let start = from_the_first.and_then(|walk| walk.waypoints.first().copied()).or(node.position);
        let start = start.ok_or_else(|| SimulationError::NoStart(node.id.clone()))?;
        let body = match robot.model {
            RobotModel::Turtlebot2 => {
                let base = Base::new(start, robot.heading);
                let odometer = Odometer::new(seed, &node.id, &base);
                Body::Turtlebot2(base, odometer)
            }
            RobotModel::Quadrotor => {
                let airframe = Airframe::new(start, robot.heading);
                let odometer = FlightOdometer::new(seed, &node.id, &airframe);
                Body::Quadrotor(airframe, odometer)
            }
        };
        let battery = robot.sensors.iter().find_map(|sensor| match sensor.kind {
            SensorKind::Battery { charge } => Some(Battery::new(charge.unwrap_or(1.0))),
            _ => None,
        });
        let has_imu = robot.sensors.iter().any(|sensor| sensor.kind == SensorKind::Imu);
        let imu = has_imu.then(|| Imu::new(seed, &node.id, body.pose()));
        let fastest = robot.model.max_speed();
        Ok(Self {
            speed_limit: walk.map_or(fastest, |walk| walk.speed_limit.clamp(0.0, fastest)),
            at: Timestamp::ZERO,
            lidar: Lidar::new(seed, &node.id),
            body,
            wanted: (Velocity::default(), Timestamp::ZERO),
            battery,
            imu,
            world,
            id: node.id.clone(),
            model: robot.model,
        })
    }

    /// Returns the simulated model.
    pub fn model(&self) -> RobotModel {
        self.model
    }

    /// Returns the true pose. Its covariance is 0.
    pub fn pose(&self) -> Pose {
        self.body.pose()
    }
}

impl RobotDriver for SimulatedRobot {
    fn robot(&self) -> &NodeId {
        &self.id
    }

    fn command_timeout(&self) -> Duration {
        COMMAND_TIMEOUT
    }

    fn advance(&mut self, now: Timestamp) {
        while self.at + Self::STEP <= now {
            let (velocity, until) = self.wanted;
            let wanted = if self.at < until { velocity } else { Velocity::default() };
            self.body.advance(wanted, Self::STEP, &self.world);
            self.at = self.at + Self::STEP;
            let rays = RAYS / Self::STEPS_A_TURN;
            let pose = self.pose();
            if let (Some(battery), Body::Turtlebot2(base, _)) = (&mut self.battery, &self.body) {
                battery.advance(base.velocity, Self::STEP);
            }
            if let Some(imu) = &mut self.imu {
                imu.advance(&pose, Self::STEP);
            }
            self.lidar.sweep(self.at, rays, &self.world, pose.position(), pose.heading);
        }
    }

    fn command(&mut self, now: Timestamp, velocity: Velocity) -> Result<Velocity, CommandError> {
        if !velocity.is_finite() {
            return Err(CommandError::NotFinite(velocity));
        }
        self.advance(now);
        let limited = limited(self.model, velocity, self.speed_limit);
        self.wanted = (limited, now + COMMAND_TIMEOUT);
        Ok(limited)
    }

    fn stop(&mut self, now: Timestamp) {
        self.advance(now);
        self.wanted = (Velocity::default(), now);
    }

    fn sensors(&self) -> SensorData {
        let (odometry, velocity, bumper) = match &self.body {
            Body::Turtlebot2(base, odometer) => (odometer.pose(), odometer.velocity(), base.bumper),
            Body::Quadrotor(airframe, odometer) => (odometer.pose(), odometer.velocity(), airframe.bumper),
        };
        let nearest_obstacle_m = self.lidar.scan().and_then(Scan::nearest);
        SensorData { pose: self.pose(), odometry, velocity, bumper, nearest_obstacle_m }
    }

    fn scan(&self) -> Option<&Scan> {
        self.lidar.scan()
    }

    fn sense(&mut self, now: Timestamp, sensor: &Sensor) -> Option<(Timestamp, Vec<f64>)> {
        let values = match sensor.kind {
            SensorKind::Battery { .. } => self.battery.as_ref().map(Battery::read),
            SensorKind::Imu => self.imu.as_mut().map(|imu| imu.read(sensor.interval)),
            _ => None,
        };
        values.map(|values| (now, values))
    }

    fn capture(&mut self, sensor: &Sensor, read: Option<Timestamp>) -> Option<Captured> {
        match &sensor.kind {
            SensorKind::Lidar { .. } => self.scan().filter(|scan| read != Some(scan.at)).map(Captured::from),
            // The view is as of the last step.
            SensorKind::Camera(camera) => (read != Some(self.at)).then(|| Captured {
                measured: self.at,
                format: camera.format,
                width: camera.width.into(),
                height: camera.height.into(),
                content: Content::View(Arc::new(View::new(camera, Arc::clone(&self.world), &self.pose()))),
            }),
            _ => None,
        }
    }

    fn truth(&self) -> Option<Pose> {
        Some(self.pose())
    }
}

#[cfg(test)]
mod tests;
