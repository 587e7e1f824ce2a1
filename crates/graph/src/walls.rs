//! Walls of the map between two places, and how much they take of a signal. The radio model and coverage decisions share
//! them.

use std::sync::Arc;

use serde::{Deserialize, Deserializer, Serialize, Serializer, de::Error};

use crate::{
    axis::Axis,
    map::{Cell, OccupancyGrid},
    units::Position,
};

/// Loss of signal by walls: the sum of equal losses in the multi-wall model (COST 231, final report, 4.7.2), whose other terms
/// are the path loss and a constant, which is zero here.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct WallLoss {
    /// Loss of each wall that the straight line between two antennas crosses, dB.
    #[serde(rename = "wall_loss_db")]
    pub loss_db: f64,
    /// Loss of all walls between two antennas together, at most, dB; without it there is no bound.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub at_most_db: Option<f64>,
}

/// Attenuation by the walls of a map.
///
/// In JSON, walls are their [`WallLoss`] alone, because a map is large. They cannot be read from there: read the loss, and add
/// the map.
#[derive(Debug, Clone, PartialEq)]
pub struct Walls {
    /// Loss of a signal in them.
    pub loss: WallLoss,
    /// The map, whose occupied cells are the walls.
    pub map: Arc<OccupancyGrid>,
}

impl Serialize for Walls {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.loss.serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for Walls {
    fn deserialize<D: Deserializer<'de>>(_deserializer: D) -> Result<Self, D::Error> {
        Err(D::Error::custom("walls need their map, which is no part of the graph in JSON"))
    }
}

impl Walls {
    /// Returns the loss by walls between two places, in dB; the same in both directions.
    pub fn loss_between(&self, a: Position, b: Position) -> f64 {
        let loss = self.map.walls_between(a, b) as f64 * self.loss.loss_db;
        self.loss.at_most_db.map_or(loss, |most| loss.min(most))
    }
}

impl OccupancyGrid {
    /// Counts the walls that the straight line between two places crosses on the floor, whatever their heights. The number
    /// is the same in both directions.
    ///
    /// A wall is a run of occupied cells along the line, however short: a line that touches the corner of a cell crosses it.
    /// Neither unknown cells nor those off the map belong to walls. A wall that one of the places is in does not count: what
    /// is there hangs on the wall.
    ///
    /// Visits each cell of the line once, in order, and at most as many as the map has rows and columns.
    pub fn walls_between(&self, a: Position, b: Position) -> usize {
        if ![a.x, a.y, b.x, b.y].iter().all(|at| at.is_finite()) {
            return 0;
        }
        // One order for both directions, so that rounding errors are the same.
        let [a, b] = if (b.x, b.y) < (a.x, a.y) { [b, a] } else { [a, b] };
        let Some(Line { from: [mut column, mut row], axes: [mut x, mut y] }) = Line::between(self, a, b)
        else {
            return 0;
        };
        let is_wall = |column, row| self.cell(column, row) == Cell::Occupied;
        let on_map = |place| self.index(place).is_some();
        let mut within = is_wall(column, row);
        let (mut walls, mut counted) = if within && !on_map(a) { (1, true) } else { (0, false) };
        while !(x.is_over() && y.is_over()) {
            let mut touched = false;
            if x.next() < y.next() {
                column = x.step(column);
            } else if y.next() < x.next() {
                row = y.step(row);
            } else {
                // Through a corner to the cell across.
                let (old_column, old_row) = (column, row);
                (column, row) = (x.step(column), y.step(row));
                touched = is_wall(column, old_row) || is_wall(old_column, row);
            }
            let now_within = is_wall(column, row);
            // Free cells that are only touched do not end a wall.
            if !within && (touched || now_within) {
                (walls, counted) = (walls + 1, true);
            }
            within = now_within;
        }
        walls - usize::from(within && counted && on_map(b))
    }
}

/// A line through cells of a map. Lengths are in cells.
struct Line {
    /// Column and row of the first cell.
    from: [usize; 2],
    axes: [Axis; 2],
}

impl Line {
    /// Returns the part on the map; `None` if there is none.
    fn between(map: &OccupancyGrid, a: Position, b: Position) -> Option<Self> {
        let origin = map.origin();
        let in_cells =
            |at: Position| [at.x - origin.x, at.y - origin.y].map(|length| length / map.resolution());
        let (from, to) = (in_cells(a), in_cells(b));
        let cells = [map.width(), map.height()];
        // Shares of the line at which it comes onto the map and leaves it (Liang and Barsky 1984).
        let (mut enters, mut leaves) = (0.0_f64, 1.0_f64);
        for axis in [0, 1] {
            let (length, side) = (to[axis] - from[axis], cells[axis] as f64);
            if length == 0.0 {
                if !(0.0..side).contains(&from[axis]) {
                    return None;
                }
                continue;
            }
            let [low, high] = [-from[axis] / length, (side - from[axis]) / length];
            (enters, leaves) = (enters.max(low.min(high)), leaves.min(low.max(high)));
        }
        if enters > leaves {
            return None;
        }
        let cell = |share: f64| {
            [0, 1].map(|axis| {
                let at = match share {
                    0.0 => from[axis],
                    1.0 => to[axis],
                    _ => from[axis] + share * (to[axis] - from[axis]),
                };
                (at.max(0.0) as usize).min(cells[axis] - 1)
            })
        };
        let (first, last) = (cell(enters), cell(leaves));
        let axis = |axis: usize| {
            // Shares of the line times the lengths along both axes, so that corners are exact.
            let each = (to[1 - axis] - from[1 - axis]).abs();
            let edge = (first[axis] + usize::from(first[axis] < last[axis])) as f64;
            Axis::new(first[axis], last[axis], (edge - from[axis]).abs() * each, each)
        };
        Some(Self { from: first, axes: [axis(0), axis(1)] })
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const SIDE: f64 = 0.5;
    const ORIGIN: Position = Position::new(-1.0, 2.0);

    /// A map from lines, the uppermost row first: `#` is occupied, `?` unknown.
    fn drawn(lines: &[&str]) -> OccupancyGrid {
        let cell = |c| match c {
            b'#' => Cell::Occupied,
            b'?' => Cell::Unknown,
            _ => Cell::Free,
        };
        let cells = lines.iter().rev().flat_map(|line| line.bytes().map(cell)).collect();
        OccupancyGrid::new(lines[0].len(), lines.len(), SIDE, ORIGIN, cells).unwrap()
    }

    /// The place so many cells from the lower left corner.
    fn at((column, row): (f64, f64)) -> Position {
        Position::new(ORIGIN.x + column * SIDE, ORIGIN.y + row * SIDE)
    }

    const ROOMS: [&str; 6] = [
        "...#......", //
        "...#..##..", //
        "...#..##.?",
        "...#.....?",
        "...#.....?",
        "..........",
    ];

    #[test]
    fn walls_match_the_golden_table() {
        let map = drawn(&ROOMS);
        let golden = [
            // In a room.
            ((0.5, 0.5), (9.5, 0.5), 0),
            ((0.5, 5.5), (2.5, 1.5), 0),
            ((0.5, 3.5), (0.5, 3.5), 0),
            // Through one wall, and through two. A thick wall is one.
            ((0.5, 2.5), (5.5, 2.5), 1),
            ((0.5, 3.5), (8.5, 4.5), 2),
            ((0.5, 1.1), (9.5, 1.3), 1),
            // Along a wall, within it and beside it, and slantwise within it.
            ((3.5, 0.5), (3.5, 8.0), 1),
            ((2.9, 0.5), (2.9, 8.0), 0),
            ((3.1, 0.5), (3.9, 7.0), 1),
            // Through the end of a wall, shortly, and past it.
            ((2.0, 0.1), (4.5, 1.25), 1),
            ((2.0, 0.1), (4.5, 1.2), 0),
            // Exactly through corners: of a wall's end, and of a block. Just past one, too.
            ((2.5, 0.5), (3.5, 1.5), 0),
            ((2.5, 1.5), (3.5, 0.5), 1),
            ((5.0, 4.0), (7.0, 2.0), 1),
            ((7.0, 2.0), (9.0, 4.0), 1),
            ((7.1, 2.0), (9.1, 4.0), 0),
            ((5.0, 2.0), (8.5, 5.5), 1),
            // To and from places in a wall: it does not count, others do.
            ((0.5, 2.5), (3.5, 2.5), 0),
            ((3.5, 2.5), (5.5, 2.5), 0),
            ((3.5, 1.5), (3.5, 4.5), 0),
            ((3.5, 3.5), (8.5, 4.5), 1),
            ((0.5, 3.5), (6.5, 4.5), 1),
            ((3.5, 3.5), (6.5, 4.5), 0),
            // Unknown cells, and places off the map.
            ((8.5, 2.5), (15.0, 2.5), 0),
            ((-9.0, 2.5), (15.0, 2.5), 1),
            ((-9.0, 9.0), (15.0, 9.0), 0),
            ((3.5, -4.0), (3.5, 9.0), 1),
        ];
        for (from, to, expected) in golden {
            assert_eq!(map.walls_between(at(from), at(to)), expected, "{from:?} to {to:?}");
        }
    }

    #[test]
    fn walls_in_steps_have_no_gaps() {
        let map = drawn(&["...#", "..#.", ".#..", "#..."]);
        for ((x0, y0), (x1, y1)) in
            [((0.0, 4.0), (4.0, 0.0)), ((0.0, 3.0), (3.0, 0.0)), ((1.0, 4.0), (4.0, 1.0))]
        {
            assert_eq!(map.walls_between(at((x0, y0)), at((x1, y1))), 1, "({x0}, {y0})");
        }
        // Within the wall, through the corners where its cells meet.
        assert_eq!(map.walls_between(at((-1.0, -1.0)), at((5.0, 5.0))), 1);
    }

    #[test]
    fn heights_do_not_matter_and_impossible_places_have_no_walls() {
        let map = drawn(&ROOMS);
        let (from, to) = (at((0.5, 2.5)), at((5.5, 2.5)));
        assert_eq!(map.walls_between(from.at_height(9.0), to.at_height(1.0)), 1);
        for x in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            assert_eq!(map.walls_between(from, Position::new(x, 0.0)), 0);
        }
        for x in [f64::MAX, f64::MIN, 1e300, 5e-324] {
            let walls = map.walls_between(Position::new(-x, x), Position::new(x, -x));
            assert!(walls <= 16, "{walls}");
        }
    }

    #[test]
    fn losses_add_up_to_the_bound() {
        let (from, to) = (at((0.5, 3.5)), at((8.5, 4.5)));
        let map = Arc::new(drawn(&ROOMS));
        let walls = |at_most_db| Walls { loss: WallLoss { loss_db: 3.4, at_most_db }, map: Arc::clone(&map) };
        assert_eq!(walls(None).loss_between(from, to), 6.8);
        assert_eq!(walls(Some(5.0)).loss_between(from, to), 5.0);
    }

    prop_compose! {
        fn any_map()(width in 1..12_usize, height in 1..12_usize)
            (width in Just(width), cells in prop::collection::vec(0..4_u8, width * height)) -> OccupancyGrid {
            let height = cells.len() / width;
            let cell = |c: u8| if c == 0 { Cell::Occupied } else if c == 1 { Cell::Unknown } else { Cell::Free };
            OccupancyGrid::new(width, height, SIDE, ORIGIN, cells.into_iter().map(cell).collect()).unwrap()
        }
    }

    /// Places on the map and off it, many of them on edges and corners.
    fn any_place() -> impl Strategy<Value = Position> {
        let along = || prop_oneof![-3.0..15.0, (-6..30_i32).prop_map(|half| f64::from(half) / 2.0)];
        (along(), along()).prop_map(at)
    }

    /// Counts walls between many points of the line, as the definition says.
    fn sampled(map: &OccupancyGrid, a: Position, b: Position) -> usize {
        let shares = (0..=5000).map(|i| f64::from(i) / 5000.0);
        let cells: Vec<_> = shares.map(|share| map.at(a.towards(b, share)) == Cell::Occupied).collect();
        let walls = cells.chunk_by(|a, b| a == b).filter(|run| run[0]).count();
        let ends = match cells[..] {
            [first, .., last] if cells.iter().all(|cell| *cell) => usize::from(first && last),
            [first, .., last] => usize::from(first) + usize::from(last),
            _ => 0,
        };
        walls - ends
    }

    proptest! {
        #[test]
        fn directions_are_equal(map in any_map(), a in any_place(), b in any_place()) {
            prop_assert_eq!(map.walls_between(a, b), map.walls_between(b, a));
            prop_assert!(map.walls_between(a, b) <= map.width() + map.height());
            prop_assert_eq!(map.walls_between(a, a), 0);
        }

        #[test]
        fn no_wall_is_missed(
            map in any_map(),
            [ax, ay, bx, by] in prop::array::uniform4(-2.987..13.0_f64),
        ) {
            let (a, b) = (at((ax, ay)), at((bx, by)));
            prop_assert!(sampled(&map, a, b) <= map.walls_between(a, b));
        }

        #[test]
        fn every_place_is_well(map in any_map(), [ax, ay, bx, by] in prop::array::uniform4(any::<f64>())) {
            map.walls_between(Position::new(ax, ay), Position::new(bx, by));
        }
    }
}
