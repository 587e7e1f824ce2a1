//! The map, prepared for fast ray casts and distances to the nearest wall.
//!
//! For rays, each cell has a box of free cells in each of the four diagonal directions, with itself in the corner. A ray
//! leaves the box of its direction in one step, and hits exactly the cell that a walk from cell to cell (Amanatides and Woo
//! 1987) hits. Boxes of any shape fit corridors, where rays go far along a wall.

use cotorra_graph::{Cell, OccupancyGrid, Position};

/// Obstacles of a map. Unknown cells and places off the map count as free.
#[derive(Debug, Clone, PartialEq)]
pub struct World {
    width: i32,
    height: i32,
    resolution: f64,
    origin: Position,
    /// Chessboard distance to the nearest occupied cell, in cells, row by row from the lower left; 0 is occupied, 255 is
    /// that far or farther.
    clearance: Vec<u8>,
    /// Width and height of a cell's free box, in cells, for each direction; 0 is occupied, 255 is that far or farther.
    boxes: [Vec<[u8; 2]>; 4],
}

impl World {
    /// Creates open space.
    pub fn open() -> Self {
        Self {
            width: 0,
            height: 0,
            resolution: 1.0,
            origin: Position::default(),
            clearance: Vec::new(),
            boxes: Default::default(),
        }
    }

    /// Prepares a map, in a few milliseconds per million cells. Share the result between robots.
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
        let (resolution, origin) = (map.resolution(), map.origin());
        let mut world = Self { width, height, resolution, origin, clearance, boxes: Default::default() };
        world.boxes = world.free_boxes();
        world.measure_clearance();
        world
    }

    /// Finds a large free box of each cell in each direction, in one pass against the direction. It is the box of the cell
    /// beside it, one wider, or that of the cell above it, one higher, whichever is larger.
    fn free_boxes(&self) -> [Vec<[u8; 2]>; 4] {
        let (width, height) = (self.width as usize, self.height as usize);
        let mut boxes = [(); 4].map(|()| vec![[0; 2]; width * height]);
        // For each column, the free cells from the last row upward, and the box there.
        let mut above = [(); 4].map(|()| vec![(u8::MAX, [u8::MAX, 0]); width]);
        for i in 0..height {
            let mut beside = [(u8::MAX, [0, u8::MAX]); 4];
            for j in 0..width {
                // The four directions are independent, so that they run in parallel.
                for direction in 0..4 {
                    let column = if direction & 1 == 0 { width - 1 - j } else { j };
                    let row = if direction & 2 == 0 { height - 1 - i } else { i };
                    let cell = row * width + column;
                    let (above, beside) = (&mut above[direction][column], &mut beside[direction]);
                    if self.clearance[cell] == 0 {
                        (*above, *beside) = ((0, [u8::MAX, 0]), (0, [0, u8::MAX]));
                        continue;
                    }
                    let (upwards, onwards) = (above.0.saturating_add(1), beside.0.saturating_add(1));
                    let wider = [beside.1[0].saturating_add(1), beside.1[1].min(upwards)];
                    let higher = [above.1[0].min(onwards), above.1[1].saturating_add(1)];
                    let area = |[width, height]: [u8; 2]| u16::from(width) * u16::from(height);
                    let free = if area(wider) > area(higher) { wider } else { higher };
                    (*above, *beside) = ((upwards, free), (onwards, free));
                    boxes[direction][cell] = free;
                }
            }
        }
        boxes
    }

    /// Computes the exact chessboard distances in two passes (Rosenfeld and Pfaltz 1968).
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
    fn index(&self, column: i32, row: i32) -> Option<usize> {
        let inside = column >= 0 && row >= 0 && column < self.width && row < self.height;
        inside.then(|| row as usize * self.width as usize + column as usize)
    }

    /// `None` off the map.
    fn clearance(&self, column: i32, row: i32) -> Option<u8> {
        self.index(column, row).map(|cell| self.clearance[cell])
    }

    /// Returns the distance along a ray, given by a unit vector, to the first occupied cell, metres; `None` if there is
    /// none within `reach` metres. It is 0 from inside an occupied cell.
    pub fn cast(&self, from: Position, direction: (f64, f64), reach: f64) -> Option<f64> {
        let x = (from.x - self.origin.x) / self.resolution;
        let y = (from.y - self.origin.y) / self.resolution;
        let inside = x >= 0.0 && y >= 0.0 && x < f64::from(self.width) && y < f64::from(self.height);
        let enter = if inside { 0.0 } else { self.entry(x, y, direction)? };
        let end = reach / self.resolution;
        let axis = |start: f64, step: f64, cells: i32| {
            let cell = ((start + enter * step) as i32).clamp(0, cells - 1);
            Axis { start, inverse: 1.0 / step, step, cell }
        };
        let (mut across, mut up) = (axis(x, direction.0, self.width), axis(y, direction.1, self.height));
        let boxes = &self.boxes[usize::from(direction.0 < 0.0) + 2 * usize::from(direction.1 < 0.0)];
        let mut travelled = enter;
        while travelled <= end {
            let [wide, high] = boxes[self.index(across.cell, up.cell)?].map(i32::from);
            if wide == 0 {
                return Some(travelled * self.resolution);
            }
            let (exit_across, exit_up) = (across.exit(wide), up.exit(high));
            if exit_across < exit_up {
                across.cross(wide);
                up.follow(exit_across, high);
                travelled = travelled.max(exit_across);
            } else {
                up.cross(high);
                across.follow(exit_up, wide);
                travelled = travelled.max(exit_up);
            }
        }
        None
    }

    /// Whether the face of a cell at a hit looks east or west, rather than north or south.
    pub(crate) fn faces_across(&self, hit: Position) -> bool {
        let off_border = |at: f64, origin: f64| {
            let cells = (at - origin) / self.resolution;
            (cells - cells.round()).abs()
        };
        off_border(hit.x, self.origin.x) <= off_border(hit.y, self.origin.y)
    }

    /// Returns the place where a ray from off the map enters it, in cells along the ray; `None` if it misses the map (slab
    /// method).
    fn entry(&self, x: f64, y: f64, direction: (f64, f64)) -> Option<f64> {
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
        (enter < leave).then_some(enter)
    }

    /// Returns the distance from a place to the nearest occupied cell, metres, or `within` if none is nearer.
    pub fn distance(&self, place: Position, within: f64) -> f64 {
        let x = (place.x - self.origin.x) / self.resolution;
        let y = (place.y - self.origin.y) / self.resolution;
        let reach = within / self.resolution;
        // From anywhere in a cell, occupied cells are at least its clearance minus one away.
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

/// Motion of a ray along one axis, in cells.
struct Axis {
    start: f64,
    step: f64,
    inverse: f64,
    cell: i32,
}

impl Axis {
    /// Returns the distance along the ray at which it leaves the cells nearer than `clear`.
    fn exit(&self, clear: i32) -> f64 {
        if self.step > 0.0 {
            (f64::from(self.cell + clear) - self.start) * self.inverse
        } else if self.step < 0.0 {
            (f64::from(self.cell - clear + 1) - self.start) * self.inverse
        } else {
            f64::INFINITY
        }
    }

    /// Moves to the first cell that is not nearer than `clear`.
    fn cross(&mut self, clear: i32) {
        self.cell += if self.step > 0.0 { clear } else { -clear };
    }

    /// Moves to the cell at this distance along the ray. It never moves back nor out of the free cells, so that the ray
    /// ends despite rounding.
    fn follow(&mut self, travelled: f64, clear: i32) {
        // Truncation one cell up replaces a call of `floor`. Places off the map stay off it.
        let cell = (self.start + travelled * self.step + 1.0) as i32 - 1;
        self.cell = if self.step >= 0.0 {
            cell.clamp(self.cell, self.cell + clear - 1)
        } else {
            cell.clamp(self.cell - clear + 1, self.cell)
        };
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::{FRAC_PI_2, PI};

    use proptest::prelude::*;

    use super::*;
    use crate::fixtures::room;

    fn towards(angle: f64) -> (f64, f64) {
        (angle.cos(), angle.sin())
    }

    /// Creates a grid of 1 m cells; `#` is occupied, the last line is at the bottom.
    fn drawn(lines: &[&str]) -> OccupancyGrid {
        let cell = |c| match c {
            b'#' => Cell::Occupied,
            b'?' => Cell::Unknown,
            _ => Cell::Free,
        };
        let cells = lines.iter().rev().flat_map(|line| line.bytes().map(cell)).collect();
        OccupancyGrid::new(lines[0].len(), lines.len(), 1.0, Position::default(), cells).unwrap()
    }

    /// Casts a ray the slow way, from cell border to cell border.
    fn walked(map: &OccupancyGrid, from: Position, (dx, dy): (f64, f64), reach: f64) -> Option<f64> {
        let cell = |at: f64, origin: f64| ((at - origin) / map.resolution()).floor();
        let (mut column, mut row) = (cell(from.x, map.origin().x), cell(from.y, map.origin().y));
        let mut travelled = 0.0;
        while travelled <= reach && column >= 0.0 && row >= 0.0 {
            if map.cell(column as usize, row as usize) == Cell::Occupied {
                return Some(travelled);
            }
            if column >= map.width() as f64 || row >= map.height() as f64 {
                return None;
            }
            let exit = |cell: f64, step: f64, start: f64, origin: f64| {
                let border = origin + (cell + if step > 0.0 { 1.0 } else { 0.0 }) * map.resolution();
                (border - start) / step
            };
            let exit_x = exit(column, dx, from.x, map.origin().x);
            let exit_y = exit(row, dy, from.y, map.origin().y);
            if exit_x < exit_y {
                (column, travelled) = (column + dx.signum(), exit_x);
            } else {
                (row, travelled) = (row + dy.signum(), exit_y);
            }
        }
        None
    }

    #[test]
    fn rays_in_a_room_end_at_its_walls() {
        let world = World::new(&room(6.0, 4.0));
        let from = Position::new(2.0, 1.5);
        for degrees in 0..360 {
            let (dx, dy) = towards(f64::from(degrees).to_radians());
            let along = |at: f64, step: f64, side: f64| match step {
                step if step > 0.0 => (side - at) / step,
                step if step < 0.0 => -at / step,
                _ => f64::INFINITY,
            };
            let expected = along(from.x, dx, 6.0).min(along(from.y, dy, 4.0));
            let range = world.cast(from, (dx, dy), 12.0).unwrap();
            assert!((range - expected).abs() < 1e-9, "{degrees}°: {range} m, not {expected} m");
        }
    }

    #[test]
    fn rays_end_at_their_reach_and_at_the_edge_of_the_map() {
        let world = World::new(&room(20.0, 4.0));
        let from = Position::new(1.0, 2.0);
        assert_eq!(world.cast(from, (1.0, 0.0), 12.0), None);
        assert!((world.cast(from, (1.0, 0.0), 19.01).unwrap() - 19.0).abs() < 1e-9);
        assert_eq!(World::open().cast(from, (1.0, 0.0), 12.0), None);
        // From off the map, a ray hits the outer face of the wall.
        let outside = Position::new(-3.0, 2.0);
        assert!((world.cast(outside, (1.0, 0.0), 12.0).unwrap() - 2.95).abs() < 1e-9);
        assert_eq!(world.cast(outside, (-1.0, 0.0), 12.0), None);
        assert_eq!(world.cast(Position::new(-3.0, 9.0), (1.0, 0.0), 12.0), None);
    }

    #[test]
    fn only_occupied_cells_stop_a_ray() {
        let world = World::new(&drawn(&[".?..#"]));
        assert_eq!(world.cast(Position::new(0.5, 0.5), (1.0, 0.0), 9.0), Some(3.5));
        assert_eq!(world.cast(Position::new(4.5, 0.5), (1.0, 0.0), 9.0), Some(0.0));
    }

    #[test]
    fn rays_do_not_slip_between_cells_that_touch_at_a_corner() {
        let world = World::new(&drawn(&["#..", ".#.", "..."]));
        for step in 0..100 {
            let from = Position::new(0.1 + f64::from(step) * 0.002, 1.1 + f64::from(step) * 0.002);
            assert!(world.cast(from, towards(PI / 4.0), 9.0).is_some());
        }
    }

    #[test]
    fn ray_that_leaves_the_map_hits_nothing_at_its_edge() {
        let world = World::new(&drawn(&["....", "....", "....", "....", "#..."]));
        let length = 20f64.sqrt();
        assert_eq!(world.cast(Position::new(1.5, 4.5), (-2.0 / length, -4.0 / length), 12.0), None);
    }

    #[test]
    fn distance_is_to_the_nearest_face_or_corner() {
        let world = World::new(&drawn(&[".....", "..#..", "....."]));
        assert_eq!(world.distance(Position::new(0.5, 1.5), 5.0), 1.5);
        assert_eq!(world.distance(Position::new(1.0, 0.0), 5.0), 2f64.sqrt());
        assert_eq!(world.distance(Position::new(2.5, 1.5), 5.0), 0.0);
        assert_eq!(world.distance(Position::new(0.5, 1.5), 1.0), 1.0);
        assert_eq!(world.distance(Position::new(-2.0, 1.5), 5.0), 4.0);
        assert_eq!(World::open().distance(Position::new(0.0, 0.0), 5.0), 5.0);
    }

    #[test]
    fn extreme_places_and_directions_are_answered() {
        let world = World::new(&room(6.0, 4.0));
        for far in [1e300, -1e300, 1e12] {
            assert_eq!(world.cast(Position::new(far, 1.0), (0.0, 1.0), 12.0), None);
            assert_eq!(world.distance(Position::new(far, 1.0), 0.2), 0.2);
        }
        assert!((world.cast(Position::new(2.0, 1.0), towards(FRAC_PI_2), 12.0).unwrap() - 3.0).abs() < 1e-9);
    }

    proptest! {
        #[test]
        fn casts_match_the_slow_walk(
            occupied in proptest::collection::vec(proptest::bool::weighted(0.06), 24 * 17),
            x in 0.0f64..24.0, y in 0.0f64..17.0, angle in -3.0f64..3.0, reach in 0.0f64..40.0,
        ) {
            let cells = occupied.iter().map(|&o| if o { Cell::Occupied } else { Cell::Free }).collect();
            let map = OccupancyGrid::new(24, 17, 0.25, Position::new(-1.0, 2.0), cells).unwrap();
            let from = Position::new(-1.0 + x * 0.25, 2.0 + y * 0.25);
            let skipped = World::new(&map).cast(from, towards(angle), reach);
            let walked = walked(&map, from, towards(angle), reach);
            prop_assert!(
                skipped.zip(walked).map_or(skipped == walked, |(s, w)| (s - w).abs() < 1e-9),
                "{skipped:?} is not {walked:?}"
            );
        }

        #[test]
        fn distances_match_an_exhaustive_search(
            occupied in proptest::collection::vec(proptest::bool::weighted(0.03), 20 * 20),
            x in -3.0f64..23.0, y in -3.0f64..23.0, within in 0.0f64..8.0,
        ) {
            let cells = occupied.iter().map(|&o| if o { Cell::Occupied } else { Cell::Free }).collect();
            let map = OccupancyGrid::new(20, 20, 1.0, Position::default(), cells).unwrap();
            let gap = |at: f64, cell: usize| (cell as f64 - at).max(at - cell as f64 - 1.0).max(0.0);
            let nearest = (0..400)
                .filter(|&i| occupied[i])
                .map(|i| gap(x, i % 20).hypot(gap(y, i / 20)))
                .fold(within, f64::min);
            let found = World::new(&map).distance(Position::new(x, y), within);
            prop_assert!((found - nearest).abs() < 1e-9);
        }
    }
}
