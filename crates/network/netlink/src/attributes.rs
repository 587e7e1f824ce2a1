//! Netlink attributes: length, kind and value, padded to four bytes (linux/netlink.h). All reading and writing of raw
//! attributes happens in this module.

/// A message of the kernel's that cannot be decoded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("cannot decode the kernel's netlink message: {0}")]
pub struct DecodeError(pub &'static str);

/// `NLA_F_NESTED`: marks the kind of an attribute that holds others.
pub const NESTED: u16 = 0x8000;

const HEADER: usize = 4;
/// Clears the flag bits (nested, network byte order) that share the field with the kind.
const KIND_MASK: u16 = 0x3fff;

/// Writer of consecutive attributes.
#[derive(Debug, Default)]
pub struct Writer(Vec<u8>);

impl Writer {
    /// Appends bytes that are no attribute, such as the fixed structure that some messages begin with.
    pub fn raw(&mut self, bytes: &[u8]) -> &mut Self {
        self.0.extend_from_slice(bytes);
        self.0.resize(self.0.len().next_multiple_of(4), 0);
        self
    }

    /// Appends an attribute with this value; without bytes, it is a flag.
    ///
    /// # Panics
    /// If the value has more than 65,531 bytes.
    pub fn bytes(&mut self, kind: u16, value: &[u8]) -> &mut Self {
        self.with(kind, |w| {
            w.0.extend_from_slice(value);
        })
    }

    /// Appends an attribute of words of 32 bits.
    pub fn words(&mut self, kind: u16, words: &[u32]) -> &mut Self {
        self.with(kind, |w| words.iter().for_each(|word| w.0.extend_from_slice(&word.to_ne_bytes())))
    }

    /// Appends an attribute of 64 bits.
    pub fn u64(&mut self, kind: u16, value: u64) -> &mut Self {
        self.bytes(kind, &value.to_ne_bytes())
    }

    /// Appends text with its terminating zero.
    pub fn text(&mut self, kind: u16, value: &str) -> &mut Self {
        self.with(kind, |w| {
            w.0.extend_from_slice(value.as_bytes());
            w.0.push(0);
        })
    }

    /// Appends an attribute whose value is written by `inside`.
    ///
    /// # Panics
    /// If the value has more than 65,531 bytes.
    pub fn with(&mut self, kind: u16, inside: impl FnOnce(&mut Self)) -> &mut Self {
        let start = self.0.len();
        self.0.extend_from_slice(&[0; HEADER]);
        inside(self);
        let length = u16::try_from(self.0.len() - start).expect("an attribute is no longer than 64 KiB");
        self.0[start..start + 2].copy_from_slice(&length.to_ne_bytes());
        self.0[start + 2..start + 4].copy_from_slice(&kind.to_ne_bytes());
        self.0.resize(self.0.len().next_multiple_of(4), 0);
        self
    }

    /// Returns what was written.
    pub fn finish(self) -> Vec<u8> {
        self.0
    }
}

/// Reads attributes, each as kind and value. A rest that is too short for a header is padding.
pub fn attributes(bytes: &[u8]) -> impl Iterator<Item = Result<(u16, &[u8]), DecodeError>> {
    let mut rest = bytes;
    std::iter::from_fn(move || {
        let header = rest.get(..HEADER)?;
        let length = usize::from(u16::from_ne_bytes([header[0], header[1]]));
        let kind = u16::from_ne_bytes([header[2], header[3]]) & KIND_MASK;
        let value = rest.get(HEADER..length);
        rest = rest.get(length.next_multiple_of(4)..).filter(|_| value.is_some()).unwrap_or_default();
        let value = value.ok_or(DecodeError("an attribute extends beyond its message"));
        Some(value.map(|value| (kind, value)))
    })
}

fn fixed<const N: usize>(value: &[u8]) -> Result<[u8; N], DecodeError> {
    value.try_into().map_err(|_| DecodeError("a number has another length"))
}

/// Reads a signed number of one byte.
///
/// # Errors
/// [`DecodeError`] for another length.
pub fn parse_i8(value: &[u8]) -> Result<i8, DecodeError> {
    fixed(value).map(i8::from_ne_bytes)
}

/// Reads a number of two bytes.
///
/// # Errors
/// [`DecodeError`] for another length.
pub fn parse_u16(value: &[u8]) -> Result<u16, DecodeError> {
    fixed(value).map(u16::from_ne_bytes)
}

/// Reads a number of four bytes.
///
/// # Errors
/// [`DecodeError`] for another length.
pub fn parse_u32(value: &[u8]) -> Result<u32, DecodeError> {
    fixed(value).map(u32::from_ne_bytes)
}

/// Reads a signed number of four bytes.
///
/// # Errors
/// [`DecodeError`] for another length.
pub fn parse_i32(value: &[u8]) -> Result<i32, DecodeError> {
    fixed(value).map(i32::from_ne_bytes)
}

/// Reads a number of eight bytes.
///
/// # Errors
/// [`DecodeError`] for another length.
pub fn parse_u64(value: &[u8]) -> Result<u64, DecodeError> {
    fixed(value).map(u64::from_ne_bytes)
}

/// Reads a MAC address.
///
/// # Errors
/// [`DecodeError`] for another length.
pub fn parse_mac(value: &[u8]) -> Result<[u8; 6], DecodeError> {
    fixed(value)
}

/// Reads text up to its terminating zero, or to its end.
pub fn text(value: &[u8]) -> String {
    let end = value.iter().position(|byte| *byte == 0).unwrap_or(value.len());
    String::from_utf8_lossy(&value[..end]).into_owned()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn read(bytes: &[u8]) -> Result<Vec<(u16, Vec<u8>)>, DecodeError> {
        attributes(bytes).map(|read| read.map(|(kind, value)| (kind, value.to_vec()))).collect()
    }

    proptest! {
        #[test]
        fn written_attributes_are_read_back(
            list in prop::collection::vec((0..KIND_MASK, prop::collection::vec(any::<u8>(), 0..40)), 0..8)
        ) {
            let mut writer = Writer::default();
            for (kind, value) in &list {
                writer.bytes(*kind, value);
            }
            prop_assert_eq!(read(&writer.finish()).unwrap(), list);
        }

        #[test]
        fn arbitrary_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..80)) {
            _ = read(&bytes);
        }
    }

    #[test]
    fn nested_attributes_are_read_level_by_level() {
        let mut writer = Writer::default();
        writer.with(1 | NESTED, |w| {
            w.text(2, "in").u64(3, 4);
        });
        let outer = read(&writer.finish()).unwrap();
        assert_eq!(outer[0].0, 1);
        let inner = read(&outer[0].1).unwrap();
        assert_eq!((text(&inner[0].1).as_str(), parse_u64(&inner[1].1)), ("in", Ok(4)));
    }

    #[test]
    fn wrong_lengths_are_malformed() {
        let mut bytes = Writer::default();
        bytes.text(1, "netem");
        let mut bytes = bytes.finish();
        for length in [200, 2] {
            bytes[0] = length;
            assert_eq!(read(&bytes), Err(DecodeError("an attribute extends beyond its message")));
        }
        assert!(parse_u32(&[0; 3]).is_err());
        assert!(parse_mac(&[0; 7]).is_err());
    }
}
