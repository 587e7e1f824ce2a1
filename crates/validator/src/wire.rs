//! What validators say to each other, and what one notes of itself before it says it: JSON, of types that leave no room for
//! what consensus does not expect, such as a vote of no round.

use malachitebft_consensus::{Input, LivenessMsg, LocallyProposedValue, ProposedValue, SignedConsensusMsg};
use malachitebft_types::{
    self as bft, NilOrVal, Round, RoundCertificateType, Timeout, TimeoutKind, Validity, ValueOrigin, VoteType,
};
use serde::{Deserialize, Serialize};

use crate::{
    block::{Block, BlockId},
    context::{Address, Chain, Height, Proposal, Signature, Vote},
    hex::Bytes,
};

/// A message is no longer than this, in bytes; a full block of 30 million gas is about 4 MB in hexadecimal digits.
pub(crate) const MAX_MESSAGE: usize = 16 << 20;

/// What one validator says to another.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Message {
    /// A vote.
    Vote(SignedVote),
    /// A proposal.
    Proposal(SignedProposal),
    /// Two thirds voted for a block.
    Polka(Polka),
    /// Why a round was begun.
    Round(RoundCertificate),
    /// A block that was proposed.
    Block {
        /// Where in the chain.
        height: Height,
        /// The round that it was proposed in.
        round: u32,
        /// The block.
        block: Block,
    },
    /// How far the sender is.
    Status {
        /// The last height that it has a decision of.
        decided: Height,
    },
    /// A wish to be told the decisions from that height on.
    Request {
        /// The first one.
        from: Height,
    },
    /// Decisions, in their order.
    Decided(Vec<Decided>),
    /// Transactions that wait at the sender's execution client, as they are signed.
    Transactions(Vec<Bytes>),
}

/// A vote and its signature.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SignedVote {
    kind: VoteType,
    height: Height,
    round: u32,
    value: Option<BlockId>,
    validator: Address,
    signature: Signature,
}

/// A proposal and its signature.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SignedProposal {
    height: Height,
    round: u32,
    value: BlockId,
    pol_round: Option<u32>,
    validator: Address,
    signature: Signature,
}

/// The votes of two thirds for a block.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Polka {
    height: Height,
    round: u32,
    value: BlockId,
    signatures: Vec<(Address, Signature)>,
}

/// The votes for whatever that begin a round.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RoundCertificate {
    height: Height,
    round: u32,
    kind: RoundCertificateType,
    votes: Vec<(VoteType, Option<BlockId>, Address, Signature)>,
}

/// A block, and the signatures that make it final.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Decided {
    round: u32,
    signatures: Vec<(Address, Signature)>,
    /// The block.
    pub block: Block,
}

/// What a validator notes before it acts on it. Once more from its notes, it says what it said, and nothing else.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Note {
    /// A vote, of itself or of others.
    Vote(SignedVote),
    /// A proposal, of itself or of others.
    Proposal(SignedProposal),
    /// Two thirds voted for a block.
    Polka(Polka),
    /// It waited long enough.
    Timeout(TimeoutNote),
    /// What a block was found to be.
    Judged {
        /// Where in the chain.
        height: Height,
        /// The round that it was proposed in.
        round: u32,
        /// Who proposed it.
        proposer: Address,
        /// The block.
        value: BlockId,
        /// Whether it may be on the chain.
        is_valid: bool,
    },
    /// A block itself.
    Block {
        /// Where in the chain.
        height: Height,
        /// The round that it was proposed in.
        round: u32,
        /// The block.
        block: Block,
    },
}

/// A step of a round that was given up.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TimeoutNote {
    height: Height,
    round: u32,
    step: Step,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Step {
    Propose,
    Prevote,
    Precommit,
}

/// The round's number. Only what the library makes of thin air has none.
fn number(round: Round) -> u32 {
    round.as_u32().expect("what is signed has a round")
}

fn value(value: &NilOrVal<BlockId>) -> Option<BlockId> {
    match value {
        NilOrVal::Nil => None,
        NilOrVal::Val(value) => Some(*value),
    }
}

fn nil_or(value: Option<BlockId>) -> NilOrVal<BlockId> {
    value.map_or(NilOrVal::Nil, NilOrVal::Val)
}

impl From<bft::SignedVote<Chain>> for SignedVote {
    fn from(vote: bft::SignedVote<Chain>) -> Self {
        let Vote { kind, height, round, value: of, validator } = vote.message;
        Self { kind, height, round: number(round), value: value(&of), validator, signature: vote.signature }
    }
}

impl From<SignedVote> for bft::SignedVote<Chain> {
    fn from(vote: SignedVote) -> Self {
        let SignedVote { kind, height, round, value, validator, signature } = vote;
        let vote = Vote { kind, height, round: Round::new(round), value: nil_or(value), validator };
        Self::new(vote, signature)
    }
}

impl From<bft::SignedProposal<Chain>> for SignedProposal {
    fn from(proposal: bft::SignedProposal<Chain>) -> Self {
        let Proposal { height, round, value, pol_round, validator } = proposal.message;
        let (round, pol_round) = (number(round), pol_round.as_u32());
        Self { height, round, value, pol_round, validator, signature: proposal.signature }
    }
}

impl From<SignedProposal> for bft::SignedProposal<Chain> {
    fn from(proposal: SignedProposal) -> Self {
        let SignedProposal { height, round, value, pol_round, validator, signature } = proposal;
        let pol_round = pol_round.map_or(Round::Nil, Round::new);
        Self::new(Proposal { height, round: Round::new(round), value, pol_round, validator }, signature)
    }
}

impl From<bft::PolkaCertificate<Chain>> for Polka {
    fn from(polka: bft::PolkaCertificate<Chain>) -> Self {
        let signatures = polka.polka_signatures.iter().map(|by| (by.address, by.signature)).collect();
        Self { height: polka.height, round: number(polka.round), value: polka.value_id, signatures }
    }
}

impl From<Polka> for bft::PolkaCertificate<Chain> {
    fn from(polka: Polka) -> Self {
        let by = |(address, signature)| bft::PolkaSignature::new(address, signature);
        Self {
            height: polka.height,
            round: Round::new(polka.round),
            value_id: polka.value,
            polka_signatures: polka.signatures.into_iter().map(by).collect(),
        }
    }
}

impl From<bft::RoundCertificate<Chain>> for RoundCertificate {
    fn from(certificate: bft::RoundCertificate<Chain>) -> Self {
        let vote =
            |by: &bft::RoundSignature<Chain>| (by.vote_type, value(&by.value_id), by.address, by.signature);
        Self {
            height: certificate.height,
            round: number(certificate.round),
            kind: certificate.cert_type,
            votes: certificate.round_signatures.iter().map(vote).collect(),
        }
    }
}

impl From<RoundCertificate> for bft::RoundCertificate<Chain> {
    fn from(certificate: RoundCertificate) -> Self {
        let by = |(kind, value, address, signature)| {
            bft::RoundSignature::new(kind, nil_or(value), address, signature)
        };
        Self {
            height: certificate.height,
            round: Round::new(certificate.round),
            cert_type: certificate.kind,
            round_signatures: certificate.votes.into_iter().map(by).collect(),
        }
    }
}

impl Decided {
    pub(crate) fn new(certificate: bft::CommitCertificate<Chain>, block: Block) -> Self {
        let signatures = certificate.commit_signatures.iter().map(|by| (by.address, by.signature)).collect();
        Self { round: number(certificate.round), signatures, block }
    }

    /// Where in the chain.
    pub fn height(&self) -> Height {
        Height(self.block.position().number)
    }

    pub(crate) fn certificate(&self) -> bft::ExtendedCommitCertificate<Chain> {
        let by =
            |(address, signature): &(_, _)| bft::ExtendedCommitSignature::new(*address, *signature, None);
        bft::ExtendedCommitCertificate {
            height: self.height(),
            round: Round::new(self.round),
            value_id: self.block.id(),
            commit_signatures: self.signatures.iter().map(by).collect(),
        }
    }
}

impl From<SignedConsensusMsg<Chain>> for Message {
    fn from(message: SignedConsensusMsg<Chain>) -> Self {
        match message {
            SignedConsensusMsg::Vote(vote) => Self::Vote(vote.into()),
            SignedConsensusMsg::Proposal(proposal) => Self::Proposal(proposal.into()),
        }
    }
}

impl From<LivenessMsg<Chain>> for Message {
    fn from(message: LivenessMsg<Chain>) -> Self {
        match message {
            LivenessMsg::Vote(vote) => Self::Vote(vote.into()),
            LivenessMsg::PolkaCertificate(polka) => Self::Polka(polka.into()),
            LivenessMsg::SkipRoundCertificate(certificate) => Self::Round(certificate.into()),
        }
    }
}

impl Note {
    /// What the library wants noted at that height; `None` for what it has again anyway.
    pub(crate) fn of(height: Height, input: Input<Chain>) -> Option<Self> {
        match input {
            Input::Vote(vote) => Some(Self::Vote(vote.into())),
            Input::Proposal(proposal) => Some(Self::Proposal(proposal.into())),
            Input::PolkaCertificate(polka) => Some(Self::Polka(polka.into())),
            Input::TimeoutElapsed(Timeout { kind, round }) => {
                let step = match kind {
                    TimeoutKind::Propose => Step::Propose,
                    TimeoutKind::Prevote => Step::Prevote,
                    TimeoutKind::Precommit => Step::Precommit,
                    TimeoutKind::Rebroadcast | TimeoutKind::FinalizeHeight(_) => return None,
                };
                Some(Self::Timeout(TimeoutNote { height, round: number(round), step }))
            }
            Input::ProposedValue(ProposedValue { height, round, proposer, value, validity, .. }, _) => {
                Some(Self::Judged {
                    height,
                    round: number(round),
                    proposer,
                    value,
                    is_valid: validity.is_valid(),
                })
            }
            Input::Propose(LocallyProposedValue { .. })
            | Input::StartHeight(..)
            | Input::RoundCertificate(_)
            | Input::SyncValueResponse(_) => None,
        }
    }

    pub(crate) fn height(&self) -> Height {
        match self {
            Self::Vote(SignedVote { height, .. })
            | Self::Proposal(SignedProposal { height, .. })
            | Self::Polka(Polka { height, .. })
            | Self::Timeout(TimeoutNote { height, .. })
            | Self::Judged { height, .. }
            | Self::Block { height, .. } => *height,
        }
    }

    /// What the library is told of it again; `None` for the block itself.
    pub(crate) fn input(self) -> Option<Input<Chain>> {
        Some(match self {
            Self::Vote(vote) => Input::Vote(vote.into()),
            Self::Proposal(proposal) => Input::Proposal(proposal.into()),
            Self::Polka(polka) => Input::PolkaCertificate(polka.into()),
            Self::Timeout(TimeoutNote { round, step, .. }) => {
                let kind = match step {
                    Step::Propose => TimeoutKind::Propose,
                    Step::Prevote => TimeoutKind::Prevote,
                    Step::Precommit => TimeoutKind::Precommit,
                };
                Input::TimeoutElapsed(Timeout::new(Round::new(round), kind))
            }
            Self::Judged { height, round, proposer, value, is_valid } => {
                judged(height, Round::new(round), proposer, value, is_valid, ValueOrigin::Consensus)
            }
            Self::Block { .. } => return None,
        })
    }
}

/// Tells the library what a block was found to be.
pub(crate) fn judged(
    height: Height,
    round: Round,
    proposer: Address,
    value: BlockId,
    is_valid: bool,
    origin: ValueOrigin,
) -> Input<Chain> {
    let (valid_round, validity) = (Round::Nil, Validity::from_bool(is_valid));
    Input::ProposedValue(ProposedValue { height, round, valid_round, proposer, value, validity }, origin)
}
