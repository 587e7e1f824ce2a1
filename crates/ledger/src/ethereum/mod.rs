//! Real ledgers: the contract on any network that speaks Ethereum's JSON-RPC.

mod abi;
pub mod anvil;
mod blocks;
mod client;
mod key;
mod node;
mod socket;
mod survey;

pub use abi::{DecodeError, bytecode, decode_error, decode_event, encode};
pub use client::{EthereumLedger, Settings};
pub use key::{Key, KeyError, Password};
pub use node::{EthereumError, deploy};
pub use survey::{Survey, block_period, survey};
