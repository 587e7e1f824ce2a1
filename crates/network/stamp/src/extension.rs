//! Extensions behind the base packet (RFC 8972, section 4): flags, type, length, value. Only padding is supported. A
//! reflector returns the others, flagged as unrecognized.

/// The reflector does not know the type.
const UNRECOGNIZED: u8 = 0x80;
/// The extension runs over the packet's end.
const MALFORMED: u8 = 0x40;
/// Extra padding (RFC 8972, section 4.1).
const PADDING: u8 = 1;
const HEADER: usize = 4;

/// Turns a sender's extensions into those of the reply, in place.
pub(crate) fn reflect(mut extensions: &mut [u8]) {
    while extensions.len() >= HEADER {
        let length = usize::from(u16::from_be_bytes([extensions[2], extensions[3]]));
        if HEADER + length > extensions.len() {
            extensions[0] |= MALFORMED;
            return;
        }
        let kind = extensions[1];
        extensions[0] = if kind == PADDING { 0 } else { UNRECOGNIZED };
        extensions = &mut extensions[HEADER + length..];
    }
}

/// Fills the space behind the base packet with one padding, if its header fits.
pub(crate) fn pad(extensions: &mut [u8]) {
    let Some(length) = extensions.len().checked_sub(HEADER).and_then(|length| u16::try_from(length).ok())
    else {
        return;
    };
    // A sender sets the flag; a reflector that recognizes the type clears it.
    extensions[0] = UNRECOGNIZED;
    extensions[1] = PADDING;
    extensions[2..HEADER].copy_from_slice(&length.to_be_bytes());
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn only_unknown_extensions_are_flagged() {
        let mut extensions = [0x80, 1, 0, 2, 7, 7, 0, 200, 0, 1, 9, 0x80, 1, 0, 9, 1];
        reflect(&mut extensions);
        assert_eq!(extensions, [0, 1, 0, 2, 7, 7, 0x80, 200, 0, 1, 9, 0xc0, 1, 0, 9, 1]);
    }

    proptest! {
        #[test]
        fn padding_comes_back_unflagged(length in HEADER..2000) {
            let mut extensions = vec![0; length];
            pad(&mut extensions);
            reflect(&mut extensions);
            prop_assert_eq!(extensions[0], 0);
        }

        #[test]
        fn replies_keep_the_length_of_extensions(mut extensions in prop::collection::vec(any::<u8>(), 0..200)) {
            let before = extensions.clone();
            reflect(&mut extensions);
            let changed = before.iter().zip(&extensions).filter(|(a, b)| a != b).count();
            prop_assert!(changed <= before.len() / HEADER);
        }
    }
}
