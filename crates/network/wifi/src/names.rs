//! Names in configurations: interfaces, countries and SSIDs.

use std::{fmt, str::FromStr};

use crate::hex;

/// The name of a network interface, such as `wlan0`: 1 to 15 letters, digits, `-`, `_` and `.`.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct InterfaceName(String);

impl InterfaceName {
    /// Returns the name.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl fmt::Display for InterfaceName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl FromStr for InterfaceName {
    type Err = NameError;

    fn from_str(text: &str) -> Result<Self, NameError> {
        let is_allowed = |byte: u8| byte.is_ascii_alphanumeric() || b"-_.".contains(&byte);
        let is_name = matches!(text.len(), 1..=15)
            && text.bytes().all(is_allowed)
            && !text.trim_matches('.').is_empty();
        if is_name { Ok(Self(text.to_owned())) } else { Err(NameError::Interface(text.to_owned())) }
    }
}

/// A country by its two letters in ISO 3166-1, such as `DE`. The regulatory domain depends on it: channels and powers.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub struct CountryCode([u8; 2]);

impl fmt::Display for CountryCode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [first, second] = self.0.map(char::from);
        write!(f, "{first}{second}")
    }
}

impl fmt::Debug for CountryCode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

impl FromStr for CountryCode {
    type Err = NameError;

    fn from_str(text: &str) -> Result<Self, NameError> {
        match *text.as_bytes() {
            [first @ b'A'..=b'Z', second @ b'A'..=b'Z'] => Ok(Self([first, second])),
            _ => Err(NameError::Country(text.to_owned())),
        }
    }
}

/// The name of a network: 1 to 32 bytes, which need not be text.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Ssid(Vec<u8>);

impl Ssid {
    /// Longest SSID, in bytes (IEEE 802.11-2020, 9.4.2.2).
    pub const LONGEST: usize = 32;

    /// Makes one from bytes.
    ///
    /// # Errors
    /// [`NameError::Ssid`] if there are none, or more than [`Self::LONGEST`].
    pub fn new(bytes: impl Into<Vec<u8>>) -> Result<Self, NameError> {
        let bytes = bytes.into();
        if matches!(bytes.len(), 1..=Self::LONGEST) {
            Ok(Self(bytes))
        } else {
            Err(NameError::Ssid(bytes.len()))
        }
    }

    /// Returns the bytes.
    pub fn as_bytes(&self) -> &[u8] {
        &self.0
    }

    /// Returns it as hexadecimal digits, which every place of a configuration or command takes.
    pub(crate) fn hex(&self) -> String {
        hex::encode(&self.0)
    }

    /// Returns it for a configuration file: in quotes if all its characters are harmless in there, otherwise in hexadecimal.
    pub(crate) fn in_file(&self) -> String {
        let is_harmless = |byte: &u8| byte.is_ascii_alphanumeric() || b" -_.".contains(byte);
        match str::from_utf8(&self.0) {
            Ok(text) if self.0.iter().all(is_harmless) => format!("\"{text}\""),
            _ => self.hex(),
        }
    }

    /// Reads what hostapd and wpa_supplicant print: printable characters as they are, and `\"`, `\\`, `\e`, `\n`, `\r`, `\t`
    /// and `\x00` for others.
    pub(crate) fn from_printed(text: &str) -> Option<Self> {
        let mut bytes = Vec::new();
        let mut rest = text.bytes();
        while let Some(byte) = rest.next() {
            bytes.push(match byte {
                b'\\' => match rest.next()? {
                    b'e' => 0x1b,
                    b'n' => b'\n',
                    b'r' => b'\r',
                    b't' => b'\t',
                    b'x' => 16 * hex::digit(rest.next()?)? + hex::digit(rest.next()?)?,
                    same @ (b'"' | b'\\') => same,
                    _ => return None,
                },
                _ => byte,
            });
        }
        Self::new(bytes).ok()
    }
}

impl FromStr for Ssid {
    type Err = NameError;

    fn from_str(text: &str) -> Result<Self, NameError> {
        Self::new(text)
    }
}

impl fmt::Display for Ssid {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.0.escape_ascii())
    }
}

impl fmt::Debug for Ssid {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "\"{self}\"")
    }
}

/// A name that hostapd and wpa_supplicant would reject or misread.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum NameError {
    /// Not the name of an interface.
    #[error("`{0}` is no name of an interface: use 1 to 15 letters, digits, `-`, `_` and `.`")]
    Interface(String),
    /// Not a country.
    #[error("`{0}` is no country: use two capital letters, such as DE")]
    Country(String),
    /// An SSID of this many bytes.
    #[error("an SSID has 1 to 32 bytes, not {0}")]
    Ssid(usize),
    /// Not the name of a key holder.
    #[error("`{0}` is no name of a key holder: use 1 to 48 letters, digits, `-`, `_`, `.` and `:`")]
    KeyHolder(String),
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn names_that_would_break_a_line_or_a_path_are_rejected() {
        for wrong in ["", ".", "..", "a/b", "a b", "a\nb", "wlan0:1", "0123456789abcdef", "wlän"] {
            assert_eq!(wrong.parse::<InterfaceName>(), Err(NameError::Interface(wrong.to_owned())));
        }
        for right in ["wlan0", "phy0-ap0", "br-lan.1"] {
            assert_eq!(right.parse::<InterfaceName>().expect("a name").as_str(), right);
        }
        for wrong in ["", "D", "de", "DEU", "D1", "D\n"] {
            assert!(wrong.parse::<CountryCode>().is_err());
        }
        assert_eq!("DE".parse::<CountryCode>().expect("a country").to_string(), "DE");
    }

    #[test]
    fn ssid_in_a_file_is_quoted_only_if_harmless() {
        let in_file = |bytes: &[u8]| Ssid::new(bytes).expect("an SSID").in_file();
        assert_eq!(in_file(b"corridor 5G"), "\"corridor 5G\"");
        assert_eq!(in_file(b"a\"b"), "612262");
        assert_eq!(in_file(b"a#b"), "612362");
        assert_eq!(in_file("é".as_bytes()), "c3a9");
        assert_eq!(in_file(b"\n\0"), "0a00");
        assert_eq!(Ssid::new(vec![0; 33]), Err(NameError::Ssid(33)));
        assert_eq!(Ssid::new(""), Err(NameError::Ssid(0)));
    }

    #[test]
    fn printed_ssid_is_read() {
        let read = |text| Ssid::from_printed(text).map(|ssid| ssid.0);
        assert_eq!(read(r#"a\"b\\c\e\n\r\t\x00\xfF"#).as_deref(), Some(&b"a\"b\\c\x1b\n\r\t\0\xff"[..]));
        for wrong in [r"\", r"\x", r"\x0", r"\xg0", r"\q", ""] {
            assert_eq!(read(wrong), None, "{wrong}");
        }
    }

    proptest! {
        #[test]
        fn reading_a_printed_ssid_never_panics(text in ".*") {
            let _ = Ssid::from_printed(&text);
        }
    }
}
