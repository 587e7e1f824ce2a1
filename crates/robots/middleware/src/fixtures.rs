//! Rooms and robots for tests of several modules.

use std::{
    net::{Ipv4Addr, SocketAddrV4},
    time::Duration,
};

use cotorra_graph::{Cell, Node, NodeId, NodeKind, OccupancyGrid, Position, Walk};
use cotorra_graph_testing as base;

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
    Node { position, ..base::node(name, NodeKind::Robot(base::robot("corridor"))) }
}

/// A walk at 0.3 m/s that emits five position packets a second.
pub fn walk(name: &str, waypoints: &[(f64, f64)]) -> Walk {
    Walk {
        robot: id(name),
        next: None,
        waypoints: waypoints.iter().map(|&(x, y)| Position::new(x, y)).collect(),
        speed_limit: 0.3,
        position_interval: Duration::from_millis(200),
        random_intervals: None,
    }
}
