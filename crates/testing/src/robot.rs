//! A testbed of one robot and its contexts, for tests of the brain alone.

use std::{collections::BTreeMap, time::Duration};

use cotorra_graph::{
    Attachment, Capacity, Dbm, DomainId, Driver, Event, HardwareGraph, Node, NodeId, NodeKind, OccupancyGrid,
    Pose, PoseSource, Position, Roaming, Robot, RobotContext, RobotModel, SensorData, Testbed, Velocity,
    Walk,
};

/// Radius of the robot, metres.
pub const RADIUS: f64 = 0.1758;

pub fn robot() -> NodeId {
    NodeId::new("robot").unwrap()
}

/// Returns a testbed of one robot and its walk.
pub fn testbed(map: Option<OccupancyGrid>, waypoints: Vec<Position>) -> Testbed {
    let domain = DomainId::new("lab").unwrap();
    let hardware = Robot {
        capacity: Capacity { cpus: 2.0, memory_bytes: 8 << 30 },
        model: RobotModel::Turtlebot2,
        network: "corridor".to_owned(),
        tx_power: Dbm(15.0),
        heading: 0.0,
        radio: None,
        roaming: Roaming::Instructed,
        driver: Driver::default(),
        sensors: Vec::new(),
    };
    Testbed {
        name: "corridor".to_owned(),
        description: String::new(),
        folder: Default::default(),
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
        emulation: Default::default(),
        services: Vec::new(),
        map,
        walks: vec![Walk {
            robot: robot(),
            waypoints,
            next: None,
            speed_limit: 0.3,
            position_interval: Duration::from_millis(200),
        }],
        plugins: Vec::new(),
        wais: Default::default(),
        seed: 1,
        script: Default::default(),
        probes: None,
        retention: Default::default(),
        border: None,
        without_port_security: Vec::new(),
        containers: Default::default(),
    }
}

pub fn pose(x: f64, y: f64, heading: f64) -> Pose {
    Pose::planar(x, y, heading, [0.0; 9], PoseSource::Simulator)
}

/// Returns κ of the robot at a pose.
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
        health: Vec::new(),
        speed_limit_mps: None,
        localization_error_m: None,
    })
}
