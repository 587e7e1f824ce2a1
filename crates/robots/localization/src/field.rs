//! The likelihood field: scores of a beam's end at each place of the map (Probabilistic Robotics, ch. 6.4, table 6.3).
//! Scores are looked up in a table and summed at the speed of memory.

use std::f64::consts::PI;

use cotorra_graph::{Cell, OccupancyGrid};
use cotorra_numbers::Draws;

use crate::{
    error::LocalizationError,
    fast::sin_cos,
    geometry::Pose2,
    parameters::{Parameters, Weighing},
    place::{Place, Places},
    scan::Beams,
};

/// A map that is prepared for a filter's parameters. Share it between the filters of robots of the same kind.
#[derive(Debug, Clone, PartialEq)]
pub struct LikelihoodField {
    resolution: f64,
    /// The lower left corner, metres.
    origin: (f64, f64),
    /// Columns and rows.
    size: (usize, usize),
    /// Score of a beam that ends in each cell. A border stands for all places off the map. Rows have 2^`shift` +
    /// [`BETWEEN_ROWS`] cells.
    table: Vec<f32>,
    shift: u32,
    /// Scores of a beam at a wall, and far from all walls.
    range: [f32; 2],
    /// Runs of free cells in rows: index of the first, and number of free cells up to the run's end.
    free: Vec<(usize, u64)>,
    /// The map in larger cells and with wider walls, for searches of the whole map.
    coarse: Option<Box<Self>>,
}

/// Cells per cell of the coarse map, in each direction, and the deviation of its walls, metres.
const COARSER: usize = 4;
const COARSE_SIGMA: f64 = 0.25;

/// Adding it to a number leaves the integer part in the lowest bits, because an `f32` from 2²³ to 2²⁴ counts ones. That
/// avoids the checks of a conversion. A number on the border between two cells may go to either.
const WHOLE: f32 = 8_388_608.0 - 0.5;
const WHOLE_BITS: u32 = 0x007f_ffff;

impl LikelihoodField {
    /// Prepares a map. It takes some 30 ms per million cells.
    pub fn new(map: &OccupancyGrid, parameters: &Parameters) -> Self {
        let mut wider = *parameters;
        wider.beams.sigma_hit = wider.beams.sigma_hit.max(COARSE_SIGMA);
        let coarse = coarser(map).map(|coarse| Box::new(Self::of(&coarse, &wider, None)));
        Self::of(map, parameters, coarse)
    }

    fn of(map: &OccupancyGrid, parameters: &Parameters, coarse: Option<Box<Self>>) -> Self {
        let (width, height) = (map.width(), map.height());
        let (model, resolution) = (&parameters.beams, map.resolution());
        let shift = (width + 2).next_power_of_two().trailing_zeros();
        let likelihood = matches!(parameters.weighing, Weighing::Likelihood { .. });
        let squared = squared_distances(map, likelihood);
        let score = |squared_cells: f32| {
            let distance = f64::from(squared_cells).sqrt() * resolution;
            let distance = distance.min(model.likelihood_max_dist);
            let hit = (-distance.powi(2) / (2.0 * model.sigma_hit.powi(2))).exp();
            // Like AMCL, without the normalization of the Gaussian.
            let p = model.z_hit * hit + model.z_rand / model.range_max;
            match parameters.weighing {
                Weighing::Likelihood { .. } => p.ln() as f32,
                Weighing::Amcl => p.powi(3) as f32,
            }
        };
        // Squared distances between cells are integers, and scores are constant from `likelihood_max_dist` on.
        let most = (model.likelihood_max_dist / resolution).powi(2).ceil() as usize;
        let scores: Vec<f32> = (0..=most).map(|squared| score(squared as f32)).collect();
        let row_length = (1 << shift) + BETWEEN_ROWS as usize;
        let mut table = vec![scores[most]; (height + 2) * row_length];
        for (row, distances) in squared.chunks(width).enumerate() {
            let begin = (row + 1) * row_length + 1;
            for (cell, &distance) in table[begin..].iter_mut().zip(distances) {
                *cell = scores[(distance as usize).min(most)];
            }
        }
        let mut free: Vec<(usize, u64)> = Vec::new();
        let mut count = 0;
        for row in 0..height {
            let mut inside = false;
            for column in 0..width {
                let is_free = map.cell(column, row) == Cell::Free;
                if is_free {
                    count += 1;
                    match free.last_mut() {
                        Some(run) if inside => run.1 = count,
                        _ => free.push((row * width + column, count)),
                    }
                }
                inside = is_free;
            }
        }
        let origin = (map.origin().x, map.origin().y);
        Self {
            resolution,
            origin,
            size: (width, height),
            table,
            shift,
            range: [scores[0], scores[most]],
            free,
            coarse,
        }
    }

    /// Returns the `most` places where the scan fits best on the coarse map. It tries each free cell with `headings`
    /// headings.
    pub(crate) fn search(&self, beams: &Beams, headings: usize, most: usize) -> Places {
        let mut found = Vec::new();
        if let Some(coarse) = &self.coarse {
            let shrunk = |ends: &[f32]| ends.iter().map(|end| end / COARSER as f32).collect();
            let beams = Beams { x: shrunk(&beams.x), y: shrunk(&beams.y), ..beams.clone() };
            coarse.search_each_cell(&beams, headings, most, &mut found);
        }
        let mut places = Places::default();
        for (_, place) in found {
            let fine = |coarse: f32| (coarse - 1.0) * COARSER as f32 + 1.0;
            places.push(Place { column: fine(place.column), row: fine(place.row), ..place });
        }
        places
    }

    /// Searches this map. With one heading, a beam ends at the same offset from each cell, so that lookups for neighbouring
    /// cells are neighbours in memory.
    fn search_each_cell(&self, beams: &Beams, headings: usize, most: usize, found: &mut Vec<(f32, Place)>) {
        let (width, height) = self.size;
        let row_length = (1 << self.shift) + BETWEEN_ROWS as usize;
        let mut scores = vec![0.0; width];
        let mut least = f32::NEG_INFINITY;
        for nth in 0..headings {
            let heading = (nth as f64 / headings as f64 - 0.5) * 2.0 * PI;
            let (sin, cos) = (heading.sin() as f32, heading.cos() as f32);
            let ends = beams.x.iter().zip(&beams.y).zip(&beams.weight);
            let ends: Vec<(isize, isize, f32)> = ends
                .map(|((x, y), weight)| {
                    ((cos * x - sin * y).round() as isize, (sin * x + cos * y).round() as isize, *weight)
                })
                .collect();
            let mut before = 0;
            for &(first, upto) in &self.free {
                let (row, column) = (first / width + 1, first % width + 1);
                let scores = &mut scores[..(upto - before) as usize];
                before = upto;
                scores.fill(0.0);
                for &(x, y, weight) in &ends {
                    let row = row as isize + y;
                    if row < 1 || row > height as isize {
                        continue;
                    }
                    // Cells of the run from which the beam ends on the map.
                    let begin = (1 - column as isize - x).max(0);
                    let end = (width as isize + 1 - column as isize - x).min(scores.len() as isize);
                    if begin >= end {
                        continue;
                    }
                    let cell = row as usize * row_length + (column as isize + x + begin) as usize;
                    let scores = &mut scores[begin as usize..end as usize];
                    for (score, at) in scores.iter_mut().zip(&self.table[cell..]) {
                        *score += weight * (at - self.range[1]);
                    }
                }
                for (nth, &score) in scores.iter().enumerate() {
                    // Only local maxima count.
                    let beside = |nth: usize| scores.get(nth).is_some_and(|beside| *beside > score);
                    if score > least && !beside(nth.wrapping_sub(1)) && !beside(nth + 1) {
                        let column = (column + nth) as f32 + 0.5;
                        found.push((score, Place { column, row: row as f32 + 0.5, heading: heading as f32 }));
                    }
                }
                if found.len() > 4 * most {
                    found.select_nth_unstable_by(most, |a, b| b.0.total_cmp(&a.0));
                    least = found[most].0;
                    found.truncate(most);
                }
            }
        }
        found.sort_by(|a, b| b.0.total_cmp(&a.0));
        found.truncate(most);
    }

    /// Checks that a robot can be localized on the map.
    ///
    /// # Errors
    /// [`LocalizationError::NoWall`] or [`LocalizationError::NoFreeSpace`].
    pub fn check(&self) -> Result<(), LocalizationError> {
        if self.free.is_empty() {
            return Err(LocalizationError::NoFreeSpace);
        }
        let walls = self.table.iter().any(|score| *score != self.range[1]);
        if walls { Ok(()) } else { Err(LocalizationError::NoWall) }
    }

    /// Draws a pose uniformly from free space; `None` if there is none.
    pub(crate) fn anywhere(&self, random: &mut Draws) -> Option<Place> {
        let all = self.free.last()?.1;
        let nth = random.below(all as usize) as u64;
        let run = self.free.partition_point(|run| run.1 <= nth);
        let before = run.checked_sub(1).map_or(0, |before| self.free[before].1);
        let cell = self.free[run].0 + (nth - before) as usize;
        let mut within = || random.unit() as f32;
        Some(Place {
            column: (cell % self.size.0) as f32 + 1.0 + within(),
            row: (cell / self.size.0) as f32 + 1.0 + within(),
            heading: (within() - 0.5) * std::f32::consts::TAU,
        })
    }

    /// Returns the share of the votes at walls that gives this score, if all others are far from walls.
    pub(crate) fn hit_share(&self, score: f32, votes: f32) -> f64 {
        let [hit, miss] = self.range;
        f64::from((score / votes - miss) / (hit - miss))
    }

    /// Returns the score of a beam that ends at this column and row, or at the nearest cell of the map.
    pub(crate) fn at(&self, column: f64, row: f64) -> f32 {
        let whole = |value: f64, size: usize| (value as usize).clamp(1, size.max(1));
        let row_length = (1 << self.shift) + BETWEEN_ROWS as usize;
        self.table[whole(row, self.size.1) * row_length + whole(column, self.size.0)]
    }

    /// Returns the probability that a beam with this score ended at a wall.
    pub(crate) fn hit(&self, score: f64) -> f64 {
        1.0 - (f64::from(self.range[1]) - score).exp()
    }

    /// Returns the second moments of column, row and heading about a place, in cells, for a robot anywhere on the map.
    pub(crate) fn anywhere_about(&self, column: f64, row: f64) -> [f64; 9] {
        let (width, height) = (self.size.0 as f64, self.size.1 as f64);
        let (x, y) = (width / 2.0 + 1.0 - column, height / 2.0 + 1.0 - row);
        let (along, across) = (width * width / 12.0 + x * x, height * height / 12.0 + y * y);
        [along, x * y, 0.0, x * y, across, 0.0, 0.0, 0.0, PI * PI / 3.0]
    }

    pub(crate) fn resolution(&self) -> f64 {
        self.resolution
    }

    pub(crate) fn place(&self, pose: Pose2) -> Place {
        Place {
            column: ((pose.x - self.origin.0) / self.resolution + 1.0) as f32,
            row: ((pose.y - self.origin.1) / self.resolution + 1.0) as f32,
            heading: pose.heading as f32,
        }
    }

    pub(crate) fn pose(&self, column: f64, row: f64, heading: f64) -> Pose2 {
        Pose2::new(
            self.origin.0 + (column - 1.0) * self.resolution,
            self.origin.1 + (row - 1.0) * self.resolution,
            heading,
        )
    }

    /// Writes Σ ωᵢ · table[end of beam i] for the robot at each place; the beams' ends are in cells.
    ///
    /// It goes beam by beam. The ends of one beam are near each other for all particles, so that lookups stay in the
    /// fastest cache.
    pub(crate) fn score(&self, places: &Places, beams: &Beams, scores: &mut Vec<f32>) {
        scores.clear();
        scores.resize(places.len(), 0.0);
        let longest = beams.x.iter().zip(&beams.y).map(|(x, y)| x * x + y * y).fold(0.0, f32::max).sqrt();
        let (mut sin, mut cos, mut cells) = ([0.0; BLOCK], [0.0; BLOCK], [[0; BLOCK]; AT_ONCE]);
        let blocks = places.column.chunks(BLOCK).zip(places.row.chunks(BLOCK));
        let blocks = blocks.zip(places.heading.chunks(BLOCK)).zip(scores.chunks_mut(BLOCK));
        for (((column, row), heading), scores) in blocks {
            for ((sin, cos), &heading) in sin.iter_mut().zip(&mut cos).zip(heading) {
                (*sin, *cos) = sin_cos(heading);
            }
            let inside =
                self.is_inside(column, self.size.0, longest) && self.is_inside(row, self.size.1, longest);
            let places = [column, row, &sin, &cos];
            let all = beams.x.chunks(AT_ONCE).zip(beams.y.chunks(AT_ONCE)).zip(beams.weight.chunks(AT_ONCE));
            for ((x, y), weight) in all {
                let mut weights = [0.0; AT_ONCE];
                weights[..weight.len()].copy_from_slice(weight);
                for ((&x, &y), cells) in x.iter().zip(y).zip(&mut cells) {
                    if inside {
                        self.ends::<false>(places, (x, y), cells);
                    } else {
                        self.ends::<true>(places, (x, y), cells);
                    }
                }
                let [a, b, c, d] = &cells;
                for ((((score, &a), &b), &c), &d) in scores.iter_mut().zip(a).zip(b).zip(c).zip(d) {
                    let at = |cell: u32| self.table[cell as usize];
                    *score +=
                        (weights[0] * at(a) + weights[1] * at(b)) + (weights[2] * at(c) + weights[3] * at(d));
                }
            }
        }
    }

    /// Whether all beams end on the map from all of these columns or rows.
    fn is_inside(&self, values: &[f32], size: usize, longest: f32) -> bool {
        let last = size as f32 + 1.0 - longest;
        values.iter().all(|&value| value > longest + 1.0 && value < last)
    }

    /// Writes the cells in which a beam ends for robots at these places. With `CLAMPED`, ends off the map go to the border.
    #[inline(always)]
    fn ends<const CLAMPED: bool>(
        &self,
        [column, row, sin, cos]: [&[f32]; 4],
        (x, y): (f32, f32),
        cells: &mut [u32],
    ) {
        let last = (self.size.0 as f32 + 1.5, self.size.1 as f32 + 1.5);
        // A plain comparison is a single instruction; `clamp` takes more, because it handles NaN.
        let within = |value: f32, last: f32| {
            if !CLAMPED {
                return value;
            }
            let value = if value > 0.5 { value } else { 0.5 };
            if value < last { value } else { last }
        };
        let whole = |value: f32| (value + WHOLE).to_bits() & WHOLE_BITS;
        for ((((column, row), sin), cos), cell) in column.iter().zip(row).zip(sin).zip(cos).zip(cells) {
            let column = whole(within(column + (cos * x - sin * y), last.0));
            let row = whole(within(row + (sin * x + cos * y), last.1));
            *cell = (row << self.shift) + row * BETWEEN_ROWS + column;
        }
    }
}

/// Beams that are looked up at once.
const AT_ONCE: usize = 4;
/// Particles that go through all beams before the next ones do.
const BLOCK: usize = 512;
/// Cells added to each row of the table: one cache line. With rows of a power of two, all cells of a column would compete
/// for the same few cache lines.
const BETWEEN_ROWS: u32 = 16;

/// Returns the squared distance from each cell's centre to that of the nearest occupied cell, in cells, row by row from the
/// lower left. With `surfaces`, only occupied cells beside a free one count.
fn squared_distances(map: &OccupancyGrid, surfaces: bool) -> Vec<f32> {
    // Cells off the map are unknown.
    let is_free = |column: usize, row: usize| map.cell(column, row) == Cell::Free;
    let beside_free = |column: usize, row: usize| {
        is_free(column.wrapping_sub(1), row)
            || is_free(column + 1, row)
            || is_free(column, row.wrapping_sub(1))
            || is_free(column, row + 1)
    };
    map.squared_distances(|column, row| {
        map.cell(column, row) == Cell::Occupied && (!surfaces || beside_free(column, row))
    })
}

/// Returns the map in larger cells. A cell is a wall if it has any, and else free if it has free space.
fn coarser(map: &OccupancyGrid) -> Option<OccupancyGrid> {
    let (width, height) = (map.width().div_ceil(COARSER), map.height().div_ceil(COARSER));
    let mut cells = vec![Cell::Unknown; width * height];
    for row in 0..map.height() {
        for column in 0..map.width() {
            let cell = &mut cells[row / COARSER * width + column / COARSER];
            match map.cell(column, row) {
                Cell::Occupied => *cell = Cell::Occupied,
                Cell::Free if *cell == Cell::Unknown => *cell = Cell::Free,
                _ => {}
            }
        }
    }
    OccupancyGrid::new(width, height, COARSER as f64 * map.resolution(), map.origin(), cells)
}

#[cfg(test)]
mod tests {
    use cotorra_graph::Position;
    use proptest::prelude::*;

    use super::*;

    fn grid(width: usize, cells: &[bool]) -> OccupancyGrid {
        let cells =
            cells.iter().map(|&wall| if wall { Cell::Occupied } else { Cell::Free }).collect::<Vec<_>>();
        OccupancyGrid::new(width, cells.len() / width, 0.5, Position::new(-3.0, 7.0), cells).unwrap()
    }

    proptest! {
        /// The fast sum equals the plain one, on the map and far off it.
        #[test]
        fn scores_are_sums_over_the_table(
            cells in prop::collection::vec(prop::bool::weighted(0.3), 63),
            x in -20.0..20.0, y in -10.0..30.0, heading in -4.0..4.0,
            ends in prop::collection::vec((-9.0..9.0_f32, -9.0..9.0_f32, 0.0..1.0_f32), 1..20),
        ) {
            let map = grid(9, &cells);
            let parameters = Parameters::default();
            let field = LikelihoodField::new(&map, &parameters);
            let mut beams = Beams::default();
            for &(x, y, weight) in &ends {
                beams.x.push(x);
                beams.y.push(y);
                beams.weight.push(weight);
            }
            let place = field.place(Pose2::new(x, y, heading));
            let mut places = Places::default();
            // More than a block, and not a whole number of lanes.
            (0..1030).for_each(|_| places.push(place));
            let distances = squared_distances(&map, true);
            let (sin, cos) = place.heading.sin_cos();
            let mut on_a_border = false;
            let expected: f32 = ends.iter().map(|&(x, y, weight)| {
                let column = place.column + (cos * x - sin * y) - 1.0;
                let row = place.row + (sin * x + cos * y) - 1.0;
                on_a_border |= [column, row].iter().any(|at| (at - at.round()).abs() < 1e-3);
                let inside = (0.0..9.0).contains(&column) && (0.0..7.0).contains(&row);
                let squared = if inside { distances[row as usize * 9 + column as usize] } else { f32::INFINITY };
                let distance = (squared.sqrt() * 0.5).min(2.0);
                let p = 0.9 * (-distance.powi(2) / (2.0 * 0.1_f32.powi(2))).exp() + 0.1 / 80.0;
                weight * p.ln()
            }).sum();
            prop_assume!(!on_a_border);
            let mut scores = vec![7.0];
            field.score(&places, &beams, &mut scores);
            prop_assert_eq!(scores.len(), 1030);
            for score in scores {
                prop_assert!((score - expected).abs() < 1e-3 * expected.abs().max(1.0), "{} {}", score, expected);
            }
        }
    }

    #[test]
    fn only_surfaces_of_walls_count() {
        let map = grid(5, &[false, true, true, true, false]);
        assert_eq!(squared_distances(&map, false), [1.0, 0.0, 0.0, 0.0, 1.0]);
        assert_eq!(squared_distances(&map, true), [1.0, 0.0, 1.0, 0.0, 1.0]);
    }

    #[test]
    fn anywhere_draws_free_cells_uniformly() {
        let walls = [true, false, false, true, false, true, true, false];
        let field = LikelihoodField::new(&grid(4, &walls), &Parameters::default());
        let mut random = Draws::new(1, "localization");
        let mut counts = [0; 8];
        for _ in 0..4000 {
            let place = field.anywhere(&mut random).unwrap();
            counts[(place.row as usize - 1) * 4 + place.column as usize - 1] += 1;
        }
        for (count, wall) in counts.into_iter().zip(walls) {
            assert!(if wall { count == 0 } else { (900..1100).contains(&count) }, "{counts:?}");
        }
        let walled = LikelihoodField::new(&grid(2, &[true; 4]), &Parameters::default());
        assert!(walled.anywhere(&mut random).is_none());
    }

    #[test]
    fn search_finds_the_place_of_a_scan() {
        // An L of walls and a pillar, in cells of 0.05 m.
        let size = 120;
        let wall = |column: usize, row: usize| {
            column == 2 || row == 2 || (70..78).contains(&column) && (90..94).contains(&row)
        };
        let cells = (0..size * size)
            .map(|i| if wall(i % size, i / size) { Cell::Occupied } else { Cell::Free })
            .collect();
        let map = OccupancyGrid::new(size, size, 0.05, Position::default(), cells).unwrap();
        let field = LikelihoodField::new(&map, &Parameters::default());
        let place = field.place(Pose2::new(2.0, 2.6, 0.7));
        let (sin, cos) = place.heading.sin_cos();
        let mut beams = Beams::default();
        for end in (0..size * size).step_by(3).filter(|&i| wall(i % size, i / size)) {
            let (x, y) = ((end % size) as f32 + 1.5 - place.column, (end / size) as f32 + 1.5 - place.row);
            beams.x.push(cos * x + sin * y);
            beams.y.push(cos * y - sin * x);
            beams.weight.push(1.0);
        }
        let found = field.search(&beams, 72, 10);
        assert_eq!(found.len(), 10);
        let best = found.at(0);
        let off = (best.column - place.column).hypot(best.row - place.row);
        assert!(off < 6.0 && (best.heading - place.heading).abs() < 0.1, "{best:?}");
    }
}
