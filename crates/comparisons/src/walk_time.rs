//! Times of walks.

use std::time::Duration;

use cotorra_graph::Walk;

/// Returns the time that a walk takes at its speed limit, at most a day.
pub fn walk_time(walk: &Walk) -> Duration {
    const DAY_S: f64 = 86_400.0;
    let length: f64 = walk.waypoints.windows(2).map(|leg| leg[0].distance(leg[1])).sum();
    Duration::from_secs_f64((length / walk.speed_limit).min(DAY_S))
}
