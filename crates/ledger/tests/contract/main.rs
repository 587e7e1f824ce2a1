//! The compiled contract on a real Ethereum virtual machine: it does what its rules in Rust say, call by call, and
//! those who mean no good gain nothing.
#![allow(clippy::unwrap_used, reason = "tests, and what helps them")]

mod adversaries;
mod both;
mod chain;
#[path = "../common/mod.rs"]
mod common;
mod gas;
mod guards;
mod random;
