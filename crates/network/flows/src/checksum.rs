//! The Internet checksum (RFC 1071).

/// Returns the ones' complement sum of `bytes` as big-endian 16-bit words, with an odd byte padded with zero.
pub fn sum(bytes: &[u8]) -> u64 {
    // Byte order changes the sum only by a final swap (RFC 1071, 2.B), so that native words suffice.
    let (words, rest) = bytes.as_chunks::<4>();
    let mut total: u64 = words.iter().map(|w| u64::from(u32::from_ne_bytes(*w))).sum();
    let mut last = [0; 4];
    last[..rest.len()].copy_from_slice(rest);
    total += u64::from(u32::from_ne_bytes(last));
    u64::from(u16::from_be(fold(total)))
}

/// Folds a sum into 16 bits, without complementing it.
#[inline]
pub fn fold(mut sum: u64) -> u16 {
    while sum > 0xffff {
        sum = (sum & 0xffff) + (sum >> 16);
    }
    sum as u16
}

/// Returns the checksum of a sum, as TCP and UDP send it: zero is sent as all ones, because zero means none in UDP.
#[inline]
pub fn complement(sum: u64) -> u16 {
    match !fold(sum) {
        0 => 0xffff,
        checksum => checksum,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn matches_the_example_of_rfc_1071() {
        assert_eq!(fold(sum(&[0x00, 0x01, 0xf2, 0x03, 0xf4, 0xf5, 0xf6, 0xf7])), 0xddf2);
    }

    proptest! {
        #[test]
        fn matches_the_definition(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
            let word = |pair: &[u8]| u64::from(u16::from_be_bytes([pair[0], *pair.get(1).unwrap_or(&0)]));
            let expected = bytes.chunks(2).map(word).sum();
            prop_assert_eq!(fold(sum(&bytes)), fold(expected));
        }
    }
}
