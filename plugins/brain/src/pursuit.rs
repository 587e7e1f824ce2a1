//! Follows a path: from where the robot is on it to the velocity that keeps it there.
//!
//! Regulated pure pursuit (Macenski, Singh, Martín, Ginés, "Regulated pure pursuit for robot path tracking",
//! Autonomous Robots 47, 2023): pure pursuit, slowed in tight curves, near obstacles and before the goal, with a
//! turn on the spot when the path leads elsewhere than the robot looks. It depends on nothing but its arguments.

use std::f64::consts::FRAC_PI_4;

use cotorra_graph::{Pose, Position, Velocity, wrapped_angle};

use crate::{
    costmap::Costmap,
    path::{Path, Projection},
};

/// Lookahead on the path, seconds; metres follow from the speed limit.
const LOOKAHEAD_TIME: f64 = 1.5;
/// Bounds of the lookahead distance, metres.
const LOOKAHEAD: (f64, f64) = (0.3, 0.9);
/// Curves of a smaller radius are driven more slowly, in proportion; metres.
const REGULATED_RADIUS: f64 = 0.9;
/// Obstacles nearer than this to the robot's centre slow it, in proportion; metres.
const REGULATED_CLEARANCE: f64 = 0.6;
/// Share of the speed limit that curves and obstacles leave it at least.
const REGULATED_FLOOR: f64 = 0.25;
/// The last stretch before a goal, on which the speed falls in proportion to what is left; metres.
const APPROACH: f64 = 1.1;
/// Speed that an approach does not fall below, m/s.
const APPROACH_FLOOR: f64 = 0.05;
/// Angle to the path above which the robot turns on the spot, radians.
const TURN_THRESHOLD: f64 = FRAC_PI_4;
/// Rate of a turn on the spot per radian that is left, 1/s: an answer may be 0.5 s old without overshoot.
const TURN_GAIN: f64 = 1.0;
/// Highest rate of a climb per metre to the height of the place to steer for, 1/s: an answer may be 0.2 s old without
/// overshoot.
const CLIMB_GAIN: f64 = 2.0;
/// A rise of more metres for each metre ahead is flown straight up or down.
const STEEP: f64 = 2.0;
/// Fastest turn, rad/s; the Kobuki base is good for 1.9.
pub const TURN_LIMIT: f64 = 1.0;

/// The velocity that follows `path` from `pose`, which projects to `on` and does not exceed `speed_limit` (m/s).
pub fn follow(
    map: Option<&Costmap>,
    path: &Path,
    on: &Projection,
    pose: &Pose,
    speed_limit: f64,
) -> Velocity {
    let carrot = carrot(map, path, on, pose.position(), speed_limit);
    let (distance, rise) = ((carrot.x - pose.x).hypot(carrot.y - pose.y), carrot.z - pose.z);
    // On a steady slope, as fast as the slope needs; straight up, at the limit.
    let gain = (speed_limit / lookahead(speed_limit)).min(CLIMB_GAIN);
    let vertical = (rise * gain).clamp(-speed_limit, speed_limit);
    // A steep rise does not turn towards what is above it.
    if distance == 0.0 || rise.abs() > STEEP * distance {
        return Velocity { vertical, ..Velocity::default() };
    }
    let bearing = wrapped_angle((carrot.y - pose.y).atan2(carrot.x - pose.x) - pose.heading);
    if bearing.abs() > TURN_THRESHOLD {
        let angular = (TURN_GAIN * bearing).clamp(-TURN_LIMIT, TURN_LIMIT);
        return Velocity { vertical, ..Velocity::planar(0.0, angular) };
    }
    // The arc through the carrot that begins along the robot's heading.
    let curvature = 2.0 * bearing.sin() / distance;
    let for_curvature = 1.0 / (curvature.abs() * REGULATED_RADIUS).max(1.0);
    let clearance = map.map_or(f64::INFINITY, |map| map.clearance_at(pose.position()));
    let for_obstacles = (clearance / REGULATED_CLEARANCE).min(1.0);
    let regulated = speed_limit * for_curvature.min(for_obstacles).max(REGULATED_FLOOR);
    let approach = speed_limit * (path.remaining(on) + on.distance) / APPROACH;
    let speed = regulated.min(approach.max(APPROACH_FLOOR)).min(speed_limit);
    // Rather slower than off the arc.
    let linear = if curvature == 0.0 { speed } else { speed.min(TURN_LIMIT / curvature.abs()) };
    Velocity { linear, vertical, angular: linear * curvature }
}

/// Returns the lookahead for a speed limit in m/s, metres.
fn lookahead(speed_limit: f64) -> f64 {
    (speed_limit * LOOKAHEAD_TIME).clamp(LOOKAHEAD.0, LOOKAHEAD.1)
}

/// The place on the path to steer for: the lookahead distance ahead, or less where a wall hides it.
fn carrot(map: Option<&Costmap>, path: &Path, on: &Projection, here: Position, speed_limit: f64) -> Position {
    let furthest = lookahead(speed_limit);
    let hidden = |place: &Position| map.is_some_and(|map| !map.sees(here, *place));
    let shares = [1.0, 0.75, 0.5, 0.25];
    let ahead = shares.map(|share| path.ahead(on, share * furthest));
    ahead.into_iter().find(|place| !hidden(place)).unwrap_or(ahead[3])
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use cotorra_graph::PoseSource;
    use proptest::prelude::*;

    use super::*;
    use crate::testing::grid;

    fn pose(x: f64, y: f64, heading: f64) -> Pose {
        Pose::planar(x, y, heading, [0.0; 9], PoseSource::Simulator)
    }

    fn on_straight(x: f64, y: f64, heading: f64) -> Velocity {
        let path = Path::straight(Position::new(0.0, 0.0), Position::new(10.0, 0.0));
        let pose = pose(x, y, heading);
        follow(None, &path, &path.project(pose.position()), &pose, 0.3)
    }

    #[test]
    fn on_its_path_it_drives_on_at_the_limit() {
        assert_eq!(on_straight(2.0, 0.0, 0.0), Velocity::planar(0.3, 0.0));
    }

    #[test]
    fn beside_its_path_it_steers_back() {
        let right = on_straight(2.0, -0.1, 0.0);
        let left = on_straight(2.0, 0.1, 0.0);
        assert!(right.angular > 0.0 && left.angular < 0.0);
        assert!((right.linear - left.linear).abs() < 1e-12);
    }

    #[test]
    fn tight_curves_slow_it() {
        let gentle = on_straight(2.0, 0.02, 0.0);
        let tight = on_straight(2.0, 0.2, 0.3);
        assert_eq!(gentle.linear, 0.3);
        assert!((0.3 * REGULATED_FLOOR..0.3).contains(&tight.linear));
    }

    #[test]
    fn a_path_to_the_side_is_turned_to_on_the_spot() {
        for (heading, angular) in [(1.2, -1.0), (-0.9, 0.9), (3.0, -1.0), (-3.0 - TAU, 1.0)] {
            let velocity = on_straight(2.0, 0.0, heading);
            assert_eq!(velocity.linear, 0.0);
            assert!((velocity.angular - angular).abs() < 1e-9, "{heading}: {velocity:?}");
        }
    }

    #[test]
    fn the_end_slows_it() {
        let speeds = [8.0, 9.2, 9.5, 9.8, 9.99].map(|x| on_straight(x, 0.0, 0.0).linear);
        assert_eq!(speeds[0], 0.3);
        assert!(speeds.is_sorted_by(|a, b| a > b));
        assert_eq!(speeds[4], APPROACH_FLOOR);
        assert_eq!(on_straight(10.0, 0.0, 0.0), Velocity::default());
    }

    #[test]
    fn walls_beside_the_path_slow_it() {
        let narrow = Costmap::new(&grid(&["##########", "..........", "##########"], 0.8), 0.177);
        let path = Path::straight(Position::new(0.1, 1.2), Position::new(7.9, 1.2));
        let pose = pose(2.0, 1.2, 0.0);
        let velocity = follow(Some(&narrow), &path, &path.project(pose.position()), &pose, 0.3);
        assert!((velocity.linear - 0.3 * 0.4 / REGULATED_CLEARANCE).abs() < 1e-6, "{velocity:?}");
    }

    #[test]
    fn a_slope_is_climbed_as_fast_as_it_rises_and_a_shaft_at_the_limit() {
        let (low, high) = (Position::new(0.0, 0.0), Position::new(10.0, 0.0).at_height(2.0));
        let path = Path::straight(low, high);
        let pose = Pose { z: 1.0, ..pose(5.0, 0.0, 0.0) };
        let velocity = follow(None, &path, &path.project(pose.position()), &pose, 0.3);
        assert!((velocity.vertical / velocity.linear - 0.2).abs() < 0.01, "{velocity:?}");
        let shaft = Path::straight(high.on_floor(), high);
        let below = Pose { x: 10.0, z: 0.5, ..pose };
        let velocity = follow(None, &shaft, &shaft.project(below.position()), &below, 0.3);
        assert_eq!(velocity, Velocity { vertical: 0.3, ..Velocity::default() });
    }

    proptest! {
        #[test]
        fn limits_hold(
            x in -20.0f64..20.0, y in -20.0f64..20.0, heading in -100.0f64..100.0, limit in 0.01f64..2.0,
            to in (-5.0f64..5.0, -5.0f64..5.0),
        ) {
            let path = Path::new(&[Position::new(0.0, 0.0), Position::new(3.0, 1.0), Position::new(to.0, to.1)], 0.1);
            let pose = pose(x, y, heading);
            let velocity = follow(None, &path, &path.project(pose.position()), &pose, limit);
            prop_assert!((0.0..=limit).contains(&velocity.linear), "{velocity:?}");
            prop_assert!(velocity.angular.abs() <= TURN_LIMIT + 1e-9, "{velocity:?}");
        }
    }
}
