//! Fields of the kernel's structures.

use cotorra_netlink::DecodeError;

/// Reads the 32-bit word at index `place` of a structure of words.
pub(crate) fn word(value: &[u8], place: usize) -> Result<u32, DecodeError> {
    let bytes = value.get(place * 4..place * 4 + 4).ok_or(DecodeError("a structure is too short"))?;
    Ok(u32::from_ne_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]))
}

/// Reads the number of eight bytes that a structure begins with.
pub(crate) fn number(value: &[u8]) -> Result<u64, DecodeError> {
    let bytes = value.first_chunk().ok_or(DecodeError("a number is too short"))?;
    Ok(u64::from_ne_bytes(*bytes))
}
