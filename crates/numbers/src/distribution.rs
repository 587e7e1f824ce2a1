//! Distributions of values that are not negative, such as times, sizes and demands.

use statrs::function::erf::erfc;

use crate::Draws;

/// A distribution of values from 0, with a finite mean.
///
/// Each sample takes one uniform number, but those of a lognormal distribution, which take a normal deviate. A stream of random
/// numbers therefore gives samples in the same order in every distribution.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Distribution(Kind);

#[derive(Debug, Clone, Copy, PartialEq)]
enum Kind {
    Constant(f64),
    Uniform {
        low: f64,
        high: f64,
    },
    Exponential {
        mean: f64,
    },
    /// `sigma` is the deviation of the logarithm.
    Lognormal {
        mean: f64,
        sigma: f64,
    },
    /// `high` is infinite without a bound.
    Pareto {
        shape: f64,
        low: f64,
        high: f64,
    },
}

impl Distribution {
    /// Returns the distribution of a value, which is finite and not negative.
    pub fn constant(value: f64) -> Option<Self> {
        (is_finite(value) && value >= 0.0).then_some(Self(Kind::Constant(value)))
    }

    /// Returns the uniform distribution between two values, of which the first is not negative and not above the second.
    pub fn uniform(low: f64, high: f64) -> Option<Self> {
        (low >= 0.0 && low <= high && is_finite(high)).then_some(Self(Kind::Uniform { low, high }))
    }

    /// Returns the exponential distribution of a mean above 0.
    pub fn exponential(mean: f64) -> Option<Self> {
        is_above_zero(mean).then_some(Self(Kind::Exponential { mean }))
    }

    /// Returns the lognormal distribution of a mean above 0, whose logarithm has the deviation `sigma`, from 0 to 10.
    pub fn lognormal(mean: f64, sigma: f64) -> Option<Self> {
        (is_above_zero(mean) && (0.0..=10.0).contains(&sigma))
            .then_some(Self(Kind::Lognormal { mean, sigma }))
    }

    /// Returns the Pareto distribution of a mean above 0 and a shape above 1, without an upper bound.
    pub fn pareto(mean: f64, shape: f64) -> Option<Self> {
        if !is_above_zero(mean) || !is_finite(shape) || shape <= 1.0 {
            return None;
        }
        Some(Self(Kind::Pareto { shape, low: mean * (shape - 1.0) / shape, high: f64::INFINITY }))
    }

    /// Returns the Pareto distribution of a mean above 0 and a shape above 0 whose values are at most `high`, which is above
    /// the mean. `None` also if no value above 0 is small enough to begin with.
    pub fn pareto_up_to(mean: f64, shape: f64, high: f64) -> Option<Self> {
        if !is_above_zero(mean) || !is_above_zero(shape) || !is_finite(high) || high <= mean {
            return None;
        }
        // The mean rises with the least value. Halves of its logarithm find it to the last bits.
        let (mut below, mut above) = (f64::MIN_POSITIVE.ln(), mean.ln());
        for _ in 0..200 {
            let middle = 0.5 * (below + above);
            if bounded_mean(shape, middle.exp(), high) > mean {
                above = middle;
            } else {
                below = middle;
            }
        }
        let low = below.exp();
        let is_met = (bounded_mean(shape, low, high) / mean - 1.0).abs() < 1e-6;
        is_met.then_some(Self(Kind::Pareto { shape, low, high }))
    }

    /// Returns the mean.
    pub fn mean(&self) -> f64 {
        match self.0 {
            Kind::Constant(value) => value,
            Kind::Uniform { low, high } => 0.5 * (low + high),
            Kind::Exponential { mean } | Kind::Lognormal { mean, .. } => mean,
            Kind::Pareto { shape, low, high } if high.is_infinite() => low * shape / (shape - 1.0),
            Kind::Pareto { shape, low, high } => bounded_mean(shape, low, high),
        }
    }

    /// Draws a value.
    pub fn sample(&self, draws: &mut Draws) -> f64 {
        match self.0 {
            Kind::Constant(value) => value,
            Kind::Uniform { low, high } => low + (high - low) * draws.unit(),
            Kind::Exponential { mean } => -mean * (1.0 - draws.unit()).ln(),
            Kind::Lognormal { mean, sigma } => (location(mean, sigma) + sigma * draws.normal()).exp(),
            Kind::Pareto { shape, low, high } => {
                let beyond = (low / high).powf(shape);
                let left = 1.0 - draws.unit() * (1.0 - beyond);
                (low * left.powf(-1.0 / shape)).min(high)
            }
        }
    }

    /// Returns the probability of values up to this one.
    pub fn cdf(&self, value: f64) -> f64 {
        let share = match self.0 {
            Kind::Constant(only) => f64::from(u8::from(value >= only)),
            Kind::Uniform { low, high } if low == high => f64::from(u8::from(value >= low)),
            Kind::Uniform { low, high } => (value - low) / (high - low),
            Kind::Exponential { mean } => -(-value / mean).exp_m1(),
            Kind::Lognormal { .. } if value <= 0.0 => 0.0,
            Kind::Lognormal { mean, sigma: 0.0 } => f64::from(u8::from(value >= mean)),
            Kind::Lognormal { mean, sigma } => {
                let standard = (value.ln() - location(mean, sigma)) / sigma;
                0.5 * erfc(-standard / std::f64::consts::SQRT_2)
            }
            Kind::Pareto { low, .. } if value <= low => 0.0,
            Kind::Pareto { shape, low, high } => {
                (1.0 - (low / value).powf(shape)) / (1.0 - (low / high).powf(shape))
            }
        };
        share.clamp(0.0, 1.0)
    }
}

fn is_finite(value: f64) -> bool {
    value.is_finite()
}

fn is_above_zero(value: f64) -> bool {
    value.is_finite() && value > 0.0
}

/// Returns the mean of the logarithm.
fn location(mean: f64, sigma: f64) -> f64 {
    mean.ln() - 0.5 * sigma * sigma
}

/// Returns the mean of a Pareto distribution between two values (Harchol-Balter, "Performance Modeling and Design of
/// Computer Systems", 2013, section 20.6).
fn bounded_mean(shape: f64, low: f64, high: f64) -> f64 {
    let ratio = (high / low).ln();
    let scale = -(-shape * ratio).exp_m1();
    // ∫ x^-shape, from low to high, by low^(1 - shape); its limit at a shape of 1 is the logarithm of the ratio.
    let power = (1.0 - shape) * ratio;
    let integral = if power.abs() < 1e-12 { ratio } else { power.exp_m1() / (1.0 - shape) };
    low * shape * integral / scale
}

/// Returns the greatest distance between the distribution of rising samples and an expected one (Kolmogorov and Smirnov). If
/// the samples are of the expected distribution, and n is large, 1 % of distances exceed 1.63 / √n.
pub fn distance(sorted: &[f64], cdf: impl Fn(f64) -> f64) -> f64 {
    let count = sorted.len() as f64;
    let at = |(place, value): (usize, &f64)| {
        let expected = cdf(*value);
        f64::max(expected - place as f64 / count, (place + 1) as f64 / count - expected)
    };
    sorted.iter().enumerate().map(at).fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const COUNT: usize = 40_000;

    fn all() -> [(&'static str, Distribution); 7] {
        [
            ("uniform", Distribution::uniform(2.0, 5.0)),
            ("exponential", Distribution::exponential(3.0)),
            ("lognormal", Distribution::lognormal(3.0, 0.8)),
            ("pareto", Distribution::pareto(3.0, 2.5)),
            ("bounded pareto", Distribution::pareto_up_to(3.0, 1.2, 400.0)),
            ("bounded pareto of shape 1", Distribution::pareto_up_to(3.0, 1.0, 400.0)),
            ("bounded pareto below 1", Distribution::pareto_up_to(3.0, 0.6, 400.0)),
        ]
        .map(|(name, distribution)| (name, distribution.unwrap()))
    }

    fn samples(distribution: &Distribution, seed: u64) -> Vec<f64> {
        let mut draws = Draws::new(seed, "distribution");
        let mut samples: Vec<f64> = (0..COUNT).map(|_| distribution.sample(&mut draws)).collect();
        samples.sort_by(f64::total_cmp);
        samples
    }

    /// Over so many seeds, more than that many distances beyond the 99 % bound have a probability below 0.001.
    #[test]
    fn samples_have_the_distribution_over_seeds() {
        for (name, distribution) in all() {
            let bound = 1.63 / (COUNT as f64).sqrt();
            let far = |seed: &u64| distance(&samples(&distribution, *seed), |x| distribution.cdf(x)) > bound;
            assert!((1..=20).filter(far).count() <= 3, "{name}");
            // A distribution with another mean is found out.
            let distance = distance(&samples(&distribution, 1), |x| distribution.cdf(x * 1.1));
            assert!(distance > bound, "{name}: {distance}");
        }
    }

    #[test]
    fn means_are_those_of_the_samples() {
        for (name, distribution) in all() {
            let means = (1..=20).map(|seed| samples(&distribution, seed).iter().sum::<f64>() / COUNT as f64);
            let means: Vec<f64> = means.collect();
            let mean = means.iter().sum::<f64>() / 20.0;
            let deviation = (means.iter().map(|of| (of - mean).powi(2)).sum::<f64>() / 19.0).sqrt();
            // Student's t at 99 % with 19 degrees of freedom.
            let within = 2.861 * deviation / 20_f64.sqrt();
            assert!((mean - distribution.mean()).abs() < within, "{name}: {mean} ± {within}");
        }
    }

    #[test]
    fn bounded_pareto_has_the_mean_of_an_integral() {
        for (name, distribution) in &all()[4..] {
            // The mean is the integral of the share above, by the trapezium rule over the logarithm.
            let Kind::Pareto { low, high, .. } = distribution.0 else { panic!("{name}") };
            let steps = 20_000;
            let at = |step: i32| low * (high / low).powf(f64::from(step) / f64::from(steps));
            let share = |value: f64| 1.0 - distribution.cdf(value);
            let slices = (0..steps).map(|step| {
                let (a, b) = (at(step), at(step + 1));
                0.5 * (b - a) * (share(a) + share(b))
            });
            let integral = low + slices.sum::<f64>();
            assert!((integral / 3.0 - 1.0).abs() < 1e-5, "{name}: {integral}");
            assert!((distribution.mean() / 3.0 - 1.0).abs() < 1e-6, "{name}");
        }
    }

    #[test]
    fn impossible_distributions_are_none() {
        let none = [
            Distribution::constant(-1.0),
            Distribution::constant(f64::NAN),
            Distribution::uniform(3.0, 2.0),
            Distribution::uniform(-1.0, 2.0),
            Distribution::exponential(0.0),
            Distribution::exponential(f64::INFINITY),
            Distribution::lognormal(1.0, -0.1),
            Distribution::lognormal(1.0, 11.0),
            Distribution::pareto(1.0, 1.0),
            Distribution::pareto_up_to(5.0, 1.5, 5.0),
            Distribution::pareto_up_to(1.0, 0.0, 5.0),
            Distribution::pareto_up_to(1.0, 1.5, f64::NAN),
        ];
        assert_eq!(none, [None; 12]);
    }

    #[test]
    fn distance_is_the_largest_gap_on_either_side() {
        // The share rises to 1 at the last value, and from 0 at the first.
        assert!((distance(&[0.1, 0.2, 0.35, 0.6], |x| x) - 0.4).abs() < 1e-12);
        assert!((distance(&[0.4, 0.65, 0.8, 0.9], |x| x) - 0.4).abs() < 1e-12);
    }

    proptest! {
        #[test]
        fn samples_are_finite_and_within_bounds(
            mean in 1e-6..1e9, shape in 0.3..4.0, times in 1.5..1e6, seed: u64,
        ) {
            let mut draws = Draws::from_seed(seed);
            let bounded = Distribution::pareto_up_to(mean, shape, mean * times);
            let distributions = [
                Distribution::constant(mean),
                Distribution::uniform(0.0, mean),
                Distribution::exponential(mean),
                Distribution::lognormal(mean, shape),
                Distribution::pareto(mean, 1.0 + shape),
                bounded,
            ];
            for distribution in distributions.iter().flatten() {
                let value = distribution.sample(&mut draws);
                prop_assert!(value.is_finite() && value >= 0.0, "{distribution:?} {value}");
            }
            if let Some(bounded) = bounded {
                prop_assert!(bounded.sample(&mut draws) <= mean * times);
                prop_assert!((bounded.mean() / mean - 1.0).abs() < 1e-6);
            }
        }
    }
}
