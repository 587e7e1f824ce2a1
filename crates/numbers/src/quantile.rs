//! Quantiles of samples.

use std::time::Duration;

use serde::Serialize;

use crate::gathered::{Gathered, between};

/// Returns the quantile of rising values at a share, which is clamped to 0 … 1: linear interpolation between closest ranks
/// (type 7 of Hyndman and Fan). `None` without values.
pub fn quantile(sorted: &[f64], share: f64) -> Option<f64> {
    let last = sorted.len().checked_sub(1)?;
    let rank = share.clamp(0.0, 1.0) * last as f64;
    Some(between(sorted[rank.floor() as usize], sorted[rank.ceil() as usize], rank.fract()))
}

/// Returns the quantile of rising times at a share, as [`quantile`], to the nanosecond.
pub fn quantile_of_times(sorted: &[Duration], share: f64) -> Option<Duration> {
    let last = sorted.len().checked_sub(1)?;
    let rank = share.clamp(0.0, 1.0) * last as f64;
    let (low, high) = (sorted[rank.floor() as usize], sorted[rank.ceil() as usize]);
    Some((low + high.saturating_sub(low).mul_f64(rank.fract())).min(high))
}

/// Returns the median; `None` without values.
pub fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_unstable_by(f64::total_cmp);
    quantile(&values, 0.5)
}

/// The usual quantiles of samples.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Quantiles {
    /// Median.
    pub p50: f64,
    /// 95th percentile.
    pub p95: f64,
    /// 99th percentile.
    pub p99: f64,
    /// Maximum.
    pub max: f64,
}

impl Quantiles {
    /// Returns the quantiles of these values; `None` without values.
    pub fn of(mut values: Vec<f64>) -> Option<Self> {
        values.sort_unstable_by(f64::total_cmp);
        let at = |share| quantile(&values, share);
        Some(Self { p50: at(0.5)?, p95: at(0.95)?, p99: at(0.99)?, max: at(1.0)? })
    }

    /// Returns the quantiles of gathered samples, as exact as these are; `None` without samples.
    pub fn gathered(samples: &Gathered) -> Option<Self> {
        let sorted = samples.sorted()?;
        let at = |share| sorted.quantile(share).value;
        Some(Self { p50: at(0.5), p95: at(0.95), p99: at(0.99), max: at(1.0) })
    }
}

#[cfg(test)]
mod tests {
    use proptest::{collection::vec, prelude::*};

    use super::*;

    #[test]
    fn quantiles_are_those_of_numpy() {
        // numpy.quantile(values, [0, .025, .25, .5, .9, .95, .99, 1]), NumPy 2.4.6
        let values = [12.5, 7.25, 8.0, 31.0, 9.75, 8.5, 8.0, 10.0, 15.5, 7.75];
        let expected = [7.25, 7.3625, 8.0, 9.125, 17.05, 24.025, 29.605, 31.0];
        let mut sorted = values;
        sorted.sort_by(f64::total_cmp);
        for (share, expected) in [0.0, 0.025, 0.25, 0.5, 0.9, 0.95, 0.99, 1.0].into_iter().zip(expected) {
            assert!((quantile(&sorted, share).unwrap() - expected).abs() < 1e-12, "{share}");
        }
        let all = Quantiles::of(values.to_vec()).unwrap();
        assert_eq!((all.p50, all.max, median(values.to_vec())), (9.125, 31.0, Some(9.125)));
        assert!((all.p95 - 24.025).abs() < 1e-12 && (all.p99 - 29.605).abs() < 1e-12, "{all:?}");
    }

    #[test]
    fn quantiles_interpolate_between_ranks() {
        let q = Quantiles::of((1..=5).map(f64::from).collect()).unwrap();
        assert_eq!((q.p50, q.p95, q.max), (3.0, 4.8, 5.0));
        assert_eq!(median(vec![3.0, 1.0, 2.0]), Some(2.0));
        assert_eq!(median(vec![4.0, 1.0, 2.0, 3.0]), Some(2.5));
    }

    #[test]
    fn one_value_is_every_quantile_and_none_has_none() {
        assert_eq!([0.0, 0.3, 1.0].map(|share| quantile(&[4.5], share)), [Some(4.5); 3]);
        assert_eq!((quantile(&[], 0.5), median(Vec::new()), Quantiles::of(Vec::new())), (None, None, None));
    }

    #[test]
    fn times_have_the_quantiles_of_their_values() {
        let sorted = [1, 2, 4, 9].map(Duration::from_millis);
        let found = [0.0, 0.5, 0.9, 1.0].map(|share| quantile_of_times(&sorted, share).unwrap().as_micros());
        assert_eq!(found, [1000, 3000, 7500, 9000]);
        assert_eq!(quantile_of_times(&[], 0.5), None);
    }

    #[test]
    fn infinite_values_have_quantiles() {
        let sorted = [1.0, f64::INFINITY, f64::INFINITY];
        assert_eq!([0.0, 0.9].map(|share| quantile(&sorted, share)), [Some(1.0), Some(f64::INFINITY)]);
    }

    proptest! {
        #[test]
        fn quantiles_rise_with_their_share_and_stay_between_the_ends(
            mut values in vec(-1e9..1e9, 1..60), a in 0.0..=1.0, b in 0.0..=1.0,
        ) {
            values.sort_by(f64::total_cmp);
            let [low, high] = [f64::min(a, b), f64::max(a, b)].map(|share| quantile(&values, share).unwrap());
            prop_assert!(values[0] <= low && low <= high && high <= values[values.len() - 1]);
        }
    }
}
