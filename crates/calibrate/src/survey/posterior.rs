//! Posterior distribution of path loss, walls and shadowing.

use cotorra_numbers::Draws;

use super::likelihood::{COEFFICIENTS, Correlation, Field, Solution, backward};
/// Noise as a share of the variance. The shares are equally likely before the survey.
const NOISE: [f64; 9] = [0.001, 0.03, 0.08, 0.15, 0.25, 0.4, 0.55, 0.75, 0.95];
/// Correlation distances for each factor of e. Their logarithm is uniform before the survey.
const PER_E: f64 = 5.0;
/// A point of the grid with a lower likelihood than e to the minus this, as a share of the best one, is left out.
const NEGLIGIBLE: f64 = 11.0;
/// Draws of the posterior.
const DRAWS: usize = 4000;

/// A draw of all unknown numbers.
#[derive(Debug, Clone, Copy)]
pub(super) struct Draw {
    /// Coefficients.
    pub coefficients: [f64; COEFFICIENTS],
    /// Standard deviation of shadowing, dB.
    pub deviation: f64,
    /// Correlation distance of shadowing, metres.
    pub distance: f64,
    /// Standard deviation of noise, dB.
    pub noise: f64,
}

/// Draws from the posterior, for correlation distances between two bounds. `None` if coefficients cannot be told apart.
///
/// On a grid of correlation distances and noise shares, the posterior of the variance is an inverse gamma distribution, and
/// that of the coefficients is normal for a given variance. The grid's weights are the likelihoods.
pub(super) fn draw(
    field: &Field,
    coefficients: usize,
    [nearest, farthest]: [f64; 2],
    draws: &mut Draws,
) -> Option<Vec<Draw>> {
    let grid = Grid::explore(field, nearest, farthest)?;
    let best = grid.solved.iter().map(|(_, _, s)| s.log_likelihood).fold(f64::NEG_INFINITY, f64::max);
    let mut weights: Vec<f64> = grid.solved.iter().map(|(_, _, s)| (s.log_likelihood - best).exp()).collect();
    let mut sum = 0.0;
    for weight in &mut weights {
        sum += *weight;
        *weight = sum;
    }
    let one = |_| {
        let at = draws.unit() * sum;
        let chosen = weights.partition_point(|w| *w <= at).min(weights.len() - 1);
        let (row, column, solution) = &grid.solved[chosen];
        let variance = solution.residuals / (2.0 * draws.gamma(field.freedom() as f64 / 2.0));
        let mut deviates = [0.0; COEFFICIENTS];
        deviates[..coefficients].fill_with(|| draws.normal() * variance.sqrt());
        let off = backward(&solution.factor, deviates, coefficients);
        let noise = NOISE[*column];
        Draw {
            coefficients: std::array::from_fn(|k| solution.coefficients[k] + off[k]),
            deviation: (variance * (1.0 - noise)).sqrt(),
            distance: grid.distance(*row as f64 + draws.unit() - 0.5),
            noise: (variance * noise).sqrt(),
        }
    };
    Some((0..DRAWS).map(one).collect())
}

/// Solutions for correlation distances (rows) and noise shares (columns).
struct Grid {
    nearest: f64,
    solved: Vec<(usize, usize, Solution)>,
}

impl Grid {
    /// Solves the part of the grid whose likelihood is not negligible: starts at the best of a few points, and goes on from
    /// point to point.
    fn explore(field: &Field, nearest: f64, farthest: f64) -> Option<Self> {
        let rows = ((farthest / nearest).ln() * PER_E).ceil().max(1.0) as usize + 1;
        let mut grid = Self { nearest, solved: Vec::new() };
        let mut seen = vec![[false; NOISE.len()]; rows];
        let solve = |row: usize, column: usize, grid: &Self| {
            let distance = grid.distance(row as f64);
            field.solve(Correlation { distance, noise: NOISE[column] })
        };
        let mut open: Vec<(usize, usize)> = Vec::new();
        let mut best = f64::NEG_INFINITY;
        for row in (0..rows).step_by(PER_E as usize) {
            for column in (1..NOISE.len()).step_by(3) {
                let solution = solve(row, column, &grid)?;
                seen[row][column] = true;
                best = best.max(solution.log_likelihood);
                grid.solved.push((row, column, solution));
            }
        }
        let around = |row: usize, column: usize| {
            let rows = row.saturating_sub(1)..(row + 2).min(rows);
            rows.flat_map(move |r| {
                (column.saturating_sub(1)..(column + 2).min(NOISE.len())).map(move |c| (r, c))
            })
        };
        let relevant = grid.solved.iter().filter(|(_, _, s)| s.log_likelihood > best - NEGLIGIBLE);
        open.extend(relevant.flat_map(|(row, column, _)| around(*row, *column)));
        while let Some((row, column)) = open.pop() {
            if std::mem::replace(&mut seen[row][column], true) {
                continue;
            }
            let solution = solve(row, column, &grid)?;
            best = best.max(solution.log_likelihood);
            if solution.log_likelihood > best - NEGLIGIBLE {
                open.extend(around(row, column));
            }
            grid.solved.push((row, column, solution));
        }
        Some(grid)
    }

    fn distance(&self, row: f64) -> f64 {
        self.nearest * (row / PER_E).exp()
    }
}
