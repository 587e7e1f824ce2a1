//! Real ledgers: the contract on any network that speaks Ethereum's JSON-RPC.

mod abi;
pub mod anvil;

pub use abi::{DecodeError, bytecode, decode_event, decode_refusal, encode};
