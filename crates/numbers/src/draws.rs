//! Random numbers from a seed.

use rand::{Rng, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

use crate::seed;

/// A stream of random numbers. The same seed and label give the same numbers.
///
/// Each use has a stream of its own, so that more draws of one leave all others unchanged.
#[derive(Debug, Clone)]
pub struct Draws {
    source: Xoshiro256PlusPlus,
    /// Second normal deviate of a pair.
    spare: Option<f64>,
}

impl Draws {
    /// Creates the stream of a label.
    pub fn new(seed: u64, label: &str) -> Self {
        Self::from_seed(seed::split(seed, label))
    }

    /// Creates the stream of a seed that nothing else uses.
    pub fn from_seed(seed: u64) -> Self {
        Self { source: Xoshiro256PlusPlus::seed_from_u64(seed), spare: None }
    }

    /// Draws the seed of another stream, and returns that stream.
    pub fn fork(&mut self) -> Self {
        Self { source: Xoshiro256PlusPlus::from_rng(&mut self.source), spare: None }
    }

    /// Returns 64 random bits.
    #[inline]
    pub fn bits(&mut self) -> u64 {
        self.source.next_u64()
    }

    /// Returns a uniform number in 0..1 (1 excluded), with 53 random bits.
    #[inline]
    pub fn unit(&mut self) -> f64 {
        (self.bits() >> 11) as f64 * (1.0 / (1u64 << 53) as f64)
    }

    /// Returns a whole number below `n`, which is above 0.
    #[inline]
    pub fn below(&mut self, n: usize) -> usize {
        // The product's upper half (Lemire, Fast random integer generation in an interval, 2019); the bias is n / 2⁶⁴.
        ((u128::from(self.bits()) * n as u128) >> 64) as usize
    }

    /// Returns a deviate of a bell curve with mean 0 and deviation 1, within ±2√3: the sum of four 16-bit uniforms
    /// (Irwin-Hall). It takes a tenth of the time of [`Self::normal`].
    #[inline]
    pub fn bell(&mut self) -> f64 {
        (self.four() as f64 - 2.0 * 65_535.0) / FOUR_DEVIATION
    }

    /// Returns a deviate of the same curve as [`Self::bell`] in single precision, for loops that draw many.
    #[inline]
    pub fn bell_f32(&mut self) -> f32 {
        (self.four() as f32 - 2.0 * 65_535.0) * (1.0 / FOUR_DEVIATION as f32)
    }

    /// Returns the sum of four 16-bit uniforms.
    #[inline]
    fn four(&mut self) -> u64 {
        let bits = self.bits();
        (bits & 0xffff) + (bits >> 16 & 0xffff) + (bits >> 32 & 0xffff) + (bits >> 48)
    }

    /// Returns a standard normal deviate (Box and Muller 1958).
    #[inline]
    pub fn normal(&mut self) -> f64 {
        if let Some(spare) = self.spare.take() {
            return spare;
        }
        let radius = (-2.0 * (1.0 - self.unit()).ln()).sqrt();
        let (sin, cos) = (std::f64::consts::TAU * self.unit()).sin_cos();
        self.spare = Some(radius * sin);
        radius * cos
    }

    /// Returns a deviate of the gamma distribution with a shape above 0 and scale 1 (Marsaglia and Tsang, A simple method for
    /// generating gamma variables, 2000).
    pub fn gamma(&mut self, shape: f64) -> f64 {
        if shape < 1.0 {
            let power = (1.0 - self.unit()).powf(1.0 / shape);
            return self.gamma(shape + 1.0) * power;
        }
        let d = shape - 1.0 / 3.0;
        let c = 1.0 / (9.0 * d).sqrt();
        loop {
            let x = self.normal();
            let v = (1.0 + c * x).powi(3);
            if v > 0.0 && (1.0 - self.unit()).ln() < 0.5 * x * x + d - d * v + d * v.ln() {
                return d * v;
            }
        }
    }

    /// Returns a deviate of the beta distribution with two shapes above 0.
    pub fn beta(&mut self, a: f64, b: f64) -> f64 {
        let (x, y) = (self.gamma(a), self.gamma(b));
        x / (x + y)
    }
}

/// Deviation of the sum of four 16-bit uniforms: √(4 · (65536² - 1) / 12).
const FOUR_DEVIATION: f64 = 37_837.227_208_35;

#[cfg(test)]
mod tests {
    use super::*;

    fn moments(mut draw: impl FnMut() -> f64) -> (f64, f64) {
        const N: usize = 50_000;
        let values: Vec<f64> = (0..N).map(|_| draw()).collect();
        let mean = values.iter().sum::<f64>() / N as f64;
        (mean, values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / N as f64)
    }

    /// Runs of the same seed must have the same samples in every version.
    #[test]
    fn a_seed_gives_the_numbers_that_it_always_gave() {
        let mut draws = Draws::new(7, "golden");
        let drawn = [draws.bits(), draws.below(1000) as u64, draws.fork().bits()];
        assert_eq!(drawn, GOLDEN_WHOLE);
        let drawn = [draws.unit(), draws.bell(), f64::from(draws.bell_f32())];
        assert_eq!(drawn, GOLDEN);
        // Logarithms and cosines differ in their last bits between machines.
        for normal in GOLDEN_NORMAL {
            assert!((draws.normal() - normal).abs() < 1e-12);
        }
    }

    const GOLDEN_WHOLE: [u64; 3] = [6_973_020_047_736_705_941, 732, 3_996_566_931_072_424_002];
    const GOLDEN: [f64; 3] = [0.135_872_488_123_301_55, -0.536_297_226_228_086_7, -0.906_805_396_080_017_1];
    const GOLDEN_NORMAL: [f64; 2] = [0.655_875_784_112_889_6, -0.255_802_731_730_193_97];

    #[test]
    fn unit_fills_its_range_evenly() {
        let mut rng = Draws::new(3, "unit");
        let draws: Vec<f64> = (0..100_000).map(|_| rng.unit()).collect();
        assert!(draws.iter().all(|u| (0.0..1.0).contains(u)));
        assert!((draws.iter().sum::<f64>() / draws.len() as f64 - 0.5).abs() < 0.005);
    }

    #[test]
    fn bell_curve_is_bounded_with_mean_zero_and_deviation_one() {
        let mut wide = Draws::new(7, "bell");
        let mut narrow = wide.clone();
        let draws: Vec<_> = (0..100_000).map(|_| [wide.bell(), f64::from(narrow.bell_f32())]).collect();
        for of in [0, 1] {
            let mean = draws.iter().map(|x| x[of]).sum::<f64>() / 1e5;
            let variance = draws.iter().map(|x| x[of] * x[of]).sum::<f64>() / 1e5;
            assert!(mean.abs() < 0.015, "{mean}");
            assert!((variance - 1.0).abs() < 0.02, "{variance}");
            assert!(draws.iter().all(|x| x[of].abs() <= 12f64.sqrt() + 1e-4));
        }
    }

    #[test]
    fn deviates_have_the_moments_of_their_distributions() {
        let mut draws = Draws::new(1, "moments");
        for (a, b) in [(0.5, 20.0), (3.0, 2.0)] {
            let (mean, variance) = moments(|| draws.beta(a, b));
            assert!((mean / (a / (a + b)) - 1.0).abs() < 0.02, "{mean}");
            let expected = a * b / ((a + b).powi(2) * (a + b + 1.0));
            assert!((variance / expected - 1.0).abs() < 0.06, "{variance} {expected}");
        }
        let (mean, variance) = moments(|| draws.normal());
        assert!(mean.abs() < 0.02 && (variance - 1.0).abs() < 0.03, "{mean} {variance}");
        let (mean, variance) = moments(|| draws.gamma(2.5));
        assert!((mean - 2.5).abs() < 0.05 && (variance - 2.5).abs() < 0.15, "{mean} {variance}");
    }

    #[test]
    fn whole_numbers_fill_their_range() {
        let mut draws = Draws::new(2, "below");
        let mut seen = [0; 5];
        (0..5000).for_each(|_| seen[draws.below(5)] += 1);
        assert!(seen.iter().all(|n| (850..1150).contains(n)), "{seen:?}");
        let mut counts = [0; 7];
        (0..70_000).for_each(|_| counts[draws.below(7)] += 1);
        assert!(counts.iter().all(|count| (9_500..10_500).contains(count)), "{counts:?}");
    }
}
