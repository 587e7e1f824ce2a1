//! Intervals of shares, which are inside 0 to 1.

use crate::{interval::Interval, mean::student_975};

/// The standard normal deviate that 2.5 % are above.
const Z: f64 = 1.959_963_984_540_054;

/// Returns Wilson's score interval (95 %) of a share: of `of` samples that do not depend on each other, `hits` count (Wilson,
/// "Probable Inference, the Law of Succession, and Statistical Inference", 1927). `None` without samples.
pub fn wilson(hits: u64, of: u64) -> Option<Interval> {
    (of > 0).then(|| wilson_at(hits as f64 / of as f64, of as f64, Z))
}

/// Returns Wilson's score interval of a share from 0 to 1, of a number of samples above 0 that need not be whole, at a number
/// of standard deviations.
pub fn wilson_at(share: f64, samples: f64, deviations: f64) -> Interval {
    let z = deviations * deviations / samples;
    let middle = (share + z / 2.0) / (1.0 + z);
    let half = (z * share * (1.0 - share) + z * z / 4.0).sqrt() / (1.0 + z);
    // Rounding leads out of the range, and away from a share at its end.
    Interval { low: (middle - half).clamp(0.0, share), high: (middle + half).clamp(share, 1.0) }
}

/// Returns the interval (95 %) of the mean of runs' shares, of `samples` in all of them together; `None` with fewer than two
/// runs.
///
/// The samples of a run depend on each other, but runs do not. The interval is therefore Wilson's for the effective number of
/// samples, i.e. that with which independent samples would vary as the runs do, at Student's t for the number of runs (Korn
/// and Graubard, "Confidence Intervals for Proportions with Small Expected Number of Positive Counts Estimated from Survey
/// Data", 1998; with Wilson's interval: Franco et al., "Comparative Study of Confidence Intervals for Proportions in Complex
/// Sample Surveys", 2019). At most `samples` are effective.
pub fn share_over_runs(shares: &[f64], samples: f64) -> Option<Interval> {
    let n = shares.len() as f64;
    if n < 2.0 || samples <= 0.0 {
        return None;
    }
    let mean = (shares.iter().sum::<f64>() / n).clamp(0.0, 1.0);
    let variance = shares.iter().map(|share| (share - mean).powi(2)).sum::<f64>() / (n - 1.0) / n;
    let effective = mean * (1.0 - mean) / variance;
    // Without a variance, it is no number.
    let effective = if effective < samples { effective } else { samples };
    Some(wilson_at(mean, effective, student_975(shares.len())))
}

#[cfg(test)]
mod tests {
    use proptest::{collection::vec, prelude::*};

    use super::*;

    #[test]
    fn intervals_of_shares_are_those_of_scipy() {
        // scipy.stats.binomtest(hits, of).proportion_ci(.95, 'wilson'), SciPy 1.17.1
        for (hits, of, low, high) in [
            (0, 10, 0.0, 0.277_532_799_862_889_26),
            (1, 10, 0.017_876_213_095_072_896, 0.404_150_026_795_238_5),
            (5, 10, 0.236_593_090_512_564, 0.763_406_909_487_436_1),
            (10, 10, 0.722_467_200_137_110_9, 1.0),
            (3, 1200, 0.000_850_581_899_388_771_4, 0.007_324_463_700_332_479),
            (81, 263, 0.255_288_519_878_274_2, 0.366_209_576_982_800_04),
            (1, 1, 0.206_549_314_377_237_45, 1.0),
        ] {
            let found = wilson(hits, of).unwrap();
            assert!(
                (found.low - low).abs() < 1e-12 && (found.high - high).abs() < 1e-12,
                "{hits} of {of}: {found:?}"
            );
        }
        assert_eq!(wilson(0, 0), None);
    }

    #[test]
    fn runs_that_agree_have_the_interval_of_all_their_samples() {
        let alike = share_over_runs(&[0.0; 4], 400.0).unwrap();
        assert_eq!(alike.low, 0.0);
        // Student's t for 3 degrees of freedom is 3.182: 3.182² / (400 + 3.182²).
        assert!((alike.high - 0.024_69).abs() < 1e-4, "{alike:?}");
        assert_eq!((share_over_runs(&[0.3], 100.0), share_over_runs(&[], 0.0)), (None, None));
    }

    #[test]
    fn runs_that_disagree_count_as_few_samples() {
        let Interval { low, high } = share_over_runs(&[0.0, 0.9, 0.1, 0.05], 4000.0).unwrap();
        assert!(low < 0.05 && high > 0.6 && high <= 1.0, "{low} {high}");
    }

    proptest! {
        #[test]
        fn intervals_of_shares_hold_the_share_and_stay_inside_the_range(
            shares in vec(0.0..=1.0, 2..9), samples in 1.0..1e6, hits in 0u64..50, others in 0u64..50,
        ) {
            let mean = shares.iter().sum::<f64>() / shares.len() as f64;
            let all = share_over_runs(&shares, samples).unwrap();
            prop_assert!(0.0 <= all.low && all.low <= mean && mean <= all.high && all.high <= 1.0, "{all:?}");
            if let Some(all) = wilson(hits, hits + others) {
                let share = hits as f64 / (hits + others) as f64;
                prop_assert!(0.0 <= all.low && all.holds(share) && all.high <= 1.0, "{all:?}");
            }
        }
    }
}
