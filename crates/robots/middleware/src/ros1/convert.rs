//! ROS 1's messages as the shared ones, which are ROS 2's, and the other way round: they differ in names, not in what
//! they say.

use cotorra_plugin::messages as shared;
use cotorra_ros1::{Time, messages as ros1};

pub(super) fn header(of: ros1::Header) -> shared::Header {
    // The year 2038 is the shared type's.
    let sec = i32::try_from(of.stamp.sec).unwrap_or(i32::MAX);
    shared::Header { stamp: shared::Time { sec, nanosec: of.stamp.nsec }, frame_id: of.frame_id }
}

pub(super) fn vector(of: ros1::Vector3) -> shared::Vector3 {
    shared::Vector3 { x: of.x, y: of.y, z: of.z }
}

pub(super) fn rotation(of: ros1::Quaternion) -> shared::Quaternion {
    shared::Quaternion { x: of.x, y: of.y, z: of.z, w: of.w }
}

pub(super) fn pose(of: ros1::PoseWithCovariance) -> shared::PoseWithCovariance {
    let ros1::Point { x, y, z } = of.pose.position;
    shared::PoseWithCovariance {
        pose: shared::Pose {
            position: shared::Point { x, y, z },
            orientation: rotation(of.pose.orientation),
        },
        covariance: shared::Covariance(of.covariance),
    }
}

pub(super) fn odometry(of: ros1::Odometry) -> shared::Odometry {
    let ros1::Twist { linear, angular } = of.twist.twist;
    shared::Odometry {
        header: header(of.header),
        child_frame_id: of.child_frame_id,
        pose: pose(of.pose),
        twist: shared::TwistWithCovariance {
            twist: shared::Twist { linear: vector(linear), angular: vector(angular) },
            covariance: shared::Covariance(of.twist.covariance),
        },
    }
}

pub(super) fn pose_stamped(of: ros1::PoseWithCovarianceStamped) -> shared::PoseWithCovarianceStamped {
    shared::PoseWithCovarianceStamped { header: header(of.header), pose: pose(of.pose) }
}

pub(super) fn frames(of: ros1::TFMessage) -> shared::TFMessage {
    let frame = |of: ros1::TransformStamped| shared::TransformStamped {
        header: header(of.header),
        child_frame_id: of.child_frame_id,
        transform: shared::Transform {
            translation: vector(of.transform.translation),
            rotation: rotation(of.transform.rotation),
        },
    };
    shared::TFMessage { transforms: of.transforms.into_iter().map(frame).collect() }
}

pub(super) fn laser_scan(of: ros1::LaserScan) -> shared::LaserScan {
    shared::LaserScan {
        header: header(of.header),
        angle_min: of.angle_min,
        angle_max: of.angle_max,
        angle_increment: of.angle_increment,
        time_increment: of.time_increment,
        scan_time: of.scan_time,
        range_min: of.range_min,
        range_max: of.range_max,
        ranges: of.ranges,
        intensities: of.intensities,
    }
}

/// What is read of it.
pub(super) fn battery(of: ros1::BatteryState) -> shared::BatteryState {
    shared::BatteryState { voltage: of.voltage, percentage: of.percentage, ..Default::default() }
}

pub(super) fn imu(of: ros1::Imu) -> shared::Imu {
    shared::Imu {
        header: header(of.header),
        orientation: rotation(of.orientation),
        orientation_covariance: of.orientation_covariance,
        angular_velocity: vector(of.angular_velocity),
        angular_velocity_covariance: of.angular_velocity_covariance,
        linear_acceleration: vector(of.linear_acceleration),
        linear_acceleration_covariance: of.linear_acceleration_covariance,
    }
}

pub(super) fn image(of: ros1::Image) -> shared::Image {
    shared::Image {
        header: header(of.header),
        height: of.height,
        width: of.width,
        encoding: of.encoding,
        is_bigendian: of.is_bigendian,
        step: of.step,
        data: shared::Bytes(of.data),
    }
}

/// ROS 1's messages of the shared ones.
pub(super) mod back {
    use super::{Time, ros1, shared};

    pub fn time(of: shared::Time) -> Time {
        Time { sec: of.sec.cast_unsigned(), nsec: of.nanosec }
    }

    fn header(of: shared::Header) -> ros1::Header {
        ros1::Header { seq: 0, stamp: time(of.stamp), frame_id: of.frame_id }
    }

    fn vector(of: &shared::Vector3) -> ros1::Vector3 {
        ros1::Vector3 { x: of.x, y: of.y, z: of.z }
    }

    fn rotation(of: &shared::Quaternion) -> ros1::Quaternion {
        ros1::Quaternion { x: of.x, y: of.y, z: of.z, w: of.w }
    }

    fn pose(of: shared::PoseWithCovariance) -> ros1::PoseWithCovariance {
        ros1::PoseWithCovariance { pose: bare_pose(&of.pose), covariance: of.covariance.0 }
    }

    fn bare_pose(of: &shared::Pose) -> ros1::Pose {
        let shared::Point { x, y, z } = of.position;
        ros1::Pose { position: ros1::Point { x, y, z }, orientation: rotation(&of.orientation) }
    }

    pub fn odometry(of: shared::Odometry) -> ros1::Odometry {
        let shared::Twist { linear, angular } = &of.twist.twist;
        ros1::Odometry {
            header: header(of.header),
            child_frame_id: of.child_frame_id,
            pose: pose(of.pose),
            twist: ros1::TwistWithCovariance {
                twist: ros1::Twist { linear: vector(linear), angular: vector(angular) },
                covariance: of.twist.covariance.0,
            },
        }
    }

    pub fn pose_stamped(of: shared::PoseWithCovarianceStamped) -> ros1::PoseWithCovarianceStamped {
        ros1::PoseWithCovarianceStamped { header: header(of.header), pose: pose(of.pose) }
    }

    pub fn frames(of: shared::TFMessage) -> ros1::TFMessage {
        let frame = |of: shared::TransformStamped| ros1::TransformStamped {
            transform: ros1::Transform {
                translation: vector(&of.transform.translation),
                rotation: rotation(&of.transform.rotation),
            },
            header: header(of.header),
            child_frame_id: of.child_frame_id,
        };
        ros1::TFMessage { transforms: of.transforms.into_iter().map(frame).collect() }
    }

    pub fn grid(of: shared::OccupancyGrid) -> ros1::OccupancyGrid {
        let info = ros1::MapMetaData {
            map_load_time: Time {
                sec: of.info.map_load_time.sec.cast_unsigned(),
                nsec: of.info.map_load_time.nanosec,
            },
            resolution: of.info.resolution,
            width: of.info.width,
            height: of.info.height,
            origin: bare_pose(&of.info.origin),
        };
        ros1::OccupancyGrid { header: header(of.header), info, data: of.data }
    }

    pub fn laser_scan(of: shared::LaserScan) -> ros1::LaserScan {
        ros1::LaserScan {
            header: header(of.header),
            angle_min: of.angle_min,
            angle_max: of.angle_max,
            angle_increment: of.angle_increment,
            time_increment: of.time_increment,
            scan_time: of.scan_time,
            range_min: of.range_min,
            range_max: of.range_max,
            ranges: of.ranges,
            intensities: of.intensities,
        }
    }
}

#[cfg(test)]
mod tests {
    use cotorra_graph::{Pose, PoseSource, SensorData, Timestamp, Velocity};

    use super::*;
    use crate::ros;

    #[test]
    fn there_and_back_is_the_same_message() {
        let at = Timestamp::from_nanos(1_700_000_000_250_000_000);
        let covariance = [0.04, 0.01, 0.02, 0.01, 0.03, 0.0, 0.02, 0.0, 0.05];
        let pose = Pose::planar(1.5, -2.0, 0.7, covariance, PoseSource::Simulator);
        let sensors = SensorData {
            pose,
            odometry: Pose { x: 1.4, source: PoseSource::Odometry, ..pose },
            velocity: Velocity::planar(0.25, -0.5),
            bumper: false,
            nearest_obstacle_m: None,
        };
        let message = ros::odometry(at, &sensors);
        assert_eq!(odometry(back::odometry(message.clone())), message);
        let message = ros::localized(at, &sensors);
        assert_eq!(pose_stamped(back::pose_stamped(message.clone())), message);
        let message = ros::frames(at, &sensors);
        assert_eq!(frames(back::frames(message.clone())), message);
    }
}
