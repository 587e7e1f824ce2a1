//! The Bandwidth Management API of ETSI GS MEC 015 v2.2.1: allocations of bandwidth to MEC applications and to their sessions,
//! as reservations of mapped paths. docs/reference/bandwidth.md has the mapping.
//!
//! [`Bandwidth`] is a state machine without a clock or a socket: requests and a [`Survey`] go in, [`Change`]s come out. The caller
//! carries out the instructions of a change, and reports the result.
#![forbid(unsafe_code)]

mod bandwidth;
mod session;
pub mod types;

pub use bandwidth::{Bandwidth, BandwidthError, Change, Selection};
pub use session::Survey;
