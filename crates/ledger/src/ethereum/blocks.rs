//! The blocks that were heard, as far back as they can be taken back: which events of the contract a new head adds, and
//! which it retracts. Without a network.

use std::collections::VecDeque;

use crate::{message::Event, values::BlockHash};

/// So many blocks may be taken back at most; more is another chain.
pub(super) const DEEPEST: usize = 128;

/// A block, with what the contract said in it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Block {
    pub(super) number: u64,
    pub(super) hash: BlockHash,
    pub(super) events: Vec<Event>,
}

/// The last blocks of the chain as it was heard.
#[derive(Debug, Default)]
pub(super) struct Blocks(VecDeque<Block>);

impl Blocks {
    /// The last block.
    pub(super) fn head(&self) -> Option<&Block> {
        self.0.back()
    }

    /// Whether a block follows one that is known.
    pub(super) fn knows(&self, hash: BlockHash) -> bool {
        self.0.iter().any(|block| block.hash == hash)
    }

    /// Takes blocks back until that one is the last. Returns what the contract said in them, latest first.
    pub(super) fn retract_to(&mut self, hash: BlockHash) -> Vec<Event> {
        let mut retracted = Vec::new();
        while let Some(block) = self.0.pop_back_if(|block| block.hash != hash) {
            retracted.extend(block.events.into_iter().rev());
        }
        retracted
    }

    /// Adds the next block.
    pub(super) fn push(&mut self, block: Block) {
        if self.0.len() == DEEPEST {
            self.0.pop_front();
        }
        self.0.push_back(block);
    }
}
