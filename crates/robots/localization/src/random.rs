//! Random numbers of a filter: one stream from one seed, so that the same log gives the same trajectory.

use cotorra_graph::seed;
use rand::{Rng, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

/// A stream of random numbers.
#[derive(Debug, Clone)]
pub(crate) struct Stream(Xoshiro256PlusPlus);

impl Stream {
    pub fn new(seed: u64) -> Self {
        Self(Xoshiro256PlusPlus::seed_from_u64(seed::split(seed, "localization")))
    }

    /// Draws a number uniformly from [0, 1).
    pub fn uniform(&mut self) -> f64 {
        (self.0.next_u64() >> 11) as f64 * (1.0 / (1u64 << 53) as f64)
    }

    /// Draws an integer uniformly from 0..count.
    pub fn below(&mut self, count: u64) -> u64 {
        // Lemire 2019 without the rejection step: biased by count/2^64.
        ((u128::from(self.0.next_u64()) * u128::from(count)) >> 64) as u64
    }

    /// Draws from a bell curve with mean 0 and deviation 1: the sum of four uniforms (Probabilistic Robotics, table 5.4,
    /// sums twelve). It takes a tenth of the time of an exact normal deviate.
    pub fn bell(&mut self) -> f32 {
        const MEAN: f32 = 2.0 * 65_535.0;
        // √(4 · (65536² - 1) / 12)
        const DEVIATION: f32 = 37_837.227;
        let bits = self.0.next_u64();
        let sum = (bits & 0xffff) + (bits >> 16 & 0xffff) + (bits >> 32 & 0xffff) + (bits >> 48);
        (sum as f32 - MEAN) * (1.0 / DEVIATION)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bell_has_mean_zero_and_deviation_one() {
        let mut stream = Stream::new(7);
        let draws: Vec<f32> = (0..100_000).map(|_| stream.bell()).collect();
        let mean = draws.iter().sum::<f32>() / 1e5;
        let variance = draws.iter().map(|x| x * x).sum::<f32>() / 1e5;
        assert!(mean.abs() < 0.015, "{mean}");
        assert!((variance - 1.0).abs() < 0.02, "{variance}");
    }

    #[test]
    fn integers_are_drawn_uniformly() {
        let mut stream = Stream::new(7);
        let mut counts = [0; 7];
        (0..70_000).for_each(|_| counts[stream.below(7) as usize] += 1);
        assert!(counts.iter().all(|count| (9_500..10_500).contains(count)), "{counts:?}");
    }
}
