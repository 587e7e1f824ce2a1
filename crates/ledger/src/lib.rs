//! The ledger over which domains that do not trust each other agree on services: calls to the contract
//! `contracts/Federation.sol`, and its events.
//!
//! [`negotiation`] has the two roles as state machines over any [`Ledger`]. [`ModelledLedger`] works in virtual time;
//! the feature `ethereum` adds real ledgers. [`Secret`] seals confidential messages; [`Contract`] has the contract's
//! rules.
#![forbid(unsafe_code)]

mod contract;
#[cfg(feature = "ethereum")]
pub mod ethereum;
mod ledger;
mod message;
mod modelled;
pub mod negotiation;
#[cfg(feature = "ethereum")]
mod outbox;
mod seal;
pub mod tunnel;
mod values;

pub use contract::Contract;
pub use ledger::{CallError, Ledger, Notice, Ticket};
pub use message::{
    Call, ContractError, Event, MAX_NAME, MAX_SEALED, MAX_SSID, Outcome, Requirements, State, Terms,
};
pub use modelled::{ModelledChain, ModelledLedger};
pub use seal::{Attachment, Bid, SealError, Sealable, Secret};
pub use values::{
    Account, BlockHash, ChainTime, Commitment, Deployment, ParseHexError, Price, PublicKey, Salt, ServiceId,
    TransactionHash, Wei,
};
