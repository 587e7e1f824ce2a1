//! Blocks as the Engine API has them, and what a validator asks of one before its execution client executes it.
//!
//! They are those of the Shanghai fork (`ExecutionPayloadV2`, Engine API, Shanghai): the last whose payload is complete without
//! a beacon chain's blobs and requests.

use std::fmt;

use malachitebft_types as bft;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::hex::{self, Bytes, Fixed, Quantity};

/// A block's clock may be so far ahead of a validator's own, in seconds. Later, and the deadlines of contracts would run away.
pub(crate) const AHEAD: u64 = 15;

/// What validators vote on: the SHA-256 of a payload's text. It binds the transactions themselves; the execution client
/// checks that the block's hash, which is its name on the chain, does as well.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct BlockId(Fixed<32>);

impl BlockId {
    pub(crate) fn bytes(&self) -> &[u8; 32] {
        &self.0.0
    }
}

impl fmt::Display for BlockId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&hex::encode(&self.0.0))
    }
}

impl fmt::Debug for BlockId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

impl bft::Value for BlockId {
    type Id = Self;

    fn id(&self) -> Self {
        *self
    }
}

/// `ExecutionPayloadV2`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
pub(crate) struct Payload {
    parent_hash: Fixed<32>,
    fee_recipient: Fixed<20>,
    state_root: Fixed<32>,
    receipts_root: Fixed<32>,
    logs_bloom: Fixed<256>,
    prev_randao: Fixed<32>,
    block_number: Quantity,
    gas_limit: Quantity,
    gas_used: Quantity,
    timestamp: Quantity,
    extra_data: Bytes,
    base_fee_per_gas: Quantity,
    block_hash: Fixed<32>,
    transactions: Vec<Bytes>,
    withdrawals: Vec<serde_json::Value>,
}

/// Where a block stands on the chain: all that its child needs to know of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Position {
    /// How many blocks are before it.
    pub number: u64,
    /// Its hash.
    pub hash: [u8; 32],
    /// Its time, in seconds of Unix.
    pub timestamp: u64,
}

/// A block.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "Payload", into = "Payload")]
pub struct Block {
    payload: Box<Payload>,
    id: BlockId,
    position: Position,
}

/// Why a payload is no block.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
#[error("the block's {0} is more than 64 bits")]
pub struct TooGreat(&'static str);

impl TryFrom<Payload> for Block {
    type Error = TooGreat;

    fn try_from(payload: Payload) -> Result<Self, TooGreat> {
        let text = serde_json::to_vec(&payload).expect("it has no maps");
        let position = Position {
            number: payload.block_number.to_u64().ok_or(TooGreat("number"))?,
            hash: payload.block_hash.0,
            timestamp: payload.timestamp.to_u64().ok_or(TooGreat("time"))?,
        };
        Ok(Self { id: BlockId(Fixed(Sha256::digest(text).into())), position, payload: Box::new(payload) })
    }
}

impl From<Block> for Payload {
    fn from(block: Block) -> Self {
        *block.payload
    }
}

/// Why a validator votes against a block that it need not even execute.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Fault {
    /// Another block is its parent.
    #[error("its parent is another")]
    Parent,
    /// Its time is not after its parent's, or too far ahead of the clock.
    #[error("its time is not after its parent's, or too far ahead of the clock")]
    Time,
    /// Its `prevRandao` is not the hash of its parent: nobody may choose it.
    #[error("its prevRandao is not the hash of its parent")]
    Randao,
    /// It pays withdrawals, which create money.
    #[error("it pays withdrawals, which create money")]
    Withdrawals,
}

impl Block {
    /// What validators vote on.
    pub fn id(&self) -> BlockId {
        self.id
    }

    /// Where it stands.
    pub fn position(&self) -> Position {
        self.position
    }

    /// How many transactions it has.
    pub fn transactions(&self) -> usize {
        self.payload.transactions.len()
    }

    /// About how many bytes it is as text.
    pub(crate) fn size(&self) -> usize {
        1500 + self.payload.transactions.iter().map(|transaction| 2 * transaction.0.len() + 5).sum::<usize>()
    }

    /// Whether it may follow a block, when the clock shows `now` seconds of Unix. What is in it, the execution client judges.
    ///
    /// # Errors
    /// [`Fault`].
    pub fn follows(&self, parent: &Position, now: u64) -> Result<(), Fault> {
        let Position { number, timestamp, .. } = self.position;
        if self.payload.parent_hash.0 != parent.hash || number.checked_sub(1) != Some(parent.number) {
            return Err(Fault::Parent);
        }
        // With blocks less than a second apart, the chain's time runs ahead of the clock by a second each.
        let is_early =
            timestamp == parent.timestamp.saturating_add(1) || timestamp <= now.saturating_add(AHEAD);
        if timestamp <= parent.timestamp || !is_early {
            return Err(Fault::Time);
        }
        if self.payload.prev_randao.0 != parent.hash {
            return Err(Fault::Randao);
        }
        if !self.payload.withdrawals.is_empty() {
            return Err(Fault::Withdrawals);
        }
        Ok(())
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use serde_json::{Value, json};

    use super::*;

    pub(crate) const GENESIS: Position = Position { number: 0, hash: [7; 32], timestamp: 1_000 };

    fn payload(parent: &Position, timestamp: u64, extra: &[u8]) -> Value {
        let hash: [u8; 32] = Sha256::new()
            .chain_update(parent.hash)
            .chain_update(timestamp.to_be_bytes())
            .chain_update(extra)
            .finalize()
            .into();
        json!({
            "parentHash": hex::encode(&parent.hash),
            "feeRecipient": hex::encode(&[0; 20]),
            "stateRoot": hex::encode(&[1; 32]),
            "receiptsRoot": hex::encode(&[2; 32]),
            "logsBloom": hex::encode(&[0; 256]),
            "prevRandao": hex::encode(&parent.hash),
            "blockNumber": format!("{:#x}", parent.number + 1),
            "gasLimit": "0x1c9c380",
            "gasUsed": "0x0",
            "timestamp": format!("{timestamp:#x}"),
            "extraData": hex::encode(extra),
            "baseFeePerGas": "0x7",
            "blockHash": hex::encode(&hash),
            "transactions": ["0x02ff"],
            "withdrawals": [],
        })
    }

    /// A block for tests, whose hash is not that of a block.
    pub(crate) fn block(parent: &Position, timestamp: u64, extra: &[u8]) -> Block {
        serde_json::from_value(payload(parent, timestamp, extra)).unwrap()
    }

    #[test]
    fn a_block_is_named_by_all_that_is_in_it() {
        let one = payload(&GENESIS, 1_001, b"");
        let block: Block = serde_json::from_value(one.clone()).unwrap();
        assert_eq!(serde_json::to_value(&block).unwrap(), one);
        assert_eq!(block.position().number, 1);
        assert_eq!(block.transactions(), 1);
        let mut other = one.clone();
        other["transactions"] = json!(["0x02fe"]);
        let other: Block = serde_json::from_value(other).unwrap();
        assert_eq!(other.position().hash, block.position().hash, "as a liar would have it");
        assert_ne!(other.id(), block.id());
        for (field, value) in
            [("blobGasUsed", "0x0"), ("gasUsed", "0x00"), ("timestamp", "0x1ffffffffffffffff")]
        {
            let mut wrong = one.clone();
            wrong[field] = json!(value);
            assert!(serde_json::from_value::<Block>(wrong).is_err(), "{field}");
        }
    }

    #[test]
    fn what_may_not_follow_is_told_before_it_is_executed() {
        let follows = |change: &dyn Fn(&mut Value), timestamp, now| {
            let mut payload = payload(&GENESIS, timestamp, b"");
            change(&mut payload);
            serde_json::from_value::<Block>(payload).unwrap().follows(&GENESIS, now)
        };
        let same = |_: &mut Value| {};
        assert_eq!(follows(&same, 1_001, 0), Ok(()), "the next second always");
        assert_eq!(follows(&same, 1_015, 1_000), Ok(()));
        assert_eq!(follows(&same, 1_016, 1_000), Err(Fault::Time));
        assert_eq!(follows(&same, 1_000, 1_000), Err(Fault::Time));
        let number = |payload: &mut Value| payload["blockNumber"] = json!("0x2");
        assert_eq!(follows(&number, 1_001, 1_000), Err(Fault::Parent));
        let parent = |payload: &mut Value| payload["parentHash"] = json!(hex::encode(&[8; 32]));
        assert_eq!(follows(&parent, 1_001, 1_000), Err(Fault::Parent));
        let randao = |payload: &mut Value| payload["prevRandao"] = json!(hex::encode(&[8; 32]));
        assert_eq!(follows(&randao, 1_001, 1_000), Err(Fault::Randao));
        let money = |payload: &mut Value| payload["withdrawals"] = json!([{ "amount": "0x1" }]);
        assert_eq!(follows(&money, 1_001, 1_000), Err(Fault::Withdrawals));
    }
}
