//! The received blocks, as far back as a reorganisation may reach. Determines which contract events a new head adds
//! and which it retracts. Works without a network.

use std::collections::VecDeque;

use crate::{message::Event, values::BlockHash};

/// Deepest reorganisation, in blocks. A deeper one is another chain.
pub(super) const DEEPEST: usize = 128;

/// A block with its contract events.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Block {
    pub(super) number: u64,
    pub(super) hash: BlockHash,
    pub(super) events: Vec<Event>,
}

/// The last received blocks of the chain.
#[derive(Debug, Default)]
pub(super) struct Blocks(VecDeque<Block>);

impl Blocks {
    pub(super) fn head(&self) -> Option<&Block> {
        self.0.back()
    }

    /// Whether a block is known.
    pub(super) fn knows(&self, hash: BlockHash) -> bool {
        self.0.iter().any(|block| block.hash == hash)
    }

    /// Removes blocks down to this one. Returns their events, latest first.
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
