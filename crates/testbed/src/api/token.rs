//! Secrets of callers.

use std::{
    fs::File,
    io::{self, Read},
};

/// A caller's secret.
#[derive(Clone)]
pub struct Token(String);

impl Token {
    /// Creates a token; `None` if the text has fewer than 16 bytes, too few for a secret.
    pub fn new(secret: impl Into<String>) -> Option<Self> {
        let secret = secret.into();
        (secret.len() >= 16).then_some(Self(secret))
    }

    /// Creates a random token.
    pub(super) fn random() -> io::Result<Self> {
        let mut bytes = [0; 32];
        File::open("/dev/urandom")?.read_exact(&mut bytes)?;
        Ok(Self(bytes.iter().map(|byte| format!("{byte:02x}")).collect()))
    }

    /// Returns the secret.
    pub(crate) fn secret(&self) -> &str {
        &self.0
    }

    /// Compares in constant time, which does not reveal how much of a guess is right.
    pub(super) fn is(&self, shown: &str) -> bool {
        let (secret, shown) = (self.0.as_bytes(), shown.as_bytes());
        let differences = secret.iter().zip(shown).fold(0, |all, (a, b)| all | (a ^ b));
        secret.len() == shown.len() && differences == 0
    }
}

impl std::fmt::Debug for Token {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Token(…)")
    }
}
