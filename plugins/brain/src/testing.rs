//! Fixtures of unit tests: drawn maps, and testbeds of one robot on them.

use cotorra_graph::{Cell, OccupancyGrid, Position, Testbed};

pub use cotorra_testing::robot::robot;

/// A grid from its rows, the northernmost first: `#` occupied, `.` free, `?` unknown.
pub fn grid(rows: &[impl AsRef<str>], resolution: f64) -> OccupancyGrid {
    let cell = |c: char| match c {
        '#' => Cell::Occupied,
        '.' => Cell::Free,
        _ => Cell::Unknown,
    };
    let width = rows[0].as_ref().len();
    let cells = rows.iter().rev().flat_map(|row| row.as_ref().chars().map(cell)).collect();
    OccupancyGrid::new(width, rows.len(), resolution, Position::new(0.0, 0.0), cells).unwrap()
}

/// A testbed on a drawn map.
pub fn testbed(rows: &[&str], resolution: f64, waypoints: Vec<Position>) -> Testbed {
    let testbed = cotorra_testing::robot::testbed(Some(grid(rows, resolution)), waypoints);
    Testbed { name: "drawn".to_owned(), ..testbed }
}
