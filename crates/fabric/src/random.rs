//! One seed a run, split by label: each link and each robot draws from a stream of its own, so that what happens on
//! one never shifts what happens on another.

use rand::{Rng, SeedableRng};
use rand_xoshiro::{SplitMix64, Xoshiro256PlusPlus};

/// The stream of random numbers of whatever `label` names, in a run with this seed.
///
/// The label's FNV-1a hash is mixed with the seed by splitmix64.
pub(crate) fn stream(seed: u64, label: &str) -> Xoshiro256PlusPlus {
    let mixed = SplitMix64::seed_from_u64(seed ^ fnv1a(label)).next_u64();
    Xoshiro256PlusPlus::seed_from_u64(mixed)
}

/// A number that is as likely anywhere in 0..1 (1 excluded), with 53 random bits.
pub(crate) fn unit(rng: &mut Xoshiro256PlusPlus) -> f64 {
    (rng.next_u64() >> 11) as f64 * (1.0 / (1u64 << 53) as f64)
}

/// FNV-1a, 64 bits (Fowler, Noll, Vo; RFC 9923).
fn fnv1a(text: &str) -> u64 {
    text.bytes()
        .fold(0xcbf2_9ce4_8422_2325, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fnv1a_matches_its_published_vectors() {
        assert_eq!(fnv1a(""), 0xcbf2_9ce4_8422_2325);
        assert_eq!(fnv1a("a"), 0xaf63_dc4c_8601_ec8c);
        assert_eq!(fnv1a("foobar"), 0x8594_4171_f739_67e8);
    }

    #[test]
    fn streams_differ_by_label_and_by_seed_and_repeat() {
        let first = |seed, label| stream(seed, label).next_u64();
        assert_eq!(first(1, "a-b"), first(1, "a-b"));
        assert_ne!(first(1, "a-b"), first(1, "a-c"));
        assert_ne!(first(1, "a-b"), first(2, "a-b"));
    }

    #[test]
    fn unit_fills_its_range_evenly() {
        let mut rng = stream(3, "unit");
        let draws: Vec<f64> = (0..100_000).map(|_| unit(&mut rng)).collect();
        assert!(draws.iter().all(|u| (0.0..1.0).contains(u)));
        assert!((draws.iter().sum::<f64>() / draws.len() as f64 - 0.5).abs() < 0.005);
    }
}
