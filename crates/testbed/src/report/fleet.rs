//! The view of many robots: a distribution over all of them, and the worst by name.

use std::cmp::Reverse;

use cotorra_graph::Natural;

use super::summary::RobotSummary;

/// Maximum number of robots that are all shown by name.
pub const FEW_ROBOTS: usize = 8;
/// Number of robots, or of their services, that are shown by name where there are more.
pub const WORST_ROBOTS: usize = 5;

/// Returns the robots to show by name: all of a few, in their order, or else the worst, from the worst. The worst have the
/// largest share of samples above their target, then the most samples without an answer.
pub fn robots_by_name(robots: &[RobotSummary]) -> Vec<&RobotSummary> {
    let mut named: Vec<_> = robots.iter().collect();
    if named.len() > FEW_ROBOTS {
        named.sort_by_cached_key(|its| (Reverse(its.unanswered), Natural::of(its.robot.as_str())));
        // A robot without samples did not miss its target.
        let above = |its: &RobotSummary| its.above_target.unwrap_or(-1.0);
        named.sort_by(|a, b| above(b).total_cmp(&above(a)));
        named.truncate(WORST_ROBOTS);
    }
    named
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns robots with these shares above their target.
    fn robots(above: &[Option<f64>]) -> Vec<RobotSummary> {
        let robot = |(i, above_target): (usize, &Option<f64>)| RobotSummary {
            robot: format!("R{}", i + 1).parse().unwrap(),
            samples: 100,
            unanswered: 0,
            above_target: *above_target,
            verdict: None,
            handovers: 0,
            handover_gap_ms: None,
            detached_ms: 0.0,
        };
        above.iter().enumerate().map(robot).collect()
    }

    #[test]
    fn of_many_robots_the_worst_are_named() {
        let names = |robots: &[RobotSummary]| -> Vec<_> {
            robots_by_name(robots).iter().map(|its| its.robot.to_string()).collect()
        };
        let mut above = [Some(0.0); 12];
        (above[3], above[11], above[0]) = (Some(0.2), Some(0.5), None);
        assert_eq!(names(&robots(&above[..8])), ["R1", "R2", "R3", "R4", "R5", "R6", "R7", "R8"]);
        assert_eq!(names(&robots(&above)), ["R12", "R4", "R2", "R3", "R5"]);
        // Of equal ones, those with more samples without an answer are worse, and R2 is before R10.
        let mut equal = robots(&[Some(0.1); 12]);
        equal.reverse();
        equal[1].unanswered = 3;
        assert_eq!(names(&equal), ["R11", "R1", "R2", "R3", "R4"]);
    }
}
