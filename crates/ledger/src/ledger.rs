//! What a ledger is to one operator: calls go in, and what happened on the chain comes out.

use cotorra_graph::Timestamp;

use crate::{
    message::{Call, ContractError, Event},
    values::{Account, ChainTime},
};

/// Names a call that was submitted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Ticket(pub u64);

/// Why a call comes to nothing.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum CallError {
    /// The contract's answer.
    #[error(transparent)]
    Contract(#[from] ContractError),
    /// The node does not take the transaction, such as for want of money for its fee.
    #[error("the ledger's node does not take the transaction: {0}")]
    Node(String),
}

/// What a ledger tells.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Notice {
    /// The chain has a new head, or still the same after the ledger was away. All that was said up to its block comes before it.
    Head {
        /// The block's number.
        number: u64,
        /// The block's time.
        time: ChainTime,
    },
    /// The contract said something.
    Event(Event),
    /// It has not said that after all: the block was reorganised away. The event may come again.
    Retracted(Event),
    /// A call is in a block. It may be reorganised away; it is then sent again, and told of again.
    Included(Ticket),
    /// A call comes to nothing, and is not sent any more.
    Refused(Ticket, CallError),
    /// The ledger cannot be reached. What was submitted is kept, and sent once it can be.
    Down(String),
    /// The ledger is reached, for the first time or again.
    Up,
}

/// One operator's access to the contract on a ledger.
///
/// Nothing here waits: a ledger that is away keeps what is submitted. Calls of one operator arrive in the order in which
/// they were submitted.
pub trait Ledger: Send {
    /// The operator.
    fn account(&self) -> Account;

    /// Has a call sent, as often as it takes until it is in a block or is refused.
    fn submit(&mut self, now: Timestamp, call: Call) -> Ticket;

    /// What has happened until `now`, oldest first; `None`: nothing more.
    fn poll(&mut self, now: Timestamp) -> Option<Notice>;

    /// When [`Ledger::poll`] may have something new.
    fn next_deadline(&self) -> Option<Timestamp>;
}
