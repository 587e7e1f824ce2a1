//! Resampling (Efron, "Bootstrap Methods: Another Look at the Jackknife", Annals of Statistics 7(1), 1979).

use crate::{draws::Draws, interval::Interval, quantile::quantile};

/// Number of resamples for an interval.
pub const RESAMPLES: usize = 1000;

/// The part of a series that is drawn as a whole.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Blocks {
    /// Each value, for values that do not depend on each other.
    Single,
    /// Blocks of this length, at least 1, that overlap (Künsch, "The Jackknife and the Bootstrap for General Stationary
    /// Observations", Annals of Statistics 17(3), 1989).
    Moving(usize),
    /// Blocks of random lengths with this mean, at least 1, that wrap around the end (Politis and Romano, "The Stationary
    /// Bootstrap", 1994).
    Stationary(f64),
}

/// Calls `each` with the indices of a resample of `n` values.
pub fn resample(n: usize, blocks: Blocks, draws: &mut Draws, mut each: impl FnMut(usize)) {
    if n == 0 {
        return;
    }
    match blocks {
        Blocks::Single => (0..n).for_each(|_| each(draws.below(n))),
        Blocks::Moving(length) => {
            let length = length.clamp(1, n);
            let mut left = n;
            while left > 0 {
                let start = draws.below(n - length + 1);
                (start..start + length.min(left)).for_each(&mut each);
                left -= length.min(left);
            }
        }
        Blocks::Stationary(mean) => {
            let mut at = draws.below(n);
            for _ in 0..n {
                each(at);
                at = if draws.unit() * mean < 1.0 { draws.below(n) } else { (at + 1) % n };
            }
        }
    }
}

/// Returns the interval (95 %) between quantiles of resampled figures; `None` without figures.
pub fn percentile_interval(mut figures: Vec<f64>) -> Option<Interval> {
    figures.sort_unstable_by(f64::total_cmp);
    Some(Interval { low: quantile(&figures, 0.025)?, high: quantile(&figures, 0.975)? })
}

/// Returns the interval (95 %) of a figure of values that do not depend on each other, by [`RESAMPLES`] resamples; `None` if
/// no resample has that figure.
pub fn bootstrap(
    values: &[f64],
    draws: &mut Draws,
    figure: impl Fn(Vec<f64>) -> Option<f64>,
) -> Option<Interval> {
    let figures = (0..RESAMPLES).filter_map(|_| {
        let mut resampled = Vec::with_capacity(values.len());
        resample(values.len(), Blocks::Single, draws, |at| resampled.push(values[at]));
        figure(resampled)
    });
    percentile_interval(figures.collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::quantile::median;

    fn indices(n: usize, blocks: Blocks) -> Vec<usize> {
        let mut all = Vec::new();
        resample(n, blocks, &mut Draws::from_seed(1), |at| all.push(at));
        all
    }

    #[test]
    fn a_resample_has_as_many_values_of_the_same_range() {
        for blocks in [Blocks::Single, Blocks::Moving(7), Blocks::Moving(500), Blocks::Stationary(9.0)] {
            let all = indices(100, blocks);
            assert!(all.len() == 100 && all.iter().all(|at| *at < 100), "{blocks:?}");
            assert!(indices(0, blocks).is_empty());
        }
    }

    #[test]
    fn blocks_keep_neighbours_together() {
        let kept = |blocks| {
            let all = indices(2000, blocks);
            all.windows(2).filter(|pair| pair[1] == (pair[0] + 1) % 2000).count() as f64 / 2000.0
        };
        assert!(kept(Blocks::Single) < 0.01);
        for blocks in [Blocks::Moving(10), Blocks::Stationary(10.0)] {
            assert!((kept(blocks) - 0.9).abs() < 0.03, "{blocks:?} {}", kept(blocks));
        }
    }

    #[test]
    fn intervals_leave_out_the_outer_five_percent() {
        let figures = (0..=1000).rev().map(f64::from).collect();
        assert_eq!(percentile_interval(figures), Some(Interval { low: 25.0, high: 975.0 }));
        assert_eq!(percentile_interval(Vec::new()), None);
    }

    #[test]
    fn intervals_hold_the_median_of_most_samples() {
        // 60 samples from 0 to 100: does the interval have the median, 50, in about 95 of 100 sets?
        let mut draws = Draws::from_seed(7);
        let count = (0..100)
            .filter(|set| {
                let samples: Vec<_> = (0..60).map(|_| draws.unit() * 100.0).collect();
                bootstrap(&samples, &mut Draws::from_seed(*set), median).unwrap().holds(50.0)
            })
            .count();
        assert!((88..=100).contains(&count), "{count}");
    }

    #[test]
    fn one_sample_has_an_interval_and_none_has_not() {
        let interval = |samples: &[f64]| bootstrap(samples, &mut Draws::from_seed(1), median);
        assert_eq!(interval(&[3.0]), Some(Interval { low: 3.0, high: 3.0 }));
        assert_eq!(interval(&[]), None);
    }
}
