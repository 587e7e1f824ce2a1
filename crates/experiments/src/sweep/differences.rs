//! Differences between contenders, i.e. combinations, over the runs that share a seed.

use std::collections::BTreeMap;

use cotorra_numbers::{self as numbers, FEWEST, Mean, holm};
use serde::Serialize;

use super::{measured::Measured, runs::Runs};

/// A figure of a combination, less that of the first combination with the same seed.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Difference {
    /// One value per axis.
    pub values: Vec<String>,
    /// Name of the figure, as in the table of combinations.
    pub figure: &'static str,
    /// Number of pairs of runs with the same seed that both have the figure.
    pub pairs: usize,
    /// Mean difference.
    pub mean: f64,
    /// Interval of 95 % by Student's t distribution; `None` for a single pair.
    pub interval: Option<numbers::Interval>,
    /// Probability of a mean at least as far from 0 if there is no difference, corrected for the number of combinations (Holm).
    /// `None` with fewer than three pairs, which are too few.
    pub p: Option<f64>,
}

impl Difference {
    /// Whether there is a difference, at 5 % over all combinations; `None` if there are too few pairs.
    pub fn is_shown(&self) -> Option<bool> {
        self.p.map(|p| p < 0.05)
    }

    /// Returns the difference in another unit, as `+1.20 (+0.80 to +1.60) *`. The star marks one that is shown. Two pairs are
    /// too few to show an interval: `+1.20 (n = 2)`.
    pub fn times(&self, factor: f64) -> String {
        let mean = format!("{:+.2}", self.mean * factor);
        match self.interval {
            Some(_) if self.pairs < FEWEST => format!("{mean} (n = {})", self.pairs),
            Some(numbers::Interval { low, high }) => {
                let star = if self.is_shown() == Some(true) { " *" } else { "" };
                format!("{mean} ({:+.2} to {:+.2}){star}", low * factor, high * factor)
            }
            None => mean,
        }
    }
}

/// Figures that are compared, with the most that two of them can differ.
type Figure = (&'static str, f64, fn(&Measured) -> Option<f64>);

const FIGURES: [Figure; 8] = [
    ("service_time_p50_ms", f64::INFINITY, |run| run.service_time_p50_ms),
    ("service_time_p95_ms", f64::INFINITY, |run| run.service_time_p95_ms),
    ("service_time_p99_ms", f64::INFINITY, |run| run.service_time_p99_ms),
    ("above_target", 1.0, |run| run.above_target),
    ("handovers", f64::INFINITY, |run| Some(run.handovers as f64)),
    ("migrations", f64::INFINITY, |run| Some(run.migrations as f64)),
    ("duration_ms", f64::INFINITY, |run| Some(run.duration_ms)),
    ("blind_m", f64::INFINITY, |run| Some(run.blind_m)),
];

impl Runs {
    /// Returns how each combination differs from the first one that has runs, figure by figure. Combinations without a seed
    /// in common with it have no differences, and neither have those with a void run.
    pub fn differences(&self) -> Vec<Difference> {
        let mut contenders: Vec<(&[String], BTreeMap<u64, &Measured>)> = Vec::new();
        for cell in self.combinations() {
            let its = self.done.iter().filter(|done| done.point.values == *cell);
            let measured = its.map(|done| Some((done.point.seed, done.outcome.measured()?)));
            contenders.push((cell, measured.collect::<Option<_>>().unwrap_or_default()));
        }
        let Some(((_, first), others)) = contenders.split_first() else { return Vec::new() };
        let mut all = Vec::new();
        for (figure, most, read) in FIGURES {
            let difference = |(values, runs): &(&[String], BTreeMap<u64, &Measured>)| {
                let pair = |(seed, run): (&u64, &&Measured)| Some((read(first.get(seed)?)?, read(run)?));
                let pairs: Vec<_> = runs.iter().filter_map(pair).collect();
                let Mean { n, mean, interval, p } = Mean::of_differences(&pairs)?;
                let interval = interval
                    .map(|its| numbers::Interval { low: its.low.max(-most), high: its.high.min(most) });
                Some(Difference { values: values.to_vec(), figure, pairs: n, mean, interval, p })
            };
            let mut its: Vec<_> = others.iter().filter_map(difference).collect();
            let told: Vec<_> = its.iter().filter_map(|difference| difference.p).collect();
            let corrected = holm(&told);
            its.iter_mut().filter_map(|its| its.p.as_mut()).zip(corrected).for_each(|(p, holm)| *p = holm);
            all.extend(its);
        }
        // By combination, in the order of the figures.
        all.sort_by_key(|its| others.iter().position(|(values, _)| *values == its.values));
        all
    }

    /// Returns the combinations that have runs, in their order.
    fn combinations(&self) -> Vec<&[String]> {
        let mut all: Vec<&[String]> = Vec::new();
        for done in &self.done {
            if all.last() != Some(&&done.point.values[..]) {
                all.push(&done.point.values);
            }
        }
        all
    }
}
