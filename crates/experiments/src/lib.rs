//! Experiments made of many runs: sweeps over settings and seeds, margins of targets, and repetitions of published
//! experiments.
//!
//! [`Sweep`](sweep::Sweep) runs a testbed file in virtual time for all combinations of settings. [`Margin`](margin::Margin)
//! searches for the smallest change that breaks a target, and [`Regret`](regret::Regret) replays decisions of plug-ins with
//! their alternatives. These three share how runs are made and kept ([`Journal`](journal::Journal)). [`okpi::Comparison`] and
//! [`federation::Comparison`] compare runs with published figures, and [`handover::Comparison`] compares kinds of radio. They
//! only read reports and histories: the caller runs the testbeds, in real or in virtual time. [`repeat`] compares a folder of
//! results with that of a repeat.
#![forbid(unsafe_code)]

mod batch;
mod cell;
pub mod federation;
pub mod handover;
pub mod journal;
mod kept;
mod key;
pub mod margin;
pub mod okpi;
mod outcome;
pub mod regret;
pub mod repeat;
pub mod sweep;
mod walk_time;

pub use batch::{Again, BatchError, LOGS};
pub use outcome::{Outcome, Void};
pub use walk_time::walk_time;
