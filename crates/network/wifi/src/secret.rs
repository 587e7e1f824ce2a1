//! Passphrases and keys. Their `Debug` output shows nothing of them.

use std::{fmt, str::FromStr};

use hmac::Hmac;
use sha1::Sha1;

use crate::{hex, names::Ssid};

/// A passphrase of WPA2 or WPA3: 8 to 63 printable ASCII characters (IEEE 802.11-2020, J.4.1).
#[derive(Clone, PartialEq, Eq)]
pub struct Passphrase(String);

impl Passphrase {
    /// Makes one of a key: its first 63 hexadecimal digits, because 64 are too many.
    pub fn of_key(key: &[u8; 32]) -> Self {
        let mut digits = hex::encode(key);
        digits.truncate(63);
        Self(digits)
    }

    /// Returns the characters, for hostapd's file, which takes all of them as they are.
    pub(crate) fn expose(&self) -> &str {
        &self.0
    }

    /// Returns the characters as hexadecimal digits.
    pub(crate) fn hex(&self) -> String {
        hex::encode(self.0.as_bytes())
    }

    /// Returns the pre-shared key of WPA2 for a network, in hexadecimal: PBKDF2 with HMAC-SHA-1, the SSID as salt and 4096
    /// rounds (IEEE 802.11-2020, J.4.1).
    pub(crate) fn psk_hex(&self, ssid: &Ssid) -> String {
        const ROUNDS: u32 = 4096;
        let mut psk = [0; 32];
        pbkdf2::pbkdf2::<Hmac<Sha1>>(self.0.as_bytes(), ssid.as_bytes(), ROUNDS, &mut psk);
        hex::encode(&psk)
    }
}

/// A text that is no [`Passphrase`]. It does not repeat the text.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum PassphraseError {
    /// This many characters.
    #[error("a passphrase has 8 to 63 characters, not {0}")]
    Length(usize),
    /// A character that some keyboards or programs lack.
    #[error("a passphrase has printable ASCII characters only")]
    Character,
}

impl FromStr for Passphrase {
    type Err = PassphraseError;

    fn from_str(text: &str) -> Result<Self, PassphraseError> {
        if !text.bytes().all(|byte| matches!(byte, b' '..=b'~')) {
            return Err(PassphraseError::Character);
        }
        if !matches!(text.len(), 8..=63) {
            return Err(PassphraseError::Length(text.len()));
        }
        Ok(Self(text.to_owned()))
    }
}

impl fmt::Debug for Passphrase {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Passphrase(…)")
    }
}

/// The key with which the units of a mobility domain encrypt stations' keys for each other (802.11r).
#[derive(Clone, PartialEq, Eq)]
pub struct DomainKey([u8; 32]);

impl DomainKey {
    /// Makes one from random bytes.
    pub fn new(bytes: [u8; 32]) -> Self {
        Self(bytes)
    }

    /// Returns it as hexadecimal digits.
    pub(crate) fn hex(&self) -> String {
        hex::encode(&self.0)
    }
}

impl fmt::Debug for DomainKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("DomainKey(…)")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn passphrases_have_8_to_63_printable_characters() {
        let parse = |text: &str| text.parse::<Passphrase>().map(drop);
        assert_eq!(parse("1234567"), Err(PassphraseError::Length(7)));
        assert_eq!(parse("12345678"), Ok(()));
        assert_eq!(parse(&"x".repeat(63)), Ok(()));
        assert_eq!(parse(&"x".repeat(64)), Err(PassphraseError::Length(64)));
        assert_eq!(parse("password\n"), Err(PassphraseError::Character));
        assert_eq!(parse("pässword"), Err(PassphraseError::Character));
        let of_key = Passphrase::of_key(&[0xab; 32]);
        assert_eq!(of_key.expose().parse(), Ok(of_key.clone()));
    }

    // The test vectors of IEEE 802.11-2020, J.4.2.
    #[test]
    fn pre_shared_keys_are_those_of_the_standard() {
        for (passphrase, ssid, psk) in [
            ("password", "IEEE", "f42c6fc52df0ebef9ebb4b90b38a5f902e83fe1b135a70e23aed762e9710a12e"),
            (
                "ThisIsAPassword",
                "ThisIsASSID",
                "0dc0d6eb90555ed6419756b9a15ec3e3209b63df707dd508d14581f8982721af",
            ),
        ] {
            let passphrase: Passphrase = passphrase.parse().expect("a passphrase");
            assert_eq!(passphrase.psk_hex(&ssid.parse().expect("an SSID")), psk);
        }
    }

    #[test]
    fn debug_output_hides_secrets() {
        let passphrase: Passphrase = "hunter2hunter2".parse().expect("a passphrase");
        assert_eq!(format!("{passphrase:?} {:?}", DomainKey::new([7; 32])), "Passphrase(…) DomainKey(…)");
    }
}
