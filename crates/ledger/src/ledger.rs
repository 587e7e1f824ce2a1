//! A ledger as one operator sees it: calls go in, and events of the chain come out.

use cotorra_graph::Timestamp;

use crate::{
    message::{Call, ContractError, Event},
    values::{Account, ChainTime},
};

/// ID of a submitted call.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Ticket(pub u64);

/// Reason for which a call has no effect.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum CallError {
    /// The contract's error.
    #[error(transparent)]
    Contract(#[from] ContractError),
    /// The node rejects the transaction, for instance for lack of money for its fee.
    #[error("the ledger's node rejects the transaction: {0}")]
    Node(String),
}

/// A notice from a ledger.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Notice {
    /// The chain has a new head, or still the same after the ledger was away. All events up to its block precede it.
    Head {
        /// Number of the block.
        number: u64,
        /// Time of the block.
        time: ChainTime,
    },
    /// The contract emitted an event.
    Event(Event),
    /// An event was retracted, because its block was reorganised away. It may come again.
    Retracted(Event),
    /// A call is in a block. If the block is reorganised away, the call is sent and reported again.
    Included(Ticket),
    /// A call failed for good.
    Refused(Ticket, CallError),
    /// The ledger cannot be reached. Submitted calls are kept until it can be.
    Down(String),
    /// The ledger is reached, for the first time or again.
    Up,
}

/// One operator's access to the contract on a ledger.
///
/// No method blocks: while the ledger is away, submitted calls are kept. Calls of one operator arrive in the order of
/// submission.
pub trait Ledger: Send {
    /// Returns the operator's address.
    fn account(&self) -> Account;

    /// Submits a call. It is sent until it is in a block or fails.
    fn submit(&mut self, now: Timestamp, call: Call) -> Ticket;

    /// Returns the next notice up to `now`, oldest first; `None` if there is none.
    fn poll(&mut self, now: Timestamp) -> Option<Notice>;

    /// Returns when [`Ledger::poll`] may have something new.
    fn next_deadline(&self) -> Option<Timestamp>;
}
