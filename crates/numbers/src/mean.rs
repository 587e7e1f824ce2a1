//! Means over runs, and differences between runs that share a seed.

use statrs::distribution::{ContinuousCDF, StudentsT};

use crate::interval::Interval;

/// Fewest runs from which something can be told. Of two, the interval of a mean is six times wider than of three.
pub const FEWEST: usize = 3;

/// A mean of values that do not depend on each other.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mean {
    /// Number of values.
    pub n: usize,
    /// The mean.
    pub mean: f64,
    /// Interval of 95 % by Student's t distribution; `None` for a single value.
    pub interval: Option<Interval>,
    /// Probability of a mean at least as far from 0 if the true one is 0, by Student's t distribution (two-sided). `None`
    /// with fewer than [`FEWEST`] values, from which nothing can be told.
    pub p: Option<f64>,
}

impl Mean {
    /// Returns the mean of values; `None` without values.
    pub fn of(values: &[f64]) -> Option<Self> {
        let (n, count) = (values.len(), values.len() as f64);
        if n == 0 {
            return None;
        }
        let mean = values.iter().sum::<f64>() / count;
        if n == 1 {
            return Some(Self { n, mean, interval: None, p: None });
        }
        let variance = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / (count - 1.0);
        let error = (variance / count).sqrt();
        let student = student(count - 1.0);
        let half = student.inverse_cdf(0.975) * error;
        let is_zero = values.iter().all(|value| *value == 0.0);
        // Without a variance, t is infinite, or nothing differs.
        let p = if is_zero { 1.0 } else { 2.0 * student.sf((mean / error).abs()) };
        let interval = Some(Interval { low: mean - half, high: mean + half });
        Some(Self { n, mean, interval, p: (n >= FEWEST).then_some(p) })
    }

    /// Returns the mean of the differences `b - a` of pairs, e.g. of runs with the same seed; `None` without pairs.
    pub fn of_differences(pairs: &[(f64, f64)]) -> Option<Self> {
        Self::of(&pairs.iter().map(|(a, b)| b - a).collect::<Vec<_>>())
    }
}

fn student(freedom: f64) -> StudentsT {
    StudentsT::new(0.0, 1.0, freedom).expect("the scale and the freedom are above 0")
}

/// Returns the 97.5 % quantile of Student's t distribution for a number of values, 2 or more.
pub(crate) fn student_975(values: usize) -> f64 {
    student(values as f64 - 1.0).inverse_cdf(0.975)
}

/// Corrects probabilities for the number of comparisons (Holm, "A Simple Sequentially Rejective Multiple Test Procedure",
/// 1979): if those below 0.05 are believed, any of them is wrong with 5 % at most.
pub fn holm(p: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..p.len()).collect();
    order.sort_by(|a, b| p[*a].total_cmp(&p[*b]));
    let mut corrected = vec![0.0; p.len()];
    let mut least = 0.0;
    for (before, place) in order.into_iter().enumerate() {
        least = f64::max(least, p[place] * (p.len() - before) as f64).min(1.0);
        corrected[place] = least;
    }
    corrected
}

#[cfg(test)]
mod tests {
    use super::*;

    const A: [f64; 6] = [11.2, 12.9, 10.4, 13.8, 12.2, 11.1];
    const B: [f64; 6] = [10.9, 12.1, 10.6, 12.7, 11.5, 10.2];

    fn is_near(found: f64, expected: f64) {
        assert!((found - expected).abs() < 1e-7, "{found} is not {expected}");
    }

    fn pairs(a: &[f64], b: &[f64]) -> Vec<(f64, f64)> {
        a.iter().copied().zip(b.iter().copied()).collect()
    }

    #[test]
    fn means_have_the_interval_of_scipy() {
        // scipy.stats.t.interval(.95, 5, loc=numpy.mean(a), scale=scipy.stats.sem(a)), SciPy 1.17.1
        let Mean { n, mean, interval, .. } = Mean::of(&A).unwrap();
        let Interval { low, high } = interval.unwrap();
        assert_eq!(n, 6);
        is_near(mean, 11.933_333_333_333_332);
        is_near(low, 10.599_820_348_006_832);
        is_near(high, 13.266_846_318_659_832);
    }

    #[test]
    fn differences_of_pairs_are_those_of_scipy() {
        // r = scipy.stats.ttest_rel(b, a); r.pvalue; r.confidence_interval(.95), SciPy 1.17.1
        let found = Mean::of_differences(&pairs(&A, &B)).unwrap();
        let Interval { low, high } = found.interval.unwrap();
        is_near(found.mean, -0.6);
        is_near(found.p.unwrap(), 0.026_692_590_729_552_535);
        is_near(low, -1.096_683_597_828_227_9);
        is_near(high, -0.103_316_402_171_772_57);
    }

    #[test]
    fn two_pairs_have_a_wide_interval_and_tell_nothing() {
        // scipy.stats.ttest_rel([1, 2.5], [.5, 1]).confidence_interval(.95), SciPy 1.17.1
        let found = Mean::of_differences(&pairs(&[0.5, 1.0], &[1.0, 2.5])).unwrap();
        let Interval { low, high } = found.interval.unwrap();
        is_near(low, -5.353_102_368_087_347);
        is_near(high, 7.353_102_368_087_347);
        assert_eq!(found.p, None);
        assert_eq!(Mean::of(&[7.0]), Some(Mean { n: 1, mean: 7.0, interval: None, p: None }));
        assert_eq!(Mean::of(&[]), None);
    }

    #[test]
    fn values_without_a_variance_are_told_apart_from_no_difference() {
        assert_eq!(Mean::of(&[0.0; 4]).unwrap().p, Some(1.0));
        assert_eq!(Mean::of(&[2.0; 4]).unwrap().p, Some(0.0));
    }

    #[test]
    fn corrected_probabilities_are_those_of_statsmodels() {
        // statsmodels.stats.multitest.multipletests(p, method='holm')[1], statsmodels 0.15.0
        for (p, expected) in [
            (&[0.01, 0.04, 0.03, 0.005][..], &[0.03, 0.06, 0.06, 0.02][..]),
            (&[0.6, 0.02, 0.02, 0.9, 0.011], &[1.0, 0.08, 0.08, 1.0, 0.055]),
            (&[0.5], &[0.5]),
            (&[], &[]),
        ] {
            let found = holm(p);
            assert_eq!(found.len(), expected.len());
            found.iter().zip(expected).for_each(|(found, expected)| is_near(*found, *expected));
        }
    }
}
