//! Costs of the map's cells for a robot of some size: cells that it cannot be in, distances to obstacles, and regions
//! that it can reach. Computed once per map; planning and control look them up.

use cotorra_graph::{Axis, Cell, OccupancyGrid, Position};

/// Cost from which on the robot's centre cannot be in a cell: it would touch an obstacle.
pub const BLOCKED: u8 = 253;
/// Cost of a cell that is occupied or unknown.
pub const OFF_FLOOR: u8 = 254;
/// Cost of a cell in which the robot all but touches an obstacle.
const TOUCHING: f64 = 252.0;
/// Costs end so far from an obstacle, metres.
const INFLATION_RADIUS: f64 = 1.0;
/// Decay of costs with the distance from an obstacle, 1/m.
const DECAY: f64 = 3.0;
/// Square of more cells than any map has in a row, where no obstacle is.
const FAR: f64 = 1e12;
/// The component of blocked cells.
const NOWHERE: u32 = 0;

/// Costs and distances on the cells of an occupancy grid, for the centre of a round robot.
///
/// Costs fall exponentially with the distance from the nearest obstacle, as in layered costmaps (Lu, Hershberger,
/// Smart 2014, the inflation layer). Unknown cells and those off the map are blocked, but do not inflate.
#[derive(Debug)]
pub struct Costmap {
    width: usize,
    height: usize,
    resolution: f64,
    origin: Position,
    costs: Vec<u8>,
    /// Metres from a cell's centre to the nearest obstacle's edge.
    clearances: Vec<f32>,
    /// Cells with one number are connected.
    components: Vec<u32>,
}

impl Costmap {
    /// The costs on `grid` for a robot of that radius, in metres.
    pub fn new(grid: &OccupancyGrid, robot_radius: f64) -> Self {
        let (width, height) = (grid.width(), grid.height());
        let clearances = clearances(grid);
        let costs: Vec<u8> = (0..width * height)
            .map(|i| match grid.cell(i % width, i / width) {
                Cell::Free => cost(f64::from(clearances[i]), robot_radius),
                Cell::Occupied | Cell::Unknown => OFF_FLOOR,
            })
            .collect();
        let components = components(&costs, width, height);
        Self {
            width,
            height,
            resolution: grid.resolution(),
            origin: grid.origin(),
            costs,
            clearances,
            components,
        }
    }

    /// Cells in a row.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Cells in all.
    pub fn len(&self) -> usize {
        self.costs.len()
    }

    /// Side of a cell, metres.
    pub fn resolution(&self) -> f64 {
        self.resolution
    }

    /// The cell at a place; `None` off the map.
    pub fn cell_at(&self, place: Position) -> Option<usize> {
        let column = ((place.x - self.origin.x) / self.resolution).floor();
        let row = ((place.y - self.origin.y) / self.resolution).floor();
        let inside = column >= 0.0 && row >= 0.0 && column < self.width as f64 && row < self.height as f64;
        inside.then(|| row as usize * self.width + column as usize)
    }

    /// The middle of a cell.
    pub fn centre(&self, cell: usize) -> Position {
        Position::new(
            self.origin.x + ((cell % self.width) as f64 + 0.5) * self.resolution,
            self.origin.y + ((cell / self.width) as f64 + 0.5) * self.resolution,
        )
    }

    /// The cost of a cell.
    pub fn cost(&self, cell: usize) -> u8 {
        self.costs[cell]
    }

    /// The cost at a place; blocked off the map.
    pub fn cost_at(&self, place: Position) -> u8 {
        self.cell_at(place).map_or(BLOCKED, |cell| self.costs[cell])
    }

    /// Metres from a place to the nearest obstacle, to within a cell; zero off the map.
    pub fn clearance_at(&self, place: Position) -> f64 {
        self.cell_at(place).map_or(0.0, |cell| f64::from(self.clearances[cell]))
    }

    /// Whether the robot can get from one cell to the other.
    pub fn connected(&self, a: usize, b: usize) -> bool {
        self.components[a] == self.components[b] && self.components[a] != NOWHERE
    }

    /// Returns the cells of the largest connected floor; none if the robot fits nowhere.
    pub fn largest_component(&self) -> Vec<usize> {
        let count = self.components.iter().max().map_or(0, |&last| last as usize + 1);
        let mut sizes = vec![0_usize; count];
        self.components.iter().for_each(|&component| sizes[component as usize] += 1);
        // The first of equals, so that the same map gives the same floor.
        let reachable = (NOWHERE + 1..count as u32).rev();
        let Some(largest) = reachable.max_by_key(|&component| sizes[component as usize]) else {
            return Vec::new();
        };
        (0..self.len()).filter(|&cell| self.components[cell] == largest).collect()
    }

    /// The nearest cell that the robot can be in, at most `reach` metres away.
    pub fn nearest_free(&self, cell: usize, reach: f64) -> Option<usize> {
        if self.costs[cell] < BLOCKED {
            return Some(cell);
        }
        let (column, row) = ((cell % self.width) as isize, (cell / self.width) as isize);
        let cells = (reach / self.resolution) as isize;
        let free = |(dc, dr): (isize, isize)| {
            let (c, r) = (column + dc, row + dr);
            let inside = c >= 0 && r >= 0 && c < self.width as isize && r < self.height as isize;
            let index = inside.then(|| r as usize * self.width + c as usize)?;
            (self.costs[index] < BLOCKED).then_some((dc * dc + dr * dr, index))
        };
        let around = (-cells..=cells).flat_map(|dr| (-cells..=cells).map(move |dc| (dc, dr)));
        let nearest = around.filter_map(free).min()?;
        (nearest.0 <= cells * cells).then_some(nearest.1)
    }

    /// Returns the cost of driving straight from one place to another, in metres of free floor; `None` if the way is
    /// blocked. Visits each cell on the way.
    pub fn straight_cost(&self, from: Position, to: Position) -> Option<f64> {
        let (start, goal) = (self.cell_at(from)?, self.cell_at(to)?);
        let place = |cell: usize| (cell % self.width, cell / self.width);
        let ((mut column, mut row), (last_column, last_row)) = (place(start), place(goal));
        let mut columns = way(from.x - self.origin.x, to.x - from.x, self.resolution, [column, last_column]);
        let mut rows = way(from.y - self.origin.y, to.y - from.y, self.resolution, [row, last_row]);
        let cost_of = |column: usize, row: usize| self.costs[row * self.width + column];
        let (mut done, mut cost) = (0.0, 0.0);
        loop {
            let cell_cost = cost_of(column, row);
            if cell_cost >= BLOCKED {
                return None;
            }
            let weight = weight(cell_cost);
            if columns.is_over() && rows.is_over() {
                return Some((cost + weight * (1.0 - done)) * from.distance(to));
            }
            let next = columns.next().min(rows.next()).min(1.0);
            cost += weight * (next - done);
            done = next;
            // Through a corner, the cells to both sides must be free, as for a diagonal move.
            let corner = (columns.next() - rows.next()).abs() < 1e-9;
            let beside = || cost_of(columns.beyond(column), row).max(cost_of(column, rows.beyond(row)));
            if corner && beside() >= BLOCKED {
                return None;
            }
            if columns.next() <= rows.next() {
                column = columns.step(column);
            } else {
                row = rows.step(row);
            }
        }
    }

    /// Whether a straight line from one place to another is free.
    pub fn sees(&self, from: Position, to: Position) -> bool {
        self.straight_cost(from, to).is_some()
    }
}

/// Converts the cost of one metre to metres of free floor.
pub fn weight(cost: u8) -> f64 {
    1.0 + f64::from(cost) / 64.0
}

fn cost(clearance: f64, robot_radius: f64) -> u8 {
    if clearance <= robot_radius {
        BLOCKED
    } else if clearance > INFLATION_RADIUS {
        0
    } else {
        (TOUCHING * (-DECAY * (clearance - robot_radius)).exp()) as u8
    }
}

/// Returns a line's way along one axis from its first to its last column (or row), as shares of its length.
fn way(start: f64, span: f64, resolution: f64, [first, last]: [usize; 2]) -> Axis {
    let edge = if last > first { first + 1 } else { first } as f64 * resolution;
    Axis::new(first, last, ((edge - start) / span).clamp(0.0, 1.0), resolution / span.abs())
}

/// Returns the distance from each cell to the nearest occupied one, less half a cell for its edge, in metres.
fn clearances(grid: &OccupancyGrid) -> Vec<f32> {
    let squares = grid.squared_distances(|column, row| grid.cell(column, row) == Cell::Occupied);
    let metres =
        |square: f32| ((f64::from(square).min(FAR).sqrt() - 0.5).max(0.0) * grid.resolution()) as f32;
    squares.into_iter().map(metres).collect()
}

/// Numbers the sets of cells that are connected by their sides. Diagonal moves that cut no corner connect no more.
fn components(costs: &[u8], width: usize, height: usize) -> Vec<u32> {
    let mut components = vec![NOWHERE; costs.len()];
    let mut open = Vec::new();
    let mut number = NOWHERE;
    for seed in 0..costs.len() {
        if costs[seed] >= BLOCKED || components[seed] != NOWHERE {
            continue;
        }
        number += 1;
        components[seed] = number;
        open.push(seed);
        while let Some(cell) = open.pop() {
            let (column, row) = (cell % width, cell / width);
            let sides = [
                (column > 0).then(|| cell - 1),
                (column + 1 < width).then_some(cell + 1),
                (row > 0).then(|| cell - width),
                (row + 1 < height).then_some(cell + width),
            ];
            for side in sides.into_iter().flatten() {
                if costs[side] < BLOCKED && components[side] == NOWHERE {
                    components[side] = number;
                    open.push(side);
                }
            }
        }
    }
    components
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::testing::grid;

    #[test]
    fn costs_fall_with_the_distance_from_a_wall() {
        let map = Costmap::new(&grid(&["#...................."], 0.1), 0.177);
        assert_eq!(map.cost(0), OFF_FLOOR);
        // The second cell's centre is 0.15 m from the wall's edge: the robot would touch it.
        assert_eq!(map.cost(2), BLOCKED);
        assert!(map.cost(3) < BLOCKED);
        assert!((0..20).all(|i| map.cost(i) >= map.cost(i + 1)), "never rising");
        assert_eq!(map.cost(20), 0);
    }

    #[test]
    fn unknown_cells_are_blocked_but_do_not_inflate() {
        let map = Costmap::new(&grid(&["?...."], 0.1), 0.177);
        assert_eq!(map.cost(0), OFF_FLOOR);
        assert_eq!(map.cost(1), 0);
    }

    #[test]
    fn a_straight_line_costs_its_length_over_free_floor_and_nothing_passes_a_wall() {
        let map = Costmap::new(&grid(&["......", "...#..", "......"], 3.0), 0.177);
        let (a, b) = (Position::new(0.1, 0.2), Position::new(17.9, 8.9));
        assert_eq!(map.straight_cost(a, a), Some(0.0));
        let (below, beyond) = (Position::new(17.9, 0.1), Position::new(18.1, 0.1));
        assert!((map.straight_cost(a, below).unwrap() - a.distance(below)).abs() < 1e-9);
        assert_eq!(
            map.straight_cost(a, below).map(|c| c.round()),
            map.straight_cost(below, a).map(|c| c.round())
        );
        assert_eq!(map.straight_cost(a, beyond), None);
        assert!(!map.sees(a, b) && !map.sees(b, a), "through the pillar");
        assert!(!map.sees(Position::new(9.01, 0.1), Position::new(9.01, 8.9)), "just inside its edge");
        assert!(map.sees(Position::new(8.99, 0.1), Position::new(8.99, 8.9)), "just outside");
    }

    #[test]
    fn a_wall_parts_the_floor() {
        let map = Costmap::new(&grid(&["..#..", "..#..", "..#.."], 1.0), 0.177);
        assert!(map.connected(0, 11) && map.connected(3, 14));
        assert!(!map.connected(0, 4) && !map.connected(2, 2));
    }

    #[test]
    fn a_robot_at_a_wall_finds_the_nearest_floor() {
        let map = Costmap::new(&grid(&["#.........."], 0.1), 0.177);
        assert_eq!(map.nearest_free(1, 0.5), Some(3));
        assert_eq!(map.nearest_free(0, 0.2), None);
        assert_eq!(map.nearest_free(7, 0.0), Some(7));
    }

    proptest! {
        #[test]
        fn clearances_are_the_true_distances(cells in prop::collection::vec(prop::bool::weighted(0.1), 12 * 9)) {
            let rows: Vec<String> =
                cells.chunks(12).map(|r| r.iter().map(|&o| if o { '#' } else { '.' }).collect()).collect();
            let map = Costmap::new(&grid(&rows, 1.0), 0.177);
            for i in 0..map.len() {
                let occupied = (0..map.len()).filter(|&j| map.cost(j) == OFF_FLOOR);
                let nearest = occupied.map(|j| map.centre(i).distance(map.centre(j))).min_by(f64::total_cmp);
                if let Some(nearest) = nearest {
                    prop_assert!((f64::from(map.clearances[i]) - (nearest - 0.5).max(0.0)).abs() < 1e-5);
                }
            }
        }
    }
}
