//! Statistics over the runs of one combination.

use serde::Serialize;
use statrs::distribution::{ContinuousCDF, StudentsT};

use super::Measured;

/// A combination of values, and the statistics over its runs.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Cell {
    /// One value per axis.
    pub values: Vec<String>,
    /// Number of runs.
    pub runs: usize,
    /// The runs' median service times, ms.
    pub service_time_p50_ms: Option<Interval>,
    /// The runs' 99th percentiles of the service time, ms.
    pub service_time_p99_ms: Option<Interval>,
    /// The runs' shares of samples above the target.
    pub above_target: Option<Interval>,
    /// The runs' numbers of handovers.
    pub handovers: Option<Interval>,
    /// The runs' durations, ms.
    pub duration_ms: Option<Interval>,
    /// The runs' distances that robots drove blind, m.
    pub blind_m: Option<Interval>,
    /// The runs' longest blind stretches, m.
    pub longest_blind_m: Option<Interval>,
}

/// A mean over runs and its 95 % confidence interval, by Student's t distribution.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Interval {
    pub mean: f64,
    /// Lower bound; `None` for a single run, which has no confidence interval.
    pub low: Option<f64>,
    /// Upper bound; `None` for a single run.
    pub high: Option<f64>,
}

impl Interval {
    /// Returns the interval of these values; `None` without values.
    pub fn of(values: &[f64]) -> Option<Self> {
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n;
        if values.len() < 2 {
            return (!values.is_empty()).then_some(Self { mean, low: None, high: None });
        }
        let variance = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / (n - 1.0);
        let t = StudentsT::new(0.0, 1.0, n - 1.0)
            .expect("the scale and the freedom are above 0")
            .inverse_cdf(0.975);
        let half = t * (variance / n).sqrt();
        Some(Self { mean, low: Some(mean - half), high: Some(mean + half) })
    }
}

impl Cell {
    pub(crate) fn of(values: Vec<String>, runs: &[&Measured]) -> Self {
        let over = |figure: fn(&Measured) -> Option<f64>| {
            Interval::of(&runs.iter().filter_map(|run| figure(run)).collect::<Vec<_>>())
        };
        Self {
            values,
            runs: runs.len(),
            service_time_p50_ms: over(|run| run.service_time_p50_ms),
            service_time_p99_ms: over(|run| run.service_time_p99_ms),
            above_target: over(|run| run.above_target),
            handovers: over(|run| Some(run.handovers as f64)),
            duration_ms: over(|run| Some(run.duration_ms)),
            blind_m: over(|run| Some(run.blind_m)),
            longest_blind_m: over(|run| Some(run.longest_blind_m)),
        }
    }

    /// Returns the intervals by the names of the table's columns.
    pub(crate) fn intervals(&self) -> [(&'static str, Option<Interval>); 7] {
        [
            ("service_time_p50_ms", self.service_time_p50_ms),
            ("service_time_p99_ms", self.service_time_p99_ms),
            ("above_target", self.above_target),
            ("handovers", self.handovers),
            ("duration_ms", self.duration_ms),
            ("blind_m", self.blind_m),
            ("longest_blind_m", self.longest_blind_m),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_interval_follows_students_t() {
        // t for 4 degrees of freedom is 2.776; the standard error of 1 to 5 is sqrt(2.5 / 5).
        let Interval { mean, low, high } = Interval::of(&[1.0, 2.0, 3.0, 4.0, 5.0]).unwrap();
        assert_eq!(mean, 3.0);
        assert!((high.unwrap() - 3.0 - 2.776_445 * 0.5_f64.sqrt()).abs() < 1e-5, "{high:?}");
        assert!((low.unwrap() + high.unwrap() - 6.0).abs() < 1e-12);
        assert_eq!(Interval::of(&[7.0]), Some(Interval { mean: 7.0, low: None, high: None }));
        assert_eq!(Interval::of(&[]), None);
    }
}
