//! Comparison of a fitted path with round trips that were not fitted, beside two baselines.

use std::time::Duration;

use serde::Serialize;

use crate::{
    bootstrap::{Ranked, Resampler},
    draws::Draws,
    error::CalibrateError,
    estimate::{Estimate, quantile},
    jitter,
    path::{PathFit, RESAMPLES, check_number},
    round_trips::RoundTrips,
};

/// Simulated packets of a prediction.
const SIMULATED: usize = 20_000;
/// Quantiles that are compared.
const LEVELS: [f64; 3] = [0.5, 0.95, 0.99];

/// What is compared of a series of round trips.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Figures<T> {
    /// Median of the packets that arrived, ms.
    pub p50_ms: T,
    /// 95 % quantile, ms.
    pub p95_ms: T,
    /// 99 % quantile, ms.
    pub p99_ms: T,
    /// Share of packets above the target; lost ones count as above it. `None` without a target.
    pub above: Option<T>,
}

/// What predicts the test part.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Predictor {
    /// The fitted path.
    Fitted,
    /// Baseline: a constant delay with normal jitter and independent loss, by the mean, the standard deviation and the share of
    /// the part that was fitted.
    Normal,
    /// Baseline: the part that was fitted, played again.
    Replay,
}

impl Predictor {
    /// All predictors, the fitted path first.
    pub const ALL: [Self; 3] = [Self::Fitted, Self::Normal, Self::Replay];

    /// Returns its name for people.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Fitted => "fitted path",
            Self::Normal => "constant delay, normal jitter",
            Self::Replay => "replay of the fitted part",
        }
    }
}

/// A prediction of the test part.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Prediction {
    /// What predicts.
    pub by: Predictor,
    /// Predicted figures.
    pub figures: Figures<f64>,
    /// Distance of the predicted distribution to that of the test part: 1-Wasserstein, ms, with the interval of the test part.
    pub wasserstein_ms: Estimate,
}

/// A comparison on the test part.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Comparison {
    /// Number of packets of the part that was fitted.
    pub fitted_packets: usize,
    /// Number of packets of the test part.
    pub test_packets: usize,
    /// The target, ms.
    pub target_ms: Option<f64>,
    /// Figures of the test part, with bootstrap intervals.
    pub measured: Figures<Estimate>,
    /// The fitted path, and the baselines.
    pub predictions: Vec<Prediction>,
}

impl Comparison {
    /// Returns, for each figure of a prediction, whether it lies in the interval of the test part.
    pub fn holds(&self, prediction: &Prediction) -> Figures<bool> {
        let (measured, predicted) = (&self.measured, &prediction.figures);
        Figures {
            p50_ms: measured.p50_ms.covers(predicted.p50_ms),
            p95_ms: measured.p95_ms.covers(predicted.p95_ms),
            p99_ms: measured.p99_ms.covers(predicted.p99_ms),
            above: measured
                .above
                .zip(predicted.above)
                .map(|(measured, predicted)| measured.covers(predicted)),
        }
    }
}

/// Compares a path that was fitted to one part with another part. The seed decides simulations and resamples.
///
/// # Errors
/// [`CalibrateError::TooLittle`] if too few packets of the test part arrived.
pub fn compare(
    fit: &PathFit,
    fitted: &RoundTrips,
    test: &RoundTrips,
    target: Option<Duration>,
    seed: u64,
) -> Result<Comparison, CalibrateError> {
    check_number(test, "test")?;
    let target_ms = target.map(|target| target.as_secs_f64() * 1e3);
    let draws = &mut Draws::new(seed, "calibrate simulation");
    let simulated = Predictor::ALL.map(|by| (by, simulate(by, fit, fitted, draws)));
    let lost = fitted.times_ms.iter().filter(|time| time.is_none()).count() as f64;
    let lost = lost / fitted.times_ms.len() as f64;
    let draws = &mut Draws::new(seed, "calibrate comparison");
    let arrived = test.arrived();
    let resampler = Resampler::new(&arrived);
    let mut ranked = Ranked::new(&arrived);
    (0..arrived.len()).for_each(|i| ranked.add(i));
    let values = ranked.quantiles(LEVELS);
    let distances = simulated.each_ref().map(|(_, times)| wasserstein(&ranked, times));
    let mut resampled = Vec::with_capacity(RESAMPLES);
    for _ in 0..RESAMPLES {
        ranked.clear();
        resampler.resample(draws, |i| ranked.add(i));
        let distances = simulated.each_ref().map(|(_, times)| wasserstein(&ranked, times));
        resampled.push((ranked.quantiles(LEVELS), distances));
    }
    let level = |k: usize| {
        Estimate::around(values[k], &mut resampled.iter().map(|(levels, _)| levels[k]).collect::<Vec<_>>())
    };
    let measured = Figures {
        p50_ms: level(0),
        p95_ms: level(1),
        p99_ms: level(2),
        above: target_ms.map(|target| share_above(test, target, draws)),
    };
    let prediction = |(k, (by, times)): (usize, &(Predictor, Vec<f64>))| {
        let [p50_ms, p95_ms, p99_ms] = LEVELS.map(|level| quantile(times, level));
        let above = target_ms.map(|target| {
            let within = times.partition_point(|time| *time <= target) as f64 / times.len() as f64;
            lost + (1.0 - lost) * (1.0 - within)
        });
        let mut distances_of = resampled.iter().map(|(_, distances)| distances[k]).collect::<Vec<_>>();
        Prediction {
            by: *by,
            figures: Figures { p50_ms, p95_ms, p99_ms, above },
            wasserstein_ms: Estimate::around(distances[k], &mut distances_of),
        }
    };
    Ok(Comparison {
        fitted_packets: fitted.times_ms.len(),
        test_packets: test.times_ms.len(),
        target_ms,
        measured,
        predictions: simulated.iter().enumerate().map(prediction).collect(),
    })
}

/// Returns predicted round trips of packets that arrive, rising.
fn simulate(by: Predictor, fit: &PathFit, fitted: &RoundTrips, draws: &mut Draws) -> Vec<f64> {
    let arrived = fitted.arrived();
    let mut times: Vec<f64> = match by {
        Predictor::Fitted => {
            let jitter = |_| fit.deviation_ms.value * jitter::draw(fit.distribution, draws);
            (0..SIMULATED).map(jitter).map(|jitter| (fit.mean_ms.value + jitter).max(0.0)).collect()
        }
        Predictor::Normal => {
            let n = arrived.len() as f64;
            let mean = arrived.iter().sum::<f64>() / n;
            let variance = arrived.iter().map(|time| (time - mean).powi(2)).sum::<f64>() / n;
            (0..SIMULATED).map(|_| (mean + variance.sqrt() * draws.normal()).max(0.0)).collect()
        }
        Predictor::Replay => arrived,
    };
    times.sort_unstable_by(f64::total_cmp);
    times
}

/// Returns the 1-Wasserstein distance between counted values and sorted ones: the mean distance between their quantiles.
fn wasserstein(counted: &Ranked, sorted: &[f64]) -> f64 {
    let total: u32 = counted.counted().map(|(_, count)| count).sum();
    let (n, m) = (f64::from(total), sorted.len() as f64);
    let (mut sum, mut at, mut next, mut end) = (0.0, 0.0, 0, 0.0);
    for (value, count) in counted.counted() {
        end += f64::from(count) / n;
        // The sorted values whose steps lie in this value's step.
        while at < end && next < sorted.len() {
            let to = ((next + 1) as f64 / m).min(end);
            sum += (value - sorted[next]).abs() * (to - at);
            at = to;
            next += usize::from((next + 1) as f64 / m <= end);
        }
    }
    sum
}

/// Returns the share of packets that were lost or above the target, with its bootstrap interval.
fn share_above(trips: &RoundTrips, target_ms: f64, draws: &mut Draws) -> Estimate {
    let above = |time: &Option<f64>| f64::from(u8::from(time.is_none_or(|time| time > target_ms)));
    let above: Vec<f64> = trips.times_ms.iter().map(above).collect();
    let n = above.len() as f64;
    let resampler = Resampler::new(&above);
    let mut one = || {
        let mut sum = 0.0;
        resampler.resample(draws, |i| sum += above[i]);
        sum / n
    };
    let mut shares: Vec<f64> = (0..RESAMPLES).map(|_| one()).collect();
    let mut share = Estimate::around(above.iter().sum::<f64>() / n, &mut shares);
    // A bootstrap of equal values has no width. What did not happen in n packets has a share of 3/n at most (95 %).
    if share.value == 0.0 {
        share.high = share.high.max(3.0 / n);
    } else if share.value == 1.0 {
        share.low = share.low.min(1.0 - 3.0 / n);
    }
    share
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{fit_path, parse_round_trips};

    fn counted(values: &[f64]) -> Ranked {
        let mut ranked = Ranked::new(values);
        (0..values.len()).for_each(|i| ranked.add(i));
        ranked
    }

    #[test]
    fn wasserstein_distances_match_those_by_hand() {
        assert_eq!(wasserstein(&counted(&[1.0, 2.0]), &[1.0, 2.0]), 0.0);
        assert_eq!(wasserstein(&counted(&[1.0, 2.0]), &[4.0, 5.0]), 3.0);
        // Two thirds of 0 and a third of 3, against halves of 0 and 2: 1/6 · 2 and 1/3 · 1 apart.
        let distance = wasserstein(&counted(&[0.0, 0.0, 3.0]), &[0.0, 2.0]);
        assert!((distance - 2.0 / 3.0).abs() < 1e-12, "{distance}");
    }

    /// Round trips with Pareto jitter of 20 ms and 2 ms, and a loss now and then.
    fn series(seed: u64, n: usize) -> RoundTrips {
        let mut draws = Draws::new(seed, "series");
        let mut time = || 20.0 + 2.0 * jitter::draw(cotorra_graph::JitterDistribution::Pareto, &mut draws);
        let rows: String = (0..n)
            .map(|i| if i % 50 == 7 { format!("{i},\n") } else { format!("{i},{}\n", time()) })
            .collect();
        parse_round_trips(&format!("seq,rtt_ms\n{rows}")).unwrap()
    }

    #[test]
    fn a_fitted_path_predicts_the_test_part_and_normal_jitter_does_not() {
        let [fitted, test] = series(4, 3000).split(0.6);
        let fit = fit_path(&fitted, 1).unwrap();
        let compared = compare(&fit, &fitted, &test, Some(Duration::from_millis(24)), 1).unwrap();
        let [by_fit, normal, replay] = &compared.predictions[..] else { panic!() };
        let all = Figures { p50_ms: true, p95_ms: true, p99_ms: true, above: Some(true) };
        assert_eq!(compared.holds(by_fit), all, "{compared:#?}");
        assert!(compared.holds(replay).p50_ms);
        assert!(!compared.holds(normal).p50_ms);
        assert!(by_fit.wasserstein_ms.value * 3.0 < normal.wasserstein_ms.value, "{compared:#?}");
    }

    #[test]
    fn the_same_seed_gives_the_same_comparison() {
        let [fitted, test] = series(5, 600).split(0.6);
        let fit = fit_path(&fitted, 1).unwrap();
        let compared = |seed| compare(&fit, &fitted, &test, None, seed).unwrap();
        assert_eq!(compared(1), compared(1));
        assert_ne!(compared(1), compared(2));
    }

    #[test]
    fn nothing_above_the_target_leaves_a_bound() {
        let trips = parse_round_trips(&format!(
            "seq,rtt_ms\n{}",
            (0..300).map(|i| format!("{i},5\n")).collect::<String>()
        ));
        let share = share_above(&trips.unwrap(), 10.0, &mut Draws::new(1, "above"));
        assert_eq!(share, Estimate { value: 0.0, low: 0.0, high: 0.01 });
    }
}
