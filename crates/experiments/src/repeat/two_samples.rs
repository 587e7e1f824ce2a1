//! Two samples of service times: their figures, and tests of whether both come from one distribution.

use cotorra_numbers::quantile;
use statrs::function::erf::erfc;

/// Times in milliseconds, in order. Requests without an answer count as infinite.
#[derive(Debug, Clone, PartialEq)]
pub struct Sample(Vec<f64>);

/// A sample beside another.
#[derive(Debug, Clone, PartialEq)]
pub struct Two {
    /// Numbers of requests.
    pub samples: [usize; 2],
    /// Medians, milliseconds; `None` without samples, and infinite if the request has no answer.
    pub p50_ms: [Option<f64>; 2],
    /// 99th percentiles, milliseconds.
    pub p99_ms: [Option<f64>; 2],
    /// Shares of requests that were answered within the target.
    pub kept: [Option<f64>; 2],
    /// p-value of the Kolmogorov-Smirnov test, less the tolerance.
    pub p: f64,
    /// p-value of the test of equal shares kept, less the tolerance.
    pub p_kept: f64,
}

impl Sample {
    /// Creates a sample of times, which are not NaN.
    pub fn new(mut times: Vec<f64>) -> Self {
        times.sort_by(f64::total_cmp);
        Self(times)
    }

    /// Returns the number of times.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Whether there are no times.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Returns the number of times up to a limit.
    fn within(&self, limit_ms: f64) -> usize {
        self.0.partition_point(|took| *took <= limit_ms)
    }

    /// Returns the share of times up to a limit; there must be times.
    fn share(&self, limit_ms: f64) -> f64 {
        self.within(limit_ms) as f64 / self.len() as f64
    }
}

impl Two {
    /// Compares two samples of a service with a target. A difference of times up to the tolerance does not count.
    pub fn of(one: &Sample, other: &Sample, target_ms: f64, tolerance_ms: f64) -> Self {
        let of = |figure: &dyn Fn(&Sample) -> Option<f64>| [figure(one), figure(other)];
        let kept = |sample: &Sample| (!sample.is_empty()).then(|| sample.share(target_ms));
        // A service without any request is another service.
        let are_there = !one.is_empty() && !other.is_empty();
        Self {
            samples: [one.len(), other.len()],
            p50_ms: of(&|sample| quantile(&sample.0, 0.5)),
            p99_ms: of(&|sample| quantile(&sample.0, 0.99)),
            kept: of(&kept),
            p: if are_there { kolmogorov_smirnov(one, other, tolerance_ms) } else { 0.0 },
            p_kept: if are_there { equal_shares(one, other, target_ms, tolerance_ms) } else { 0.0 },
        }
    }

    /// Whether neither test rejects at this level that both come from one distribution.
    pub fn is_same(&self, level: f64) -> bool {
        self.p >= level && self.p_kept >= level
    }
}

/// Returns the p-value of the two-sample Kolmogorov-Smirnov test, by the asymptotic distribution with Stephens' correction for
/// small samples. The distance is what remains of it when either sample is made slower by the tolerance.
fn kolmogorov_smirnov(one: &Sample, other: &Sample, tolerance_ms: f64) -> f64 {
    // The largest lead of a sample over the other is at one of its times.
    let lead = |ahead: &Sample, behind: &Sample| {
        let leads = ahead.0.iter().map(|took| ahead.share(*took) - behind.share(took + tolerance_ms));
        leads.fold(0.0, f64::max)
    };
    let distance = lead(one, other).max(lead(other, one));
    let (n, m) = (one.len() as f64, other.len() as f64);
    let root = (n * m / (n + m)).sqrt();
    let lambda = (root + 0.12 + 0.11 / root) * distance;
    // The series does not converge there, and is 1 to ten digits.
    if lambda < 0.2 {
        return 1.0;
    }
    let term = |k: u32| {
        let sign = if k % 2 == 1 { 2.0 } else { -2.0 };
        sign * (-2.0 * (f64::from(k) * lambda).powi(2)).exp()
    };
    (1..=100).map(term).sum::<f64>().clamp(0.0, 1.0)
}

/// Returns the p-value of the two-sided test of equal shares within a target, with the pooled variance. The tolerance brings
/// both shares together, up to being equal.
fn equal_shares(one: &Sample, other: &Sample, target_ms: f64, tolerance_ms: f64) -> f64 {
    let (more, less) =
        if one.share(target_ms) >= other.share(target_ms) { (one, other) } else { (other, one) };
    let difference = more.share(target_ms) - less.share(target_ms + tolerance_ms);
    if difference <= 0.0 {
        return 1.0;
    }
    let (n, m) = (more.len() as f64, less.len() as f64);
    let pooled = (more.within(target_ms) + less.within(target_ms + tolerance_ms)) as f64 / (n + m);
    let deviation = (pooled * (1.0 - pooled) * (1.0 / n + 1.0 / m)).sqrt();
    erfc(difference / deviation / std::f64::consts::SQRT_2)
}

#[cfg(test)]
mod tests {
    use cotorra_numbers::Draws;

    use super::*;

    /// Times around 10 ms, later by `shift_ms`.
    fn drawn(seed: u64, count: usize, shift_ms: f64) -> Sample {
        let mut random = Draws::from_seed(seed);
        let mut share = || random.bits() as f64 / u64::MAX as f64;
        let mut time = || (0..12).map(|_| share()).sum::<f64>() + 4.0 + shift_ms;
        Sample::new((0..count).map(|_| time()).collect())
    }

    fn p(one: &Sample, other: &Sample, tolerance_ms: f64) -> f64 {
        Two::of(one, other, 10.0, tolerance_ms).p
    }

    #[test]
    fn p_values_are_those_of_the_asymptotic_distribution() {
        let sample = |range: std::ops::Range<u32>| Sample::new(range.map(f64::from).collect());
        // D = 0.2, 50 and 50 values: lambda = (5 + 0.12 + 0.022) · 0.2 = 1.0284, Q = 0.2408.
        let two = p(&sample(0..50), &sample(10..60), 0.0);
        assert!((two - 0.2408).abs() < 5e-4, "{two}");
        // D = 0.4: lambda = 2.0568, Q = 4.23e-4.
        let two = p(&sample(0..50), &sample(20..70), 0.0);
        assert!((two - 4.23e-4).abs() < 5e-6, "{two}");
        assert_eq!(p(&sample(0..50), &sample(0..50), 0.0), 1.0);
    }

    #[test]
    fn samples_of_one_distribution_are_rejected_as_often_as_the_level_says() {
        let rejected =
            (0..400).filter(|seed| p(&drawn(2 * seed, 300, 0.0), &drawn(2 * seed + 1, 300, 0.0), 0.0) < 0.05);
        let rejected = rejected.count();
        assert!((5..=35).contains(&rejected), "{rejected} of 400 at a level of 5 %");
    }

    #[test]
    fn later_samples_differ_unless_they_are_within_the_tolerance() {
        let (one, later) = (drawn(1, 2000, 0.0), drawn(2, 2000, 0.3));
        assert!(p(&one, &later, 0.0) < 1e-6 && p(&later, &one, 0.0) < 1e-6);
        assert!(p(&one, &later, 0.3) > 0.01 && p(&later, &one, 0.3) > 0.01);
    }

    #[test]
    fn requests_without_an_answer_count_as_later_than_all() {
        let lost = |count: usize| {
            let infinite = std::iter::repeat_n(f64::INFINITY, count);
            Sample::new(drawn(1, 1000 - count, 0.0).0.into_iter().chain(infinite).collect())
        };
        let two = Two::of(&lost(0), &lost(200), 20.0, 0.1);
        assert_eq!((two.kept, two.p50_ms[0].is_some()), ([Some(1.0), Some(0.8)], true));
        assert!(two.p < 1e-6 && two.p_kept < 1e-6);
        assert_eq!(Two::of(&lost(0), &lost(20), 20.0, 0.1).p99_ms[1], Some(f64::INFINITY));
    }

    #[test]
    fn a_target_between_two_narrow_distributions_is_told_apart_by_shares() {
        // 96.5 % and 99.5 %: the largest distance of the distributions is small, and the shares differ.
        let with =
            |above: usize| Sample::new((0..1000).map(|i| if i < above { 30.0 } else { 10.0 }).collect());
        let two = Two::of(&with(35), &with(5), 20.0, 0.1);
        assert!(two.p > 0.5 && two.p_kept < 1e-4, "{two:?}");
        assert!(!two.is_same(0.005) && two.is_same(1e-9));
    }

    #[test]
    fn a_service_that_is_gone_differs() {
        let two = Two::of(&drawn(1, 100, 0.0), &Sample::new(Vec::new()), 10.0, 0.1);
        assert!(!two.is_same(1e-12) && two.p99_ms[1].is_none());
    }
}
