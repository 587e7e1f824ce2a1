//! Checks of figures against values that are known without running anything.

use super::observed::{Observed, World};

/// Standard deviations within which a random figure must lie: once in 16,000 checks, a right one does not.
const DEVIATIONS: f64 = 4.0;
/// Highest distance of an empirical distribution from the right one, times the root of the number of values. Once in 2,000 checks,
/// a right one is farther away (Kolmogorov, 1933).
const KOLMOGOROV: f64 = 1.95;

/// A figure, and where it must lie.
#[derive(Debug, Clone, PartialEq)]
pub struct Check {
    /// Name of the compared figure, with its unit.
    pub figure: &'static str,
    /// The right value.
    pub expected: f64,
    /// Lowest and highest accepted value.
    pub within: (f64, f64),
    /// `None` if the run has no such figure.
    pub measured: Option<f64>,
}

impl Check {
    /// Expects a time in milliseconds. With real packets it may be longer by what a valid run may be late.
    pub fn time(figure: &'static str, observed: &Observed, expected_ms: f64, measured: Option<f64>) -> Self {
        let (early, late) = observed.world.tolerance_ms();
        Self { figure, expected: expected_ms, within: (expected_ms - early, expected_ms + late), measured }
    }

    /// Expects exactly this value.
    pub fn exact(figure: &'static str, expected: f64, measured: Option<f64>) -> Self {
        Self { figure, expected, within: (expected, expected), measured }
    }

    /// Expects the mean of values with this mean and standard deviation, which may be correlated: they count as `independent`
    /// ones. `late` is added above, for what real packets may be late.
    pub fn mean(
        figure: &'static str,
        (mean, deviation): (f64, f64),
        independent: f64,
        late: f64,
        values: &[f64],
    ) -> Self {
        let width = DEVIATIONS * deviation / independent.max(1.0).sqrt();
        let measured = (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64);
        Self { figure, expected: mean, within: (mean - width, mean + width + late), measured }
    }

    /// Expects a share in percent among `n` that each count with this probability. Runs of equal ones of the mean length
    /// 1 / (1 - `correlation`) are less certain.
    pub fn share(figure: &'static str, probability: f64, correlation: f64, n: usize, counted: usize) -> Self {
        let inflation = (1.0 + correlation) / (1.0 - correlation);
        let deviation = (probability * (1.0 - probability) * inflation / n.max(1) as f64).sqrt();
        let width = DEVIATIONS * deviation;
        Self {
            figure,
            expected: probability * 100.0,
            within: ((probability - width).max(0.0) * 100.0, (probability + width).min(1.0) * 100.0),
            measured: (n > 0).then(|| counted as f64 / n as f64 * 100.0),
        }
    }

    /// Expects values with this distribution: the largest distance of the two distribution functions (Kolmogorov-Smirnov). With
    /// real packets, values may be later by what moves the function by `slack`.
    pub fn distribution(
        figure: &'static str,
        world: World,
        slack: f64,
        mut values: Vec<f64>,
        function: impl Fn(f64) -> f64,
    ) -> Self {
        values.sort_by(f64::total_cmp);
        let n = values.len() as f64;
        let distance = values.iter().enumerate().map(|(i, value)| {
            let at = function(*value);
            (at - i as f64 / n).max((i as f64 + 1.0) / n - at)
        });
        let farthest = KOLMOGOROV / n.max(1.0).sqrt() + if world == World::Real { slack } else { 0.0 };
        Self {
            figure,
            expected: 0.0,
            within: (0.0, farthest),
            measured: (!values.is_empty()).then(|| distance.fold(0.0, f64::max)),
        }
    }

    /// Whether the figure is right.
    pub fn holds(&self) -> bool {
        self.measured.is_some_and(|measured| (self.within.0..=self.within.1).contains(&measured))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missing_figure_is_wrong() {
        assert!(!Check::exact("status", 0.0, None).holds());
        assert!(Check::exact("status", 3.0, Some(3.0)).holds());
        assert!(!Check::exact("status", 3.0, Some(0.0)).holds());
    }

    #[test]
    fn shares_have_the_interval_of_the_binomial_distribution() {
        let share = |counted| Check::share("lost, %", 0.1, 0.0, 900, counted);
        let near = |(low, high): (f64, f64), expected: (f64, f64)| {
            assert!((low - expected.0).abs() < 1e-9 && (high - expected.1).abs() < 1e-9, "{low} to {high}");
        };
        // 4 deviations of 1 %.
        near(share(90).within, (6.0, 14.0));
        assert!(share(55).holds() && !share(53).holds() && !share(127).holds());
        assert!(!Check::share("lost, %", 0.1, 0.0, 0, 0).holds(), "nothing was measured");
        // Twice the deviation.
        near(Check::share("lost, %", 0.1, 0.6, 900, 90).within, (2.0, 18.0));
    }

    #[test]
    fn a_distribution_is_told_from_another() {
        let uniform = |value: f64| value.clamp(0.0, 1.0);
        let values: Vec<_> = (0..1000).map(|i| (f64::from(i) + 0.5) / 1000.0).collect();
        let of = |values: Vec<f64>| Check::distribution("distance", World::Virtual, 0.0, values, uniform);
        assert!(of(values.clone()).holds());
        assert!(!of(values.iter().map(|value| value * value).collect()).holds());
        assert!(!of(Vec::new()).holds());
    }
}
