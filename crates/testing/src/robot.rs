//! A testbed of one robot and its contexts, for tests of the brain alone.

use std::time::Duration;

use cotorra_graph::{
    Event, Node, NodeId, NodeKind, OccupancyGrid, Pose, Position, RobotContext, Testbed, Walk,
};
use cotorra_graph_testing as base;

pub use cotorra_graph_testing::pose;

/// Radius of the robot, metres.
pub const RADIUS: f64 = 0.1758;

pub fn robot() -> NodeId {
    NodeId::new("robot").unwrap()
}

/// Returns a testbed of one robot and its walk.
pub fn testbed(map: Option<OccupancyGrid>, waypoints: Vec<Position>) -> Testbed {
    let node = base::node("robot", NodeKind::Robot(base::robot("corridor")));
    let node = Node { position: waypoints.first().copied(), ..node };
    Testbed {
        name: "corridor".to_owned(),
        map,
        walks: vec![Walk {
            robot: robot(),
            waypoints,
            next: None,
            speed_limit: 0.3,
            position_interval: Duration::from_millis(200),
            random_intervals: None,
        }],
        ..base::testbed(base::graph(vec![node], Vec::new()))
    }
}

/// Returns κ of the robot at a pose.
pub fn context(pose: Pose, waypoint: u32) -> Event {
    Event::Robot(RobotContext { waypoint, ..base::robot_context("robot", pose) })
}
