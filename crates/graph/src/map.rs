//! The map that robots move on: an occupancy grid in ROS map_server's files (YAML + PGM).

use crate::units::Position;

/// Occupancy of one cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Cell {
    /// Nothing is there.
    Free,
    /// Something is there.
    Occupied,
    /// Unknown.
    Unknown,
}

/// An occupancy grid.
#[derive(Debug, Clone, PartialEq)]
pub struct OccupancyGrid {
    /// Cells in a row.
    width: usize,
    /// Rows.
    height: usize,
    /// Side of a cell, metres.
    resolution: f64,
    /// The lower left corner of the lower left cell.
    origin: Position,
    /// Row by row from the lower left.
    cells: Vec<Cell>,
}

impl OccupancyGrid {
    /// A grid of `width` × `height` cells, row by row from the lower left; `None` if the numbers do not agree.
    pub fn new(
        width: usize,
        height: usize,
        resolution: f64,
        origin: Position,
        cells: Vec<Cell>,
    ) -> Option<Self> {
        let well = resolution.is_finite()
            && resolution > 0.0
            && width > 0
            && width.checked_mul(height) == Some(cells.len())
            && !cells.is_empty();
        well.then_some(Self { width, height, resolution, origin, cells })
    }

    /// Cells in a row.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Side of a cell, metres.
    pub fn resolution(&self) -> f64 {
        self.resolution
    }

    /// The lower left corner of the lower left cell.
    pub fn origin(&self) -> Position {
        self.origin
    }

    /// Column and row of the cell at a place; `None` off the map.
    pub fn index(&self, place: Position) -> Option<(usize, usize)> {
        let column = ((place.x - self.origin.x) / self.resolution).floor();
        let row = ((place.y - self.origin.y) / self.resolution).floor();
        let inside = column >= 0.0 && row >= 0.0 && column < self.width as f64 && row < self.height as f64;
        inside.then_some((column as usize, row as usize))
    }

    /// The middle of a cell.
    pub fn centre(&self, column: usize, row: usize) -> Position {
        Position::new(
            self.origin.x + (column as f64 + 0.5) * self.resolution,
            self.origin.y + (row as f64 + 0.5) * self.resolution,
        )
    }

    /// The cell at a column and row; `Unknown` off the map.
    #[inline]
    pub fn cell(&self, column: usize, row: usize) -> Cell {
        if column < self.width && row < self.height {
            self.cells[row * self.width + column]
        } else {
            Cell::Unknown
        }
    }

    /// Describes a place that is not free ground, such as "in a wall"; `None` for free ground.
    pub fn not_free(&self, place: Position) -> Option<&'static str> {
        match (self.index(place), self.at(place)) {
            (None, _) => Some("off the map"),
            (_, Cell::Occupied) => Some("in a wall"),
            (_, Cell::Unknown) => Some("where the map knows nothing"),
            (_, Cell::Free) => None,
        }
    }

    /// The cell at a place; `Unknown` off the map.
    pub fn at(&self, place: Position) -> Cell {
        self.index(place).map_or(Cell::Unknown, |(column, row)| self.cell(column, row))
    }
}
