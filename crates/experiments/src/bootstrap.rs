//! Confidence intervals by the bootstrap (Efron, "Bootstrap Methods: Another Look at the Jackknife", Annals of Statistics 7(1),
//! 1979), with percentiles of the resampled figures as the ends.

use cotorra_graph::seed;
use cotorra_testbed::Quantiles;
use rand::{Rng, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

use crate::okpi::Interval;

/// Number of resampled sets.
pub(crate) const RESAMPLES: usize = 1000;
/// Share of the resampled figures inside an interval.
const LEVEL: f64 = 0.95;

/// Returns the 95 % interval around the median (`quantile` of 0.5) or the 95th percentile (otherwise) of samples that do not
/// depend on each other; `None` without samples. `label` names the random numbers of this interval.
pub(crate) fn of_quantile(samples: &[f64], quantile: f64, seed: u64, label: &str) -> Option<Interval> {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(seed::split(seed, &format!("bootstrap {label}")));
    let figures = (0..RESAMPLES).filter_map(|_| {
        let resampled = (0..samples.len()).map(|_| samples[below(&mut random, samples.len())]).collect();
        Quantiles::of(resampled).map(|its| if quantile == 0.5 { its.p50 } else { its.p95 })
    });
    middle(figures.collect())
}

/// Draws a number below `bound`, by Lemire's multiplication. Its bias is below `bound` / 2^64.
pub(crate) fn below(random: &mut Xoshiro256PlusPlus, bound: usize) -> usize {
    ((u128::from(random.next_u64()) * bound as u128) >> 64) as usize
}

/// Returns the interval with [`LEVEL`] of the values in its middle.
pub(crate) fn middle(mut values: Vec<f64>) -> Option<Interval> {
    values.sort_by(f64::total_cmp);
    let outside = (1.0 - LEVEL) / 2.0 * values.len().checked_sub(1)? as f64;
    let (low, high) = (outside.round() as usize, values.len() - 1 - outside.round() as usize);
    Some(Interval { low: values[low], high: values[high] })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intervals_hold_the_quantiles_of_most_samples() {
        // 60 samples from 0 to 100: does the interval have the median, 50, in about 95 of 100 sets?
        let mut random = Xoshiro256PlusPlus::seed_from_u64(7);
        let has_it = (0..100).filter(|set| {
            let samples: Vec<_> = (0..60).map(|_| below(&mut random, 10_000) as f64 / 100.0).collect();
            let Interval { low, high } = of_quantile(&samples, 0.5, *set, "gap p50").unwrap();
            (low..=high).contains(&50.0)
        });
        let count = has_it.count();
        assert!((88..=100).contains(&count), "{count}");
    }

    #[test]
    fn a_few_samples_have_an_interval_and_none_have_not() {
        assert_eq!(of_quantile(&[3.0], 0.95, 1, ""), Some(Interval { low: 3.0, high: 3.0 }));
        assert_eq!(of_quantile(&[], 0.95, 1, ""), None);
    }
}
