//! Prediction of signals by a fitted radio, and by the shadowing of readings nearby.

use cotorra_numbers::Draws;

use super::{
    likelihood::{COEFFICIENTS, Sample},
    posterior::Draw,
};
use crate::estimate::Estimate;

/// Readings that predict a signal nearby.
const NEIGHBOURS: usize = 20;

/// The middle of the posterior distribution of a radio.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Middle {
    coefficients: [f64; COEFFICIENTS],
    covariance: [[f64; COEFFICIENTS]; COEFFICIENTS],
    /// Standard deviations of shadowing and noise, dB.
    deviation: f64,
    noise: f64,
    /// Correlation distance, metres.
    distance: f64,
    /// Uncertainty of the deviation of shadowing and noise together: the standard deviation of its logarithm.
    spread: f64,
    /// Likewise, that of the variance of shadowing over its correlation distance.
    roughness_spread: f64,
}

/// A draw of how far a fit is off.
#[derive(Debug, Clone, Copy)]
pub(super) struct Off {
    pub coefficients: [f64; COEFFICIENTS],
    /// Factor of the deviation.
    pub deviation: f64,
}

impl Middle {
    /// Takes the means and covariances of coefficients, and the medians of the others. There is a draw at least.
    pub fn of(posterior: &[Draw]) -> Self {
        let n = posterior.len() as f64;
        let mean = |of: &dyn Fn(&Draw) -> f64| posterior.iter().map(of).sum::<f64>() / n;
        let coefficients = std::array::from_fn(|k| mean(&|draw| draw.coefficients[k]));
        let off = |draw: &Draw, k: usize| draw.coefficients[k] - coefficients[k];
        let log_deviation = |draw: &Draw| draw.deviation.hypot(draw.noise).ln();
        let middle = mean(&log_deviation);
        let log_roughness = |draw: &Draw| (draw.deviation.powi(2) / draw.distance).ln();
        let roughness = mean(&log_roughness);
        let median =
            |of: fn(&Draw) -> f64| Estimate::of(&mut posterior.iter().map(of).collect::<Vec<_>>()).value;
        Self {
            coefficients,
            covariance: std::array::from_fn(|k| {
                std::array::from_fn(|l| mean(&|draw| off(draw, k) * off(draw, l)))
            }),
            deviation: median(|draw| draw.deviation),
            noise: median(|draw| draw.noise),
            distance: median(|draw| draw.distance),
            spread: mean(&|draw| (log_deviation(draw) - middle).powi(2)).sqrt(),
            roughness_spread: mean(&|draw| (log_roughness(draw) - roughness).powi(2)).sqrt(),
        }
    }

    fn mean(&self, factors: &[f64; COEFFICIENTS]) -> f64 {
        factors.iter().zip(self.coefficients).map(|(factor, coefficient)| factor * coefficient).sum()
    }

    /// Returns the variance of a linear function of the coefficients.
    fn variance(&self, factors: &[f64; COEFFICIENTS]) -> f64 {
        let row = |row: &[f64; COEFFICIENTS]| row.iter().zip(factors).map(|(c, f)| c * f).sum::<f64>();
        factors.iter().zip(&self.covariance).map(|(factor, covariances)| factor * row(covariances)).sum()
    }

    /// Returns the difference of two values, less that of their means.
    pub fn residual(&self, a: &Sample, b: &Sample) -> f64 {
        a.value - self.mean(&a.factors) - b.value + self.mean(&b.factors)
    }

    /// Draws a factor of [`Self::semivariance`] over short distances.
    pub fn draw_roughness(&self, draws: &mut Draws) -> f64 {
        (self.roughness_spread * draws.normal()).exp()
    }

    /// Returns half of the mean squared difference of shadowing at a distance in metres, dB².
    pub fn semivariance(&self, apart_m: f64) -> f64 {
        self.deviation.powi(2) * (1.0 - (-apart_m / self.distance).exp())
    }

    /// Predicts a value by path loss and walls.
    pub fn predict(&self, sample: &Sample) -> Normal {
        let variance = self.deviation.powi(2) + self.noise.powi(2) + self.variance(&sample.factors);
        Normal { mean: self.mean(&sample.factors), deviation: variance.sqrt() }
    }

    /// Draws how far the fit is off.
    pub fn draw_off(&self, draws: &mut Draws) -> Off {
        // The Cholesky factor of the covariance, whose last row is 0 without walls.
        let mut factor = [[0.0; COEFFICIENTS]; COEFFICIENTS];
        for row in 0..COEFFICIENTS {
            for column in 0..=row {
                let sum: f64 = (0..column).map(|k| factor[row][k] * factor[column][k]).sum();
                let left = self.covariance[row][column] - sum;
                factor[row][column] = if row == column {
                    left.max(0.0).sqrt()
                } else if factor[column][column] > 0.0 {
                    left / factor[column][column]
                } else {
                    0.0
                };
            }
        }
        let deviates: [f64; COEFFICIENTS] = std::array::from_fn(|_| draws.normal());
        let coefficients = factor.map(|row| row.iter().zip(deviates).map(|(f, deviate)| f * deviate).sum());
        Off { coefficients, deviation: (self.spread * draws.normal()).exp() }
    }

    /// Predicts a value from other samples of the radio unit, too: kriging with the nearest ones (Cressie, Statistics for
    /// spatial data, 1993, 3.4). What their weights leave of the factors has the uncertainty of the coefficients; it is returned,
    /// too.
    pub fn predict_nearby(&self, sample: &Sample, others: &[Sample]) -> (Normal, [f64; COEFFICIENTS]) {
        let mut nearest: Vec<&Sample> = others.iter().collect();
        if nearest.len() > NEIGHBOURS {
            nearest.select_nth_unstable_by(NEIGHBOURS - 1, |a, b| {
                sample.distance(a).total_cmp(&sample.distance(b))
            });
            nearest.truncate(NEIGHBOURS);
        }
        let (shadowing, noise) = (self.deviation.powi(2), self.noise.powi(2));
        let covariance = |a: &Sample, b: &Sample| shadowing * (-a.distance(b) / self.distance).exp();
        let to: Vec<f64> = nearest.iter().map(|other| covariance(sample, other)).collect();
        // Readings at one place without noise are one reading.
        let least = 1e-9 * (shadowing + noise);
        let between = |row: usize, column: usize| {
            let own = if row == column { noise.max(least) } else { 0.0 };
            covariance(nearest[row], nearest[column]) + own
        };
        let weights = solve(nearest.len(), between, &to);
        let (mut mean, mut left, mut variance) =
            (self.mean(&sample.factors), sample.factors, shadowing + noise);
        for ((weight, other), to) in weights.iter().zip(&nearest).zip(&to) {
            mean += weight * (other.value - self.mean(&other.factors));
            variance -= weight * to;
            left.iter_mut().zip(other.factors).for_each(|(left, factor)| *left -= weight * factor);
        }
        variance += self.variance(&left);
        (Normal { mean, deviation: variance.max(0.0).sqrt() }, left)
    }
}

/// Solves A·x = b for a symmetric, positive definite A by Cholesky's decomposition.
fn solve(n: usize, matrix: impl Fn(usize, usize) -> f64, b: &[f64]) -> Vec<f64> {
    let mut factor = vec![vec![0.0; n]; n];
    let mut x = b.to_vec();
    for row in 0..n {
        for column in 0..=row {
            let sum: f64 = (0..column).map(|k| factor[row][k] * factor[column][k]).sum();
            let left = matrix(row, column) - sum;
            factor[row][column] = if row == column {
                left.max(f64::MIN_POSITIVE).sqrt()
            } else {
                left / factor[column][column]
            };
        }
        let sum: f64 = (0..row).map(|k| factor[row][k] * x[k]).sum();
        x[row] = (x[row] - sum) / factor[row][row];
    }
    for row in (0..n).rev() {
        let sum: f64 = (row + 1..n).map(|k| factor[k][row] * x[k]).sum();
        x[row] = (x[row] - sum) / factor[row][row];
    }
    x
}

/// A normal distribution, dB or dBm.
#[derive(Debug, Clone, Copy)]
pub(super) struct Normal {
    pub mean: f64,
    pub deviation: f64,
}

impl Normal {
    /// Describes values; those of no value have no deviation.
    pub fn of(values: impl Iterator<Item = f64> + Clone) -> Self {
        let n = values.clone().count().max(1) as f64;
        let mean = values.clone().sum::<f64>() / n;
        Self { mean, deviation: (values.map(|value| (value - mean).powi(2)).sum::<f64>() / n).sqrt() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn middle() -> Middle {
        let covariance = [[0.04, 0.0, 0.0], [0.0, 0.01, 0.0], [0.0; 3]];
        Middle {
            coefficients: [3.0, 2.0, 0.0],
            covariance,
            deviation: 4.0,
            noise: 0.0,
            distance: 2.0,
            spread: 0.0,
            roughness_spread: 0.0,
        }
    }

    fn at(x: f64, value: f64) -> Sample {
        Sample { place: [x, 0.0], factors: [-1.0, -10.0, 0.0], value }
    }

    #[test]
    fn a_reading_nearby_weighs_by_the_correlation_of_shadowing() {
        // Its shadowing is 5 dB, and the correlation at 2 · ln 2 metres is 1/2.
        let other = at(2.0 * 2f64.ln(), -3.0 - 20.0 + 5.0);
        let (predicted, _) = middle().predict_nearby(&at(0.0, 0.0), &[other]);
        assert!((predicted.mean - (-23.0 + 2.5)).abs() < 1e-6, "{predicted:?}");
        // 3/4 of the variance is left, and half of the uncertainty of the coefficients: 1/4 of 0.04 + 100 · 0.01.
        assert!((predicted.deviation.powi(2) - (12.0 + 1.04 / 4.0)).abs() < 1e-6, "{predicted:?}");
        let (alone, _) = middle().predict_nearby(&at(0.0, 0.0), &[]);
        assert!((alone.deviation.powi(2) - 17.04).abs() < 1e-9 && alone.mean == -23.0);
        assert_eq!(alone.deviation, middle().predict(&at(0.0, 0.0)).deviation);
    }
}
