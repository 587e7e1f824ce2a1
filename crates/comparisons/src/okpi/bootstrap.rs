//! Intervals around figures of samples that depend on their neighbours, by the moving block bootstrap.

use cotorra_numbers::{Blocks, Draws, RESAMPLES, percentile_interval, resample};

use super::{
    figures::{Distribution, Intervals},
    times::Timed,
};

/// Length of a block, seconds: the longest period of the published walk, between two scans by probing.
const BLOCK_S: f64 = 25.0;

/// Returns 95 % intervals around the figures of a walk; `None` without answered samples.
pub(super) fn intervals(walk: &[Timed], seed: u64) -> Option<Intervals> {
    Distribution::of(walk)?;
    let mut draws = Draws::new(seed, "bootstrap");
    let block = block(walk);
    let mut resampled = Vec::with_capacity(walk.len());
    let mut figures: [Vec<f64>; 4] = Default::default();
    for _ in 0..RESAMPLES {
        resampled.clear();
        resample(walk.len(), Blocks::Moving(block), &mut draws, |at| resampled.push(walk[at]));
        // Without an answer in a resampled walk, it has no quantiles.
        let Some(of) = Distribution::of(&resampled) else { continue };
        for (all, figure) in figures.iter_mut().zip([of.p95_ms, of.p99_ms, of.above_15_ms, of.above_40_ms]) {
            all.push(figure);
        }
    }
    let [p95_ms, p99_ms, above_15_ms, above_40_ms] = figures.map(percentile_interval);
    Some(Intervals { p95_ms: p95_ms?, p99_ms: p99_ms?, above_15_ms: above_15_ms?, above_40_ms: above_40_ms? })
}

/// Returns the number of samples in a block: those within [`BLOCK_S`] on average, and at least four blocks in a walk.
fn block(walk: &[Timed]) -> usize {
    let span = walk.last().zip(walk.first()).map_or(0.0, |(last, first)| last.at_s - first.at_s);
    let within = (BLOCK_S * walk.len() as f64 / span).round();
    (within.min(walk.len() as f64 / 4.0) as usize).max(1)
}

#[cfg(test)]
mod tests {
    use cotorra_numbers::Interval;

    use super::*;

    /// A walk of 450 s with a sample each second.
    fn walk(ms: impl Fn(usize) -> f64) -> Vec<Timed> {
        (0..450).map(|second| Timed { at_s: second as f64, ms: Some(ms(second)) }).collect()
    }

    /// Samples that do not depend on each other, uniform in 0..100 ms.
    fn noise() -> Vec<f64> {
        let mut draws = Draws::from_seed(1);
        (0..450).map(|_| draws.below(10_000) as f64 / 100.0).collect()
    }

    #[test]
    fn a_constant_has_intervals_without_width() {
        let all = intervals(&walk(|_| 20.0), 1).unwrap();
        for (interval, value) in [(all.p95_ms, 20.0), (all.above_15_ms, 1.0), (all.above_40_ms, 0.0)] {
            assert_eq!(interval, Interval { low: value, high: value });
        }
    }

    #[test]
    fn the_same_seed_draws_the_same_intervals() {
        let noise = noise();
        let walk = walk(|second| noise[second]);
        assert_eq!(intervals(&walk, 1), intervals(&walk, 1));
        assert_ne!(intervals(&walk, 1), intervals(&walk, 2));
    }

    #[test]
    fn independent_samples_have_the_width_of_a_binomial_share() {
        let noise = noise();
        let walk = walk(|second| noise[second]);
        let Interval { low, high } = intervals(&walk, 1).unwrap().above_40_ms;
        let share = Distribution::of(&walk).unwrap().above_40_ms;
        assert!(low < share && share < high, "{low} {share} {high}");
        // 1.96 standard deviations to both sides.
        let binomial = 2.0 * 1.96 * (share * (1.0 - share) / 450.0).sqrt();
        assert!((0.6..1.4).contains(&((high - low) / binomial)), "{} {binomial}", high - low);
    }

    #[test]
    fn samples_that_depend_on_their_neighbours_have_wider_intervals() {
        let width = |walk: &[Timed]| {
            let Interval { low, high } = intervals(walk, 1).unwrap().above_40_ms;
            high - low
        };
        let noise = noise();
        let [alone, in_runs] = [1, 25].map(|run| width(&walk(|second| noise[second / run])));
        assert!(in_runs > 2.0 * alone, "{in_runs} {alone}");
    }

    #[test]
    fn a_walk_without_answers_has_no_intervals() {
        let silent: Vec<_> = (0..40).map(|at| Timed { at_s: f64::from(at), ms: None }).collect();
        assert_eq!((intervals(&silent, 1), intervals(&[], 1)), (None, None));
        // A single instant has blocks, too.
        assert!(intervals(&[Timed { at_s: 1.0, ms: Some(3.0) }], 1).is_some());
    }
}
