//! What stands where: the map, prepared for the two questions that a simulated robot asks of it many times a second -
//! what does a ray hit, and how near is the nearest wall.
//!
//! Each cell holds its clearance, the chessboard distance to the nearest occupied cell. A ray crosses all cells
//! within it in one step, and so hits exactly what a walk from cell to cell (Amanatides and Woo 1987) hits.

use cotorra_graph::{Cell, OccupancyGrid, Position};

/// What stands where. Cells that nobody looked at and everything off the map count as free.
#[derive(Debug, Clone, PartialEq)]
pub struct World {
    width: i32,
    height: i32,
    resolution: f64,
    origin: Position,
    /// In cells, row by row from the lower left; 0 is occupied, 255 is that far or farther.
    clearance: Vec<u8>,
}

impl World {
    /// Open space.
    pub fn open() -> Self {
        Self { width: 0, height: 0, resolution: 1.0, origin: Position::default(), clearance: Vec::new() }
    }

    /// The world that a map shows. Takes a few milliseconds per million cells; share it between robots.
    ///
    /// # Panics
    /// With more than 2³¹ cells in a row or column.
    pub fn new(map: &OccupancyGrid) -> Self {
        let side = |cells: usize| i32::try_from(cells).expect("a map has fewer than 2^31 cells a side");
        let (width, height) = (side(map.width()), side(map.height()));
        let cells = (0..map.height()).flat_map(|row| (0..map.width()).map(move |column| (column, row)));
        let clearance = cells
            .map(|(column, row)| if map.cell(column, row) == Cell::Occupied { 0 } else { u8::MAX })
            .collect();
        let mut world = Self { width, height, resolution: map.resolution(), origin: map.origin(), clearance };
        world.measure_clearance();
        world
    }

    /// Two passes give the chessboard distance exactly (Rosenfeld and Pfaltz 1968).
    fn measure_clearance(&mut self) {
        for row in 0..self.height {
            for column in 0..self.width {
                self.lower(column, row, [(-1, 0), (-1, -1), (0, -1), (1, -1)]);
            }
        }
        for row in (0..self.height).rev() {
            for column in (0..self.width).rev() {
                self.lower(column, row, [(1, 0), (1, 1), (0, 1), (-1, 1)]);
            }
        }
    }

    fn lower(&mut self, column: i32, row: i32, neighbours: [(i32, i32); 4]) {
        let nearest = neighbours
            .into_iter()
            .filter_map(|(right, up)| self.clearance(column + right, row + up))
            .fold(u8::MAX, u8::min)
            .saturating_add(1);
        let cell = &mut self.clearance[row as usize * self.width as usize + column as usize];
        *cell = nearest.min(*cell);
    }

    /// `None` off the map.
    fn clearance(&self, column: i32, row: i32) -> Option<u8> {
        let inside = column >= 0 && row >= 0 && column < self.width && row < self.height;
        inside.then(|| self.clearance[row as usize * self.width as usize + column as usize])
    }

    /// Distance in metres along a ray, given by a unit vector, to the first occupied cell; `None` if there is none
    /// within `reach` metres. Zero from inside an occupied cell.
    pub fn cast(&self, from: Position, direction: (f64, f64), reach: f64) -> Option<f64> {
        let x = (from.x - self.origin.x) / self.resolution;
        let y = (from.y - self.origin.y) / self.resolution;
        let (enter, leave) = self.crossing(x, y, direction)?;
        let end = leave.min(reach / self.resolution);
        let axis = |start: f64, step: f64, cells: i32| {
            let cell = ((start + enter * step).floor() as i32).clamp(0, cells - 1);
            Axis { start, inverse: 1.0 / step, step, cell }
        };
        let (mut across, mut up) = (axis(x, direction.0, self.width), axis(y, direction.1, self.height));
        let mut travelled = enter;
        while travelled <= end {
            let clear = i32::from(self.clearance(across.cell, up.cell)?);
            if clear == 0 {
                return Some(travelled * self.resolution);
            }
            let (exit_across, exit_up) = (across.exit(clear), up.exit(clear));
            if exit_across < exit_up {
                across.cross(clear);
                up.follow(exit_across, clear);
                travelled = travelled.max(exit_across);
            } else {
                up.cross(clear);
                across.follow(exit_up, clear);
                travelled = travelled.max(exit_up);
            }
        }
        None
    }

    /// Where a ray enters and leaves the map, in cells along it; `None` if it misses it (slab method).
    fn crossing(&self, x: f64, y: f64, direction: (f64, f64)) -> Option<(f64, f64)> {
        let slab = |start: f64, step: f64, cells: i32| {
            if step == 0.0 {
                let inside = (0.0..f64::from(cells)).contains(&start);
                return if inside { (f64::NEG_INFINITY, f64::INFINITY) } else { (f64::INFINITY, 0.0) };
            }
            let (near, far) = (-start / step, (f64::from(cells) - start) / step);
            (near.min(far), near.max(far))
        };
        let ((enter_x, leave_x), (enter_y, leave_y)) =
            (slab(x, direction.0, self.width), slab(y, direction.1, self.height));
        let (enter, leave) = (enter_x.max(enter_y).max(0.0), leave_x.min(leave_y));
        (enter <= leave).then_some((enter, leave))
    }

    /// Distance in metres from a place to the nearest occupied cell, or `within` if none is nearer.
    pub fn distance(&self, place: Position, within: f64) -> f64 {
        let x = (place.x - self.origin.x) / self.resolution;
        let y = (place.y - self.origin.y) / self.resolution;
        let reach = within / self.resolution;
        // From within a cell of that clearance, what is occupied is at least one cell less away.
        let clear = self.clearance(x.floor() as i32, y.floor() as i32);
        if clear.is_some_and(|clear| f64::from(clear) - 1.0 >= reach) {
            return within;
        }
        let cells = |at: f64, count: i32| {
            ((at - reach).floor() as i32).max(0)..((at + reach).floor() as i32).saturating_add(1).min(count)
        };
        let gap = |at: f64, cell: i32| (f64::from(cell) - at).max(at - f64::from(cell) - 1.0).max(0.0);
        let mut nearest = reach;
        for row in cells(y, self.height) {
            for column in cells(x, self.width) {
                if self.clearance(column, row) == Some(0) {
                    nearest = nearest.min(gap(x, column).hypot(gap(y, row)));
                }
            }
        }
        (nearest * self.resolution).min(within)
    }
}

/// A ray's way along one axis, in cells.
struct Axis {
    start: f64,
    step: f64,
    inverse: f64,
    cell: i32,
}

impl Axis {
    /// How far along the ray it leaves the cells nearer than `clear`.
    fn exit(&self, clear: i32) -> f64 {
        if self.step > 0.0 {
            (f64::from(self.cell + clear) - self.start) * self.inverse
        } else if self.step < 0.0 {
            (f64::from(self.cell - clear + 1) - self.start) * self.inverse
        } else {
            f64::INFINITY
        }
    }

    /// Goes to the first cell that is not nearer than `clear`.
    fn cross(&mut self, clear: i32) {
        self.cell += if self.step > 0.0 { clear } else { -clear };
    }

    /// Goes to the cell at that distance along the ray. It never goes back, nor out of the free cells: where
    /// rounding would have it otherwise, the ray still ends.
    fn follow(&mut self, travelled: f64, clear: i32) {
        let cell = (self.start + travelled * self.step).floor() as i32;
        self.cell = if self.step >= 0.0 {
            cell.clamp(self.cell, self.cell + clear - 1)
        } else {
            cell.clamp(self.cell - clear + 1, self.cell)
        };
    }
}
