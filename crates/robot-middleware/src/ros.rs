//! What a robot senses, as the ROS messages that a TurtleBot 2 publishes.

use std::f64::consts::PI;

use cotorra_graph::{SensorData, Timestamp};
use cotorra_plugin::messages::{Covariance, Header, LaserScan, Odometry, TwistWithCovariance};

use crate::lidar::{RANGE_MAX, RANGE_MIN, RAYS, Scan};

/// The frame of the map, in which poses are.
pub const MAP_FRAME: &str = "map";
/// The frame in which odometry began.
pub const ODOMETRY_FRAME: &str = "odom";
/// The frame of the robot's base.
pub const BASE_FRAME: &str = "base_footprint";
/// The frame of the lidar: at the base's axis, looking forward.
pub const LASER_FRAME: &str = "laser";

/// `sensor_msgs/LaserScan` of a turn of the lidar.
pub fn laser_scan(scan: &Scan) -> LaserScan {
    const INCREMENT: f64 = 2.0 * PI / RAYS as f64;
    const SCAN_TIME: f64 = 0.1;
    LaserScan {
        header: Header::new(scan.at, LASER_FRAME),
        angle_min: Scan::angle(0) as f32,
        angle_max: Scan::angle(RAYS - 1) as f32,
        angle_increment: INCREMENT as f32,
        time_increment: (SCAN_TIME / RAYS as f64) as f32,
        scan_time: SCAN_TIME as f32,
        range_min: RANGE_MIN as f32,
        range_max: RANGE_MAX as f32,
        ranges: scan.ranges.clone(),
        intensities: Vec::new(),
    }
}

/// `nav_msgs/Odometry` of what wheels and gyro say. The twist's covariance is left at zero, which in ROS means that
/// it is not known.
pub fn odometry(at: Timestamp, sensors: &SensorData) -> Odometry {
    Odometry {
        header: Header::new(at, ODOMETRY_FRAME),
        child_frame_id: BASE_FRAME.to_owned(),
        pose: (&sensors.odometry).into(),
        twist: TwistWithCovariance { twist: sensors.velocity.into(), covariance: Covariance::default() },
    }
}
