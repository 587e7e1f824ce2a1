//! Damaged copies of bytes, for readers of what others made.

/// Returns damaged copies without an end, the same each time: with other bytes, without a part, with a part twice, cut off.
pub fn mutations(original: &[u8]) -> impl Iterator<Item = Vec<u8>> {
    // A linear congruential generator (Knuth).
    let mut state = 1_u64;
    let mut draw = move |below: usize| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as usize % below.max(1)
    };
    std::iter::repeat_with(move || {
        let mut bytes = original.to_vec();
        for _ in 0..=draw(4) {
            let at = draw(bytes.len());
            let end = (at + draw(64)).min(bytes.len());
            match draw(6) {
                0 | 1 if at < bytes.len() => bytes[at] ^= 1 << draw(8),
                2 if at < bytes.len() => bytes[at] = [0, 0xff, 0x7f, b'"', b'[', b'{'][draw(6)],
                3 => drop(bytes.drain(at..end)),
                4 => {
                    let part = bytes[at..end].to_vec();
                    bytes.splice(at..at, part);
                }
                _ => bytes.truncate(draw(bytes.len() + 1)),
            }
        }
        bytes
    })
}
