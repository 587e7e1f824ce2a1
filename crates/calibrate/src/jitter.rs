//! The distribution of delays around their mean.

use std::f64::consts::FRAC_1_SQRT_2;

use cotorra_graph::{Correlation, JitterDistribution};
use cotorra_numbers::Draws;
use statrs::function::erf::{erfc, erfc_inv};

/// Quantiles that are matched: at 2.5, 7.5 … 97.5 %.
pub(crate) const LEVELS: usize = 20;

/// Returns the levels of the matched quantiles.
pub(crate) fn levels() -> [f64; LEVELS] {
    std::array::from_fn(|i| (i as f64 + 0.5) / LEVELS as f64)
}

/// The distributions of jitter that a testbed knows.
pub(crate) const ALL: [JitterDistribution; 3] =
    [JitterDistribution::Normal, JitterDistribution::Uniform, JitterDistribution::Pareto];

/// Returns the quantiles of a jitter at [`levels`], in units of its deviation.
pub(crate) fn standard_quantiles(distribution: JitterDistribution) -> [f64; LEVELS] {
    levels().map(|level| standard_quantile(distribution, level))
}

/// Returns a quantile of a jitter, in units of its deviation.
pub(crate) fn standard_quantile(distribution: JitterDistribution, level: f64) -> f64 {
    match distribution {
        JitterDistribution::Uniform => 2.0 * level - 1.0,
        JitterDistribution::Normal => normal_quantile(level),
        // Shape 3 and scale 1 have the mean 3/2 and the variance 3/4.
        JitterDistribution::Pareto => ((1.0 - level).powf(-1.0 / 3.0) - 1.5) / 0.75f64.sqrt(),
    }
}

/// Draws a jitter, in units of its deviation.
pub(crate) fn draw(distribution: JitterDistribution, draws: &mut Draws) -> f64 {
    match distribution {
        JitterDistribution::Normal => draws.normal(),
        other => standard_quantile(other, draws.unit()),
    }
}

/// Draws the jitters of successive packets, in units of their deviation, as a link does: an autoregression of normal scores.
pub(crate) fn draw_series(
    distribution: JitterDistribution,
    correlation: Correlation,
    packets: usize,
    draws: &mut Draws,
) -> Vec<f64> {
    let correlation = distribution.score_correlation(correlation);
    let innovation = (1.0 - correlation * correlation).sqrt();
    let mut score = draws.normal();
    let next = || {
        score = correlation * score + innovation * draws.normal();
        match distribution {
            JitterDistribution::Normal => score,
            other => standard_quantile(other, 1.0 - erfc(score * FRAC_1_SQRT_2) / 2.0),
        }
    };
    std::iter::repeat_with(next).take(packets).collect()
}

/// A delay with jitter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Located {
    /// Mean.
    pub mean: f64,
    /// Deviation, as the testbed's jitter has it: half the width of a uniform one.
    pub deviation: f64,
    /// Root of the mean squared distance between quantiles.
    pub distance: f64,
}

/// Matches a distribution to quantiles at [`levels`]: the line of least squares through the pairs of standard and observed
/// quantiles.
pub(crate) fn match_quantiles(standard: &[f64; LEVELS], observed: &[f64; LEVELS]) -> Located {
    let average = |values: &[f64; LEVELS]| values.iter().sum::<f64>() / LEVELS as f64;
    let (x, y) = (average(standard), average(observed));
    let pairs = || standard.iter().zip(observed);
    let slope = pairs().map(|(s, o)| (s - x) * (o - y)).sum::<f64>()
        / standard.iter().map(|s| (s - x).powi(2)).sum::<f64>();
    // Equal quantiles may leave one below zero by rounding.
    let deviation = slope.max(0.0);
    let mean = y - deviation * x;
    let squares = pairs().map(|(s, o)| (o - mean - deviation * s).powi(2)).sum::<f64>();
    Located { mean, deviation, distance: (squares / LEVELS as f64).sqrt() }
}

/// Returns the quantile of the standard normal distribution.
pub(crate) fn normal_quantile(level: f64) -> f64 {
    -std::f64::consts::SQRT_2 * erfc_inv(2.0 * level)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normal_quantiles_match_the_table() {
        for (level, expected) in [
            (0.5, 0.0),
            (0.975, 1.959_963_985),
            (0.95, 1.644_853_627),
            (0.01, -2.326_347_874),
            (1e-6, -4.753_424_309),
        ] {
            assert!((normal_quantile(level) - expected).abs() < 1e-7, "{level}");
        }
    }

    #[test]
    fn quantiles_of_a_distribution_give_it_back() {
        for distribution in ALL {
            let observed = levels().map(|level| 20.0 + 3.0 * standard_quantile(distribution, level));
            let found = match_quantiles(&standard_quantiles(distribution), &observed);
            assert!((found.mean - 20.0).abs() < 1e-9 && (found.deviation - 3.0).abs() < 1e-9, "{found:?}");
            assert!(found.distance < 1e-9);
            for other in ALL.into_iter().filter(|other| *other != distribution) {
                assert!(match_quantiles(&standard_quantiles(other), &observed).distance > 0.1);
            }
        }
    }

    #[test]
    fn draws_have_mean_zero_and_the_deviation_of_their_distribution() {
        for (distribution, variance) in ALL.into_iter().zip([1.0, 1.0 / 3.0, 1.0]) {
            let mut draws = Draws::new(1, "jitter");
            let drawn: Vec<f64> = (0..200_000).map(|_| draw(distribution, &mut draws)).collect();
            let mean = drawn.iter().sum::<f64>() / drawn.len() as f64;
            let found = drawn.iter().map(|d| d * d).sum::<f64>() / drawn.len() as f64;
            assert!(
                mean.abs() < 0.01 && (found / variance - 1.0).abs() < 0.2,
                "{distribution:?} {mean} {found}"
            );
        }
    }
}
