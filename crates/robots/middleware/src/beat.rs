//! When what repeats on a robot is due.

use std::time::Duration;

use cotorra_graph::{Phase, RobotClock, Timestamp};
use cotorra_numbers::Draws;

/// Returns when something of this interval is due first, and how long it takes from one time to the next by its clock.
pub(crate) fn beat(clock: &RobotClock, interval: Duration, mut draws: Draws) -> (Timestamp, Duration) {
    let (phase, error) = (draws.unit(), 2.0 * draws.unit() - 1.0);
    let first = match clock.phase {
        Phase::Random => interval.mul_f64(phase),
        Phase::Aligned => Duration::ZERO,
    };
    (Timestamp::ZERO + first, interval.mul_f64(1.0 + clock.drift_ppm * 1e-6 * error))
}
