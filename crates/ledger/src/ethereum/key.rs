//! An operator's key. It is kept encrypted in a key store (Web3 Secret Storage, version 3), never in a testbed file.

use std::{
    env, fmt, fs, io,
    path::{Path, PathBuf},
};

use alloy::{
    consensus::{SignableTransaction, TxEip1559, TxEnvelope},
    network::TxSignerSync,
    signers::local::PrivateKeySigner,
};
use sha3::{Digest, Keccak256};

use crate::{
    seal::Secret,
    values::{Account, Deployment},
};

/// Source of a key store's password.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Password {
    /// The environment variable with this name.
    Environment(String),
    /// The first line of this file.
    File(PathBuf),
}

/// A key that could not be opened.
#[derive(Debug, thiserror::Error)]
pub enum KeyError {
    /// The environment variable is not set.
    #[error("the environment variable {0}, which is not set, must have the key store's password")]
    NoVariable(String),
    /// The password file cannot be read.
    #[error("cannot read the key store's password from {}: {reason}", path.display())]
    NoFile { path: PathBuf, reason: io::Error },
    /// The key store cannot be read or decrypted.
    #[error(
        "the key store {} cannot be opened: {reason}; it must be a Web3 Secret Storage file (version 3) with its \
         own password",
        path.display()
    )]
    Store { path: PathBuf, reason: String },
}

/// An operator's key, from which all its secrets derive.
#[derive(Clone)]
pub struct Key {
    pub(super) signer: PrivateKeySigner,
}

impl fmt::Debug for Key {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Key({})", self.account())
    }
}

impl Password {
    fn read(&self) -> Result<String, KeyError> {
        match self {
            Self::Environment(name) => env::var(name).map_err(|_| KeyError::NoVariable(name.clone())),
            Self::File(path) => {
                let text = fs::read_to_string(path)
                    .map_err(|reason| KeyError::NoFile { path: path.clone(), reason })?;
                Ok(text.lines().next().unwrap_or_default().to_owned())
            }
        }
    }
}

impl Key {
    /// Opens a key store.
    ///
    /// # Errors
    /// [`KeyError`] if it cannot be read or the password is wrong.
    pub fn open(path: &Path, password: &Password) -> Result<Self, KeyError> {
        let signer = PrivateKeySigner::decrypt_keystore(path, password.read()?)
            .map_err(|reason| KeyError::Store { path: path.to_owned(), reason: reason.to_string() })?;
        Ok(Self { signer })
    }

    /// Makes a key from 32 secret bytes; `None` for zero, and beyond the curve's order.
    pub fn from_bytes(bytes: [u8; 32]) -> Option<Self> {
        PrivateKeySigner::from_slice(&bytes).ok().map(|signer| Self { signer })
    }

    pub(super) fn sign(&self, mut transaction: TxEip1559) -> TxEnvelope {
        let signature = self.signer.sign_transaction_sync(&mut transaction).expect("the key is in memory");
        transaction.into_signed(signature).into()
    }

    /// Returns the operator's address.
    pub fn account(&self) -> Account {
        Account(self.signer.address().into())
    }

    /// Returns the secret from which the operator's keys and salts with a contract derive.
    pub fn secret(&self, deployment: Deployment) -> Secret {
        // Distinct from the signing key: neither reveals anything about the other.
        let key = self.signer.to_bytes();
        let bytes = Keccak256::new().chain_update(key).chain_update(b"cotorra federation secret");
        Secret::new(bytes.finalize().into(), deployment)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Test vector of the Web3 Secret Storage definition with PBKDF2.
    const STORE: &str = r#"{
        "crypto": {
            "cipher": "aes-128-ctr",
            "cipherparams": { "iv": "6087dab2f9fdbbfaddc31a909735c1e6" },
            "ciphertext": "5318b4d5bcd28de64ee5559e671353e16f075ecae9f99c7a79a38af5f869aa46",
            "kdf": "pbkdf2",
            "kdfparams": {
                "c": 262144,
                "dklen": 32,
                "prf": "hmac-sha256",
                "salt": "ae3cd4e7013836a3df6bd7241b12db061dbe2c6785853cce422d148a624ce0bd"
            },
            "mac": "517ead924a9d0dc3124507e3393d175ce3ff7c1e96529c6c555ce9e51205e9b2"
        },
        "id": "3198bc9c-6672-5ab3-d995-4942343ae5b6",
        "version": 3
    }"#;

    #[test]
    fn key_stores_open_only_with_their_password() {
        let folder = tempfile::tempdir().unwrap();
        let (store, password) = (folder.path().join("store.json"), folder.path().join("password"));
        fs::write(&store, STORE).unwrap();
        fs::write(&password, "testpassword\n").unwrap();
        let key = Key::open(&store, &Password::File(password.clone())).unwrap();
        assert_eq!(key.account(), "0x008aeeda4d805471df9b2a5b0f38a0c3bcba786b".parse().unwrap());
        assert_eq!(format!("{key:?}"), "Key(0x008aeeda4d805471df9b2a5b0f38a0c3bcba786b)");
        fs::write(&password, "another\n").unwrap();
        let refused = Key::open(&store, &Password::File(password)).unwrap_err().to_string();
        assert!(refused.contains("store.json cannot be opened"), "{refused}");
        let missing =
            Key::open(&store, &Password::Environment("COTORRA_TEST_NO_SUCH".to_owned())).unwrap_err();
        assert!(missing.to_string().contains("COTORRA_TEST_NO_SUCH, which is not set"), "{missing}");
    }
}
