//! Addresses, IDs and amounts as distinct types.

use std::{fmt, str::FromStr};

use sha3::{Digest, Keccak256};

/// A text that is not a hexadecimal value of the required length.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{text}` is not a valid {what}: write `0x` and {digits} hexadecimal digits")]
pub struct ParseHexError {
    text: String,
    what: &'static str,
    digits: usize,
}

macro_rules! bytes {
    ($(#[$doc:meta])* $name:ident, $len:literal, $what:literal) => {
        $(#[$doc])*
        #[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
        pub struct $name(pub [u8; $len]);

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("0x")?;
                self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
            }
        }

        impl fmt::Debug for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                fmt::Display::fmt(self, f)
            }
        }

        impl FromStr for $name {
            type Err = ParseHexError;

            fn from_str(text: &str) -> Result<Self, ParseHexError> {
                let mut bytes = [0; $len];
                match decode(text, &mut bytes) {
                    Some(()) => Ok(Self(bytes)),
                    None => Err(ParseHexError { text: text.to_owned(), what: $what, digits: 2 * $len }),
                }
            }
        }
    };
}

bytes!(
    /// An operator's address on the ledger.
    Account, 20, "address"
);
bytes!(
    /// ID of a service; see [`ServiceId::of`].
    ServiceId, 32, "service id"
);
bytes!(
    /// Makes an ID unique, or a commitment impossible to guess.
    Salt, 32, "salt"
);
bytes!(
    /// Commitment of a bid to its price; see [`Commitment::to`].
    Commitment, 32, "commitment"
);
bytes!(TransactionHash, 32, "transaction hash");
bytes!(BlockHash, 32, "block hash");
bytes!(
    /// An X25519 public key (RFC 7748).
    PublicKey, 32, "public key"
);

fn decode(text: &str, bytes: &mut [u8]) -> Option<()> {
    let digits = text.strip_prefix("0x")?.as_bytes();
    if digits.len() != 2 * bytes.len() {
        return None;
    }
    let digit = |character: u8| (character as char).to_digit(16);
    for (byte, pair) in bytes.iter_mut().zip(digits.chunks_exact(2)) {
        *byte = u8::try_from(16 * digit(pair[0])? + digit(pair[1])?).expect("two digits are a byte");
    }
    Some(())
}

/// Returns Keccak-256 of the ABI encoding of words, as the contract computes it.
fn keccak(words: &[[u8; 32]]) -> [u8; 32] {
    Keccak256::digest(words.as_flattened()).into()
}

/// Returns `bytes` as an ABI word, right-aligned.
fn word(bytes: &[u8]) -> [u8; 32] {
    let mut word = [0; 32];
    word[32 - bytes.len()..].copy_from_slice(bytes);
    word
}

/// A contract on a chain. IDs, salts and keys are bound to it, so that none repeats on another chain or with another
/// contract.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub struct Deployment {
    /// Chain ID (EIP-155).
    pub chain_id: u64,
    /// Address of the contract.
    pub contract: Account,
}

impl ServiceId {
    /// Returns the ID of the service that `creator` announces with `salt`: the contract's `idOf`.
    pub fn of(deployment: Deployment, creator: Account, salt: Salt) -> Self {
        let Deployment { chain_id, contract } = deployment;
        let purpose = Keccak256::digest("cotorra federation").into();
        let chain = word(&chain_id.to_be_bytes());
        Self(keccak(&[purpose, chain, word(&contract.0), word(&creator.0), salt.0]))
    }
}

impl Commitment {
    /// Returns the commitment of `provider` to `price` for a service: the contract's `commitmentOf`.
    pub fn to(id: ServiceId, provider: Account, price: Price, salt: Salt) -> Self {
        Self(keccak(&[id.0, word(&provider.0), word(&price.0.to_be_bytes()), salt.0]))
    }
}

/// An amount of the ledger's money: 10¹⁸ wei are one ether.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub struct Wei(pub u128);

impl fmt::Display for Wei {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} wei", self.0)
    }
}

/// Price of a service per second, in wei. At most 2⁹⁶ - 1, so that no deposit overflows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Price(u128);

impl Price {
    /// The highest price.
    pub const MAX: Self = Self((1 << 96) - 1);

    /// Makes a price; `None` above [`Price::MAX`].
    pub const fn new(wei_per_second: u128) -> Option<Self> {
        if wei_per_second <= Self::MAX.0 { Some(Self(wei_per_second)) } else { None }
    }

    /// Returns the wei per second.
    pub const fn get(self) -> u128 {
        self.0
    }

    /// Returns the cost of `seconds` seconds.
    pub fn times(self, seconds: u32) -> Wei {
        Wei(self.0 * u128::from(seconds))
    }
}

impl fmt::Display for Price {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} wei/s", self.0)
    }
}

/// A time of the chain: `block.timestamp`, seconds since 1970 by the clocks of block makers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub struct ChainTime(pub u64);

impl ChainTime {
    /// Returns the time `seconds` later.
    #[must_use]
    pub fn after(self, seconds: u32) -> Self {
        Self(self.0 + u64::from(seconds))
    }
}
