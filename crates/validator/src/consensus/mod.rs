//! A validator without a network, a disk, a clock or an execution client: what it hears goes in, and what it says, notes and
//! wants executed comes out. The rounds are the library's; pace, blocks and catching up are here.

mod host;
#[cfg(test)]
mod tests;

use std::{collections::BTreeMap, time::Duration};

use cotorra_graph::Timestamp;
use ed25519_dalek::SigningKey;
use host::Host;
use malachitebft_consensus::{Error, Input, LocallyProposedValue, Params, PeerId, State, process};
use malachitebft_types::{self as bft, Round, ValueOrigin, ValuePayload, ValueResponse, VoteExtensionPolicy};

use crate::{
    block::{Block, BlockId, Position},
    context::{Chain, Height, Validators},
    sign::NetworkId,
    wire::{Decided, Message, Note, judged},
};

/// How often a validator says how far it is.
const STATUS: Duration = Duration::from_millis(500);
/// Rounds ahead whose blocks are executed.
const ROUNDS_AHEAD: u32 = 10;
/// Heights ahead whose messages are kept, and messages of each.
const AHEAD: (usize, usize) = (4, 1024);

/// What a validator is.
#[derive(Debug, Clone)]
pub struct Settings {
    /// All validators of the network.
    pub validators: Validators,
    /// Which of them it is.
    pub me: usize,
    /// Its key.
    pub key: SigningKey,
    /// The network.
    pub network: NetworkId,
    /// From the beginning of one height to that of the next: what lies between blocks where no round fails.
    pub period: Duration,
}

/// What is to be done, in this order.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Output {
    /// To be on the disk before anything after it is done.
    Note(Note),
    /// To be said to another validator, or to all others.
    Say(Option<usize>, Message),
    /// To be executed: [`Consensus::judged`].
    Judge(Block),
    /// To be made: [`Consensus::built`].
    Build(Order),
    /// Final. To be on the disk before anything after it is done; notes of its height are of no use any more.
    Decided(Decided),
    /// To be told decisions from that height on.
    Serve(usize, Height),
}

/// A block that is wanted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Order {
    /// Where in the chain.
    pub height: Height,
    /// In which round.
    pub round: u32,
    /// Behind which block.
    pub parent: Position,
    /// Its time, in seconds of Unix.
    pub timestamp: u64,
}

/// Why a validator may not take part: from its notes it would say something else than it said.
#[derive(Debug, thiserror::Error)]
#[error("the notes of height {height} do not lead to what this validator said: {reason}")]
pub struct Diverged {
    height: Height,
    reason: String,
}

/// A validator.
pub struct Consensus {
    state: State<Chain>,
    host: Host,
}

impl Consensus {
    /// One that goes on behind a block: the last that it knows to be final, or the genesis.
    ///
    /// It says nothing before [`Consensus::start`].
    pub fn new(settings: Settings, last: Position, now: Timestamp) -> Self {
        let height = Height(last.number + 1);
        let params = Params {
            address: settings.validators.address(settings.me),
            threshold_params: bft::ThresholdParams::default(),
            value_payload: ValuePayload::ProposalAndParts,
            enabled: true,
        };
        let state = State::new(Chain, height, settings.validators.clone(), params, AHEAD.0, AHEAD.1);
        let host = Host::new(settings, last, now);
        Self { state, host }
    }

    /// Takes part, after what it noted of the height that it is at.
    ///
    /// # Errors
    /// [`Diverged`], for example because the notes are another validator's.
    pub fn start(&mut self, now: Timestamp, notes: Vec<Note>) -> Result<(), Diverged> {
        self.host.now = now;
        self.host.is_replaying = true;
        self.begin();
        let height = self.state.height();
        let notes: Vec<Note> = notes.into_iter().filter(|note| note.height() == height).collect();
        let (mut inputs, mut unjudged) = (Vec::new(), BTreeMap::new());
        for note in notes {
            match &note {
                Note::Block { round, block, .. } => {
                    self.host.keep(height, *round, block);
                    unjudged.insert(block.id(), Round::new(*round));
                }
                Note::Judged { value, .. } => _ = unjudged.remove(value),
                _ => {}
            }
            inputs.extend(note.input());
        }
        self.state.index_wal_entries(&inputs);
        for input in inputs {
            self.process(input).map_err(|reason| Diverged { height, reason: reason.to_string() })?;
        }
        self.state.reset_entries_index();
        self.host.is_replaying = false;
        for (id, round) in unjudged {
            let is_own = self.host.own.values().any(|own| *own == id);
            if !is_own && self.host.begins.is_none() {
                self.host.judging.insert(id, (round, ValueOrigin::Consensus));
                self.host.outputs.push_back(Output::Judge(self.host.blocks[&id].clone()));
            }
        }
        self.go_on();
        Ok(())
    }

    /// The height that is being decided, or was last.
    pub fn height(&self) -> Height {
        self.state.height()
    }

    /// Hears a message of another validator.
    pub fn hear(&mut self, now: Timestamp, from: usize, message: Message) {
        self.host.now = now;
        match message {
            Message::Vote(vote) => self.take(Input::Vote(vote.into())),
            Message::Proposal(proposal) => self.take(Input::Proposal(proposal.into())),
            Message::Polka(polka) => self.take(Input::PolkaCertificate(polka.into())),
            Message::Round(certificate) => self.take(Input::RoundCertificate(certificate.into())),
            Message::Block { height, round, block } => self.offered(from, height, round, block),
            Message::Status { decided } => self.host.heights[from] = decided,
            Message::Request { from: height } => self.host.outputs.push_back(Output::Serve(from, height)),
            Message::Decided(decided) => self.host.take_decided(decided),
            // They are the execution client's.
            Message::Transactions(_) => {}
        }
        self.go_on();
    }

    /// Hears whether the execution client found a block valid.
    pub fn judged(&mut self, now: Timestamp, block: BlockId, is_valid: bool) {
        self.host.now = now;
        if let Some((round, origin)) = self.host.judging.remove(&block) {
            let height = self.state.height();
            let proposer = *self.state.get_proposer(height, round);
            self.take(judged(height, round, proposer, block, is_valid, origin));
        }
        self.go_on();
    }

    /// Has the block that was wanted.
    pub fn built(&mut self, now: Timestamp, order: &Order, block: Block) {
        self.host.now = now;
        let (height, round) = (order.height, Round::new(order.round));
        // It may have taken so long that the round is over, or that it is noted already that it proposed another.
        if self.state.height() == height
            && self.state.round() == round
            && !self.host.own.contains_key(&order.round)
        {
            self.host.note(Note::Block { height, round: order.round, block: block.clone() });
            self.host.keep(height, order.round, &block);
            self.propose(round, block);
        }
        self.go_on();
    }

    /// Does what is due.
    pub fn expire(&mut self, now: Timestamp) {
        self.host.now = now;
        while let Some(index) = self.host.timers.iter().position(|(due, _)| *due <= now) {
            let (_, timeout) = self.host.timers.remove(index);
            self.take(Input::TimeoutElapsed(timeout));
        }
        if self.host.status <= now {
            self.host.status = now + STATUS;
            let decided = Height(self.host.last.number);
            self.host.say(Message::Status { decided });
        }
        self.go_on();
    }

    /// When [`Consensus::expire`] has something to do.
    pub fn next_deadline(&self) -> Timestamp {
        let timers = self.host.timers.iter().map(|(due, _)| *due);
        timers.chain(self.host.begins).fold(self.host.status, Timestamp::min)
    }

    /// What is to be done next.
    pub fn poll(&mut self) -> Option<Output> {
        self.host.outputs.pop_front()
    }

    /// What follows from what was heard.
    fn go_on(&mut self) {
        loop {
            if self.host.is_time_for_the_next() {
                self.begin();
                for (from, round, block) in std::mem::take(&mut self.host.early) {
                    self.offered(from, self.state.height(), round, block);
                }
            } else if let Some(decided) = self.host.next_decided(self.state.height()) {
                let (certificate, block) = (decided.certificate(), decided.block);
                self.host.blocks.insert(block.id(), block);
                let response = ValueResponse::new(peer(), bytes::Bytes::new(), certificate);
                self.take(Input::SyncValueResponse(response));
            } else if let Some((height, round)) = self.host.wanted.take() {
                self.provide(height, round);
            } else {
                break;
            }
        }
        self.host.ask();
    }

    /// Begins the height behind the last block.
    fn begin(&mut self) {
        let height = Height(self.host.last.number + 1);
        self.host.clear();
        let validators = self.host.settings.validators.clone();
        self.take(Input::StartHeight(height, validators, false, None, VoteExtensionPolicy::Disabled));
    }

    /// Proposes, where it has not.
    fn provide(&mut self, height: Height, round: Round) {
        let is_due = self.state.height() == height
            && self.state.round() == round
            && self.state.driver.step_is_propose();
        let Some(number) = round.as_u32().filter(|_| is_due) else { return };
        if let Some(own) = self.host.own.get(&number) {
            let block = self.host.blocks[own].clone();
            return self.propose(round, block);
        }
        let parent = self.host.last;
        let timestamp = self.host.clock().max(parent.timestamp + 1);
        self.host.outputs.push_back(Output::Build(Order { height, round: number, parent, timestamp }));
    }

    fn propose(&mut self, round: Round, block: Block) {
        let (height, value) = (self.state.height(), block.id());
        self.host.show(height, round, block);
        self.take(Input::Propose(LocallyProposedValue::new(height, round, value)));
    }

    /// Has a block of another validator executed, if it may be on the chain at all.
    fn offered(&mut self, from: usize, height: Height, round: u32, block: Block) {
        let id = block.id();
        let at = self.state.height();
        let is_next = height.0 == at.0 + 1 && self.host.begins.is_some();
        let is_known = self.host.blocks.contains_key(&id) || height.0 != block.position().number;
        let is_this = height == at && self.host.begins.is_none();
        let latest = if is_this { self.state.round().as_u32().unwrap_or(0) } else { 0 } + ROUNDS_AHEAD;
        if is_known || !(is_this || is_next) || round > latest || !self.host.offers.insert((from, round)) {
            return;
        }
        if is_next {
            self.host.early.push((from, round, block));
            return;
        }
        self.host.note(Note::Block { height, round, block: block.clone() });
        let follows = block.follows(&self.host.last, self.host.clock());
        self.host.blocks.insert(id, block.clone());
        let round = Round::new(round);
        match follows {
            Ok(()) => {
                self.host.judging.insert(id, (round, ValueOrigin::Consensus));
                self.host.outputs.push_back(Output::Judge(block));
            }
            Err(fault) => {
                tracing::warn!(%height, block = %id, %fault, "a block that may not be on the chain");
                let proposer = *self.state.get_proposer(height, round);
                self.take(judged(height, round, proposer, id, false, ValueOrigin::Consensus));
            }
        }
    }

    /// Tells the library something. What it cannot use, such as a message of a liar, it says and forgets.
    fn take(&mut self, input: Input<Chain>) {
        if let Err(error) = self.process(input) {
            tracing::warn!(%error, "an input that consensus cannot use");
        }
    }

    fn process(&mut self, input: Input<Chain>) -> Result<(), Box<Error<Chain>>> {
        let Self { state, host } = self;
        process!(input: input, state: state, metrics: &(), with: effect => host.handle(effect))
    }
}

/// The library wants to know whom to blame; the links know that.
fn peer() -> PeerId {
    // An identity multihash of no bytes.
    PeerId::from_bytes(&[0, 0]).expect("it is a multihash")
}
