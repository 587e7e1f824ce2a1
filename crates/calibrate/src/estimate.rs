//! Estimates with intervals.

use std::fmt;

use serde::Serialize;

/// A fitted value with its 95 % interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Estimate {
    /// Best value.
    pub value: f64,
    /// Lower end of the interval.
    pub low: f64,
    /// Upper end of the interval.
    pub high: f64,
}

impl Estimate {
    /// Share of the probability that is below the interval, and above it.
    const TAIL: f64 = 0.025;

    /// Takes the interval between the 2.5 % and the 97.5 % quantile of draws, around a value.
    pub(crate) fn around(value: f64, draws: &mut [f64]) -> Self {
        draws.sort_unstable_by(f64::total_cmp);
        Self { value, low: quantile(draws, Self::TAIL), high: quantile(draws, 1.0 - Self::TAIL) }
    }

    /// Takes the median and the interval of draws.
    pub(crate) fn of(draws: &mut [f64]) -> Self {
        let around = Self::around(0.0, draws);
        Self { value: quantile(draws, 0.5), ..around }
    }

    /// Whether the interval holds a value.
    pub fn covers(&self, value: f64) -> bool {
        (self.low..=self.high).contains(&value)
    }

    /// Widens the interval of a share that is 0 or 1, of which a bootstrap has no width: what did not happen in n cases has a
    /// share of 3/n at most (95 %).
    pub(crate) fn widen(&mut self, cases: usize) {
        let bound = 3.0 / cases as f64;
        if self.value == 0.0 {
            self.high = self.high.max(bound.min(1.0));
        } else if self.value == 1.0 {
            self.low = self.low.min((1.0 - bound).max(0.0));
        }
    }

    /// Returns the estimate with a constant added.
    pub(crate) fn shifted(self, by: f64) -> Self {
        Self { value: self.value + by, low: self.low + by, high: self.high + by }
    }

    /// Returns the estimate of what rises with it.
    pub(crate) fn map(self, rising: impl Fn(f64) -> f64) -> Self {
        Self { value: rising(self.value), low: rising(self.low), high: rising(self.high) }
    }

    /// Returns the estimate in another unit.
    pub(crate) fn scaled(self, by: f64) -> Self {
        Self { value: self.value * by, low: self.low * by, high: self.high * by }
    }
}

impl fmt::Display for Estimate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let digits = f.precision().unwrap_or(2);
        write!(f, "{:.digits$} ({:.digits$} to {:.digits$})", self.value, self.low, self.high)
    }
}

/// Returns a quantile of sorted values; NaN without values.
pub(crate) fn quantile(sorted: &[f64], level: f64) -> f64 {
    cotorra_numbers::quantile(sorted, level).unwrap_or(f64::NAN)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_share_of_nothing_leaves_a_bound() {
        let mut share = Estimate { value: 0.0, low: 0.0, high: 0.0 };
        share.widen(300);
        assert_eq!(share, Estimate { value: 0.0, low: 0.0, high: 0.01 });
    }

    #[test]
    fn an_interval_leaves_out_the_outer_five_percent() {
        let mut draws: Vec<f64> = (0..=1000).rev().map(f64::from).collect();
        assert_eq!(Estimate::of(&mut draws), Estimate { value: 500.0, low: 25.0, high: 975.0 });
    }
}
