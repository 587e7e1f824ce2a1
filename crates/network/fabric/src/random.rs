//! Random numbers from the run's seed, split by label. Each link and each robot draws from a stream of its own, so that
//! events on one never shift the numbers of another.

use cotorra_graph::seed;
use rand::{Rng, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

/// Returns the stream of random numbers for a label, in a run with this seed.
pub(crate) fn stream(seed: u64, label: &str) -> Xoshiro256PlusPlus {
    Xoshiro256PlusPlus::seed_from_u64(seed::split(seed, label))
}

/// Returns a uniform number in 0..1 (1 excluded), with 53 random bits.
pub(crate) fn unit(rng: &mut Xoshiro256PlusPlus) -> f64 {
    (rng.next_u64() >> 11) as f64 * (1.0 / (1u64 << 53) as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_fills_its_range_evenly() {
        let mut rng = stream(3, "unit");
        let draws: Vec<f64> = (0..100_000).map(|_| unit(&mut rng)).collect();
        assert!(draws.iter().all(|u| (0.0..1.0).contains(u)));
        assert!((draws.iter().sum::<f64>() / draws.len() as f64 - 0.5).abs() < 0.005);
    }
}
