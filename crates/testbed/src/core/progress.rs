//! Notices that no robot makes progress on its walk, because a run that ends with its walks would then never end.
//!
//! A robot makes progress when it reaches a waypoint, the end of its walk, or a place where it has not been since its last
//! waypoint. A robot that finds its way around an obstacle does so, too; one that stands or goes to and fro does not.

use std::{
    collections::{BTreeMap, BTreeSet},
    time::Duration,
};

use cotorra_graph::{NodeId, Position, Timestamp};
use cotorra_robot_middleware::Walker;

/// Longest time without progress of any robot.
pub(crate) const PATIENCE: Duration = Duration::from_secs(60);
/// Longest time without progress while that may be intended: a robot is halted or at a goal, or VNFs start for the first time,
/// which can be a pull of their images.
const LONG_PATIENCE: Duration = Duration::from_secs(600);
/// Edge of distinct places, metres.
const PLACE: f64 = 0.5;
/// Most robots that a sentence describes.
const DESCRIBED: usize = 8;

/// The progress of all robots on their walks.
#[derive(Debug, Default)]
pub(crate) struct Progress {
    /// Time of the last progress.
    last: Timestamp,
    /// Robots that are not at the end of their walks.
    legs: BTreeMap<NodeId, Leg>,
    walkers: Vec<Walker>,
}

/// Places of a robot since its last waypoint.
#[derive(Debug, Default)]
struct Leg {
    waypoint: u32,
    places: BTreeSet<[i64; 3]>,
}

impl Progress {
    /// Notes where the robots are that are not at the end of their walks.
    pub(crate) fn note(&mut self, now: Timestamp, walkers: Vec<Walker>) {
        let mut progress = walkers.len() < self.walkers.len();
        for walker in &walkers {
            let leg = self.legs.entry(walker.robot.clone()).or_default();
            if walker.waypoint > leg.waypoint {
                *leg = Leg { waypoint: walker.waypoint, ..Leg::default() };
            }
            progress |= leg.places.insert(place(walker.position));
        }
        if progress {
            self.last = now;
        }
        self.walkers = walkers;
    }

    /// Starts the time without progress anew.
    pub(crate) fn excuse(&mut self, now: Timestamp) {
        self.last = now;
    }

    /// Whether no robot has made progress for too long. `starting` says that VNFs start for the first time.
    pub(crate) fn is_over(&self, now: Timestamp, starting: bool) -> bool {
        let long = now.since(self.last);
        let may_be_intended = || starting || self.walkers.iter().any(|walker| walker.is_held);
        long >= LONG_PATIENCE || (long >= PATIENCE && !may_be_intended())
    }

    /// Describes where the robots stand.
    pub(crate) fn describe(&self, waypoints: impl Fn(&NodeId) -> usize) -> String {
        let stand = |walker: &Walker| {
            let Walker { robot, waypoint, position, .. } = walker;
            let at = match &walker.radio_unit {
                Some(radio_unit) => format!("attached to {radio_unit}"),
                None => "attached to no radio unit".to_owned(),
            };
            let held = if walker.is_held { ", halted or at a goal" } else { "" };
            let of = waypoints(robot);
            format!("{robot} is at {position}, on its way to waypoint {} of {of}, {at}{held}", waypoint + 1)
        };
        let mut described: Vec<_> = self.walkers.iter().take(DESCRIBED).map(stand).collect();
        let more = self.walkers.len().saturating_sub(DESCRIBED);
        described.extend((more > 0).then(|| format!("and {more} more robots")));
        described.join("; ")
    }
}

/// Returns the number of the place in each dimension.
fn place(position: Position) -> [i64; 3] {
    [position.x, position.y, position.z].map(|metres| (metres / PLACE).floor() as i64)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(s: f64) -> Timestamp {
        Timestamp::from_secs_f64(s)
    }

    fn walker(x: f64, waypoint: u32) -> Walker {
        let position = Position { x, y: 0.0, z: 0.0 };
        Walker { robot: "r1".parse().unwrap(), waypoint, position, radio_unit: None, is_held: false }
    }

    /// Returns the second at which no robot has made progress for too long, of 2000.
    fn over(walker: impl Fn(f64) -> Vec<Walker>) -> Option<u32> {
        let mut progress = Progress::default();
        (0..2000).find(|s| {
            let now = at(f64::from(*s));
            progress.note(now, walker(f64::from(*s)));
            progress.is_over(now, false)
        })
    }

    #[test]
    fn a_robot_that_stands_or_goes_to_and_fro_makes_no_progress() {
        assert_eq!(over(|_| vec![walker(1.0, 1)]), Some(60));
        assert_eq!(over(|s| vec![walker(if s < 10.0 { s } else { 9.0 }, 1)]), Some(69));
        // The last new place is at 20 m, after 20 s.
        assert_eq!(over(|s| vec![walker((s % 40.0 - 20.0).abs(), 1)]), Some(80));
    }

    #[test]
    fn a_detour_a_slow_robot_a_waypoint_and_the_end_of_a_walk_are_progress() {
        assert_eq!(over(|s| vec![walker(-0.01 * s, 1)]), None);
        assert_eq!(over(|s| vec![walker(1.0, (s / 50.0) as u32)]), None);
        let other = |s: f64| (s < 59.0).then(|| Walker { robot: "r2".parse().unwrap(), ..walker(2.0, 1) });
        assert_eq!(over(|s| [walker(1.0, 1)].into_iter().chain(other(s)).collect()), Some(119));
    }

    #[test]
    fn what_may_be_intended_is_waited_for_longer() {
        assert_eq!(over(|_| vec![Walker { is_held: true, ..walker(1.0, 1) }]), Some(600));
        let progress = Progress::default();
        assert!(!progress.is_over(at(599.0), true) && progress.is_over(at(600.0), true));
    }

    #[test]
    fn the_robots_are_named_with_their_places() {
        let mut progress = Progress::default();
        progress.note(at(0.0), vec![walker(1.0, 1)]);
        let expected = "r1 is at (1.0, 0.0), on its way to waypoint 2 of 5, attached to no radio unit";
        assert_eq!(progress.describe(|_| 5), expected);
        progress.note(at(0.0), vec![walker(1.0, 1); 10]);
        assert!(progress.describe(|_| 5).ends_with("; and 2 more robots"));
    }
}
