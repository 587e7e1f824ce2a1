//! The wall clock of a run, shared by the fabric's thread and all threads that stamp packets.

#[allow(clippy::disallowed_types, reason = "this is the shell's clock, where real time comes from")]
use std::time::Instant;

use cotorra_graph::Timestamp;

/// Nanoseconds since a run began, by `CLOCK_MONOTONIC`. Copies share their start.
#[derive(Debug, Clone, Copy)]
#[allow(clippy::disallowed_types, reason = "this is the shell's clock, where real time comes from")]
pub struct Clock(Instant);

#[allow(clippy::disallowed_types, reason = "this is the shell's clock, where real time comes from")]
impl Clock {
    /// Starts a clock at zero.
    pub fn start() -> Self {
        Self(Instant::now())
    }

    /// Returns the time since the start.
    pub fn now(self) -> Timestamp {
        Timestamp::ZERO + self.0.elapsed()
    }
}
