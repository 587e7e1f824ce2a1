//! Comparison of a fitted path with round trips that were not fitted, beside two baselines.

use std::time::Duration;

use cotorra_graph::{Correlation, JitterDistribution};
use cotorra_numbers::{Counted, Draws, Resampler, block_length};
use serde::Serialize;

use crate::{
    error::CalibrateError,
    estimate::{Estimate, quantile},
    jitter,
    matched::RESAMPLES,
    path::{PathFit, TWO_SIDED, check_number},
    times::PacketTimes,
};

/// Simulated packets of a prediction.
const SIMULATED: usize = 20_000;
/// Distances are computed with one in so many simulated packets, which are sorted.
const THINNED: usize = 20;
/// Quantiles that are compared.
const LEVELS: [f64; 3] = [0.5, 0.95, 0.99];
/// Difference below which times are the same, ms, and shares: captures have nanoseconds.
const SAME: f64 = 1e-6;

/// The figures of a series of times that are compared.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Figures<T> {
    /// Median of the packets that arrived, ms.
    pub p50_ms: T,
    /// 95 % quantile, ms.
    pub p95_ms: T,
    /// 99 % quantile, ms.
    pub p99_ms: T,
    /// Mean difference of the times of two packets that follow each other, ms.
    pub change_ms: T,
    /// Share of packets above the target; lost ones count as above it. `None` without a target.
    pub above: Option<T>,
}

/// A predictor of the test part.
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
    /// The predictor.
    pub by: Predictor,
    /// Predicted figures.
    pub figures: Figures<f64>,
    /// Whether each figure agrees with the test part: the interval of their difference, over resamples of both parts, holds 0.
    pub agrees: Figures<bool>,
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

/// Values of the figures: quantiles at [`LEVELS`], the mean change from packet to packet, and the share above the target, which
/// is 0 without one.
type Values = [f64; 5];

/// A resample of both parts.
struct Resample {
    measured: Values,
    /// Values by each predictor.
    predicted: [Values; 3],
    /// Distance of each predictor's distribution to that of the test part, ms.
    distances: [f64; 3],
}

/// Compares a path that was fitted to one part with another part. The seed decides simulations and resamples.
///
/// # Errors
/// [`CalibrateError::TooLittle`] if too few packets of the test part arrived.
pub fn compare(
    fit: &PathFit,
    fitted: &PacketTimes,
    test: &PacketTimes,
    target: Option<Duration>,
    seed: u64,
) -> Result<Comparison, CalibrateError> {
    check_number(test, "test")?;
    let target_ms = target.map(|target| target.as_secs_f64() * 1e3);
    let draws = &mut Draws::new(seed, "calibrate simulation");
    let by_fit = Standard::new(|draws| jitter::draw(fit.distribution, draws), draws);
    let normal = Standard::new(Draws::normal, draws);
    // Quantiles do not depend on the correlation; changes from packet to packet do.
    let changes = &mut Draws::new(seed, "calibrate changes");
    let correlation = fit.jitter_correlation();
    let [fit_change, normal_change] =
        [(fit.distribution, correlation), (JitterDistribution::Normal, Correlation::NONE)].map(
            |(distribution, correlation)| {
                mean_change(&jitter::draw_series(distribution, correlation, SIMULATED, changes))
            },
        );
    let (mut fitted, mut test) = (Part::new(fitted, target_ms), Part::new(test, target_ms));
    // The prediction of each predictor if the fit and the resample of the fitted part are these.
    let predict = |mean: f64, deviation: f64, change: f64, fitted: &Part| {
        let (average, spread) = fitted.moments();
        let lost = fitted.lost_share();
        [
            by_fit.values([mean, deviation], change, lost, target_ms),
            normal.values([average, spread], normal_change, lost, target_ms),
            fitted.values(),
        ]
    };
    let (measured, predicted) =
        (test.values(), predict(fit.mean_ms.value, fit.deviation_ms.value, fit_change, &fitted));
    let (average, spread) = fitted.moments();
    let times = [
        by_fit.times([fit.mean_ms.value, fit.deviation_ms.value]),
        normal.times([average, spread]),
        fitted.sorted(),
    ];
    let distances = times.each_ref().map(|times| wasserstein(&test.arrived, times));
    let mut resamples = Vec::with_capacity(RESAMPLES);
    for located in &fit.resampled {
        fitted.resample(draws);
        test.resample(draws);
        let distances = times.each_ref().map(|times| wasserstein(&test.arrived, times));
        let change = fit_change * changes_by_error(fit.correlation, correlation, changes.normal());
        let predicted = predict(located.mean, located.deviation, change, &fitted);
        resamples.push(Resample { measured: test.values(), predicted, distances });
    }
    let estimate = |value: f64, of: &dyn Fn(&Resample) -> f64| {
        Estimate::around(value, &mut resamples.iter().map(of).collect::<Vec<_>>())
    };
    let prediction = |(k, by): (usize, Predictor)| {
        let agrees = std::array::from_fn(|i| {
            let difference = estimate(0.0, &|resample| resample.predicted[k][i] - resample.measured[i]);
            // Times or shares that are the same in all resamples of both parts leave no interval.
            difference.covers(0.0) || (predicted[k][i] - measured[i]).abs() < SAME
        });
        Prediction {
            by,
            figures: Figures::new(predicted[k], target_ms),
            agrees: Figures::new(agrees, target_ms),
            wasserstein_ms: estimate(distances[k], &|resample| resample.distances[k]),
        }
    };
    let mut intervals: [Estimate; 5] =
        std::array::from_fn(|i| estimate(measured[i], &|resample| resample.measured[i]));
    intervals[4].widen(test.packets.len());
    Ok(Comparison {
        fitted_packets: fitted.packets.len(),
        test_packets: test.packets.len(),
        target_ms,
        measured: Figures::new(intervals, target_ms),
        predictions: Predictor::ALL.into_iter().enumerate().map(prediction).collect(),
    })
}

impl<T> Figures<T> {
    fn new([p50_ms, p95_ms, p99_ms, change_ms, above]: [T; 5], target_ms: Option<f64>) -> Self {
        Self { p50_ms, p95_ms, p99_ms, change_ms, above: target_ms.map(|_| above) }
    }
}

/// Returns the mean difference of two values that follow each other.
fn mean_change(series: &[f64]) -> f64 {
    let changes = series.windows(2).map(|pair| (pair[1] - pair[0]).abs());
    changes.sum::<f64>() / (series.len() - 1) as f64
}

/// Returns by how much changes from packet to packet grow if the correlation is wrong by a normal deviate: with normal jitter, they
/// are proportional to √(1 - ρ).
fn changes_by_error(measured: Estimate, fitted: Correlation, deviate: f64) -> f64 {
    let error = (measured.high - measured.low) / (2.0 * TWO_SIDED) * deviate;
    ((1.0 - fitted.get() - error) / (1.0 - fitted.get())).max(0.0).sqrt()
}

/// Simulated jitter of a distribution, rising, in units of its deviation.
struct Standard(Vec<f64>);

impl Standard {
    fn new(mut draw: impl FnMut(&mut Draws) -> f64, draws: &mut Draws) -> Self {
        let mut simulated: Vec<f64> = (0..SIMULATED).map(|_| draw(draws)).collect();
        simulated.sort_unstable_by(f64::total_cmp);
        Self(simulated)
    }

    /// Returns round trips with this mean and deviation, rising: every [`THINNED`]th.
    fn times(&self, [mean, deviation]: [f64; 2]) -> Vec<f64> {
        let thinned = self.0.iter().skip(THINNED / 2).step_by(THINNED);
        thinned.map(|jitter| (mean + deviation * jitter).max(0.0)).collect()
    }

    /// Returns the figures with this mean and deviation. The mean change from packet to packet is in units of the deviation.
    fn values(&self, [mean, deviation]: [f64; 2], change: f64, lost: f64, target_ms: Option<f64>) -> Values {
        let [a, b, c] = LEVELS.map(|level| (mean + deviation * quantile(&self.0, level)).max(0.0));
        let above = target_ms.map_or(0.0, |target| {
            let within = self.0.partition_point(|jitter| mean + deviation * jitter <= target);
            lost + (1.0 - lost) * (1.0 - within as f64 / self.0.len() as f64)
        });
        [a, b, c, deviation * change, above]
    }
}

/// A part of the round trips, or a resample of it.
struct Part {
    /// Place of each packet among those that arrived; `None` if it was lost.
    packets: Vec<Option<usize>>,
    arrived: Counted,
    /// Number of lost packets.
    lost: usize,
    /// Difference of each packet's time and the next one's, ms; `None` if one of them was lost.
    changes: Vec<Option<f64>>,
    /// Sum of differences, ms, and their number.
    changed: (f64, usize),
    resampler: Resampler,
    target_ms: Option<f64>,
}

impl Part {
    fn new(trips: &PacketTimes, target_ms: Option<f64>) -> Self {
        let times = trips.arrived();
        let mut next = 0..times.len();
        let packets: Vec<_> = trips.times_ms.iter().map(|time| time.and_then(|_| next.next())).collect();
        let mut arrived = Counted::new(&times);
        (0..times.len()).for_each(|i| arrived.add(i));
        // Blocks are long enough for times and for losses.
        let lost: Vec<f64> = packets.iter().map(|packet| f64::from(u8::from(packet.is_none()))).collect();
        let length = block_length(&times).max(block_length(&lost));
        let change = |pair: &[Option<f64>]| Some((pair[0]? - pair[1]?).abs());
        let changes: Vec<Option<f64>> = trips.times_ms.windows(2).map(change).collect();
        Self {
            lost: packets.len() - times.len(),
            changed: (changes.iter().flatten().sum(), changes.iter().flatten().count()),
            changes,
            resampler: Resampler::of_length(packets.len(), length),
            packets,
            arrived,
            target_ms,
        }
    }

    fn resample(&mut self, draws: &mut Draws) {
        let Self { packets, arrived, lost, changes, changed: (sum, number), resampler, .. } = self;
        arrived.clear();
        (*lost, *sum, *number) = (0, 0.0, 0);
        resampler.resample(draws, |i| {
            match packets[i] {
                Some(at) => arrived.add(at),
                None => *lost += 1,
            }
            if let Some(Some(change)) = changes.get(i) {
                *sum += change;
                *number += 1;
            }
        });
    }

    fn lost_share(&self) -> f64 {
        self.lost as f64 / self.packets.len() as f64
    }

    fn values(&self) -> Values {
        let [a, b, c] = self.arrived.quantiles(LEVELS);
        let above = self.target_ms.map_or(0.0, |target| {
            let late = self.arrived.counted().filter(|(time, _)| *time > target);
            let late: u32 = late.map(|(_, count)| count).sum();
            (self.lost as f64 + f64::from(late)) / self.packets.len() as f64
        });
        let (sum, number) = self.changed;
        [a, b, c, sum / number.max(1) as f64, above]
    }

    /// Returns the mean and the standard deviation of the packets that arrived.
    fn moments(&self) -> (f64, f64) {
        let (mut n, mut sum) = (0.0, 0.0);
        for (time, count) in self.arrived.counted() {
            n += f64::from(count);
            sum += time * f64::from(count);
        }
        let mean = sum / n;
        let squares = self.arrived.counted().map(|(time, count)| (time - mean).powi(2) * f64::from(count));
        (mean, (squares.sum::<f64>() / n).sqrt())
    }

    /// Returns the times of the packets that arrived, rising.
    fn sorted(&self) -> Vec<f64> {
        self.arrived.counted().flat_map(|(time, count)| (0..count).map(move |_| time)).collect()
    }
}

/// Returns the 1-Wasserstein distance between counted values and sorted ones: the mean distance between their quantiles.
fn wasserstein(counted: &Counted, sorted: &[f64]) -> f64 {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{fit_path, parse_round_trips};

    fn counted(values: &[f64]) -> Counted {
        let mut ranked = Counted::new(values);
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
    fn series(seed: u64, n: usize) -> PacketTimes {
        let mut draws = Draws::new(seed, "series");
        let mut time = || 20.0 + 2.0 * jitter::draw(JitterDistribution::Pareto, &mut draws);
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
        let all = Figures { p50_ms: true, p95_ms: true, p99_ms: true, change_ms: true, above: Some(true) };
        assert_eq!(by_fit.agrees, all, "{compared:#?}");
        assert!(replay.agrees.p50_ms);
        assert!(!normal.agrees.p50_ms);
        assert!(by_fit.wasserstein_ms.value * 3.0 < normal.wasserstein_ms.value, "{compared:#?}");
    }

    #[test]
    fn a_constant_delay_is_predicted() {
        let rows: String = (0..1000).map(|i| format!("{i},5.500{:04}\n", i % 2)).collect();
        let [fitted, test] = parse_round_trips(&format!("seq,rtt_ms\n{rows}")).unwrap().split(0.6);
        let fit = fit_path(&fitted, 1).unwrap();
        let compared = compare(&fit, &fitted, &test, None, 1).unwrap();
        let [by_fit, ..] = &compared.predictions[..] else { panic!() };
        let all = Figures { p50_ms: true, p95_ms: true, p99_ms: true, change_ms: true, above: None };
        assert_eq!(by_fit.agrees, all, "{compared:#?}");
    }

    #[test]
    fn changes_from_packet_to_packet_follow_the_correlation() {
        let mut draws = Draws::new(7, "series");
        let correlation = Correlation::new(0.7).unwrap();
        let jitter = jitter::draw_series(JitterDistribution::Uniform, correlation, 3000, &mut draws);
        let times_ms: Vec<_> = jitter.iter().map(|jitter| Some(20.0 + 2.0 * jitter)).collect();
        let series = PacketTimes { times_ms, ..series(7, 10) };
        let [fitted, test] = series.split(0.6);
        let fit = fit_path(&fitted, 1).unwrap();
        assert!(fit.correlation.covers(0.7), "{:?}", fit.correlation);
        let compared = compare(&fit, &fitted, &test, None, 1).unwrap();
        let agree: Vec<_> = compared.predictions.iter().map(|by| by.agrees.change_ms).collect();
        assert_eq!(agree, [true, false, true], "{compared:#?}");
    }

    #[test]
    fn the_same_seed_gives_the_same_comparison() {
        let [fitted, test] = series(5, 600).split(0.6);
        let fit = fit_path(&fitted, 1).unwrap();
        let compared = |seed| compare(&fit, &fitted, &test, None, seed).unwrap();
        assert_eq!(compared(1), compared(1));
        assert_ne!(compared(1), compared(2));
    }
}
