//! Walls of a map, merged into few rectangles.

use cotorra_figure::Extent;
use cotorra_graph::{Cell, OccupancyGrid};

/// Cells along the longer side from which rectangles are made, at most. A picture shows no finer ones.
const FINEST: usize = 1000;
/// Rectangles, at most. If there are more, cells are made coarser.
const MOST: usize = 2000;

/// Occupied squares of several cells of a map.
struct Raster {
    columns: usize,
    rows: usize,
    is_occupied: Vec<bool>,
}

impl Raster {
    /// Joins so many cells in both directions. A square is occupied if a cell in it is.
    fn new(map: &OccupancyGrid, joined: usize) -> Self {
        let (columns, rows) = (map.width().div_ceil(joined), map.height().div_ceil(joined));
        let mut is_occupied = vec![false; columns * rows];
        for row in 0..map.height() {
            let begin = row / joined * columns;
            for column in 0..map.width() {
                is_occupied[begin + column / joined] |= map.cell(column, row) == Cell::Occupied;
            }
        }
        Self { columns, rows, is_occupied }
    }

    /// Returns the first and the end of each run of occupied squares in a row.
    fn runs(&self, row: usize) -> impl Iterator<Item = (usize, usize)> {
        let squares = &self.is_occupied[row * self.columns..(row + 1) * self.columns];
        let mut at = 0;
        let chunks = squares.chunk_by(|a, b| a == b).map(move |chunk| {
            at += chunk.len();
            (chunk[0], at - chunk.len(), at)
        });
        chunks.filter(|(is_occupied, ..)| *is_occupied).map(|(_, first, end)| (first, end))
    }

    /// Merges runs, and runs of the same columns in rows that follow each other. Rectangles are columns and rows.
    fn rectangles(&self) -> Vec<[(usize, usize); 2]> {
        let mut done = Vec::new();
        let mut open: Vec<[(usize, usize); 2]> = Vec::new();
        for row in 0..self.rows {
            let next = self.runs(row).map(|run| {
                let above = open.iter().position(|[columns, _]| *columns == run).map(|i| open.swap_remove(i));
                let first = above.map_or(row, |[_, (first, _)]| first);
                [run, (first, row + 1)]
            });
            let next: Vec<_> = next.collect();
            done.append(&mut open);
            open = next;
        }
        done.append(&mut open);
        done.sort_unstable();
        done
    }
}

/// Returns the walls of a map.
pub fn walls(map: &OccupancyGrid) -> Vec<Extent> {
    let mut joined = map.width().max(map.height()).div_ceil(FINEST);
    let mut rectangles = Raster::new(map, joined).rectangles();
    while rectangles.len() > MOST {
        joined *= 2;
        rectangles = Raster::new(map, joined).rectangles();
    }
    let extent = super::extent::of_map(map);
    let side = map.resolution() * joined as f64;
    let wall = |[(left, right), (bottom, top)]: [(usize, usize); 2]| Extent {
        left: extent.left + left as f64 * side,
        bottom: extent.bottom + bottom as f64 * side,
        right: (extent.left + right as f64 * side).min(extent.right),
        top: (extent.bottom + top as f64 * side).min(extent.top),
    };
    rectangles.into_iter().map(wall).collect()
}

#[cfg(test)]
mod tests {
    use cotorra_graph::Position;
    use proptest::prelude::*;

    use super::*;

    fn map(width: usize, is_occupied: impl IntoIterator<Item = bool>) -> OccupancyGrid {
        let cells = is_occupied.into_iter().map(|wall| if wall { Cell::Occupied } else { Cell::Free });
        let cells: Vec<_> = cells.collect();
        OccupancyGrid::new(width, cells.len() / width, 0.5, Position::new(-1.0, 2.0), cells).unwrap()
    }

    #[test]
    fn a_room_is_four_rectangles() {
        let is_wall = |i: usize| [i % 10, i / 10].iter().any(|at| [0, 9].contains(at));
        let walls = walls(&map(10, (0..100).map(is_wall)));
        assert_eq!(walls.len(), 4, "{walls:?}");
        let left = Extent { left: -1.0, bottom: 2.5, right: -0.5, top: 6.5 };
        assert!(walls.contains(&left), "{walls:?}");
    }

    #[test]
    fn noise_is_made_coarser_until_rectangles_are_few() {
        let checkers = map(1000, (0..1_000_000).map(|i: usize| (i + i / 1000).is_multiple_of(2)));
        assert!(walls(&checkers).len() <= MOST);
        // One cell in 30 by 30 is occupied: 1156 squares, however many cells are joined.
        let dots =
            map(1000, (0..1_000_000).map(|i: usize| [i % 1000, i / 1000].iter().all(|at| at % 30 == 0)));
        assert_eq!(walls(&dots).len(), 1156);
    }

    proptest! {
        #[test]
        fn rectangles_cover_each_occupied_cell_once(
            width in 1..20_usize, cells in prop::collection::vec(any::<bool>(), 1..200)
        ) {
            let cells = &cells[..(cells.len() / width * width).max(width).min(cells.len())];
            prop_assume!(cells.len().is_multiple_of(width));
            let map = map(width, cells.iter().copied());
            let walls = walls(&map);
            for (i, is_wall) in cells.iter().enumerate() {
                let Position { x, y, .. } = map.centre(i % width, i / width);
                let over = |wall: &&Extent| (wall.left..wall.right).contains(&x) && (wall.bottom..wall.top).contains(&y);
                prop_assert_eq!(walls.iter().filter(over).count(), usize::from(*is_wall));
            }
        }
    }
}
