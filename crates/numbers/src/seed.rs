//! One seed a run, split by label: each link, robot and plug-in draws from a stream of its own, so that what happens
//! on one never shifts what happens on another.

/// The seed of whatever `label` names, in a run with this seed: the label's FNV-1a hash, mixed with the seed by
/// splitmix64 (Steele, Lea, Flood 2014).
pub fn split(seed: u64, label: &str) -> u64 {
    splitmix64(seed ^ fnv1a(label))
}

/// FNV-1a, 64 bits (Fowler, Noll, Vo; RFC 9923).
fn fnv1a(text: &str) -> u64 {
    text.bytes()
        .fold(0xcbf2_9ce4_8422_2325, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3))
}

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
    fn fnv1a_matches_its_published_vectors() {
        assert_eq!(fnv1a(""), 0xcbf2_9ce4_8422_2325);
        assert_eq!(fnv1a("a"), 0xaf63_dc4c_8601_ec8c);
        assert_eq!(fnv1a("foobar"), 0x8594_4171_f739_67e8);
    }

    #[test]
    fn splitmix64_gives_its_published_first_value() {
        assert_eq!(splitmix64(1_234_567), 6_457_827_717_110_365_317);
    }

    #[test]
    fn seeds_differ_by_label_and_by_seed_and_repeat() {
        assert_eq!(split(1, "a-b"), split(1, "a-b"));
        assert_ne!(split(1, "a-b"), split(1, "a-c"));
        assert_ne!(split(1, "a-b"), split(2, "a-b"));
    }
}
