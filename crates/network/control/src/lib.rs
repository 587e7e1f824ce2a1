//! The Network Control block. It observes the network (ι of radio units, d and λ of links), changes the conditions of links
//! (ψ, δ and absolute ones), hands robots over, and maps VNFs and virtual links (VIM).
//!
//! It reaches the emulated network through [`Network`], and the processes of VNFs through [`cotorra_engine::Engine`]. It owns neither
//! a clock nor a socket; every call takes the time.
#![forbid(unsafe_code)]

mod access;
mod control;
mod mappings;
mod network;
#[cfg(test)]
mod testing;
pub mod vim;

pub use control::NetworkControl;
pub use network::{
    Deployment, InstructionError, Network, NetworkGone, attach_in_fabric, change_fabric,
    check_switch_on_in_fabric, pin_in_fabric, provision_in_fabric, scan_in_fabric, suggest_in_fabric,
    switch_off_in_fabric, switch_on_in_fabric, test_fabric_throughput,
};
