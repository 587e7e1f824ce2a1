//! What the library asks of its surroundings: blocks, timers, signatures, and a voice.

use std::{
    collections::{BTreeMap, BTreeSet, VecDeque},
    time::Duration,
};

use cotorra_graph::Timestamp;
use malachitebft_consensus::{ConsensusMsg, Effect, Resumable, Resume, VoteExtensionError};
use malachitebft_signing::VerifierExt;
use malachitebft_types::{self as bft, LinearTimeouts, Round, Timeout, ValueOrigin};

use super::{Output, Settings};
use crate::{
    block::{Block, BlockId, Position},
    context::{Address, Chain, Height},
    sign::{sign_proposal, sign_vote},
    wire::{Decided, Message, Note},
};

/// How long each step of a round may take before it is given up, more in each round.
const TIMEOUTS: LinearTimeouts = LinearTimeouts {
    propose: Duration::from_millis(1000),
    propose_delta: Duration::from_millis(1000),
    prevote: Duration::from_millis(500),
    prevote_delta: Duration::from_millis(500),
    precommit: Duration::from_millis(500),
    precommit_delta: Duration::from_millis(500),
    rebroadcast: Duration::from_millis(1000),
    max_timeout: Duration::from_secs(10),
};
/// So long it waits for decisions that it asked for before it asks another.
const ANSWER: Duration = Duration::from_secs(1);

/// What the library asks of its surroundings.
pub(super) struct Host {
    pub(super) settings: Settings,
    pub(super) now: Timestamp,
    pub(super) outputs: VecDeque<Output>,
    pub(super) timers: Vec<(Timestamp, Timeout)>,
    /// The last block that is final.
    pub(super) last: Position,
    /// Blocks of the height, by name, whatever they were found to be.
    pub(super) blocks: BTreeMap<BlockId, Block>,
    /// Those that it proposed, by round.
    pub(super) own: BTreeMap<u32, BlockId>,
    /// Those that are being executed: the round that they were proposed in, and how they came.
    pub(super) judging: BTreeMap<BlockId, (Round, ValueOrigin)>,
    /// Who offered a block in which round: each may have one executed.
    pub(super) offers: BTreeSet<(usize, u32)>,
    /// Blocks of the next height that came before it began.
    pub(super) early: Vec<(usize, u32, Block)>,
    /// A round for which a block is wanted.
    pub(super) wanted: Option<(Height, Round)>,
    pub(super) is_replaying: bool,
    pub(super) began: Timestamp,
    /// When the next height begins, once this one is decided.
    pub(super) begins: Option<Timestamp>,
    /// How far the others are.
    pub(super) heights: Vec<Height>,
    pub(super) status: Timestamp,
    pub(super) asked: Option<Timestamp>,
    /// Decisions that others told.
    pub(super) told: VecDeque<Decided>,
}

impl Host {
    pub(super) fn new(settings: Settings, last: Position, now: Timestamp) -> Self {
        let count = settings.validators.len();
        Self {
            settings,
            now,
            outputs: VecDeque::new(),
            timers: Vec::new(),
            last,
            blocks: BTreeMap::new(),
            own: BTreeMap::new(),
            judging: BTreeMap::new(),
            offers: BTreeSet::new(),
            early: Vec::new(),
            wanted: None,
            is_replaying: false,
            began: now,
            begins: None,
            heights: vec![Height(0); count],
            status: now,
            asked: None,
            told: VecDeque::new(),
        }
    }

    /// The clock, in seconds of Unix.
    pub(super) fn clock(&self) -> u64 {
        self.now.since(Timestamp::ZERO).as_secs()
    }

    pub(super) fn say(&mut self, message: Message) {
        self.outputs.push_back(Output::Say(None, message));
    }

    pub(super) fn note(&mut self, note: Note) {
        if !self.is_replaying {
            self.outputs.push_back(Output::Note(note));
        }
    }

    /// Keeps a block of the height.
    pub(super) fn keep(&mut self, height: Height, round: u32, block: &Block) {
        let turn =
            bft::Context::select_proposer(&Chain, &self.settings.validators, height, Round::new(round));
        if *bft::Validator::address(turn) == self.address() {
            self.own.insert(round, block.id());
        }
        self.blocks.insert(block.id(), block.clone());
    }

    pub(super) fn address(&self) -> Address {
        self.settings.validators.address(self.settings.me)
    }

    pub(super) fn show(&mut self, height: Height, round: Round, block: Block) {
        if let Some(round) = round.as_u32() {
            self.say(Message::Block { height, round, block });
        }
    }

    /// Forgets the height that is over.
    pub(super) fn clear(&mut self) {
        self.blocks.clear();
        self.own.clear();
        self.judging.clear();
        self.offers.clear();
        self.wanted = None;
        self.begins = None;
        self.began = self.now;
    }

    /// Whether the next height may begin: at its time, or at once where others have decided it.
    pub(super) fn is_time_for_the_next(&self) -> bool {
        self.begins.is_some_and(|begins| begins <= self.now || !self.told.is_empty())
    }

    pub(super) fn take_decided(&mut self, decided: Vec<Decided>) {
        if self.told.is_empty() {
            self.told.extend(decided);
        }
    }

    /// The decision of a height that others told, unless it is being looked at.
    pub(super) fn next_decided(&mut self, height: Height) -> Option<Decided> {
        let is_looked_at = self.judging.values().any(|(_, origin)| origin.is_sync());
        if self.begins.is_some() || is_looked_at {
            return None;
        }
        while let Some(decided) = self.told.pop_front() {
            if decided.height() == height {
                return Some(decided);
            }
        }
        None
    }

    /// Asks who is ahead for what it decided.
    pub(super) fn ask(&mut self) {
        let is_waiting = self.asked.is_some_and(|asked| self.now < asked + ANSWER);
        let next = Height(self.last.number + 1);
        let ahead: Vec<usize> =
            (0..self.heights.len()).filter(|index| self.heights[*index] >= next).collect();
        if ahead.is_empty() || is_waiting || !self.told.is_empty() || !self.judging.is_empty() {
            return;
        }
        // Not always the same one: it may lie.
        let turn = self.clock() as usize % ahead.len();
        self.asked = Some(self.now);
        self.outputs.push_back(Output::Say(Some(ahead[turn]), Message::Request { from: next }));
    }

    #[expect(clippy::unnecessary_wraps, reason = "what the library's macro asks for")]
    pub(super) fn handle(
        &mut self,
        effect: Effect<Chain>,
    ) -> Result<Resume<Chain>, std::convert::Infallible> {
        Ok(match effect {
            Effect::CancelAllTimeouts(r) => {
                self.timers.clear();
                r.resume_with(())
            }
            Effect::CancelTimeout(timeout, r) => {
                self.timers.retain(|(_, other)| *other != timeout);
                r.resume_with(())
            }
            Effect::ScheduleTimeout(timeout, r) => {
                self.timers.push((self.now + TIMEOUTS.duration_for(timeout), timeout));
                r.resume_with(())
            }
            Effect::StartRound(height, round, proposer, _, r) => {
                tracing::debug!(%height, %round, %proposer, "a round");
                r.resume_with(())
            }
            Effect::PublishConsensusMsg(message, r) => {
                self.say(message.into());
                r.resume_with(())
            }
            Effect::PublishLivenessMsg(message, r) => {
                self.say(message.into());
                r.resume_with(())
            }
            Effect::RepublishVote(vote, r) => {
                self.say(Message::Vote(vote.into()));
                r.resume_with(())
            }
            Effect::RepublishRoundCertificate(certificate, r) => {
                self.say(Message::Round(certificate.into()));
                r.resume_with(())
            }
            Effect::GetValue(height, round, _, r) => {
                self.wanted = Some((height, round));
                r.resume_with(())
            }
            Effect::RestreamProposal(height, round, _, _, value, r) => {
                if let Some(block) = self.blocks.get(&value).cloned() {
                    self.show(height, round, block);
                }
                r.resume_with(())
            }
            Effect::CertVerifiedSyncValue(response, _, r) => {
                let certificate = &response.certificate;
                let block = self.blocks[&certificate.value_id].clone();
                if let Some(round) = certificate.round.as_u32() {
                    self.note(Note::Block { height: certificate.height, round, block: block.clone() });
                }
                self.judging.insert(certificate.value_id, (certificate.round, ValueOrigin::Sync));
                self.outputs.push_back(Output::Judge(block));
                r.resume_with(())
            }
            Effect::CertRejectedSyncValue(_, height, error, r) => {
                tracing::warn!(%height, %error, "a decision that is none");
                self.told.clear();
                r.resume_with(())
            }
            Effect::Decide(certificate, _, r) => {
                let block = self.blocks.get(&certificate.value_id).expect("it was found valid").clone();
                self.last = block.position();
                self.begins = Some(self.now.max(self.began + self.settings.period));
                self.asked = None;
                self.outputs.push_back(Output::Decided(Decided::new(certificate, block)));
                r.resume_with(())
            }
            Effect::Finalize(certificate, _, evidence, r) => {
                let liars = evidence.votes.iter().map(|(liar, _)| liar);
                for validator in liars.chain(evidence.proposals.iter().map(|(liar, _)| liar)) {
                    tracing::warn!(height = %certificate.height, %validator, "a validator said two things");
                }
                r.resume_with(())
            }
            Effect::SignVote(vote, r) => {
                r.resume_with(sign_vote(&self.settings.network, &self.settings.key, vote))
            }
            Effect::SignProposal(proposal, r) => {
                r.resume_with(sign_proposal(&self.settings.network, &self.settings.key, proposal))
            }
            Effect::VerifySignature(message, key, r) => {
                let (network, signature) = (&self.settings.network, &message.signature);
                r.resume_with(match &message.message {
                    ConsensusMsg::Vote(vote) => network.verifies_vote(vote, signature, &key),
                    ConsensusMsg::Proposal(proposal) => network.verifies_proposal(proposal, signature, &key),
                })
            }
            Effect::VerifyCommitCertificate(certificate, validators, thresholds, r) => {
                let verifies = self.settings.network.verify_commit_certificate(
                    &Chain,
                    &certificate,
                    &validators,
                    thresholds,
                );
                r.resume_with(at_once(verifies))
            }
            Effect::VerifyExtendedCommitCertificate(certificate, validators, thresholds, policy, r) => {
                let network = &self.settings.network;
                let verifies = network.verify_extended_commit_certificate(
                    &Chain,
                    &certificate,
                    &validators,
                    thresholds,
                    policy,
                );
                r.resume_with(at_once(verifies))
            }
            Effect::VerifyPolkaCertificate(certificate, validators, thresholds, r) => {
                let verifies = self.settings.network.verify_polka_certificate(
                    &Chain,
                    &certificate,
                    &validators,
                    thresholds,
                );
                r.resume_with(at_once(verifies))
            }
            Effect::VerifyRoundCertificate(certificate, validators, thresholds, r) => {
                let verifies = self.settings.network.verify_round_certificate(
                    &Chain,
                    &certificate,
                    &validators,
                    thresholds,
                );
                r.resume_with(at_once(verifies))
            }
            Effect::WalAppend(height, input, r) => {
                if let Some(note) = Note::of(height, input) {
                    self.note(note);
                }
                r.resume_with(())
            }
            Effect::ExtendVote(.., r) => r.resume_with(None),
            Effect::VerifyVoteExtension(.., r) => {
                r.resume_with(Err(VoteExtensionError::InvalidVoteExtension))
            }
        })
    }
}

/// What a future has to say that waits for nothing.
fn at_once<T>(future: impl Future<Output = T>) -> T {
    let mut context = std::task::Context::from_waker(std::task::Waker::noop());
    match std::pin::pin!(future).poll(&mut context) {
        std::task::Poll::Ready(value) => value,
        std::task::Poll::Pending => unreachable!("signatures are verified at once"),
    }
}
