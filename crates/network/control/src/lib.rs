//! The Network Control block: holds what is known of the network (ι of radio units, d and λ of links), changes what
//! links do (ψ, δ and absolute conditions), steers attachments, and maps VNFs and virtual links (VIM).
//!
//! It reaches the emulated network through [`Network`] and what runs VNFs through [`vim::Engine`]; it owns neither a
//! clock nor a socket, and every call takes the time.
#![forbid(unsafe_code)]

mod access;
mod control;
mod environment;
mod mappings;
mod network;
#[cfg(test)]
mod testing;
pub mod vim;

pub use control::NetworkControl;
pub use environment::program_of_others;
pub use network::{InstructionError, Network, NetworkGone, change_fabric, test_fabric_throughput};
