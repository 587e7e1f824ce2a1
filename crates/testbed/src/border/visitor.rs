//! The driver of a visitor: a robot that stands where a robot of another core is.

use std::{collections::BTreeMap, sync::Arc, time::Duration};

use cotorra_graph::{NodeId, Pose, PoseSource, Position, SensorData, Timestamp, Velocity};
use cotorra_robot_middleware::{CommandError, RobotDriver, Scan};
use parking_lot::Mutex;

/// Places of visitors.
#[derive(Debug, Clone, Default)]
pub(crate) struct Places(Arc<Mutex<BTreeMap<NodeId, Position>>>);

impl Places {
    pub(super) fn set(&self, visitor: &NodeId, position: Position) {
        self.0.lock().insert(visitor.clone(), position);
    }

    /// Makes the driver of a visitor. It stands at `begin` until its place is known.
    pub(crate) fn driver(&self, visitor: &NodeId, begin: Position) -> Visitor {
        self.set(visitor, begin);
        Visitor { robot: visitor.clone(), places: self.clone() }
    }
}

/// A visitor. Its own core alone moves it.
pub(crate) struct Visitor {
    robot: NodeId,
    places: Places,
}

impl Visitor {
    fn pose(&self) -> Pose {
        let Position { x, y, z } = self.places.0.lock().get(&self.robot).copied().unwrap_or_default();
        Pose { z, ..Pose::planar(x, y, 0.0, [0.0; 9], PoseSource::Localization) }
    }
}

impl RobotDriver for Visitor {
    fn robot(&self) -> &NodeId {
        &self.robot
    }

    fn command_timeout(&self) -> Duration {
        Duration::ZERO
    }

    fn advance(&mut self, _now: Timestamp) {}

    fn command(&mut self, _now: Timestamp, _velocity: Velocity) -> Result<Velocity, CommandError> {
        Err(CommandError::Visitor)
    }

    fn stop(&mut self, _now: Timestamp) {}

    fn sensors(&self) -> SensorData {
        let (pose, velocity) = (self.pose(), Velocity::default());
        SensorData { pose, odometry: pose, velocity, bumper: false, nearest_obstacle_m: None }
    }

    fn scan(&self) -> Option<&Scan> {
        None
    }
}
