//! What validators sign: votes, proposals and greetings, each in bytes of its own that belong to one network.

use ed25519_dalek::{Signer as _, SigningKey, VerifyingKey};
use malachitebft_signing::{Error, VerificationResult, Verifier};
use malachitebft_types::{self as bft, NilOrVal, Round, VoteType};
use sha2::{Digest, Sha256};

use crate::{
    context::{Chain, Height, Proposal, Signature, Validators, Vote},
    hex::Fixed,
};

/// The network that signatures are for: its chain and its validators. One for another network is worth nothing here.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct NetworkId([u8; 32]);

impl NetworkId {
    /// That of the network with this genesis block and these validators.
    pub fn new(genesis: &[u8; 32], validators: &Validators) -> Self {
        let mut hash = Sha256::new().chain_update(b"cotorra validators 1").chain_update(genesis);
        for key in validators.keys() {
            hash.update(key.as_bytes());
        }
        Self(hash.finalize().into())
    }

    fn vote(&self, vote: &Vote) -> Vec<u8> {
        let kind = match vote.kind {
            VoteType::Prevote => 1,
            VoteType::Precommit => 2,
        };
        let mut bytes = self.begin(kind, vote.height, vote.round);
        if let NilOrVal::Val(value) = &vote.value {
            bytes.extend(value.bytes());
        }
        bytes
    }

    fn proposal(&self, proposal: &Proposal) -> Vec<u8> {
        let mut bytes = self.begin(3, proposal.height, proposal.round);
        bytes.extend(proposal.pol_round.as_i64().to_be_bytes());
        bytes.extend(proposal.value.bytes());
        bytes
    }

    fn begin(&self, kind: u8, height: Height, round: Round) -> Vec<u8> {
        let mut bytes = self.0.to_vec();
        bytes.push(kind);
        bytes.extend(height.0.to_be_bytes());
        bytes.extend(round.as_i64().to_be_bytes());
        bytes
    }

    /// What a validator signs to show another one who it is.
    pub(crate) fn greeting(&self, challenge: &[u8; 32], to: usize) -> Vec<u8> {
        let mut bytes = self.0.to_vec();
        bytes.push(4);
        bytes.extend(challenge);
        bytes.extend((to as u64).to_be_bytes());
        bytes
    }
}

pub(crate) fn sign(key: &SigningKey, bytes: &[u8]) -> Signature {
    Signature(Fixed(key.sign(bytes).to_bytes()))
}

pub(crate) fn verifies(key: &VerifyingKey, bytes: &[u8], signature: &Signature) -> bool {
    key.verify_strict(bytes, &ed25519_dalek::Signature::from_bytes(&signature.0.0)).is_ok()
}

pub(crate) fn sign_vote(network: &NetworkId, key: &SigningKey, vote: Vote) -> bft::SignedVote<Chain> {
    let signature = sign(key, &network.vote(&vote));
    bft::SignedVote::new(vote, signature)
}

pub(crate) fn sign_proposal(
    network: &NetworkId,
    key: &SigningKey,
    proposal: Proposal,
) -> bft::SignedProposal<Chain> {
    let signature = sign(key, &network.proposal(&proposal));
    bft::SignedProposal::new(proposal, signature)
}

impl NetworkId {
    pub(crate) fn verifies_vote(&self, vote: &Vote, signature: &Signature, key: &VerifyingKey) -> bool {
        verifies(key, &self.vote(vote), signature)
    }

    pub(crate) fn verifies_proposal(
        &self,
        proposal: &Proposal,
        signature: &Signature,
        key: &VerifyingKey,
    ) -> bool {
        verifies(key, &self.proposal(proposal), signature)
    }
}

/// The library's interface is asynchronous for those who ask other machines; nothing here waits.
#[async_trait::async_trait]
impl Verifier<Chain> for NetworkId {
    async fn verify_signed_vote(
        &self,
        vote: &Vote,
        signature: &Signature,
        key: &VerifyingKey,
    ) -> Result<VerificationResult, Error> {
        Ok(VerificationResult::from_bool(self.verifies_vote(vote, signature, key)))
    }

    async fn verify_signed_proposal(
        &self,
        proposal: &Proposal,
        signature: &Signature,
        key: &VerifyingKey,
    ) -> Result<VerificationResult, Error> {
        Ok(VerificationResult::from_bool(self.verifies_proposal(proposal, signature, key)))
    }

    // Votes are not extended.
    async fn verify_signed_vote_extension(
        &self,
        _: &bft::VoteExtensionScope<Chain>,
        _: &(),
        _: &Signature,
        _: &VerifyingKey,
    ) -> Result<VerificationResult, Error> {
        Ok(VerificationResult::Invalid)
    }

    // Peers are known by their greeting.
    async fn verify_validator_proof(
        &self,
        _: &bft::ValidatorProof<Chain>,
    ) -> Result<VerificationResult, Error> {
        Ok(VerificationResult::Invalid)
    }
}
