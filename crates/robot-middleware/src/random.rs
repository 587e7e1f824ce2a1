//! Randomness from the run's one seed, a stream for each use, so that drawing more for one thing leaves all others as
//! they were.

use rand::{Rng, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

/// A stream of random numbers.
#[derive(Debug, Clone)]
pub(crate) struct Stream(Xoshiro256PlusPlus);

impl Stream {
    /// The stream of that label: FNV-1a of the label, mixed with the seed by splitmix64.
    pub fn new(seed: u64, label: &str) -> Self {
        let hash = label.bytes().fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| {
            (hash ^ u64::from(byte)).wrapping_mul(0x100_0000_01b3)
        });
        // The generator expands its 64 bits with splitmix64 itself.
        Self(Xoshiro256PlusPlus::seed_from_u64(splitmix64(seed ^ hash)))
    }

    /// Uniform in [0, 1).
    pub fn uniform(&mut self) -> f64 {
        (self.0.next_u64() >> 11) as f64 * (1.0 / (1u64 << 53) as f64)
    }

    /// Mean 0, deviation 1, bell-shaped and within ±2√3: the sum of four 16-bit uniforms (Irwin-Hall). A bounded
    /// error cannot put a wall on the wrong side of a robot, and it costs a tenth of an exact normal.
    pub fn bell(&mut self) -> f64 {
        const MEAN: f64 = 2.0 * 65_535.0;
        // √(4 · (65536² - 1) / 12)
        const DEVIATION: f64 = 37_837.227_208_35;
        let bits = self.0.next_u64();
        let sum = (bits & 0xffff) + (bits >> 16 & 0xffff) + (bits >> 32 & 0xffff) + (bits >> 48);
        (sum as f64 - MEAN) / DEVIATION
    }
}

/// Steele, Lea, Flood 2014.
fn splitmix64(seed: u64) -> u64 {
    let z = seed.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn splitmix64_gives_its_published_first_value() {
        assert_eq!(splitmix64(1_234_567), 6_457_827_717_110_365_317);
    }

    #[test]
    fn streams_differ_by_label_and_seed_and_repeat() {
        let first = |seed, label| Stream::new(seed, label).uniform();
        assert_eq!(first(1, "robot1/lidar"), first(1, "robot1/lidar"));
        assert_ne!(first(1, "robot1/lidar"), first(2, "robot1/lidar"));
        assert_ne!(first(1, "robot1/lidar"), first(1, "robot2/lidar"));
    }

    #[test]
    fn the_bell_has_mean_zero_deviation_one_and_an_end() {
        let mut stream = Stream::new(7, "bell");
        let draws: Vec<f64> = (0..100_000).map(|_| stream.bell()).collect();
        let mean = draws.iter().sum::<f64>() / 1e5;
        let variance = draws.iter().map(|x| x * x).sum::<f64>() / 1e5;
        assert!(mean.abs() < 0.015, "{mean}");
        assert!((variance - 1.0).abs() < 0.02, "{variance}");
        assert!(draws.iter().all(|x| x.abs() <= 12f64.sqrt() + 1e-4));
    }
}
