//! The wall clock of a run, which the fabric's thread and everyone who stamps packets must share.

#[allow(clippy::disallowed_types, reason = "this is the shell's clock, where real time comes from")]
use std::time::Instant;

use cotorra_graph::Timestamp;

/// Nanoseconds since a run began, by `CLOCK_MONOTONIC`. Copies keep the same beginning.
#[derive(Debug, Clone, Copy)]
#[allow(clippy::disallowed_types, reason = "this is the shell's clock, where real time comes from")]
pub struct Clock(Instant);

#[allow(clippy::disallowed_types, reason = "this is the shell's clock, where real time comes from")]
impl Clock {
    /// A clock that begins now.
    pub(crate) fn start() -> Self {
        Self(Instant::now())
    }

    /// The time now.
    pub fn now(self) -> Timestamp {
        Timestamp::ZERO + self.0.elapsed()
    }
}
