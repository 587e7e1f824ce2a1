//! Comparisons of runs: with published figures, and of kinds of radio.
//!
//! [`okpi::Comparison`] and [`federation::Comparison`] set runs beside the figures of the COTORRA letter, and
//! [`handover::Comparison`] sets the model of the radio beside real Wi-Fi software and real radios. They only read reports and
//! histories: the caller runs the testbeds, in real or in virtual time.
#![forbid(unsafe_code)]

pub mod federation;
pub mod handover;
pub mod okpi;
mod walk_time;

pub use walk_time::walk_time;
