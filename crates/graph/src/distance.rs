//! Distances of a map's cells to the nearest wall.

use crate::map::OccupancyGrid;

impl OccupancyGrid {
    /// Returns the squared distance from each cell's centre to that of the nearest wall, in cells, row by row from the lower
    /// left; infinite without walls. `is_wall` gets column and row.
    ///
    /// Distances of up to 4096 cells are exact: a pass along the columns, then lower envelopes of parabolas along the rows
    /// (Felzenszwalb and Huttenlocher, Distance transforms of sampled functions, 2012).
    pub fn squared_distances(&self, is_wall: impl Fn(usize, usize) -> bool) -> Vec<f32> {
        let (width, height) = (self.width(), self.height());
        let is_wall = &is_wall;
        let mut distance: Vec<f32> = (0..height)
            .flat_map(|row| (0..width).map(move |column| is_wall(column, row)))
            .map(|is_wall| if is_wall { 0.0 } else { f32::INFINITY })
            .collect();
        // Whole rows at a time, so that the loop vectorizes over columns.
        let mut nearer = |from: usize, to: usize| {
            let (low, high) = distance.split_at_mut(from.max(to) * width);
            let (low, high) = (&mut low[from.min(to) * width..][..width], &mut high[..width]);
            let (from, to) = if from < to { (low, high) } else { (high, low) };
            for (to, from) in to.iter_mut().zip(from) {
                *to = if *from + 1.0 < *to { *from + 1.0 } else { *to };
            }
        };
        (1..height).for_each(|row| nearer(row - 1, row));
        (1..height).rev().for_each(|row| nearer(row, row - 1));
        distance.iter_mut().for_each(|distance| *distance *= *distance);
        let mut envelope = Envelope::default();
        distance.chunks_mut(width).for_each(|line| envelope.lower(line));
        distance
    }
}

/// A lower envelope of parabolas: place, height, and start of the interval where each is the lowest.
#[derive(Default)]
struct Envelope(Vec<(usize, f32, f64)>);

impl Envelope {
    /// Replaces each value f(q) by the minimum over p of (q - p)² + f(p).
    // Compiled with the crates that use it, some of which are optimised more than this one.
    #[inline]
    fn lower(&mut self, line: &mut [f32]) {
        self.0.clear();
        for (place, &height) in line.iter().enumerate() {
            if height == f32::INFINITY {
                continue;
            }
            let mut from = f64::NEG_INFINITY;
            while let Some(&(other, other_height, other_from)) = self.0.last() {
                let rise = f64::from(height) - f64::from(other_height);
                let (p, q) = (place as f64, other as f64);
                from = (rise + p * p - q * q) / (2.0 * (p - q));
                if from > other_from {
                    break;
                }
                self.0.pop();
                from = f64::NEG_INFINITY;
            }
            self.0.push((place, height, from));
        }
        let mut lowest = 0;
        if self.0.is_empty() {
            return;
        }
        for (place, value) in line.iter_mut().enumerate() {
            while self.0.get(lowest + 1).is_some_and(|next| next.2 <= place as f64) {
                lowest += 1;
            }
            let (centre, height, _) = self.0[lowest];
            *value = (place.abs_diff(centre) as f32).powi(2) + height;
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::{map::Cell, units::Position};

    proptest! {
        #[test]
        fn distances_match_an_exhaustive_search(
            width in 1_usize..12,
            cells in prop::collection::vec(prop::bool::weighted(0.2), 12..150),
        ) {
            let cells = &cells[..cells.len() / width * width];
            let map = OccupancyGrid::new(
                width,
                cells.len() / width,
                0.5,
                Position::new(-3.0, 7.0),
                vec![Cell::Free; cells.len()],
            )
            .unwrap();
            let found = map.squared_distances(|column, row| cells[row * width + column]);
            for (cell, &squared) in found.iter().enumerate() {
                let walls = cells.iter().enumerate().filter(|(_, wall)| **wall);
                let nearest = walls
                    .map(|(wall, _)| {
                        (wall % width).abs_diff(cell % width).pow(2) + (wall / width).abs_diff(cell / width).pow(2)
                    })
                    .min();
                prop_assert_eq!(squared, nearest.map_or(f32::INFINITY, |squared| squared as f32));
            }
        }
    }
}
