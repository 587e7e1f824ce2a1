//! Distributions of jitter, as the tables that NetEm draws from. A table is the inverse of the distribution function
//! at equally spaced points, in units of 1/8192 of the deviation (linux/pkt_sched.h, `NETEM_DIST_SCALE`). Tables are
//! computed from the distributions' definitions, so iproute2's files are not needed.

use serde::{Deserialize, Serialize};
use statrs::distribution::{ContinuousCDF, Normal};

/// Distribution of a jitter.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Distribution {
    /// Uniform within ± deviation.
    Uniform,
    /// Gaussian, with the deviation as standard deviation.
    #[default]
    Normal,
    /// Pareto with shape 3, shifted and scaled to mean 0 and the deviation as standard deviation: a long upper tail.
    Pareto,
    /// A quarter normal and three quarters Pareto, mixed by quantile, and scaled like Pareto.
    ParetoNormal,
}

/// Entries of a table. The kernel's documentation uses this size, a quarter of the maximum.
const SIZE: usize = 4096;
/// Table units per deviation.
const SCALE: f64 = 8192.0;
/// Largest deviation: a table's entries are 16 bits wide, which limits jitter to four deviations.
const MOST: f64 = i16::MAX as f64 / SCALE;
/// Shape of the Pareto distribution.
const SHAPE: f64 = 3.0;

impl Distribution {
    /// All distributions.
    pub const ALL: [Self; 4] = [Self::Uniform, Self::Normal, Self::Pareto, Self::ParetoNormal];

    /// Returns the name that `tc` uses.
    pub fn name(self) -> &'static str {
        match self {
            Self::Uniform => "uniform",
            Self::Normal => "normal",
            Self::Pareto => "pareto",
            Self::ParetoNormal => "paretonormal",
        }
    }

    /// Returns the `u`-quantile of the jitter in deviations, before it is clamped to four of them.
    fn quantile(self, u: f64) -> f64 {
        // x_m = 1: F(x) = 1 - x^-a; mean a/(a-1), variance a/((a-1)²(a-2)).
        let pareto = |u: f64| {
            let mean = SHAPE / (SHAPE - 1.0);
            let deviation = (SHAPE / (SHAPE - 2.0)).sqrt() / (SHAPE - 1.0);
            ((1.0 - u).powf(-1.0 / SHAPE) - mean) / deviation
        };
        let normal = |u| Normal::standard().inverse_cdf(u);
        match self {
            Self::Uniform => 2.0 * u - 1.0,
            Self::Normal => normal(u),
            Self::Pareto => pareto(u),
            Self::ParetoNormal => 0.25 * normal(u) + 0.75 * pareto(u),
        }
    }

    /// Returns the table for `TCA_NETEM_DELAY_DIST`.
    pub(crate) fn table(self) -> Vec<i16> {
        let mut values: Vec<_> =
            (0..SIZE).map(|i| self.quantile((i as f64 + 0.5) / SIZE as f64).clamp(-MOST, MOST)).collect();
        if self != Self::Uniform {
            // Clamping the tail changes mean and deviation. Rescaling pushes more values into the clamp, so iterate
            // until it settles.
            for _ in 0..50 {
                let mean = values.iter().sum::<f64>() / SIZE as f64;
                let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / SIZE as f64;
                for value in &mut values {
                    *value = ((*value - mean) / variance.sqrt()).clamp(-MOST, MOST);
                }
            }
        }
        values.into_iter().map(|v| (v * SCALE).round() as i16).collect()
    }
}

impl From<cotorra_graph::JitterDistribution> for Distribution {
    fn from(distribution: cotorra_graph::JitterDistribution) -> Self {
        use cotorra_graph::JitterDistribution as Graph;
        match distribution {
            Graph::Uniform => Self::Uniform,
            Graph::Normal => Self::Normal,
            Graph::Pareto => Self::Pareto,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn moments(table: &[i16]) -> (f64, f64) {
        let values: Vec<_> = table.iter().map(|v| f64::from(*v) / SCALE).collect();
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / values.len() as f64;
        (mean, variance.sqrt())
    }

    #[test]
    fn tables_have_mean_zero_and_the_requested_deviation() {
        for distribution in Distribution::ALL {
            let table = distribution.table();
            let (mean, deviation) = moments(&table);
            // A uniform distribution's deviation is its half-width.
            let expected = if distribution == Distribution::Uniform { 1.0 / 3f64.sqrt() } else { 1.0 };
            assert!(mean.abs() < 2e-3, "{distribution:?}: mean {mean}");
            assert!((deviation - expected).abs() < 2e-3, "{distribution:?}: deviation {deviation}");
            assert!(table.is_sorted(), "{distribution:?}");
        }
    }

    /// Compares each curve with a snapshot at 1, 25, 50, 75 and 99 %.
    #[test]
    fn tables_have_the_shape_of_their_distribution() {
        let at = |d: Distribution| {
            let table = d.table();
            [0.01, 0.25, 0.5, 0.75, 0.99].map(|u| table[(u * SIZE as f64) as usize])
        };
        let near = |found: [i16; 5], expected: [f64; 5], slack: f64| {
            for (found, expected) in found.into_iter().zip(expected) {
                let found = f64::from(found) / SCALE;
                assert!((found - expected).abs() < slack, "{found} is not {expected}");
            }
        };
        near(at(Distribution::Uniform), [-0.98, -0.5, 0.0, 0.5, 0.98], 1e-3);
        near(at(Distribution::Normal), [-2.326, -0.674, 0.0, 0.674, 2.326], 5e-3);
        let pareto = at(Distribution::Pareto);
        assert!(
            pareto[2] < 0 && f64::from(pareto[4]) > 2.5 * SCALE && f64::from(pareto[0]) > -SCALE,
            "{pareto:?}"
        );
    }
}
