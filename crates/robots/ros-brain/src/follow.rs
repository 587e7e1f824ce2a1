//! The loop of the brain, over the topics of either ROS.

use cotorra_brain::{Pilot, Step};
use cotorra_graph::PoseSource;
use cotorra_plugin::{
    convert::{from_pose, to_twist},
    vnf,
};
use cotorra_ros_messages::{Header, PoseWithCovarianceStamped, Twist};

/// Frame in which robots take velocities (REP 105).
const BASE_FRAME: &str = "base_link";
/// The topic of the next waypoint's index, `std_msgs/UInt32`, latched: an instance that starts goes on from there.
pub(crate) const NEXT_WAYPOINT: &str = "next_waypoint";

/// The brain's topics, in the namespace of its robot.
pub(crate) trait Topics {
    /// Waits for the robot's newest pose. Returns `None` when the node was shut down.
    fn pose(&self) -> Option<PoseWithCovarianceStamped>;

    /// Returns the next waypoint that an instance reported, oldest first; `None` if none did since.
    fn reported(&self) -> Option<u32>;

    /// Commands the robot.
    fn command(&self, header: Header, twist: Twist);

    /// Reports the next waypoint.
    fn report(&self, waypoint: u32);
}

/// Answers each pose with a command, until the node is shut down. The command's stamp is the pose's, so that a robot can see
/// how old its reason is.
pub(crate) fn follow(pilot: &mut Pilot, topics: &impl Topics) {
    let (mut reported, mut blocked) = (None, None);
    while let Some(pose) = topics.pose() {
        while let Some(waypoint) = topics.reported() {
            pilot.advance_to(waypoint);
        }
        let step = pilot.step(&from_pose(&pose.pose.pose, PoseSource::Localization));
        let header = Header { frame_id: BASE_FRAME.to_owned(), ..pose.header };
        topics.command(header, to_twist(step.velocity));
        if reported != Some(step.waypoint) {
            reported = Some(step.waypoint);
            topics.report(step.waypoint);
        }
        log_change(&mut blocked, step);
    }
}

/// Logs when the robot begins to stand still in the middle of its walk, and when the way is open again.
fn log_change(blocked: &mut Option<String>, step: Step) {
    let now = step.blocked.map(|reason| reason.to_string());
    if *blocked != now {
        vnf::log(format_args!("{}", now.as_deref().unwrap_or("the way is open again")));
        *blocked = now;
    }
}

#[cfg(test)]
mod tests {
    use std::cell::RefCell;

    use cotorra_graph::{Pose, Position, Timestamp};
    use cotorra_plugin::convert::{to_header, to_pose_with_covariance};
    use cotorra_testing::robot::{robot, testbed};

    use super::*;

    /// Topics in memory, with poses and reports to take, the last ones first.
    #[derive(Default)]
    struct Memory {
        poses: RefCell<Vec<PoseWithCovarianceStamped>>,
        heard: RefCell<Vec<u32>>,
        commands: RefCell<Vec<(Header, Twist)>>,
        reports: RefCell<Vec<u32>>,
    }

    impl Topics for Memory {
        fn pose(&self) -> Option<PoseWithCovarianceStamped> {
            self.poses.borrow_mut().pop()
        }

        fn reported(&self) -> Option<u32> {
            self.heard.borrow_mut().pop()
        }

        fn command(&self, header: Header, twist: Twist) {
            self.commands.borrow_mut().push((header, twist));
        }

        fn report(&self, waypoint: u32) {
            self.reports.borrow_mut().push(waypoint);
        }
    }

    fn at(second: u64, x: f64) -> PoseWithCovarianceStamped {
        let pose = Pose::planar(x, 0.0, 0.0, [0.0; 9], PoseSource::Localization);
        let header = to_header(Timestamp::from_nanos(second * 1_000_000_000), "map");
        PoseWithCovarianceStamped { header, pose: to_pose_with_covariance(&pose) }
    }

    /// A walk along x, from 0 m by 4 m to 8 m and back to 4 m.
    fn pilot() -> Pilot {
        let waypoints = [0.0, 4.0, 8.0, 4.0].map(|x| Position::new(x, 0.0)).to_vec();
        Pilot::new(&testbed(None, waypoints), &robot()).unwrap()
    }

    #[test]
    fn each_pose_is_answered_once_with_its_own_stamp() {
        let topics = Memory { poses: vec![at(3, 3.9), at(2, 2.0), at(1, 0.0)].into(), ..Memory::default() };
        follow(&mut pilot(), &topics);
        let commands = topics.commands.into_inner();
        let stamps: Vec<_> = commands.iter().map(|(header, _)| header.stamp.sec).collect();
        assert_eq!(stamps, [1, 2, 3]);
        assert!(commands.iter().all(|(header, _)| header.frame_id == BASE_FRAME));
        assert!(commands[1].1.linear.x > 0.0, "{commands:?}");
        assert_eq!(topics.reports.into_inner(), [1, 2], "changes alone are reported");
    }

    #[test]
    fn an_instance_goes_on_where_another_one_is() {
        let topics = Memory { poses: vec![at(1, 6.0)].into(), heard: vec![3].into(), ..Memory::default() };
        follow(&mut pilot(), &topics);
        let twist = topics.commands.into_inner()[0].1;
        assert!(twist.linear.x == 0.0 && twist.angular.z.abs() > 0.5, "it turns back: {twist:?}");
        assert_eq!(topics.reports.into_inner(), [3]);
    }
}
