//! A simulated TurtleBot 2: a Kobuki base with an RPLIDAR A2, moving through a [`World`].
//!
//! It is a function of time, seed and commands alone. Physics goes in fixed steps of [`SimulatedRobot::STEP`], so
//! that it does not matter how often or how late it is asked to advance.

use std::{sync::Arc, time::Duration};

use cotorra_graph::{
    Node, NodeId, NodeKind, Pose, PoseSource, RobotModel, SensorData, Timestamp, Velocity, Walk,
};

use crate::{
    driver::{CommandRefused, RobotDriver},
    kobuki::{self, Base, COMMAND_TIMEOUT, MAX_SPEED, Odometer},
    lidar::{Lidar, RAYS, Scan},
    world::World,
};

/// Why a node cannot be simulated.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum SimulationError {
    /// It is no robot.
    #[error("`{0}` is no robot")]
    NotARobot(NodeId),
    /// It has no place to start from.
    #[error("robot `{0}` has neither a walk nor a position to start from")]
    NoStart(NodeId),
}

/// A simulated TurtleBot 2.
#[derive(Debug, Clone)]
pub struct SimulatedRobot {
    id: NodeId,
    world: Arc<World>,
    speed_limit: f64,
    /// Up to when physics was computed.
    at: Timestamp,
    base: Base,
    odometer: Odometer,
    lidar: Lidar,
}

impl SimulatedRobot {
    /// Time from one step of physics to the next; Kobuki itself reports at this rate, 50 Hz. What the robot tells is
    /// as of the last step.
    pub const STEP: Duration = Duration::from_millis(20);
    /// The lidar turns ten times a second.
    const STEPS_A_TURN: usize = 5;

    /// The robot of that node at the start of its walk, or at the node's position if it has none, standing at the
    /// beginning of the run. It goes no faster than the walk's speed limit, where there is one.
    ///
    /// # Errors
    /// [`SimulationError`] if the node is no robot or has no start.
    pub fn new(
        node: &Node,
        walk: Option<&Walk>,
        world: Arc<World>,
        seed: u64,
    ) -> Result<Self, SimulationError> {
        let NodeKind::Robot(robot) = &node.kind else {
            return Err(SimulationError::NotARobot(node.id.clone()));
        };
        // One model so far; another one makes this match grow.
        match robot.model {
            RobotModel::Turtlebot2 => {}
        }
        let start = walk.and_then(|walk| walk.waypoints.first().copied()).or(node.position);
        let start = start.ok_or_else(|| SimulationError::NoStart(node.id.clone()))?;
        let base = Base::new(start, robot.heading);
        Ok(Self {
            speed_limit: walk.map_or(MAX_SPEED, |walk| walk.speed_limit.clamp(0.0, MAX_SPEED)),
            at: Timestamp::ZERO,
            odometer: Odometer::new(seed, &node.id, &base),
            lidar: Lidar::new(seed, &node.id),
            base,
            world,
            id: node.id.clone(),
        })
    }

    /// Where it is: exactly known to the simulator, so with no covariance.
    pub fn pose(&self) -> Pose {
        Pose {
            x: self.base.position.x,
            y: self.base.position.y,
            heading: self.base.heading,
            covariance: [0.0; 9],
            source: PoseSource::Simulator,
        }
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
            let motion = self.base.advance(self.at, Self::STEP, &self.world);
            self.odometer.advance(motion, Self::STEP);
            self.at = self.at + Self::STEP;
            let rays = RAYS / Self::STEPS_A_TURN;
            self.lidar.sweep(self.at, rays, &self.world, self.base.position, self.base.heading);
        }
    }

    fn command(&mut self, now: Timestamp, velocity: Velocity) -> Result<Velocity, CommandRefused> {
        if !(velocity.linear.is_finite() && velocity.angular.is_finite()) {
            return Err(CommandRefused::NotFinite(velocity));
        }
        self.advance(now);
        let limited = kobuki::limited(velocity, self.speed_limit);
        self.base.command(now, limited);
        Ok(limited)
    }

    fn stop(&mut self, now: Timestamp) {
        self.advance(now);
        self.base.command(now, Velocity::default());
    }

    fn sensors(&self) -> SensorData {
        SensorData {
            pose: self.pose(),
            odometry: self.odometer.pose(),
            velocity: self.odometer.velocity(),
            bumper: self.base.bumper,
            nearest_obstacle_m: self.lidar.scan().and_then(Scan::nearest),
        }
    }

    fn scan(&self) -> Option<&Scan> {
        self.lidar.scan()
    }

    fn truth(&self) -> Option<Pose> {
        Some(self.pose())
    }
}

#[cfg(test)]
mod tests;
