//! Bytes and numbers as Ethereum's JSON-RPC writes them: `0x` and hexadecimal digits. What is read is what is written again,
//! digit by digit, so that two texts of one value cannot differ.

use std::fmt::Write;

use serde::{Deserialize, Deserializer, Serialize, Serializer, de::Error};

/// Writes bytes.
pub(crate) fn encode(bytes: &[u8]) -> String {
    bytes.iter().fold("0x".to_owned(), |mut text, byte| {
        write!(text, "{byte:02x}").expect("a string takes all");
        text
    })
}

/// Reads bytes: lower-case digits, two each.
pub(crate) fn decode(text: &str) -> Option<Vec<u8>> {
    let digits = text.strip_prefix("0x")?.as_bytes();
    let digit = |digit: u8| match digit {
        b'0'..=b'9' => Some(digit - b'0'),
        b'a'..=b'f' => Some(digit - b'a' + 10),
        _ => None,
    };
    let (pairs, rest) = digits.as_chunks::<2>();
    if !rest.is_empty() {
        return None;
    }
    pairs.iter().map(|[high, low]| Some(digit(*high)? << 4 | digit(*low)?)).collect()
}

/// So many bytes.
pub(crate) fn decode_array<const N: usize>(text: &str) -> Option<[u8; N]> {
    decode(text)?.try_into().ok()
}

/// Bytes of any number.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct Bytes(pub Vec<u8>);

impl Serialize for Bytes {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(&encode(&self.0))
    }
}

impl<'de> Deserialize<'de> for Bytes {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = String::deserialize(deserializer)?;
        decode(&text).map(Self).ok_or_else(|| D::Error::custom("bytes are to be 0x and two digits each"))
    }
}

/// So many bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Fixed<const N: usize>(pub [u8; N]);

impl<const N: usize> Serialize for Fixed<N> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(&encode(&self.0))
    }
}

impl<'de, const N: usize> Deserialize<'de> for Fixed<N> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = String::deserialize(deserializer)?;
        decode_array(&text).map(Self).ok_or_else(|| D::Error::custom(format!("it is to be 0x and {N} bytes")))
    }
}

/// A number of up to 256 bits, most significant digit first, without leading zeros.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize)]
pub struct Quantity(String);

impl Quantity {
    /// A number.
    pub(crate) fn new(number: u64) -> Self {
        Self(format!("{number:#x}"))
    }

    /// The number, unless it is greater.
    pub(crate) fn to_u64(&self) -> Option<u64> {
        u64::from_str_radix(&self.0[2..], 16).ok()
    }

    /// The bytes, most significant first, without leading zeros: none for zero.
    pub(crate) fn to_bytes(&self) -> Vec<u8> {
        let digits = self.0[2..].trim_start_matches('0');
        let padding = if digits.len().is_multiple_of(2) { "" } else { "0" };
        decode(&format!("0x{padding}{digits}")).expect("its digits were looked at")
    }
}

impl<'de> Deserialize<'de> for Quantity {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = String::deserialize(deserializer)?;
        let is_number = text.strip_prefix("0x").is_some_and(|digits| {
            let is_short = (1..=64).contains(&digits.len()) && (digits == "0" || !digits.starts_with('0'));
            is_short && digits.bytes().all(|digit| matches!(digit, b'0'..=b'9' | b'a'..=b'f'))
        });
        if is_number {
            Ok(Self(text))
        } else {
            Err(D::Error::custom("a number is to be 0x and its digits, without leading zeros"))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_one_text_is_a_value() {
        let read = |text: &str| serde_json::from_str::<Quantity>(&format!("\"{text}\""));
        assert_eq!(read("0x0").unwrap().to_u64(), Some(0));
        assert_eq!(read("0x1c9c380").unwrap().to_u64(), Some(30_000_000));
        assert_eq!(read("0x1c9c380").unwrap().to_bytes(), [0x01, 0xc9, 0xc3, 0x80]);
        assert_eq!(read("0x0").unwrap().to_bytes(), [0u8; 0]);
        assert_eq!(read(&format!("0x{}", "f".repeat(64))).unwrap().to_u64(), None);
        for text in ["", "0x", "0x00", "0x01", "1", "0xA", "0xg", &format!("0x{}", "1".repeat(65))] {
            assert!(read(text).is_err(), "{text}");
        }
        assert_eq!(decode("0x00ff"), Some(vec![0, 255]));
        for text in ["", "0", "0x0", "0xFF", "0x0g"] {
            assert_eq!(decode(text), None, "{text}");
        }
        assert_eq!(encode(&[0, 255]), "0x00ff");
    }
}
