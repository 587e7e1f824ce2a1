//! The Bandwidth Management API of ETSI GS MEC 015 v2.2.1: allocations of bandwidth to MEC applications and to their sessions,
//! as reservations of mapped paths. docs/reference/bandwidth.md has the mapping.
//!
//! [`Bandwidth`] is a state machine without a clock or a socket: requests of a [`Consumer`] and a [`Survey`] go in, [`Change`]s
//! come out. The caller carries out the instructions of a change, and reports the result.
#![forbid(unsafe_code)]

mod allocation;
mod bandwidth;
mod change;
mod consumer;
#[cfg(test)]
mod document;
mod error;
mod selection;
mod session;
pub mod types;

pub use bandwidth::Bandwidth;
pub use change::Change;
pub use consumer::Consumer;
pub use error::BandwidthError;
pub use selection::Selection;
pub use session::{Mapped, Seen, Survey};

/// Returns the OpenAPI document of the service, which is checked in. A test derives it from the types, and compares.
pub fn openapi() -> String {
    include_str!("../../../../docs/bwm.openapi.json").to_owned()
}
