//! Likelihood of signals in shadowing that is correlated in space.
//!
//! A reading is a linear function of the unknown coefficients, less shadowing, plus noise. Shadowing is Gaussian with the
//! correlation exp(-Δ/D) (Gudmundson 1991), independent for each radio unit. Noise is independent for each reading.

/// Readings before a reading that its distribution is conditioned on.
const NEIGHBOURS: usize = 10;
/// Largest number of coefficients.
pub(super) const COEFFICIENTS: usize = 3;

/// A signal of one radio unit at a place.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sample {
    /// Place on the floor, metres.
    pub place: [f64; 2],
    /// Factors of the coefficients; those beyond their number are 0.
    pub factors: [f64; COEFFICIENTS],
    /// Value, dB.
    pub value: f64,
}

impl Sample {
    pub fn distance(&self, other: &Self) -> f64 {
        (self.place[0] - other.place[0]).hypot(self.place[1] - other.place[1])
    }
}

/// Correlation of samples: two unknown numbers beside the coefficients and the variance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Correlation {
    /// Distance over which the correlation of shadowing falls to 1/e, metres.
    pub distance: f64,
    /// Share of the variance that is noise.
    pub noise: f64,
}

/// Samples of all radio units, with the neighbours of each.
#[derive(Debug)]
pub(super) struct Field {
    coefficients: usize,
    samples: Vec<Sample>,
    /// Neighbours of each sample among the samples before it, of the same radio unit.
    neighbours: Vec<Vec<usize>>,
    /// Distances between a sample's neighbours and to the sample itself: a lower triangle, row by row, with the sample last.
    distances: Vec<Vec<f64>>,
}

/// Generalized least squares for one correlation.
#[derive(Debug, Clone, Copy)]
pub(super) struct Solution {
    /// Best coefficients.
    pub coefficients: [f64; COEFFICIENTS],
    /// Lower Cholesky factor of the normal equations.
    pub factor: [[f64; COEFFICIENTS]; COEFFICIENTS],
    /// Weighted sum of squared residuals.
    pub residuals: f64,
    /// Logarithm of the likelihood, with coefficients and variance integrated out, up to a constant.
    pub log_likelihood: f64,
}

impl Field {
    /// Arranges the samples of each radio unit. `coefficients` is their number.
    pub fn new(units: &[Vec<Sample>], coefficients: usize) -> Self {
        let mut field =
            Self { coefficients, samples: Vec::new(), neighbours: Vec::new(), distances: Vec::new() };
        for unit in units {
            let first = field.samples.len();
            field.samples.extend(unit);
            for i in first..field.samples.len() {
                let to = |j: &usize| field.samples[i].distance(&field.samples[*j]);
                let mut nearest: Vec<usize> = (first..i).collect();
                if nearest.len() > NEIGHBOURS {
                    nearest.select_nth_unstable_by(NEIGHBOURS - 1, |a, b| to(a).total_cmp(&to(b)));
                    nearest.truncate(NEIGHBOURS);
                }
                let all: Vec<usize> = nearest.iter().copied().chain([i]).collect();
                let row = |(k, a): (usize, &usize)| {
                    let a = &field.samples[*a];
                    all[..k].iter().map(|b| a.distance(&field.samples[*b])).collect::<Vec<_>>()
                };
                field.distances.push(all.iter().enumerate().flat_map(row).collect());
                field.neighbours.push(nearest);
            }
        }
        field
    }

    /// Number of samples less that of coefficients.
    pub fn freedom(&self) -> usize {
        self.samples.len() - self.coefficients
    }

    /// Solves for the coefficients. `None` if they cannot be told apart.
    ///
    /// The likelihood is a product of conditional ones, each on the nearest samples before it (Vecchia, Estimation and model
    /// identification for continuous spatial processes, 1988); with few samples, it is exact. Coefficients and variance are
    /// integrated over the prior 1/variance (Berger, De Oliveira and Sansó, Objective Bayesian analysis of spatially correlated
    /// data, 2001, equation 5 with a = 1).
    pub fn solve(&self, correlation: Correlation) -> Option<Solution> {
        const K: usize = COEFFICIENTS;
        let mut normal = [[0.0; K]; K];
        let (mut right, mut squares, mut log_determinant) = ([0.0; K], 0.0, 0.0);
        let mut matrix = [[0.0; NEIGHBOURS + 1]; NEIGHBOURS + 1];
        let mut whitened = [[0.0; K + 1]; NEIGHBOURS + 1];
        for (i, neighbours) in self.neighbours.iter().enumerate() {
            let n = neighbours.len();
            let mut distances = self.distances[i].iter();
            // The Cholesky factor of the neighbours and the sample; its last row holds the conditional distribution. Samples are
            // whitened on the way.
            for row in 0..=n {
                let sample = &self.samples[if row == n { i } else { neighbours[row] }];
                for column in 0..row {
                    let distance = distances.next().copied().unwrap_or_default();
                    let mut sum = (1.0 - correlation.noise) * (-distance / correlation.distance).exp();
                    for (a, b) in matrix[row][..column].iter().zip(&matrix[column][..column]) {
                        sum -= a * b;
                    }
                    matrix[row][column] = sum / matrix[column][column];
                }
                let left = 1.0 - matrix[row][..row].iter().map(|entry| entry * entry).sum::<f64>();
                // Samples at one place without noise are one sample.
                let diagonal = left.max(1e-9).sqrt();
                matrix[row][row] = diagonal;
                let mut values = [sample.factors[0], sample.factors[1], sample.factors[2], sample.value];
                for column in 0..row {
                    for (value, before) in values.iter_mut().zip(whitened[column]) {
                        *value -= matrix[row][column] * before;
                    }
                }
                whitened[row] = values.map(|value| value / diagonal);
            }
            log_determinant += 2.0 * matrix[n][n].ln();
            let [a, b, c, value] = whitened[n];
            let factors = [a, b, c];
            for row in 0..K {
                for column in 0..=row {
                    normal[row][column] += factors[row] * factors[column];
                }
                right[row] += factors[row] * value;
            }
            squares += value * value;
        }
        let factor = cholesky(normal, self.coefficients)?;
        let half = forward(&factor, right, self.coefficients);
        let coefficients = backward(&factor, half, self.coefficients);
        // Rounding alone leaves this much of readings that follow the formula exactly.
        const ROUNDING: f64 = 1e-12;
        let residuals = (squares - half.iter().map(|h| h * h).sum::<f64>()).max(ROUNDING * squares);
        let log_factor: f64 = (0..self.coefficients).map(|k| factor[k][k].ln()).sum();
        let log_likelihood =
            -0.5 * log_determinant - log_factor - 0.5 * self.freedom() as f64 * residuals.ln();
        Some(Solution { coefficients, factor, residuals, log_likelihood })
    }
}

type Matrix = [[f64; COEFFICIENTS]; COEFFICIENTS];

/// Returns the lower Cholesky factor of the first `n` rows; `None` if they are nearly dependent.
fn cholesky(matrix: Matrix, n: usize) -> Option<Matrix> {
    let mut factor = [[0.0; COEFFICIENTS]; COEFFICIENTS];
    for row in 0..n {
        for column in 0..=row {
            let sum: f64 = (0..column).map(|k| factor[row][k] * factor[column][k]).sum();
            let left = matrix[row][column] - sum;
            if row != column {
                factor[row][column] = left / factor[column][column];
            } else if left > 1e-9 * matrix[row][row] && left.is_finite() {
                factor[row][row] = left.sqrt();
            } else {
                return None;
            }
        }
    }
    Some(factor)
}

/// Solves L·x = b.
fn forward(factor: &Matrix, mut b: [f64; COEFFICIENTS], n: usize) -> [f64; COEFFICIENTS] {
    for row in 0..n {
        let sum: f64 = (0..row).map(|k| factor[row][k] * b[k]).sum();
        b[row] = (b[row] - sum) / factor[row][row];
    }
    b
}

/// Solves Lᵀ·x = b.
pub(super) fn backward(factor: &Matrix, mut b: [f64; COEFFICIENTS], n: usize) -> [f64; COEFFICIENTS] {
    for row in (0..n).rev() {
        let sum: f64 = (row + 1..n).map(|k| factor[k][row] * b[k]).sum();
        b[row] = (b[row] - sum) / factor[row][row];
    }
    b
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(x: f64, value: f64) -> Sample {
        Sample { place: [x, 0.0], factors: [1.0, 0.0, 0.0], value }
    }

    #[test]
    fn the_mean_of_correlated_samples_matches_the_closed_form() {
        // Two samples that are log 2 · D apart have the correlation 1/2, a third is independent of both. The weights of a
        // generalized mean are proportional to the row sums of the inverse: 2/3, 2/3, 1.
        let field = Field::new(&[vec![sample(0.0, 1.0), sample(2f64.ln(), 2.0)], vec![sample(0.0, 6.0)]], 1);
        let solution = field.solve(Correlation { distance: 1.0, noise: 0.0 }).unwrap();
        let weight = 2.0 / 3.0;
        let mean = (weight * 3.0 + 6.0) / (2.0 * weight + 1.0);
        assert!((solution.coefficients[0] - mean).abs() < 1e-12, "{solution:?}");
        // rᵀ·C⁻¹·r, with C⁻¹ = 4/3 · [[1, -1/2], [-1/2, 1]] for the pair.
        let [a, b, c] = [1.0 - mean, 2.0 - mean, 6.0 - mean];
        let residuals = 4.0 / 3.0 * (a * a - a * b + b * b) + c * c;
        assert!((solution.residuals - residuals).abs() < 1e-12);
        // det C = 3/4, Xᵀ·C⁻¹·X = 7/3, n - p = 2.
        let expected = -0.5 * (0.75f64.ln() + (7.0f64 / 3.0).ln()) - residuals.ln();
        assert!((solution.log_likelihood - expected).abs() < 1e-12);
    }

    #[test]
    fn dependent_factors_have_no_solution() {
        let both = |x: f64| Sample { factors: [1.0, 2.0, 0.0], ..sample(x, x) };
        let field = Field::new(&[(0..9).map(|i| both(f64::from(i))).collect()], 2);
        assert!(field.solve(Correlation { distance: 1.0, noise: 0.1 }).is_none());
    }
}
