//! Netlink attributes: length, kind and value, padded to four bytes (linux/netlink.h). All reading and writing of raw
//! attributes happens in this module.

/// A netlink answer that cannot be decoded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("cannot decode the kernel's netlink answer: {0}")]
pub struct DecodeError(pub(crate) &'static str);

const HEADER: usize = 4;
/// Clears the flag bits (nested, network byte order) that share the field with the kind.
const KIND_MASK: u16 = 0x3fff;

/// Writer of consecutive attributes.
#[derive(Debug, Default)]
pub(crate) struct Writer(Vec<u8>);

impl Writer {
    /// Appends bytes that are no attribute, such as the fixed structure that some messages begin with.
    pub(crate) fn raw(&mut self, bytes: &[u8]) -> &mut Self {
        self.0.extend_from_slice(bytes);
        self.0.resize(self.0.len().next_multiple_of(4), 0);
        self
    }

    pub(crate) fn bytes(&mut self, kind: u16, value: &[u8]) -> &mut Self {
        self.with(kind, |w| {
            w.0.extend_from_slice(value);
        })
    }

    pub(crate) fn words(&mut self, kind: u16, words: &[u32]) -> &mut Self {
        self.with(kind, |w| words.iter().for_each(|word| w.0.extend_from_slice(&word.to_ne_bytes())))
    }

    pub(crate) fn u64(&mut self, kind: u16, value: u64) -> &mut Self {
        self.bytes(kind, &value.to_ne_bytes())
    }

    /// Appends text with its terminating zero.
    pub(crate) fn text(&mut self, kind: u16, value: &str) -> &mut Self {
        self.with(kind, |w| {
            w.0.extend_from_slice(value.as_bytes());
            w.0.push(0);
        })
    }

    /// Appends an attribute whose value is written by `inside`.
    pub(crate) fn with(&mut self, kind: u16, inside: impl FnOnce(&mut Self)) -> &mut Self {
        let start = self.0.len();
        self.0.extend_from_slice(&[0; HEADER]);
        inside(self);
        let length = u16::try_from(self.0.len() - start).expect("no attribute here is longer than 64 KiB");
        self.0[start..start + 2].copy_from_slice(&length.to_ne_bytes());
        self.0[start + 2..start + 4].copy_from_slice(&kind.to_ne_bytes());
        self.0.resize(self.0.len().next_multiple_of(4), 0);
        self
    }

    pub(crate) fn finish(self) -> Vec<u8> {
        self.0
    }
}

/// Reads the attributes in `bytes`, each as kind and value.
pub(crate) fn attributes(bytes: &[u8]) -> Result<Vec<(u16, &[u8])>, DecodeError> {
    let mut found = Vec::new();
    let mut rest = bytes;
    // A rest too short for a header is padding.
    while let Some(header) = rest.get(..HEADER) {
        let length = usize::from(u16::from_ne_bytes([header[0], header[1]]));
        let kind = u16::from_ne_bytes([header[2], header[3]]) & KIND_MASK;
        let value = rest.get(HEADER..length).ok_or(DecodeError("an attribute extends beyond its message"))?;
        found.push((kind, value));
        rest = rest.get(length.next_multiple_of(4)..).unwrap_or_default();
    }
    Ok(found)
}

/// Reads the 32-bit word at index `place` of a structure of words.
pub(crate) fn word(value: &[u8], place: usize) -> Result<u32, DecodeError> {
    let bytes = value.get(place * 4..place * 4 + 4).ok_or(DecodeError("a structure is too short"))?;
    Ok(u32::from_ne_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]))
}

/// Reads a number of eight bytes.
pub(crate) fn number(value: &[u8]) -> Result<u64, DecodeError> {
    let bytes = value.first_chunk().ok_or(DecodeError("a number is too short"))?;
    Ok(u64::from_ne_bytes(*bytes))
}

/// Reads text up to its terminating zero.
pub(crate) fn text(value: &[u8]) -> String {
    let end = value.iter().position(|b| *b == 0).unwrap_or(value.len());
    String::from_utf8_lossy(&value[..end]).into_owned()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn written_attributes_are_read_back(list in prop::collection::vec((0_u16..KIND_MASK, prop::collection::vec(any::<u8>(), 0..40)), 0..8)) {
            let mut writer = Writer::default();
            for (kind, value) in &list {
                writer.bytes(*kind, value);
            }
            let bytes = writer.finish();
            let read: Vec<_> = attributes(&bytes).unwrap().into_iter().map(|(k, v)| (k, v.to_vec())).collect();
            prop_assert_eq!(read, list);
        }

        #[test]
        fn arbitrary_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..80)) {
            _ = attributes(&bytes);
        }
    }

    #[test]
    fn wrong_lengths_are_malformed() {
        let mut bytes = Writer::default();
        bytes.text(1, "netem");
        let mut bytes = bytes.finish();
        bytes[0] = 200;
        assert!(attributes(&bytes).is_err());
        bytes[0] = 2;
        assert!(attributes(&bytes).is_err());
    }
}
