//! Poses of the graph as beliefs of the filter, and back. Both ends of the localization service use them.

use cotorra_graph::{Pose, PoseSource, RobotModel};

use crate::{belief::Belief, geometry::Pose2, parameters::Parameters};

/// Returns the filter's parameters for a robot model. Both ends use them: for the motion noise, and for when a scan is
/// wanted.
pub fn parameters(model: RobotModel) -> Parameters {
    match model {
        // Both have the same lidar, and the errors of wheels that the filter allows for are larger than those in the air.
        RobotModel::Turtlebot2 | RobotModel::Quadrotor => Parameters::turtlebot2(),
    }
}

/// Returns a pose on the floor.
pub fn planar(pose: &Pose) -> Pose2 {
    Pose2::new(pose.x, pose.y, pose.heading)
}

/// Converts a pose to a belief of the filter.
pub fn believed(pose: &Pose) -> Belief {
    Belief { pose: planar(pose), covariance: pose.covariance }
}

/// Converts a belief of the filter to a pose.
pub fn to_pose(Belief { pose, covariance }: &Belief) -> Pose {
    Pose::planar(pose.x, pose.y, pose.heading, *covariance, PoseSource::Localization)
}
