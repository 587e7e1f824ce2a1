//! Follows a robot's walk by its poses alone, for robots that do not say which waypoint is next.

use cotorra_graph::{NodeId, Pose, Testbed, Timestamp};
use cotorra_plugin::{Actions, Plugin};

use crate::{
    Brain,
    navigation::{Navigation, Step},
    serve::NoWalk,
};

/// The brain of one robot, which keeps the next waypoint itself.
///
/// A pilot that starts in the middle of a walk begins with the first leg that passes near the robot. [`Self::advance_to`] says
/// how far another instance has come.
#[derive(Debug, Clone)]
pub struct Pilot {
    navigation: Navigation,
    /// The next waypoint; `None` before the first pose.
    waypoint: Option<u32>,
    /// A waypoint that others know to be next, or an earlier one.
    known: u32,
}

impl Pilot {
    /// Plans the robot's walk.
    ///
    /// # Errors
    /// [`NoWalk`] if it has none.
    pub fn new(testbed: &Testbed, robot: &NodeId) -> Result<Self, NoWalk> {
        let mut brain = Brain::for_robot(robot.clone());
        brain.start(Timestamp::ZERO, testbed, &mut Actions::default());
        let navigation = brain.into_navigation(robot);
        let navigation = navigation.ok_or_else(|| NoWalk::new(robot, testbed))?;
        Ok(Self { navigation, waypoint: None, known: 0 })
    }

    /// Goes on from a waypoint that another instance reports as next, unless this one is farther. Ignores waypoints that
    /// the walk does not have.
    pub fn advance_to(&mut self, waypoint: u32) {
        if self.navigation.has_waypoint(waypoint) {
            self.known = self.known.max(waypoint);
        }
    }

    /// Returns the motion from `pose`: the velocity is zero at the end of the walk and where no way leads on.
    pub fn step(&mut self, pose: &Pose) -> Step {
        let next = match self.waypoint {
            Some(waypoint) => waypoint,
            None if pose.is_finite() => self.navigation.resume(pose.position()),
            None => 0,
        };
        let step = self.navigation.step(pose, next.max(self.known));
        if pose.is_finite() {
            self.waypoint = Some(step.waypoint);
        }
        step
    }
}

#[cfg(test)]
mod tests {
    use cotorra_graph::{PoseSource, Position, Velocity};

    use super::*;
    use crate::{
        planner::Unreachable,
        testing::{robot, testbed},
    };

    /// From x = 1 m to x = 9 m and back, at y = 2 m.
    fn pilot() -> Pilot {
        let waypoints = [1.0, 5.0, 9.0, 5.0, 1.0].map(|x| Position::new(x, 2.0)).to_vec();
        Pilot::new(&testbed(&["..........", "..........", ".........."], 1.0, waypoints), &robot()).unwrap()
    }

    fn at(x: f64, heading: f64) -> Pose {
        Pose::planar(x, 2.0, heading, [0.0; 9], PoseSource::Localization)
    }

    #[test]
    fn the_next_waypoint_follows_from_the_poses() {
        let mut pilot = pilot();
        let next = [1.0, 4.9, 8.9, 5.0].map(|x| pilot.step(&at(x, 0.0)).waypoint);
        assert_eq!(next, [1, 2, 3, 4]);
        let end = pilot.step(&at(1.1, 0.0));
        assert_eq!(end, Step { velocity: Velocity::default(), waypoint: 5, blocked: None });
        assert_eq!(pilot.step(&at(5.0, 0.0)).waypoint, 5, "the walk stays at its end");
    }

    #[test]
    fn a_pilot_that_starts_in_the_middle_goes_on_from_there() {
        let step = pilot().step(&at(6.0, 0.0));
        assert_eq!((step.waypoint, step.velocity), (2, Velocity::planar(0.3, 0.0)));
    }

    #[test]
    fn what_another_instance_knows_wins_over_the_place() {
        let mut other = pilot();
        other.advance_to(4);
        assert_eq!(other.step(&at(6.0, 0.0)).waypoint, 4, "on the way back");
        other.advance_to(2);
        assert_eq!(other.step(&at(6.0, 0.0)).waypoint, 4, "never backwards");
        other.advance_to(77);
        assert_eq!(other.step(&at(6.0, 0.0)).waypoint, 4, "the walk has no such waypoint");
    }

    #[test]
    fn poses_that_are_no_numbers_stop_the_robot_and_change_nothing() {
        let mut pilot = pilot();
        let step = pilot.step(&at(f64::NAN, 0.0));
        assert_eq!((step.velocity, step.blocked), (Velocity::default(), Some(Unreachable::NoPose)));
        assert_eq!(pilot.step(&at(6.0, 0.0)).waypoint, 2);
    }

    #[test]
    fn a_robot_without_a_walk_is_an_error() {
        let mut testbed = testbed(&["..."], 1.0, Vec::new());
        testbed.walks.clear();
        let error = Pilot::new(&testbed, &robot()).unwrap_err();
        assert_eq!(error.to_string(), "robot `robot` has no walk in testbed `drawn`");
    }
}
