//! Conversions between ROS messages and the hardware graph's times, poses and velocities.

use cotorra_graph::{Pose, PoseSource, Timestamp, Velocity};
use cotorra_ros_messages::{self as ros, Covariance, Header, PoseWithCovariance, Time, Twist, Vector3};

/// Converts a timestamp. Saturates after 68 years.
pub fn to_time(at: Timestamp) -> Time {
    Time::from_nanos(at.as_nanos())
}

/// Returns a header for a time and a coordinate frame.
pub fn to_header(at: Timestamp, frame_id: &str) -> Header {
    Header::new(to_time(at), frame_id)
}

/// Converts a velocity.
pub fn to_twist(velocity: Velocity) -> Twist {
    Twist {
        linear: Vector3 { x: velocity.linear, y: 0.0, z: velocity.vertical },
        angular: Vector3 { z: velocity.angular, ..Vector3::default() },
    }
}

/// Returns the forward, upward and angular (about z) parts of a twist. The others are dropped.
pub fn from_twist(twist: &Twist) -> Velocity {
    Velocity { linear: twist.linear.x, vertical: twist.linear.z, angular: twist.angular.z }
}

/// Converts a pose. Covariance and source are dropped.
pub fn to_pose(pose: &Pose) -> ros::Pose {
    ros::Pose {
        position: ros::Point { x: pose.x, y: pose.y, z: pose.z },
        orientation: ros::Quaternion::from_angles(pose.roll, pose.pitch, pose.heading),
    }
}

/// Converts a pose, exactly known. `source` is what ROS does not carry.
pub fn from_pose(pose: &ros::Pose, source: PoseSource) -> Pose {
    let ros::Point { x, y, z } = pose.position;
    let (roll, pitch) = pose.orientation.tilt();
    Pose { z, roll, pitch, ..Pose::planar(x, y, pose.orientation.heading(), [0.0; 9], source) }
}

/// Converts a pose with its covariance.
pub fn to_pose_with_covariance(pose: &Pose) -> PoseWithCovariance {
    PoseWithCovariance { pose: to_pose(pose), covariance: Covariance::from_planar(&pose.covariance) }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn planar_poses_survive_conversion(x in -1e6f64..1e6, y in -1e6f64..1e6, heading in -3.0f64..3.0) {
            let pose = Pose::planar(x, y, heading, [0.25; 9], PoseSource::Simulator);
            let converted = to_pose_with_covariance(&pose);
            let back = from_pose(&converted.pose, PoseSource::Simulator);
            prop_assert_eq!((back.x, back.y, converted.covariance.planar()), (x, y, pose.covariance));
            prop_assert!((back.heading - heading).abs() < 1e-12);
        }
    }
}
