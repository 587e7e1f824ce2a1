//! Both ends of the localization service: the robot's, which sends scans and lives between two answers by its odometry,
//! and the VNF's, which answers each scan with a pose. What travels between them is in `cotorra_plugin::wire`.

mod endpoint;
#[cfg(test)]
mod tests;
mod vnf;

use cotorra_graph::{Pose, PoseSource, RobotModel};
use cotorra_localization::{Belief, Parameters, Pose2};

pub(crate) use endpoint::LocalizationEndpoint;
pub use vnf::{LocalizationVnf, NotLocalized, PacketError};

/// The filter for a kind of robot: both ends go by its motion noise and by when it wants a scan.
fn parameters(model: RobotModel) -> Parameters {
    match model {
        // Both have the same lidar; the filter allows for more error of wheels than there is in the air.
        RobotModel::Turtlebot2 | RobotModel::Quadrotor => Parameters::turtlebot2(),
    }
}

pub(crate) fn planar(pose: &Pose) -> Pose2 {
    Pose2::new(pose.x, pose.y, pose.heading)
}

pub(crate) fn believed(pose: &Pose) -> Belief {
    Belief { pose: planar(pose), covariance: pose.covariance }
}

fn told(Belief { pose, covariance }: &Belief) -> Pose {
    Pose::planar(pose.x, pose.y, pose.heading, *covariance, PoseSource::Localization)
}
