//! Rooms and robots for tests of several modules.

use std::{
    net::{Ipv4Addr, SocketAddrV4},
    time::Duration,
};

use cotorra_graph::{
    Capacity, Cell, Dbm, DomainId, Driver, Node, NodeId, NodeKind, OccupancyGrid, Position, Roaming, Robot,
    RobotModel, Walk,
};

/// Side of a cell, metres.
pub const CELL: f64 = 0.05;

/// Socket of the robots' VNFs.
pub const SERVER: SocketAddrV4 = SocketAddrV4::new(Ipv4Addr::new(10, 0, 0, 9), 7711);

/// Creates an empty room with walls of one cell. Its inner size is `width` × `height`, metres, and (0, 0) its inner lower
/// left corner.
pub fn room(width: f64, height: f64) -> OccupancyGrid {
    let (columns, rows) = ((width / CELL).round() as usize + 2, (height / CELL).round() as usize + 2);
    let wall =
        |row: usize, column: usize| row == 0 || column == 0 || row == rows - 1 || column == columns - 1;
    let cells =
        (0..rows * columns).map(|i| if wall(i / columns, i % columns) { Cell::Occupied } else { Cell::Free });
    OccupancyGrid::new(columns, rows, CELL, Position::new(-CELL, -CELL), cells.collect()).unwrap()
}

pub fn id(name: &str) -> NodeId {
    NodeId::new(name).unwrap()
}

pub fn robot(name: &str, position: Option<Position>) -> Node {
    let robot = Robot {
        capacity: Capacity { cpus: 2.0, memory_bytes: 8 << 30 },
        model: RobotModel::Turtlebot2,
        network: "corridor".to_owned(),
        tx_power: Dbm(15.0),
        heading: 0.0,
        roaming: Roaming::Instructed,
        driver: Driver::default(),
        sensors: Vec::new(),
        radio: None,
    };
    Node { id: id(name), domain: DomainId::new("main").unwrap(), position, kind: NodeKind::Robot(robot) }
}

/// A walk at 0.3 m/s that emits five position packets a second.
pub fn walk(name: &str, waypoints: &[(f64, f64)]) -> Walk {
    Walk {
        robot: id(name),
        next: None,
        waypoints: waypoints.iter().map(|&(x, y)| Position::new(x, y)).collect(),
        speed_limit: 0.3,
        position_interval: Duration::from_millis(200),
    }
}
