//! A network's file, which all its validators have, and a validator's key.

use std::{
    fs::{self, OpenOptions},
    io::{self, Write},
    os::unix::fs::OpenOptionsExt,
    path::{Path, PathBuf},
    time::Duration,
};

use ed25519_dalek::{SigningKey, VerifyingKey};
use serde::{Deserialize, Serialize};

use crate::{
    context::Validators,
    hex::{self, Fixed},
};

/// Those who decide, and how often.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Network {
    /// From block to block, in seconds.
    pub block_period: f64,
    /// The validators, one per domain.
    pub validators: Vec<Member>,
}

/// A validator.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Member {
    /// What it is called.
    pub name: String,
    /// Its public key (Ed25519).
    pub key: PublicKey,
    /// Where the others reach it, such as `validator.domain-1.example:30400`.
    pub address: String,
}

/// A validator's public key, in hexadecimal digits.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct PublicKey(Fixed<32>);

impl std::fmt::Display for PublicKey {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&hex::encode(&self.0.0))
    }
}

/// An account of the chain.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Account(pub(crate) [u8; 20]);

impl std::str::FromStr for Account {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let account = hex::decode_array(&text.to_lowercase()).map(Self);
        account.ok_or_else(|| format!("an account is 0x and 40 hexadecimal digits, not `{text}`"))
    }
}

impl std::fmt::Display for Account {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&hex::encode(&self.0))
    }
}

/// Why there is no network, or no key.
#[derive(Debug, thiserror::Error)]
pub enum NetworkError {
    /// A file cannot be read or written.
    #[error("{}: {reason}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// Why not.
        reason: io::Error,
    },
    /// A file has something else in it.
    #[error("{}: {reason}", path.display())]
    Text {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// The key is none of the network's.
    #[error("the key {key} is not that of a validator in the network's file")]
    Stranger {
        /// The public key.
        key: PublicKey,
    },
}

impl Network {
    /// Reads a network's file.
    ///
    /// # Errors
    /// [`NetworkError`].
    pub fn read(path: &Path) -> Result<Self, NetworkError> {
        let text = fs::read_to_string(path).map_err(|reason| file(path, reason))?;
        let network: Self = serde_json::from_str(&text).map_err(|error| wrong(path, error.to_string()))?;
        network.check().map_err(|reason| wrong(path, reason))?;
        Ok(network)
    }

    fn check(&self) -> Result<(), String> {
        if !(0.1..=3600.0).contains(&self.block_period) {
            return Err("block_period is to be from 0.1 to 3600 seconds".to_owned());
        }
        if self.validators.is_empty() {
            return Err("there is to be at least one validator".to_owned());
        }
        for (index, member) in self.validators.iter().enumerate() {
            if VerifyingKey::from_bytes(&member.key.0.0).is_err() {
                return Err(format!("{} is no key of Ed25519", member.key));
            }
            if self.validators[..index].iter().any(|other| other.key == member.key) {
                return Err(format!("{} and another validator have one key", member.name));
            }
        }
        Ok(())
    }

    /// From block to block.
    pub fn period(&self) -> Duration {
        Duration::from_secs_f64(self.block_period)
    }

    pub(crate) fn validators(&self) -> Validators {
        let key = |member: &Member| {
            VerifyingKey::from_bytes(&member.key.0.0).expect("it was checked when it was read")
        };
        Validators::new(&self.validators.iter().map(key).collect::<Vec<_>>())
    }

    pub(crate) fn index_of(&self, key: PublicKey) -> Result<usize, NetworkError> {
        let index = self.validators.iter().position(|member| member.key == key);
        index.ok_or(NetworkError::Stranger { key })
    }
}

/// A validator's key.
pub struct Key(pub(crate) SigningKey);

impl Key {
    /// Makes one, and writes it to a new file that nobody else may read.
    ///
    /// # Errors
    /// [`NetworkError::File`], also where there is a file already.
    pub fn create(path: &Path) -> Result<Self, NetworkError> {
        let secret: [u8; 32] = rand::random();
        let created = OpenOptions::new().write(true).create_new(true).mode(0o600).open(path);
        let written = created.and_then(|mut created| writeln!(created, "{}", hex::encode(&secret)));
        written.map_err(|reason| file(path, reason))?;
        Ok(Self(SigningKey::from_bytes(&secret)))
    }

    /// Reads one.
    ///
    /// # Errors
    /// [`NetworkError`].
    pub fn read(path: &Path) -> Result<Self, NetworkError> {
        let text = fs::read_to_string(path).map_err(|reason| file(path, reason))?;
        let secret = hex::decode_array(text.trim())
            .ok_or_else(|| wrong(path, "it is to have 0x and 64 digits".to_owned()))?;
        Ok(Self(SigningKey::from_bytes(&secret)))
    }

    /// Its public half.
    pub fn public(&self) -> PublicKey {
        PublicKey(Fixed(self.0.verifying_key().to_bytes()))
    }
}

fn file(path: &Path, reason: io::Error) -> NetworkError {
    NetworkError::File { path: path.to_owned(), reason }
}

fn wrong(path: &Path, reason: String) -> NetworkError {
    NetworkError::Text { path: path.to_owned(), reason }
}
