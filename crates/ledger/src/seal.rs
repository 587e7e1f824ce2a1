//! Encryption of confidential messages on the public chain: bids, and the data needed to attach. They are sealed to
//! the one-time key of an announcement by hybrid public-key encryption (RFC 9180: X25519, HKDF-SHA256,
//! ChaCha20-Poly1305).
//!
//! All randomness derives from the operator's secret and its purpose, as in deterministic signatures (RFC 6979). A
//! restarted operator therefore has the same keys and repeats the same messages, without keeping anything on disk.

use std::{fmt, net::SocketAddr};

use hpke::{
    Deserializable, Kem as _, OpModeR, OpModeS, Serializable, aead::ChaCha20Poly1305, kdf::HkdfSha256,
    kem::X25519HkdfSha256,
};
use rand::{SeedableRng, rngs::ChaCha20Rng};
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use sha3::{Digest, Keccak256};

use crate::{
    message::MAX_SEALED,
    values::{Account, Deployment, Price, PublicKey, Salt, ServiceId},
};

type Kem = X25519HkdfSha256;

/// Bytes before a sealed message: the sender's one-time public key.
const HEAD: usize = 32;
/// Bytes after it: the authentication tag.
const TAG: usize = 16;
/// Messages are padded to a multiple of this, to hide their length.
const BLOCK: usize = 256;

/// A message that cannot be sealed or opened.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum SealError {
    /// The key is not a point that can be encrypted to.
    #[error("{0} is no X25519 public key")]
    Key(PublicKey),
    /// The message is too long.
    #[error("a message of {0} bytes does not fit: sealed messages have at most {MAX_SEALED}")]
    TooLong(usize),
    /// It was sealed to another key, for another service or purpose, or by another sender; or it was changed.
    #[error("the message was not sealed to this key by this sender for this service")]
    Broken,
    /// The decrypted message is invalid.
    #[error("the sealed message says something else than it should: {0}")]
    Content(String),
}

/// An operator's secret with one contract on one chain, from which all its keys and salts there derive. With other
/// contracts they differ.
#[derive(Clone)]
pub struct Secret {
    bytes: [u8; 32],
    deployment: Deployment,
}

impl fmt::Debug for Secret {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Secret(…)")
    }
}

/// A message that can be sealed.
pub trait Sealable: Serialize + DeserializeOwned {
    /// Distinguishes kinds of messages.
    const PURPOSE: &'static str;
}

/// A provider's confidential bid to the creator.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Bid {
    /// Price of the commitment.
    price: u128,
    /// Salt of the commitment.
    salt: [u8; 32],
    /// Address of the provider's orchestrator.
    pub endpoint: String,
}

impl Bid {
    /// Makes a bid; `salt` comes from [`Secret::bid_salt`].
    pub fn new(price: Price, salt: Salt, endpoint: String) -> Self {
        Self { price: price.get(), salt: salt.0, endpoint }
    }

    /// Returns the price; `None` if it is above the maximum.
    pub fn price(&self) -> Option<Price> {
        Price::new(self.price)
    }

    /// Returns the salt of the commitment.
    pub fn salt(&self) -> Salt {
        Salt(self.salt)
    }
}

impl Sealable for Bid {
    const PURPOSE: &'static str = "bid";
}

/// The data needed to attach to a deployed virtual access point.
#[derive(Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Attachment {
    /// Radio unit that it runs on, in its domain's terms.
    pub radio_unit: String,
    /// Name of the network.
    pub ssid: String,
    /// MAC address of the access point.
    pub bssid: [u8; 6],
    /// Frequency of the channel's centre, MHz.
    pub frequency_mhz: u16,
    /// The pairwise master key of fast transition (IEEE 802.11-2020, 12.7.1.6.4: PMK-R1), for this robot and access
    /// point alone.
    pub pmk_r1: [u8; 32],
    /// Address at which the provider's core takes the robots of other cores; `None` if the robot's core is the provider's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub core: Option<SocketAddr>,
}

impl fmt::Debug for Attachment {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { radio_unit, ssid, bssid, frequency_mhz, pmk_r1: _, core: _ } = self;
        write!(f, "Attachment({ssid} on {radio_unit}, {bssid:02x?}, {frequency_mhz} MHz)")
    }
}

impl Sealable for Attachment {
    const PURPOSE: &'static str = "attachment";
}

impl Secret {
    /// Makes a secret from 32 confidential bytes, for that contract.
    pub fn new(bytes: [u8; 32], deployment: Deployment) -> Self {
        Self { bytes, deployment }
    }

    pub fn deployment(&self) -> Deployment {
        self.deployment
    }

    /// Returns the public one-time key of the service announced with `salt`.
    pub fn public_key(&self, salt: Salt) -> PublicKey {
        PublicKey(Kem::derive_keypair(&self.derive("one-time key", &[&salt.0])).1.to_bytes().into())
    }

    /// Returns the salt of the operator's `number`th announcement.
    pub fn announcement_salt(&self, number: u64) -> Salt {
        Salt(self.derive("announcement", &[&number.to_be_bytes()]))
    }

    /// Returns the salt of the operator's bid for a service.
    pub fn bid_salt(&self, id: ServiceId) -> Salt {
        Salt(self.derive("bid", &[&id.0]))
    }

    /// Returns the fast-transition key of a service that the operator provides, for one robot and one access point.
    pub fn ft_key(&self, id: ServiceId) -> [u8; 32] {
        self.derive("fast transition", &[&id.0])
    }

    /// Seals a message about a service from this operator, `sender`, to the holder of `key`.
    ///
    /// # Errors
    /// [`SealError::Key`] if `key` is invalid; [`SealError::TooLong`].
    pub fn seal<T: Sealable>(
        &self,
        key: PublicKey,
        id: ServiceId,
        sender: Account,
        message: &T,
    ) -> Result<Vec<u8>, SealError> {
        let to = <Kem as hpke::Kem>::PublicKey::from_bytes(&key.0).map_err(|_| SealError::Key(key))?;
        let mut text = serde_json::to_vec(message).expect("it has strings for keys");
        // JSON is self-delimiting, so trailing blanks change nothing.
        text.resize(text.len().next_multiple_of(BLOCK), b' ');
        let length = HEAD + text.len() + TAG;
        if length > MAX_SEALED {
            return Err(SealError::TooLong(length));
        }
        let seed = self.derive("sealing", &[&key.0, &info::<T>(id, sender), &text]);
        let (head, body) = hpke::single_shot_seal_with_rng::<ChaCha20Poly1305, HkdfSha256, Kem>(
            &OpModeS::Base,
            &to,
            &info::<T>(id, sender),
            &text,
            &[],
            &mut ChaCha20Rng::from_seed(seed),
        )
        .map_err(|_| SealError::Key(key))?;
        Ok([&head.to_bytes()[..], &body].concat())
    }

    /// Opens a message from `sender` about the service that this operator announced with `salt`.
    ///
    /// # Errors
    /// [`SealError::Broken`] or [`SealError::Content`].
    pub fn open<T: Sealable>(
        &self,
        salt: Salt,
        id: ServiceId,
        sender: Account,
        sealed: &[u8],
    ) -> Result<T, SealError> {
        let (key, _) = Kem::derive_keypair(&self.derive("one-time key", &[&salt.0]));
        let (head, body) = sealed.split_at_checked(HEAD).ok_or(SealError::Broken)?;
        let head = <Kem as hpke::Kem>::EncappedKey::from_bytes(head).map_err(|_| SealError::Broken)?;
        let text = hpke::single_shot_open::<ChaCha20Poly1305, HkdfSha256, Kem>(
            &OpModeR::Base,
            &key,
            &head,
            &info::<T>(id, sender),
            body,
            &[],
        )
        .map_err(|_| SealError::Broken)?;
        serde_json::from_slice(&text).map_err(|reason| SealError::Content(reason.to_string()))
    }

    /// Returns Keccak-256 of the secret, the contract, a label and parts, each with its length. A sponge with a
    /// prepended key is a pseudo-random function (Bertoni and others, "Cryptographic sponge functions", 2011).
    fn derive(&self, label: &str, parts: &[&[u8]]) -> [u8; 32] {
        let Deployment { chain_id, contract } = self.deployment;
        let mut hash = Keccak256::new().chain_update(self.bytes);
        for part in [&[&chain_id.to_be_bytes()[..], &contract.0, label.as_bytes()], parts].concat() {
            hash.update((part.len() as u64).to_be_bytes());
            hash.update(part);
        }
        hash.finalize().into()
    }
}

/// Returns the context that a message is bound to: a copy for another service or by another sender does not open.
fn info<T: Sealable>(id: ServiceId, sender: Account) -> Vec<u8> {
    [b"cotorra federation ", T::PURPOSE.as_bytes(), b"\0", &id.0, &sender.0].concat()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const ID: ServiceId = ServiceId([3; 32]);
    const SENDER: Account = Account([4; 20]);
    const SALT: Salt = Salt([5; 32]);
    const HERE: Deployment = Deployment { chain_id: 1, contract: Account([6; 20]) };

    fn creator() -> Secret {
        Secret::new([1; 32], HERE)
    }

    fn provider() -> Secret {
        Secret::new([2; 32], HERE)
    }

    fn bid() -> Bid {
        Bid::new(Price::MAX, Salt([7; 32]), "http://domain-2:7700".to_owned())
    }

    fn sealed() -> Vec<u8> {
        provider().seal(creator().public_key(SALT), ID, SENDER, &bid()).unwrap()
    }

    #[test]
    fn only_the_key_holder_can_open() {
        assert_eq!(creator().open(SALT, ID, SENDER, &sealed()), Ok(bid()));
        assert_eq!(provider().open::<Bid>(SALT, ID, SENDER, &sealed()), Err(SealError::Broken));
    }

    #[test]
    fn copies_for_another_context_do_not_open() {
        let creator = creator();
        assert_eq!(creator.open::<Bid>(SALT, ServiceId([9; 32]), SENDER, &sealed()), Err(SealError::Broken));
        assert_eq!(creator.open::<Bid>(SALT, ID, Account([9; 20]), &sealed()), Err(SealError::Broken));
        assert_eq!(creator.open::<Bid>(Salt([9; 32]), ID, SENDER, &sealed()), Err(SealError::Broken));
        assert_eq!(creator.open::<Attachment>(SALT, ID, SENDER, &sealed()), Err(SealError::Broken));
    }

    #[test]
    fn keys_and_salts_differ_between_contracts_and_chains() {
        let redeployed = Deployment { contract: Account([7; 20]), ..HERE };
        let elsewhere = Deployment { chain_id: 2, ..HERE };
        let made = |deployment| {
            let secret = Secret::new([1; 32], deployment);
            let salt = secret.announcement_salt(1);
            let id = ServiceId::of(deployment, SENDER, salt);
            // Salts and IDs of one contract, replayed with another.
            let again = ServiceId::of(deployment, SENDER, SALT);
            let sealed = secret.seal(creator().public_key(SALT), ID, SENDER, &bid()).unwrap();
            let keys = [secret.public_key(SALT).0, secret.ft_key(ID), secret.bid_salt(ID).0];
            [salt.0, id.0, again.0, sealed[..HEAD].try_into().unwrap()].into_iter().chain(keys)
        };
        let made: Vec<_> = [HERE, redeployed, elsewhere].into_iter().flat_map(made).collect();
        let different: std::collections::BTreeSet<_> = made.iter().collect();
        assert_eq!(different.len(), made.len());
    }

    #[test]
    fn the_length_does_not_reveal_the_endpoint() {
        let length = |endpoint: &str| {
            let bid = Bid::new(Price::MAX, Salt([7; 32]), endpoint.to_owned());
            provider().seal(creator().public_key(SALT), ID, SENDER, &bid).unwrap().len()
        };
        assert_eq!(length("a"), length("http://b.example:1234"));
    }

    #[test]
    fn long_messages_and_invalid_keys_are_rejected() {
        let bid = Bid::new(Price::MAX, SALT, "x".repeat(1000));
        let key = creator().public_key(SALT);
        assert!(matches!(provider().seal(key, ID, SENDER, &bid), Err(SealError::TooLong(_))));
        // Of low order: any multiple gives a known shared secret (RFC 7748, 6.1).
        let key = PublicKey([0; 32]);
        assert_eq!(provider().seal(key, ID, SENDER, &self::bid()), Err(SealError::Key(key)));
    }

    #[test]
    fn sealing_is_deterministic() {
        assert_eq!(sealed(), sealed());
        let other = Bid::new(Price::new(1).unwrap(), Salt([7; 32]), bid().endpoint);
        let other = provider().seal(creator().public_key(SALT), ID, SENDER, &other).unwrap();
        assert_ne!(sealed()[..HEAD], other[..HEAD], "another one-time key of the sender");
    }

    #[test]
    fn secrets_are_not_printed() {
        assert_eq!(format!("{:?}", Secret::new([0xab; 32], HERE)), "Secret(…)");
        let attachment = Attachment {
            radio_unit: "R4".to_owned(),
            ssid: "robots".to_owned(),
            bssid: [2, 0, 0, 0, 0, 4],
            frequency_mhz: 5180,
            pmk_r1: [0xab; 32],
            core: Some(([192, 168, 77, 2], 7450).into()),
        };
        let shown = format!("{attachment:?}");
        assert!(!shown.contains("ab,") && !shown.contains("171"), "{shown}");
        let sealed = provider().seal(creator().public_key(SALT), ID, SENDER, &attachment).unwrap();
        assert_eq!(creator().open(SALT, ID, SENDER, &sealed), Ok(attachment));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn modified_messages_do_not_open(at in any::<prop::sample::Index>(), bit in 0..8u8) {
            let mut sealed = sealed();
            // Including the highest bit of the public key, which X25519 ignores (RFC 7748, 5) but the key schedule
            // does not.
            *at.get_mut(&mut sealed) ^= 1u8 << bit;
            prop_assert_eq!(creator().open::<Bid>(SALT, ID, SENDER, &sealed), Err(SealError::Broken));
        }

        #[test]
        fn arbitrary_messages_never_panic(sealed in prop::collection::vec(any::<u8>(), 0..400)) {
            prop_assert!(creator().open::<Bid>(SALT, ID, SENDER, &sealed).is_err());
        }
    }
}
