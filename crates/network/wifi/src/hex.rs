//! Hexadecimal digits.

use std::fmt::Write;

/// Returns two digits for each byte.
pub(crate) fn encode(bytes: &[u8]) -> String {
    let mut text = String::with_capacity(2 * bytes.len());
    for byte in bytes {
        write!(text, "{byte:02x}").expect("a string takes all");
    }
    text
}

/// Reads one digit.
pub(crate) fn digit(character: u8) -> Option<u8> {
    char::from(character).to_digit(16).and_then(|value| value.try_into().ok())
}

/// Reads pairs of digits; `None` if there is anything else.
pub(crate) fn decode(text: &str) -> Option<Vec<u8>> {
    let pair = |pair: &[u8]| match *pair {
        [high, low] => Some(16 * digit(high)? + digit(low)?),
        _ => None,
    };
    text.as_bytes().chunks(2).map(pair).collect()
}
