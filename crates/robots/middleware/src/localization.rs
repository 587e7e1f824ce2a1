//! Both ends of the localization service. The robot sends scans, and moves its last answer on by odometry. The VNF answers
//! each scan with a pose. Their packets are in `cotorra_plugin::wire`.

mod endpoint;
#[cfg(test)]
mod tests;
mod vnf;

use cotorra_graph::{Pose, PoseSource, RobotModel};
use cotorra_localization::{Belief, Parameters, Pose2};

pub(crate) use endpoint::LocalizationEndpoint;
pub use vnf::{LocalizationVnf, NotLocalized, PacketError};

/// Returns the filter's parameters for a robot model. Both ends use them: for the motion noise, and for when a scan is
/// wanted.
fn parameters(model: RobotModel) -> Parameters {
    match model {
        // Both have the same lidar, and the errors of wheels that the filter allows for are larger than those in the air.
        RobotModel::Turtlebot2 | RobotModel::Quadrotor => Parameters::turtlebot2(),
    }
}

pub(crate) fn planar(pose: &Pose) -> Pose2 {
    Pose2::new(pose.x, pose.y, pose.heading)
}

pub(crate) fn believed(pose: &Pose) -> Belief {
    Belief { pose: planar(pose), covariance: pose.covariance }
}

fn to_pose(Belief { pose, covariance }: &Belief) -> Pose {
    Pose::planar(pose.x, pose.y, pose.heading, *covariance, PoseSource::Localization)
}
