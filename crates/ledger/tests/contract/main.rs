//! Tests the compiled contract on a real Ethereum virtual machine: it follows its rules in Rust, call by call, and
//! attackers gain nothing.
#![allow(clippy::unwrap_used, reason = "tests may panic")]

mod adversaries;
mod both;
mod chain;
mod gas;
mod guards;
mod random;
