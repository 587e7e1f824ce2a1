//! Numbers in either order of bytes.

/// Order of the bytes of a number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Order {
    Little,
    Big,
}

impl Order {
    /// Reads the number of two bytes at an offset; `None` beyond the end.
    pub fn u16_at(self, bytes: &[u8], at: usize) -> Option<u16> {
        let number = bytes.get(at..)?.first_chunk().copied()?;
        Some(if self == Self::Little { u16::from_le_bytes(number) } else { u16::from_be_bytes(number) })
    }

    /// Reads the number of four bytes at an offset; `None` beyond the end.
    pub fn u32_at(self, bytes: &[u8], at: usize) -> Option<u32> {
        let number = bytes.get(at..)?.first_chunk().copied()?;
        Some(if self == Self::Little { u32::from_le_bytes(number) } else { u32::from_be_bytes(number) })
    }

    /// Reads the signed number of eight bytes at an offset; `None` beyond the end.
    pub fn i64_at(self, bytes: &[u8], at: usize) -> Option<i64> {
        let number = bytes.get(at..)?.first_chunk().copied()?;
        Some(if self == Self::Little { i64::from_le_bytes(number) } else { i64::from_be_bytes(number) })
    }
}
