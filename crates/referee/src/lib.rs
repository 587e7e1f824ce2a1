//! A second opinion on a testbed's figures: the same radio units, robots, walks, wires and packets in ns-3, an independent
//! simulator, and how far the two are apart.
//!
//! 1. [`plain()`] takes out of a testbed what ns-3 has no part for, and lists it. Both sides then run the same.
//! 2. [`ours()`] runs it in virtual time. What its robots sent, when and where, becomes a [`Scenario`].
//! 3. [`Ns3`] compiles the program `ns3/scenario.cc` against the wheel of ns-3, and runs the scenario in it.
//! 4. [`compare()`] puts the samples of both beside each other, and judges them by [`Bound`].
#![forbid(unsafe_code)]

mod compare;
mod ns3;
mod ours;
mod plain;
mod scenario;

pub use compare::{Bound, Compared, Figure, Row, Verdict, compare};
pub use ns3::{Ns3, Ns3Error, WHEEL};
pub use ours::{Ours, ours};
pub use plain::{Plain, plain};
pub use scenario::Scenario;

use std::collections::BTreeMap;

use cotorra_numbers::Quantiles;

/// What was measured of one service or camera of one run.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Measured {
    /// Times from each request to its answer, ms, by the number of the request. Empty for a camera.
    pub took_ms: BTreeMap<u32, f64>,
    /// Requests or images that were sent.
    pub sent: u32,
}

/// What was measured of a source of traffic.
#[derive(Debug, Clone, PartialEq)]
pub struct Carried {
    /// Payload that arrived while the source sent, Mbit/s.
    pub mbps: f64,
    /// Of datagrams: those that did not arrive, %.
    pub lost: Option<f64>,
    /// Of datagrams that arrived: the times from host to host, ms.
    pub delay_ms: Option<Quantiles>,
}

/// The measurements of one run: by the name of the sender, and the Mbit/s that came from each robot at its radio units.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Run {
    /// By service and by camera.
    pub senders: BTreeMap<String, Measured>,
    /// Mbit/s of Ethernet frames by robot.
    pub mbps: BTreeMap<String, f64>,
    /// By source of traffic.
    pub traffic: BTreeMap<String, Carried>,
}
