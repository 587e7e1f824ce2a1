//! Delay, jitter, loss and duplication of a path, fitted to times of its packets: round trips, or one way.

use cotorra_graph::{Correlation, JitterDistribution};
use cotorra_numbers::Draws;
use serde::Serialize;

use crate::{
    error::CalibrateError,
    estimate::Estimate,
    jitter::{self, Located, normal_quantile, standard_quantile},
    loss::{self, LossFit},
    matched::{Matched, RESAMPLES},
    times::PacketTimes,
};

/// Fewest packets of a fit, and of a test.
pub const LEAST_ARRIVED: usize = 100;
/// A time that is this rare is the shortest one.
pub(crate) const SHORTEST: f64 = 0.001;
/// Strongest correlation of a jitter: with 1, it would never change.
const STRONGEST: f64 = 0.9999;
/// Distinct times below which rounding hides the distribution.
const COARSE: usize = 20;
/// Normal deviate of a two-sided interval of 95 %.
pub(crate) const TWO_SIDED: f64 = 1.959_964;

/// A path, fitted to times of its packets.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PathFit {
    /// Number of packets.
    pub packets: usize,
    /// Mean time, ms.
    pub mean_ms: Estimate,
    /// Deviation of times, ms: half the width of a uniform distribution, the standard deviation of others.
    pub deviation_ms: Estimate,
    /// Distribution whose quantiles are nearest to those measured.
    pub distribution: JitterDistribution,
    /// Distance of each distribution to the measured quantiles, ms: root of the mean square.
    pub distances_ms: Vec<(JitterDistribution, f64)>,
    /// Correlation of a time with that of the next packet, in the fitted distribution.
    pub correlation: Estimate,
    /// Mean length of a block of the bootstrap, in packets.
    pub block_length: f64,
    /// Losses, of round trips in both directions together; `None` if they were not measured.
    pub loss: Option<LossFit>,
    /// Share of packets that arrive twice; `None` if it was not measured.
    pub duplication: Option<Estimate>,
    /// Notes on the fit, for people.
    pub notes: Vec<String>,
    /// Fits of resamples.
    #[serde(skip)]
    pub(crate) resampled: Vec<Located>,
}

impl PathFit {
    /// Returns a quantile of the fitted times, ms.
    pub(crate) fn quantile_ms(&self, level: f64) -> f64 {
        (self.mean_ms.value + self.deviation_ms.value * standard_quantile(self.distribution, level)).max(0.0)
    }

    /// Returns the correlation of the jitter; none if its interval holds 0.
    pub(crate) fn jitter_correlation(&self) -> Correlation {
        let Estimate { value, low, high } = self.correlation;
        let known = low > 0.0 || high < 0.0;
        let correlation = if known { value.clamp(-STRONGEST, STRONGEST) } else { 0.0 };
        Correlation::new(correlation).unwrap_or_default()
    }

    /// Returns the shortest time, ms, which jitter adds to.
    pub(crate) fn shortest_ms(&self) -> f64 {
        self.quantile_ms(SHORTEST)
    }
}

/// Fits a path. The seed decides resamples and draws.
///
/// # Errors
/// [`CalibrateError::TooLittle`] if too few packets arrived.
pub fn fit_path(trips: &PacketTimes, seed: u64) -> Result<PathFit, CalibrateError> {
    let draws = &mut Draws::new(seed, "calibrate path");
    let arrived = trips.arrived();
    check_number(trips, "fit")?;
    let matched = Matched::nearest(&jitter::ALL, &arrived, draws);
    let lost: Vec<bool> = trips.times_ms.iter().map(Option::is_none).collect();
    let fitted = PathFit {
        packets: trips.times_ms.len(),
        mean_ms: matched.mean(),
        deviation_ms: matched.deviation(),
        distribution: matched.distribution,
        distances_ms: matched.distances,
        correlation: correlation(&trips.times_ms)
            .map(|of_scores| matched.distribution.correlation(of_scores)),
        block_length: matched.block_length,
        loss: trips.counts_losses.then(|| loss::fit(&lost, draws)),
        duplication: trips.counts_losses.then(|| share(trips.duplicated.len(), arrived.len(), draws)),
        notes: Vec::new(),
        resampled: matched.resampled,
    };
    let notes = notes(&fitted, trips, matched.distinct);
    Ok(PathFit { notes, ..fitted })
}

/// Rejects a part with too few packets.
pub(crate) fn check_number(trips: &PacketTimes, to: &str) -> Result<(), CalibrateError> {
    let (sent, arrived) = (trips.times_ms.len(), trips.times_ms.iter().flatten().count());
    match arrived {
        0 => Err(CalibrateError::too_little(format!("all {sent} packets of the part to {to} were lost"))),
        _ if arrived < LEAST_ARRIVED => Err(CalibrateError::too_little(format!(
            "{arrived} of {sent} packets arrived in the part to {to}: it needs {LEAST_ARRIVED} or more"
        ))),
        _ => Ok(()),
    }
}

fn notes(fitted: &PathFit, trips: &PacketTimes, distinct: usize) -> Vec<String> {
    let mut notes = trips.notes.clone();
    if distinct < COARSE && fitted.deviation_ms.value > 0.0 {
        notes.push(format!(
            "only {distinct} different times were measured: rounding hides the distribution of the jitter"
        ));
    }
    let correlation = fitted.jitter_correlation();
    if !correlation.is_none() {
        let apart = trips.interval.map_or_else(String::new, |interval| {
            format!(", which were sent {:.1} ms apart", interval.as_secs_f64() * 1e3)
        });
        notes.push(format!(
            "the correlation is that of packets as measured{apart}; the testbed's jitter has it from packet to packet at any rate"
        ));
    }
    let deviation_s = fitted.deviation_ms.value / 1e3;
    if trips.interval.is_some_and(|interval| interval.as_secs_f64() < 4.0 * deviation_s) {
        notes.push(
            "packets followed each other within their jitter: keeping their order adds delay".to_owned(),
        );
    }
    if trips.late > 0 {
        notes.push(format!("{} packets were overtaken, which is not fitted", trips.late));
    }
    let least =
        fitted.mean_ms.value + fitted.deviation_ms.value * standard_quantile(fitted.distribution, SHORTEST);
    if least < 0.0 {
        notes.push("some times of the fitted distribution are below zero, and become zero".to_owned());
    }
    notes
}

/// Returns a share with Jeffreys' interval.
fn share(number: usize, of: usize, draws: &mut Draws) -> Estimate {
    let mut drawn: Vec<f64> =
        (0..RESAMPLES).map(|_| draws.beta(number as f64 + 0.5, (of - number) as f64 + 0.5)).collect();
    let mut share = Estimate::around(number as f64 / of as f64, &mut drawn);
    if number == 0 {
        share.low = 0.0;
    }
    share
}

/// Returns the correlation of packets that follow each other, by normal scores of their ranks (van der Waerden 1952): that of
/// the scores, which does not depend on the distribution.
///
/// The interval is that of an autoregression of first order: the variance is (1 - ρ²)/n (Bartlett 1946), and the bias
/// -(1 + 3ρ)/n is taken off (Kendall 1954).
fn correlation(times_ms: &[Option<f64>]) -> Estimate {
    let arrived: Vec<f64> = times_ms.iter().flatten().copied().collect();
    let mut sorted = arrived;
    sorted.sort_unstable_by(f64::total_cmp);
    let n = sorted.len() as f64;
    let score = |time: f64| {
        // The middle of equal ones.
        let (below, up_to) = (sorted.partition_point(|t| *t < time), sorted.partition_point(|t| *t <= time));
        normal_quantile((below + up_to) as f64 / (2.0 * n))
    };
    let scores: Vec<Option<f64>> = times_ms.iter().map(|time| time.map(score)).collect();
    let pairs: Vec<(f64, f64)> = scores.windows(2).filter_map(|pair| pair[0].zip(pair[1])).collect();
    let variance = scores.iter().flatten().map(|s| s * s).sum::<f64>() / n;
    if variance <= 0.0 || pairs.is_empty() {
        return Estimate { value: 0.0, low: -1.0, high: 1.0 };
    }
    let number = pairs.len() as f64;
    let raw = pairs.iter().map(|(a, b)| a * b).sum::<f64>() / number / variance;
    let value = (raw + (1.0 + 3.0 * raw) / number).clamp(-1.0, 1.0);
    let half = TWO_SIDED * ((1.0 - value * value).max(0.0) / number).sqrt();
    Estimate { value, low: (value - half).max(-1.0), high: (value + half).min(1.0) }
}
