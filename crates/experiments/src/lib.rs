//! Experiments made of many runs: sweeps over settings and seeds, margins of targets, and regrets of decisions.
//!
//! [`Sweep`](sweep::Sweep) runs a testbed file in virtual time for all combinations of settings. [`Margin`](margin::Margin)
//! searches for the smallest change that breaks a target, and [`Regret`](regret::Regret) replays decisions of plug-ins with
//! their alternatives. These three share how runs are made and kept ([`Journal`](journal::Journal)). [`repeat`] compares a
//! folder of results with that of a repeat. Comparisons with published figures are in `cotorra-comparisons`.
#![forbid(unsafe_code)]

mod batch;
mod cell;
pub mod journal;
mod kept;
mod key;
pub mod margin;
mod outcome;
pub mod regret;
pub mod repeat;
pub mod sweep;

pub use batch::{Again, BatchError, LOGS};
pub use outcome::Outcome;
