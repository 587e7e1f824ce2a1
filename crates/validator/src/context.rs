//! What the consensus library (Malachite, an implementation of Tendermint: Buchman, Kwon and Milosevic, "The latest gossip on
//! BFT consensus", 2018) is to know of a network: its validators, and their votes and proposals.

use std::fmt;

use ed25519_dalek::{SigningKey, VerifyingKey};
use malachitebft_types::{self as bft, NilOrVal, Round, VoteType};
use serde::{Deserialize, Serialize};

use crate::{
    block::BlockId,
    hex::{self, Fixed},
};

/// The types of this network, for the library's.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Chain;

/// A validator's address: its public key.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Address(Fixed<32>);

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&hex::encode(&self.0.0))
    }
}

impl fmt::Debug for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

impl bft::Address for Address {}

/// A height of consensus: the number of the block that is decided there.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Height(pub u64);

impl fmt::Display for Height {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

impl bft::Height for Height {
    const ZERO: Self = Self(0);
    const INITIAL: Self = Self(1);

    fn increment_by(&self, n: u64) -> Self {
        Self(self.0.saturating_add(n))
    }

    fn decrement_by(&self, n: u64) -> Option<Self> {
        self.0.checked_sub(n).map(Self)
    }

    fn as_u64(&self) -> u64 {
        self.0
    }
}

/// An Ed25519 signature (RFC 8032).
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Signature(pub(crate) Fixed<64>);

/// Ed25519.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Ed25519;

impl bft::SigningScheme for Ed25519 {
    type DecodingError = ed25519_dalek::SignatureError;
    type Signature = Signature;
    type PublicKey = VerifyingKey;
    type PrivateKey = SigningKey;

    fn decode_signature(bytes: &[u8]) -> Result<Signature, Self::DecodingError> {
        ed25519_dalek::Signature::from_slice(bytes).map(|signature| Signature(Fixed(signature.to_bytes())))
    }

    fn encode_signature(signature: &Signature) -> Vec<u8> {
        signature.0.0.to_vec()
    }

    fn decode_public_key(bytes: &[u8]) -> Result<VerifyingKey, Self::DecodingError> {
        VerifyingKey::try_from(bytes)
    }

    fn encode_public_key(key: &VerifyingKey) -> Vec<u8> {
        key.as_bytes().to_vec()
    }
}

/// One of those who decide.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Validator {
    address: Address,
    key: VerifyingKey,
}

impl bft::Validator<Chain> for Validator {
    fn address(&self) -> &Address {
        &self.address
    }

    fn public_key(&self) -> &VerifyingKey {
        &self.key
    }

    fn voting_power(&self) -> bft::VotingPower {
        1
    }
}

/// Those who decide, each with one vote, in the order of the network's file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Validators(Vec<Validator>);

impl Validators {
    /// Those with these keys.
    pub fn new(keys: &[VerifyingKey]) -> Self {
        let validator = |key: &VerifyingKey| Validator { address: Address(Fixed(key.to_bytes())), key: *key };
        Self(keys.iter().map(validator).collect())
    }

    /// How many of them may fail or lie, f of 3f+1, before no block is decided any more; with more liars than that, nothing holds.
    pub fn tolerated(&self) -> usize {
        (self.0.len() - 1) / 3
    }

    pub(crate) fn address(&self, index: usize) -> Address {
        self.0[index].address
    }

    pub(crate) fn key(&self, index: usize) -> Option<&VerifyingKey> {
        self.0.get(index).map(|validator| &validator.key)
    }

    pub(crate) fn keys(&self) -> impl Iterator<Item = &VerifyingKey> {
        self.0.iter().map(|validator| &validator.key)
    }

    pub(crate) fn len(&self) -> usize {
        self.0.len()
    }
}

impl bft::ValidatorSet<Chain> for Validators {
    fn count(&self) -> usize {
        self.0.len()
    }

    fn total_voting_power(&self) -> bft::VotingPower {
        self.0.len() as u64
    }

    fn get_by_address(&self, address: &Address) -> Option<&Validator> {
        self.0.iter().find(|validator| validator.address == *address)
    }

    fn get_by_index(&self, index: usize) -> Option<&Validator> {
        self.0.get(index)
    }
}

/// Whose turn it is proposes a block. A `pol_round` names the round in which two thirds voted for it already.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Proposal {
    pub(crate) height: Height,
    pub(crate) round: Round,
    pub(crate) value: BlockId,
    pub(crate) pol_round: Round,
    pub(crate) validator: Address,
}

impl bft::Proposal<Chain> for Proposal {
    fn height(&self) -> Height {
        self.height
    }

    fn round(&self) -> Round {
        self.round
    }

    fn value(&self) -> &BlockId {
        &self.value
    }

    fn take_value(self) -> BlockId {
        self.value
    }

    fn pol_round(&self) -> Round {
        self.pol_round
    }

    fn validator_address(&self) -> &Address {
        &self.validator
    }
}

/// A vote for a block, or for none.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Vote {
    pub(crate) kind: VoteType,
    pub(crate) height: Height,
    pub(crate) round: Round,
    pub(crate) value: NilOrVal<BlockId>,
    pub(crate) validator: Address,
}

impl bft::Vote<Chain> for Vote {
    fn height(&self) -> Height {
        self.height
    }

    fn round(&self) -> Round {
        self.round
    }

    fn value(&self) -> &NilOrVal<BlockId> {
        &self.value
    }

    fn take_value(self) -> NilOrVal<BlockId> {
        self.value
    }

    fn vote_type(&self) -> VoteType {
        self.kind
    }

    fn validator_address(&self) -> &Address {
        &self.validator
    }

    // Votes say nothing else.
    fn extension(&self) -> Option<&bft::SignedExtension<Chain>> {
        None
    }

    fn take_extension(&mut self) -> Option<bft::SignedExtension<Chain>> {
        None
    }

    fn extend(self, _: bft::SignedExtension<Chain>) -> Self {
        self
    }
}

/// Blocks are sent whole.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Part;

impl bft::ProposalPart<Chain> for Part {
    fn is_first(&self) -> bool {
        true
    }

    fn is_last(&self) -> bool {
        true
    }
}

impl bft::Context for Chain {
    type Address = Address;
    type Height = Height;
    type ProposalPart = Part;
    type Proposal = Proposal;
    type Validator = Validator;
    type ValidatorSet = Validators;
    type Timeouts = bft::LinearTimeouts;
    type Value = BlockId;
    type Vote = Vote;
    type Extension = ();
    type SigningScheme = Ed25519;

    fn select_proposer<'a>(&self, validators: &'a Validators, height: Height, round: Round) -> &'a Validator {
        // In turn, and the next one where a round came to nothing.
        let turn = height.0.wrapping_add(u64::from(round.as_u32().unwrap_or(0)));
        &validators.0[(turn % validators.0.len() as u64) as usize]
    }

    fn new_proposal(
        &self,
        height: Height,
        round: Round,
        value: BlockId,
        pol_round: Round,
        validator: Address,
    ) -> Proposal {
        Proposal { height, round, value, pol_round, validator }
    }

    fn new_prevote(
        &self,
        height: Height,
        round: Round,
        value: NilOrVal<BlockId>,
        validator: Address,
    ) -> Vote {
        Vote { kind: VoteType::Prevote, height, round, value, validator }
    }

    fn new_precommit(
        &self,
        height: Height,
        round: Round,
        value: NilOrVal<BlockId>,
        validator: Address,
    ) -> Vote {
        Vote { kind: VoteType::Precommit, height, round, value, validator }
    }
}
