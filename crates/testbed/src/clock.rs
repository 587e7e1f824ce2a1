//! Clocks as values: whoever needs the time is given a [`Clock`].

use std::sync::Arc;

use cotorra_graph::Timestamp;

/// Returns the current time of a run, real or virtual.
pub(crate) use cotorra_robot_middleware::Clock;

/// Returns a monotonic clock that begins at zero now. It limits the calls of plug-ins while virtual time stands still.
#[allow(clippy::disallowed_types, reason = "plug-ins run in real time, and may hang there")]
pub(crate) fn wall_clock() -> Clock {
    let began = std::time::Instant::now();
    Arc::new(move || Timestamp::ZERO + began.elapsed())
}
