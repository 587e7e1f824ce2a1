//! ROS messages of a robot's sensors, as a TurtleBot 2 publishes them.

use cotorra_graph::{self as graph, Cell, SensorData, Timestamp};
use cotorra_plugin::convert::{to_header, to_pose_with_covariance, to_twist};
use cotorra_ros_messages::{
    Covariance, LaserScan, MapMetaData, OccupancyGrid, Odometry, Point, Pose, PoseWithCovarianceStamped,
    Quaternion, TFMessage, Transform, TransformStamped, TwistWithCovariance, Vector3,
};

use crate::{lidar::Scan, planar::Planar};

/// Frame of the map, in which poses are given.
pub const MAP_FRAME: &str = "map";
/// Frame of the odometry.
pub const ODOMETRY_FRAME: &str = "odom";
/// Frame of the robot's base.
pub const BASE_FRAME: &str = "base_footprint";
/// Frame of the lidar: at the base's axis, looking forward.
pub const LASER_FRAME: &str = "laser";

/// Returns a turn of the lidar as `sensor_msgs/LaserScan`.
pub fn laser_scan(scan: &Scan) -> LaserScan {
    LaserScan {
        header: to_header(scan.at, LASER_FRAME),
        angle_min: scan.angle(0) as f32,
        angle_max: scan.angle(scan.ranges.len().saturating_sub(1)) as f32,
        angle_increment: scan.angle_step as f32,
        time_increment: scan.ray_interval.as_secs_f32(),
        scan_time: scan.turn.as_secs_f32(),
        range_min: scan.range_min as f32,
        range_max: scan.range_max as f32,
        ranges: scan.ranges.clone(),
        intensities: Vec::new(),
    }
}

/// Returns the odometry as `nav_msgs/Odometry`. The covariance of its twist is 0, which means unknown in ROS.
pub fn odometry(at: Timestamp, sensors: &SensorData) -> Odometry {
    Odometry {
        header: to_header(at, ODOMETRY_FRAME),
        child_frame_id: BASE_FRAME.to_owned(),
        pose: to_pose_with_covariance(&sensors.odometry),
        twist: TwistWithCovariance { twist: to_twist(sensors.velocity), covariance: Covariance::default() },
    }
}

/// Returns the pose on the map as `geometry_msgs/PoseWithCovarianceStamped`, as localization publishes it.
pub fn localized(at: Timestamp, sensors: &SensorData) -> PoseWithCovarianceStamped {
    PoseWithCovarianceStamped {
        header: to_header(at, MAP_FRAME),
        pose: to_pose_with_covariance(&sensors.pose),
    }
}

/// Returns all frames as `tf2_msgs/TFMessage`: those of the map, the odometry, the base and the lidar.
pub fn frames(at: Timestamp, sensors: &SensorData) -> TFMessage {
    let frame = |parent: &str, child: &str, Planar { x, y, z, heading }, roll, pitch| TransformStamped {
        header: to_header(at, parent),
        child_frame_id: child.to_owned(),
        transform: Transform {
            translation: Vector3 { x, y, z },
            rotation: Quaternion::from_angles(roll, pitch, heading),
        },
    };
    let base = Planar::of(&sensors.odometry);
    let transforms = vec![
        frame(MAP_FRAME, ODOMETRY_FRAME, Planar::of(&sensors.pose).then(base.inverse()), 0.0, 0.0),
        frame(ODOMETRY_FRAME, BASE_FRAME, base, sensors.odometry.roll, sensors.odometry.pitch),
        frame(BASE_FRAME, LASER_FRAME, Planar { x: 0.0, y: 0.0, z: 0.0, heading: 0.0 }, 0.0, 0.0),
    ];
    TFMessage { transforms }
}

/// Returns the map as `nav_msgs/OccupancyGrid`.
pub fn map(map: &graph::OccupancyGrid) -> OccupancyGrid {
    let cell = |place: usize| match map.cell(place % map.width(), place / map.width()) {
        Cell::Free => 0,
        Cell::Occupied => 100,
        Cell::Unknown => -1,
    };
    let origin = Point { x: map.origin().x, y: map.origin().y, z: 0.0 };
    OccupancyGrid {
        header: to_header(Timestamp::ZERO, MAP_FRAME),
        info: MapMetaData {
            resolution: map.resolution() as f32,
            width: map.width() as u32,
            height: map.height() as u32,
            origin: Pose { position: origin, ..Pose::default() },
            ..MapMetaData::default()
        },
        data: (0..map.width() * map.height()).map(cell).collect(),
    }
}
