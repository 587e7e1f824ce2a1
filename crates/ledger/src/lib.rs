//! The ledger over which domains that do not trust each other agree on services: what is said to the contract
//! `contracts/Federation.sol`, and what it says.
//!
//! [`Contract`] has the contract's rules without a ledger. With the feature `ethereum`, [`ethereum`] speaks to real
//! ones.
#![forbid(unsafe_code)]

mod contract;
#[cfg(feature = "ethereum")]
pub mod ethereum;
mod message;
mod values;

pub use contract::Contract;
pub use message::{
    Call, Event, MAX_NAME, MAX_SEALED, MAX_SSID, Outcome, Refusal, Requirements, State, Terms,
};
pub use values::{
    Account, BlockHash, ChainTime, Commitment, ParseHexError, Price, PublicKey, Salt, ServiceId,
    TransactionHash, Wei,
};
