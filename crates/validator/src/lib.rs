//! A consensus client for Ethereum's execution clients: one validator of a network in which two thirds decide each block
//! (Tendermint, by the library Malachite), which its own execution client made and all others executed (Engine API).
//!
//! [`Consensus`] is the validator itself, and [`Node`] what runs it.
#![forbid(unsafe_code)]

mod block;
mod consensus;
mod context;
mod engine;
mod hex;
mod links;
pub mod local;
mod network;
mod node;
mod pool;
mod sign;
mod store;
mod transaction;
mod wire;
mod worker;

pub use block::{Block, BlockId, Fault, Position, TooGreat};
pub use consensus::{Consensus, Diverged, Order, Output, Settings};
pub use context::{Height, Validators};
pub use engine::{EngineError, Secret, SecretError};
pub use network::{Account, Key, Member, Network, NetworkError, PublicKey};
pub use node::{Config, Node, NodeError, Stop};
pub use sign::NetworkId;
pub use store::StoreError;
pub use wire::{Decided, Message, Note};
