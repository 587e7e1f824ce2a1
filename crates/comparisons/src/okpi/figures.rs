//! Figures of a walk's service times, and how tables show them.

use cotorra_numbers::{Interval, Quantiles};
use serde::Serialize;

use super::times::Timed;

/// Service times whose shares above are compared, ms: the published target, and the top of the published figure.
pub(super) const ABOVE_MS: [f64; 2] = [15.0, 40.0];

/// Figures of the distribution of a walk's service times.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Distribution {
    /// Number of samples, also of those without an answer.
    pub samples: usize,
    /// Median of the answered samples, ms.
    pub p50_ms: f64,
    /// 95th percentile of the answered samples, ms.
    pub p95_ms: f64,
    /// 99th percentile of the answered samples, ms.
    pub p99_ms: f64,
    /// Share of samples above 15 ms, the published target. Samples without an answer count as above it.
    pub above_15_ms: f64,
    /// Share of samples above 40 ms, the top of the published figure, or without an answer.
    pub above_40_ms: f64,
}

impl Distribution {
    /// Returns the figures of these samples; `None` without answered samples.
    pub(super) fn of(samples: &[Timed]) -> Option<Self> {
        let quantiles = Quantiles::of(samples.iter().filter_map(|timed| timed.ms).collect())?;
        let share = |limit_ms| {
            let above = samples.iter().filter(|timed| timed.is_above(limit_ms)).count();
            above as f64 / samples.len() as f64
        };
        let [above_15_ms, above_40_ms] = ABOVE_MS.map(share);
        let Quantiles { p50, p95, p99, .. } = quantiles;
        let samples = samples.len();
        Some(Self { samples, p50_ms: p50, p95_ms: p95, p99_ms: p99, above_15_ms, above_40_ms })
    }
}

/// 95 % intervals around a measured walk's figures, by the moving block bootstrap.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Intervals {
    pub p95_ms: Interval,
    pub p99_ms: Interval,
    pub above_15_ms: Interval,
    pub above_40_ms: Interval,
}

/// Returns a time for readers, without its unit.
pub(super) fn ms(ms: f64) -> String {
    format!("{ms:.2}")
}

/// Returns a share for readers.
pub(super) fn percent(share: f64) -> String {
    format!("{:.2} %", share * 100.0)
}

/// Returns a figure for readers, with its interval if it has one.
pub(super) fn with_interval(show: &dyn Fn(f64) -> String, figure: f64, interval: Option<Interval>) -> String {
    let ends = interval.map(|Interval { low, high }| format!(" ({} to {})", show(low), show(high)));
    show(figure) + &ends.unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_without_an_answer_are_above_any_time_but_in_no_quantile() {
        let samples = [Some(10.0), Some(20.0), Some(50.0), None];
        let timed: Vec<_> = samples.into_iter().map(|ms| Timed { at_s: 0.0, ms }).collect();
        let of = Distribution::of(&timed).unwrap();
        assert_eq!((of.samples, of.p50_ms, of.above_15_ms, of.above_40_ms), (4, 20.0, 0.75, 0.5));
        assert_eq!(Distribution::of(&timed[3..]), None);
        assert_eq!(Distribution::of(&[]), None);
    }

    #[test]
    fn a_sample_at_the_limit_is_not_above_it() {
        let timed = [Timed { at_s: 0.0, ms: Some(15.0) }, Timed { at_s: 1.0, ms: Some(40.0) }];
        let of = Distribution::of(&timed).unwrap();
        assert_eq!((of.above_15_ms, of.above_40_ms), (0.5, 0.0));
    }
}
