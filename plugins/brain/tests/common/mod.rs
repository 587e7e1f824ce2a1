//! The corridor of the published testbed as a walk between walls, for tests and benchmarks of the brain alone.
#![allow(dead_code, reason = "no test or benchmark uses all of it")]
#![allow(clippy::unwrap_used, reason = "clippy knows helpers of integration tests for no tests")]

use std::{collections::BTreeMap, time::Duration};

use cotorra_graph::{
    Attachment, Capacity, Cell, Dbm, DomainId, Event, HardwareGraph, Node, NodeId, NodeKind, OccupancyGrid,
    Pose, PoseSource, Position, Roaming, Robot, RobotContext, RobotModel, SensorData, Testbed, Velocity,
    Walk,
};

/// Radius of the robot, metres.
pub const RADIUS: f64 = 0.1758;

const WAY_OUT: [(f64, f64); 18] = [
    (25.5, -27.8),
    (25.5, -24.6),
    (25.8, -21.8),
    (26.4, -18.7),
    (27.3, -15.6),
    (27.1, -12.4),
    (27.2, -9.4),
    (27.5, -6.2),
    (25.5, -4.3),
    (22.5, -2.4),
    (19.3, -1.9),
    (16.1, -1.7),
    (12.9, -1.3),
    (9.8, -0.7),
    (6.6, -0.3),
    (3.4, 0.1),
    (0.2, 0.2),
    (-2.1, 0.4),
];

/// The waypoints out and back.
pub fn waypoints() -> Vec<Position> {
    let out = WAY_OUT.iter();
    out.clone().chain(out.rev().skip(1)).map(|&(x, y)| Position::new(x, y)).collect()
}

/// A floor of 2 m to each side of the way, with walls around it; nobody looked behind them.
pub fn map() -> OccupancyGrid {
    let (width, height, resolution, origin) = (700, 640, 0.05, Position::new(-5.0, -30.5));
    let way: Vec<Position> = WAY_OUT.iter().map(|&(x, y)| Position::new(x, y)).collect();
    let cell = |i: usize| {
        let centre = Position::new(
            origin.x + ((i % width) as f64 + 0.5) * resolution,
            origin.y + ((i / width) as f64 + 0.5) * resolution,
        );
        match way.windows(2).map(|leg| distance(centre, leg[0], leg[1])).fold(f64::INFINITY, f64::min) {
            d if d < 2.0 => Cell::Free,
            d if d < 2.2 => Cell::Occupied,
            _ => Cell::Unknown,
        }
    };
    OccupancyGrid::new(width, height, resolution, origin, (0..width * height).map(cell).collect()).unwrap()
}

fn distance(place: Position, a: Position, b: Position) -> f64 {
    let (dx, dy) = (b.x - a.x, b.y - a.y);
    let t = (((place.x - a.x) * dx + (place.y - a.y) * dy) / (dx * dx + dy * dy)).clamp(0.0, 1.0);
    place.distance(Position::new(a.x + t * dx, a.y + t * dy))
}

pub fn robot() -> NodeId {
    NodeId::new("robot").unwrap()
}

/// A testbed of one robot and its walk.
pub fn testbed(map: Option<OccupancyGrid>, waypoints: Vec<Position>) -> Testbed {
    let domain = DomainId::new("lab").unwrap();
    let hardware = Robot {
        capacity: Capacity { cpus: 2.0, memory_bytes: 8 << 30 },
        model: RobotModel::Turtlebot2,
        network: "corridor".to_owned(),
        tx_power: Dbm(15.0),
        heading: 0.0,
        roaming: Roaming::Instructed,
    };
    Testbed {
        name: "corridor".to_owned(),
        description: String::new(),
        graph: HardwareGraph {
            domains: vec![domain.clone()],
            nodes: vec![Node {
                id: robot(),
                domain,
                position: waypoints.first().copied(),
                kind: NodeKind::Robot(hardware),
            }],
            links: Vec::new(),
            wireless: BTreeMap::new(),
        },
        services: Vec::new(),
        map,
        walks: vec![Walk {
            robot: robot(),
            waypoints,
            speed_limit: 0.3,
            position_interval: Duration::from_millis(200),
        }],
        plugins: Vec::new(),
        seed: 1,
    }
}

/// The whole walk through the corridor.
pub fn corridor() -> Testbed {
    testbed(Some(map()), waypoints())
}

pub fn pose(x: f64, y: f64, heading: f64) -> Pose {
    Pose { x, y, heading, covariance: [0.0; 9], source: PoseSource::Simulator }
}

/// κ of the robot at that pose.
pub fn context(pose: Pose, waypoint: u32) -> Event {
    Event::Robot(RobotContext {
        robot: robot(),
        attachments: Vec::<Attachment>::new(),
        sensors: SensorData {
            pose,
            odometry: pose,
            velocity: Velocity::default(),
            bumper: false,
            nearest_obstacle_m: None,
        },
        waypoint,
    })
}
