//! Finds the cheapest way over a costmap, and makes it one that a robot can follow smoothly.

use std::{cmp::Reverse, collections::BinaryHeap};

use cotorra_graph::Position;

use crate::{
    costmap::{BLOCKED, Costmap, OFF_FLOOR, weight},
    path::Path,
};

/// Longest way of a robot that stands too near an obstacle back to floor that it can plan on, metres.
const ESCAPE: f64 = 0.5;
/// Distance between the points of a smoothed path, metres.
const SPACING: f64 = 0.1;
/// Number of smoothing passes over a path.
const SMOOTHING_PASSES: usize = 40;
/// Pull of a point to its place in the search, each pass.
const KEEP: f64 = 0.1;
/// … and towards the middle of its neighbours.
const SMOOTH: f64 = 0.4;
/// One metre of free floor, in the search's whole numbers per cell side.
const STRAIGHT: f64 = 1000.0;

/// Reason why no path leads to a place.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum Unreachable {
    /// The robot does not say where it is.
    #[error("the robot's pose is not a number")]
    NoPose,
    /// The robot is somewhere that the map does not show.
    #[error("the robot at {0} is off the map's floor")]
    StartOffFloor(Position),
    /// The goal is in a wall, in the unknown or off the map.
    #[error("{0} is not on the map's floor")]
    GoalOffFloor(Position),
    /// The goal is where the robot would touch something.
    #[error("{goal} is {clearance:.2} m from an obstacle, too near for the robot")]
    GoalTooNear {
        /// The goal.
        goal: Position,
        /// Distance of the obstacle, metres.
        clearance: f64,
    },
    /// Walls are between.
    #[error("no way leads from {from} to {to}")]
    NoWay {
        /// The start.
        from: Position,
        /// The goal.
        to: Position,
    },
}

/// A* on the eight neighbours of a cell (Hart, Nilsson, Raphael 1968), with the octile distance as its heuristic.
/// Its buffers are kept from one search to the next.
#[derive(Debug, Clone, Default)]
pub struct Planner {
    visits: Vec<Visit>,
    search: u32,
    open: BinaryHeap<Reverse<u64>>,
    cells: Vec<usize>,
}

/// State of a cell in a search.
#[derive(Debug, Clone, Copy, Default)]
struct Visit {
    /// The search that wrote this; another's is void.
    search: u32,
    /// Cost from the start.
    cost: u32,
    /// The cell before it.
    before: u32,
    closed: bool,
}

impl Planner {
    /// The way from one place to another; it begins at `from`, unless the robot stands too near an obstacle there,
    /// and ends at `to`.
    ///
    /// # Errors
    /// [`Unreachable`] says why there is none.
    pub fn plan(&mut self, map: &Costmap, from: Position, to: Position) -> Result<Path, Unreachable> {
        let (start, goal) = ends(map, from, to)?;
        let begin = if map.cell_at(from) == Some(start) { from } else { map.centre(start) };
        // Most legs of a walk are straight over free floor, where no search can do better.
        let no_dearer = |cost| cost <= begin.distance(to) + 1e-6;
        if start == goal || map.straight_cost(begin, to).is_some_and(no_dearer) {
            return Ok(Path::new(&[begin, to], SPACING));
        }
        self.search(map, start, goal);
        let corners = self.pull_taut(map, begin, to);
        let mut path = Path::new(&corners, SPACING);
        smooth(map, path.points_mut());
        Ok(path)
    }

    /// Leaves the cheapest cells from start to goal, which are connected, in `self.cells`.
    fn search(&mut self, map: &Costmap, start: usize, goal: usize) {
        if self.visits.len() != map.len() || self.search == u32::MAX {
            self.visits = vec![Visit::default(); map.len()];
            self.search = 0;
        }
        self.search += 1;
        self.open.clear();
        self.visits[start] = Visit { search: self.search, cost: 0, before: start as u32, closed: false };
        self.open.push(entry(octile(map, start, goal), start));
        while let Some(Reverse(entry)) = self.open.pop() {
            let cell = entry as u32 as usize;
            if cell == goal {
                break;
            }
            if std::mem::replace(&mut self.visits[cell].closed, true) {
                continue;
            }
            let cost = self.visits[cell].cost;
            for (neighbour, step) in neighbours(map, cell) {
                let reached = cost.saturating_add(step);
                let visit = &mut self.visits[neighbour];
                if visit.search != self.search || (!visit.closed && reached < visit.cost) {
                    *visit = Visit { search: self.search, cost: reached, before: cell as u32, closed: false };
                    self.open
                        .push(self::entry(reached.saturating_add(octile(map, neighbour, goal)), neighbour));
                }
            }
        }
        self.cells.clear();
        let mut cell = goal;
        self.cells.push(cell);
        while cell != start {
            cell = self.visits[cell].before as usize;
            self.cells.push(cell);
        }
        self.cells.reverse();
    }

    /// Replaces stretches of the found cells by straight lines where these cost no more, as one pulls a string taut.
    fn pull_taut(&self, map: &Costmap, from: Position, to: Position) -> Vec<Position> {
        let last = self.cells.len() - 1;
        let place = |i: usize| match i {
            0 => from,
            i if i == last => to,
            i => map.centre(self.cells[i]),
        };
        let found = |i: usize| f64::from(self.visits[self.cells[i]].cost) / STRAIGHT * map.resolution();
        // Two cells' worth of grace: the ends lie anywhere in theirs.
        let grace = 2.0 * map.resolution();
        let mut corners = vec![from];
        let mut anchor = 0;
        while anchor < last {
            let cheaper = |&next: &usize| {
                let straight = map.straight_cost(place(anchor), place(next));
                straight.is_some_and(|cost| cost <= found(next) - found(anchor) + grace)
            };
            // The neighbour itself is always within reach.
            let next = (anchor + 2..=last).take_while(cheaper).last().unwrap_or(anchor + 1);
            corners.push(place(next));
            anchor = next;
        }
        corners
    }
}

/// The cells to search between.
fn ends(map: &Costmap, from: Position, to: Position) -> Result<(usize, usize), Unreachable> {
    let start = map.cell_at(from).and_then(|cell| map.nearest_free(cell, ESCAPE));
    let start = start.ok_or(Unreachable::StartOffFloor(from))?;
    let goal = map.cell_at(to).ok_or(Unreachable::GoalOffFloor(to))?;
    if map.cost(goal) >= BLOCKED {
        return Err(if map.cost(goal) == OFF_FLOOR {
            Unreachable::GoalOffFloor(to)
        } else {
            Unreachable::GoalTooNear { goal: to, clearance: map.clearance_at(to) }
        });
    }
    if map.connected(start, goal) { Ok((start, goal)) } else { Err(Unreachable::NoWay { from, to }) }
}

/// The least total first; among equals the lowest cell, so that a search never depends on chance.
fn entry(total: u32, cell: usize) -> Reverse<u64> {
    Reverse(u64::from(total) << 32 | cell as u64)
}

/// Cost of the cheapest way over an empty floor.
fn octile(map: &Costmap, a: usize, b: usize) -> u32 {
    let columns = (a % map.width()).abs_diff(b % map.width());
    let rows = (a / map.width()).abs_diff(b / map.width());
    let (long, short) = (columns.max(rows), columns.min(rows));
    (long - short) as u32 * STRAIGHT as u32 + short as u32 * DIAGONAL as u32
}

const DIAGONAL: f64 = STRAIGHT * std::f64::consts::SQRT_2;

/// The neighbours that can be driven to without cutting a corner, and what that costs.
fn neighbours(map: &Costmap, cell: usize) -> impl Iterator<Item = (usize, u32)> {
    let width = map.width();
    let (column, row) = (cell % width, cell / width);
    let free = |inside: bool, neighbour: usize| inside && map.cost(neighbour) < BLOCKED;
    let (has_west, has_east) = (column > 0, column + 1 < width);
    let (has_south, has_north) = (row > 0, (row + 1) * width < map.len());
    let west = free(has_west, cell.wrapping_sub(1));
    let east = free(has_east, cell + 1);
    let south = free(has_south, cell.wrapping_sub(width));
    let north = free(has_north, cell + width);
    let cost = move |neighbour: usize, length: f64| (length * weight(map.cost(neighbour))) as u32;
    let straight = [
        (west, cell.wrapping_sub(1)),
        (east, cell + 1),
        (south, cell.wrapping_sub(width)),
        (north, cell + width),
    ];
    let diagonal = [
        (south && west, cell.wrapping_sub(width + 1)),
        (south && east, cell.wrapping_sub(width).wrapping_add(1)),
        (north && west, (cell + width).wrapping_sub(1)),
        (north && east, cell + width + 1),
    ];
    let straight = straight.into_iter().filter(|s| s.0).map(move |(_, n)| (n, cost(n, STRAIGHT)));
    let diagonal = diagonal.into_iter().filter(|d| d.0).map(move |(_, n)| (n, cost(n, DIAGONAL)));
    straight.chain(diagonal.filter(|d| map.cost(d.0) < BLOCKED))
}

/// Rounds the corners: each point but the ends is moved between staying and the middle of its neighbours (Thrun's
/// weighted smoothing by gradient descent), unless that costs more than where the search put it.
fn smooth(map: &Costmap, points: &mut [Position]) {
    let found = points.to_vec();
    for _ in 0..SMOOTHING_PASSES {
        for i in 1..points.len().saturating_sub(1) {
            let (before, here, after) = (points[i - 1], points[i], points[i + 1]);
            let pull = |here: f64, found: f64, before: f64, after: f64| {
                here + KEEP * (found - here) + SMOOTH * (before + after - 2.0 * here)
            };
            let moved = Position::new(
                pull(here.x, found[i].x, before.x, after.x),
                pull(here.y, found[i].y, before.y, after.y),
            );
            let allowed = map.cost_at(found[i]).max(map.cost_at(here));
            let fits = map.cost_at(moved) <= allowed && map.sees(before, moved) && map.sees(moved, after);
            if fits {
                points[i] = moved;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::testing::grid;

    fn map(rows: &[&str]) -> Costmap {
        Costmap::new(&grid(rows, 0.5), 0.177)
    }

    /// The cheapest cost by trying all ways (Bellman-Ford).
    fn cheapest(map: &Costmap, start: usize, goal: usize) -> u32 {
        let mut costs = vec![u32::MAX; map.len()];
        costs[start] = 0;
        loop {
            let before = costs.clone();
            for cell in (0..map.len()).filter(|&cell| before[cell] < u32::MAX) {
                for (neighbour, step) in neighbours(map, cell) {
                    costs[neighbour] = costs[neighbour].min(before[cell] + step);
                }
            }
            if costs == before {
                return costs[goal];
            }
        }
    }

    #[test]
    fn over_free_floor_it_goes_straight() {
        let map = map(&[".........."; 10]);
        let path = Planner::default().plan(&map, Position::new(0.3, 0.3), Position::new(4.8, 3.1)).unwrap();
        let line = Path::new(&[Position::new(0.3, 0.3), Position::new(4.8, 3.1)], SPACING);
        assert_eq!(path, line);
    }

    #[test]
    fn around_a_wall_it_keeps_its_distance_and_rounds_the_corner() {
        let map = map(&[
            "............",
            "............",
            "............",
            "#######.....",
            "............",
            "............",
        ]);
        let (from, to) = (Position::new(0.6, 0.3), Position::new(0.6, 2.7));
        let path = Planner::default().plan(&map, from, to).unwrap();
        let points = path.points();
        assert_eq!((points[0], points[points.len() - 1]), (from, to));
        assert!(points.iter().all(|&p| map.clearance_at(p) > 0.177));
        let turn = |w: &[Position]| {
            let heading = |a: Position, b: Position| (b.y - a.y).atan2(b.x - a.x);
            (heading(w[1], w[2]) - heading(w[0], w[1])).sin().abs()
        };
        assert!(points.windows(3).all(|w| turn(w) < 0.6), "no sharp corner");
    }

    #[test]
    fn missing_paths_have_a_reason() {
        let map = map(&["..#..?", "..#..?", "..#..?"]);
        let plan = |from, to| Planner::default().plan(&map, from, to).unwrap_err();
        let (left, right) = (Position::new(0.3, 0.8), Position::new(2.2, 0.8));
        assert_eq!(plan(left, right), Unreachable::NoWay { from: left, to: right });
        let wall = Position::new(1.2, 0.8);
        assert_eq!(plan(left, wall), Unreachable::GoalOffFloor(wall));
        let outside = Position::new(-3.0, 0.8);
        assert_eq!(plan(left, outside), Unreachable::GoalOffFloor(outside));
        assert_eq!(plan(outside, left), Unreachable::StartOffFloor(outside));
    }

    #[test]
    fn robot_at_a_wall_plans_away_from_it() {
        let map = Costmap::new(&grid(&["#..................."], 0.1), 0.177);
        let path =
            Planner::default().plan(&map, Position::new(0.15, 0.05), Position::new(1.5, 0.05)).unwrap();
        assert_eq!(path.points()[0], map.centre(3));
    }

    proptest! {
        #[test]
        fn no_way_is_cheaper_and_none_leaves_the_floor(
            cells in prop::collection::vec(prop::bool::weighted(0.25), 14 * 11),
            pairs in prop::collection::vec((0usize..14 * 11, 0usize..14 * 11), 1..6),
        ) {
            let rows: Vec<String> =
                cells.chunks(14).map(|r| r.iter().map(|&o| if o { '#' } else { '.' }).collect()).collect();
            let map = Costmap::new(&grid(&rows, 0.5), 0.177);
            let mut planner = Planner::default();
            for (start, goal) in pairs {
                let (from, to) = (map.centre(start), map.centre(goal));
                if map.connected(start, goal) {
                    planner.search(&map, start, goal);
                    prop_assert_eq!(planner.visits[goal].cost, cheapest(&map, start, goal));
                    let path = planner.plan(&map, from, to).unwrap();
                    prop_assert!(path.points().iter().all(|&p| map.cost_at(p) < BLOCKED), "{path:?}");
                    prop_assert_eq!(Planner::default().plan(&map, from, to).unwrap(), path, "buffers leave no trace");
                } else {
                    prop_assert!(map.cost(start) >= BLOCKED || planner.plan(&map, from, to).is_err());
                }
            }
        }
    }
}
