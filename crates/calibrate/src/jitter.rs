//! The distribution of delays around their mean.

use cotorra_graph::JitterDistribution;

use crate::draws::Draws;

/// Quantiles that are matched: at 2.5, 7.5 … 97.5 %.
pub(crate) const LEVELS: usize = 20;

/// Returns the levels of the matched quantiles.
pub(crate) fn levels() -> [f64; LEVELS] {
    std::array::from_fn(|i| (i as f64 + 0.5) / LEVELS as f64)
}

/// The distributions of jitter that a testbed knows.
pub(crate) const ALL: [JitterDistribution; 3] =
    [JitterDistribution::Normal, JitterDistribution::Uniform, JitterDistribution::Pareto];

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
pub(crate) fn match_quantiles(distribution: JitterDistribution, observed: &[f64; LEVELS]) -> Located {
    let standard = levels().map(|level| standard_quantile(distribution, level));
    let average = |values: &[f64; LEVELS]| values.iter().sum::<f64>() / LEVELS as f64;
    let (x, y) = (average(&standard), average(observed));
    let pairs = || standard.iter().zip(observed);
    let deviation = pairs().map(|(s, o)| (s - x) * (o - y)).sum::<f64>()
        / standard.iter().map(|s| (s - x).powi(2)).sum::<f64>();
    let mean = y - deviation * x;
    let squares = pairs().map(|(s, o)| (o - mean - deviation * s).powi(2)).sum::<f64>();
    Located { mean, deviation, distance: (squares / LEVELS as f64).sqrt() }
}

/// Returns the quantile of the standard normal distribution, with a relative error below 10⁻⁸ (Acklam's rational
/// approximation, 2003).
pub(crate) fn normal_quantile(level: f64) -> f64 {
    const A: [f64; 6] = [
        -3.969683028665376e1,
        2.209460984245205e2,
        -2.759285104469687e2,
        1.383577518672690e2,
        -3.066479806614716e1,
        2.506628277459239,
    ];
    const B: [f64; 5] = [
        -5.447609879822406e1,
        1.615858368580409e2,
        -1.556989798598866e2,
        6.680131188771972e1,
        -1.328068155288572e1,
    ];
    const C: [f64; 6] = [
        -7.784894002430293e-3,
        -3.223964580411365e-1,
        -2.400758277161838,
        -2.549732539343734,
        4.374664141464968,
        2.938163982698783,
    ];
    const D: [f64; 4] = [7.784695709041462e-3, 3.224671290700398e-1, 2.445134137142996, 3.754408661907416];
    const TAIL: f64 = 0.02425;
    let polynomial = |coefficients: &[f64], x: f64| coefficients.iter().fold(0.0, |sum, c| sum * x + c);
    let tail = |level: f64| {
        let x = (-2.0 * level.ln()).sqrt();
        polynomial(&C, x) / (polynomial(&D, x) * x + 1.0)
    };
    if level < TAIL {
        tail(level)
    } else if level > 1.0 - TAIL {
        -tail(1.0 - level)
    } else {
        let x = level - 0.5;
        polynomial(&A, x * x) * x / (polynomial(&B, x * x) * x * x + 1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normal_quantiles_match_the_table() {
        for (level, expected) in
            [(0.5, 0.0), (0.975, 1.959_963_985), (0.95, 1.644_853_627), (0.01, -2.326_347_874), (1e-6, -4.753_424_309)]
        {
            assert!((normal_quantile(level) - expected).abs() < 1e-7, "{level}");
        }
    }

    #[test]
    fn quantiles_of_a_distribution_give_it_back() {
        for distribution in ALL {
            let observed = levels().map(|level| 20.0 + 3.0 * standard_quantile(distribution, level));
            let found = match_quantiles(distribution, &observed);
            assert!((found.mean - 20.0).abs() < 1e-9 && (found.deviation - 3.0).abs() < 1e-9, "{found:?}");
            assert!(found.distance < 1e-9);
            for other in ALL.into_iter().filter(|other| *other != distribution) {
                assert!(match_quantiles(other, &observed).distance > 0.1);
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
            assert!(mean.abs() < 0.01 && (found / variance - 1.0).abs() < 0.2, "{distribution:?} {mean} {found}");
        }
    }
}
