//! Random numbers from the run's seed: a stream for each use, so that more draws of one leave all others unchanged.

use cotorra_graph::seed;
use rand::{Rng, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

/// A stream of random numbers.
#[derive(Debug, Clone)]
pub(crate) struct Stream(Xoshiro256PlusPlus);

impl Stream {
    /// Creates the stream of this label.
    pub fn new(seed: u64, label: &str) -> Self {
        Self(Xoshiro256PlusPlus::seed_from_u64(seed::split(seed, label)))
    }

    /// Draws 64 bits.
    pub fn bits(&mut self) -> u64 {
        self.0.next_u64()
    }

    /// Draws a number uniformly from [0, 1).
    pub fn uniform(&mut self) -> f64 {
        (self.bits() >> 11) as f64 * (1.0 / (1u64 << 53) as f64)
    }

    /// Draws from a bell curve with mean 0 and deviation 1, within ±2√3: the sum of four 16-bit uniforms (Irwin-Hall). A
    /// bounded error cannot put a wall on the wrong side of a robot, and takes a tenth of the time of an exact normal
    /// deviate.
    pub fn bell(&mut self) -> f64 {
        const MEAN: f64 = 2.0 * 65_535.0;
        // √(4 · (65536² - 1) / 12)
        const DEVIATION: f64 = 37_837.227_208_35;
        let bits = self.0.next_u64();
        let sum = (bits & 0xffff) + (bits >> 16 & 0xffff) + (bits >> 32 & 0xffff) + (bits >> 48);
        (sum as f64 - MEAN) / DEVIATION
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bell_curve_is_bounded_with_mean_zero_and_deviation_one() {
        let mut stream = Stream::new(7, "bell");
        let draws: Vec<f64> = (0..100_000).map(|_| stream.bell()).collect();
        let mean = draws.iter().sum::<f64>() / 1e5;
        let variance = draws.iter().map(|x| x * x).sum::<f64>() / 1e5;
        assert!(mean.abs() < 0.015, "{mean}");
        assert!((variance - 1.0).abs() < 0.02, "{variance}");
        assert!(draws.iter().all(|x| x.abs() <= 12f64.sqrt() + 1e-4));
    }
}
