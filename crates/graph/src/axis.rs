//! Walks from cell to cell of a map.

/// A straight line's way along one axis of a map's cells (Amanatides and Woo, A fast voxel traversal algorithm for ray tracing,
/// Eurographics 1987).
#[derive(Debug)]
pub struct Axis {
    left: usize,
    forwards: bool,
    next: f64,
    each: f64,
}

impl Axis {
    /// Creates the way from one column, or row, to another. `next` is the length of the line up to the first edge between
    /// cells, and `each` that from edge to edge, in any unit.
    #[inline]
    pub fn new(first: usize, last: usize, next: f64, each: f64) -> Self {
        let left = first.abs_diff(last);
        Self { left, forwards: first < last, next: if left == 0 { f64::INFINITY } else { next }, each }
    }

    /// Returns the length of the line up to the next edge; infinite in the last column or row.
    #[inline]
    pub fn next(&self) -> f64 {
        self.next
    }

    /// Whether no edge is left.
    #[inline]
    pub fn is_over(&self) -> bool {
        self.left == 0
    }

    /// Returns the column or row behind the next edge; the same in the last.
    #[inline]
    pub fn beyond(&self, at: usize) -> usize {
        match (self.left, self.forwards) {
            (0, _) => at,
            (_, true) => at + 1,
            (_, false) => at - 1,
        }
    }

    /// Crosses the next edge, if one is left. Returns the column or row behind it.
    #[inline]
    pub fn step(&mut self, at: usize) -> usize {
        let beyond = self.beyond(at);
        if self.left > 0 {
            self.left -= 1;
            self.next = if self.left == 0 { f64::INFINITY } else { self.next + self.each };
        }
        beyond
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn a_walk_visits_the_cells_of_many_points_of_the_line_in_order(
            [ax, ay, bx, by] in prop::array::uniform4(0.01..9.99_f64),
        ) {
            let axis = |from: f64, to: f64| {
                let edge = if to > from { from.floor() + 1.0 } else { from.floor() };
                Axis::new(from as usize, to as usize, (edge - from) / (to - from), 1.0 / (to - from).abs())
            };
            let (mut x, mut y) = (axis(ax, bx), axis(ay, by));
            let (mut column, mut row) = (ax as usize, ay as usize);
            let mut walked = vec![(column, row)];
            while !(x.is_over() && y.is_over()) {
                let beyond = (x.beyond(column), y.beyond(row));
                if x.next() < y.next() {
                    column = x.step(column);
                    prop_assert_eq!(column, beyond.0);
                } else {
                    row = y.step(row);
                    prop_assert_eq!(row, beyond.1);
                }
                walked.push((column, row));
            }
            prop_assert_eq!((x.step(column), y.step(row)), (bx as usize, by as usize));
            let mut reached = 0;
            for share in (0..=1000).map(|i| f64::from(i) / 1000.0) {
                let at = |from: f64, to: f64| from + share * (to - from);
                let near_edge = |at: f64| (at - at.round()).abs() < 1e-9;
                let (at_x, at_y) = (at(ax, bx), at(ay, by));
                if !near_edge(at_x) && !near_edge(at_y) {
                    let cell = (at_x as usize, at_y as usize);
                    let further = walked[reached..].iter().position(|its| *its == cell);
                    prop_assert!(further.is_some(), "{:?} is not after {} of {:?}", cell, reached, walked);
                    reached += further.unwrap();
                }
            }
        }
    }
}
