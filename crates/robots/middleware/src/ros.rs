//! What a robot senses, as the ROS messages that a TurtleBot 2 publishes.

use cotorra_graph::{self as graph, Cell, SensorData, Timestamp};
use cotorra_plugin::convert::{to_header, to_pose_with_covariance, to_twist};
use cotorra_ros_messages::{
    Covariance, LaserScan, MapMetaData, OccupancyGrid, Odometry, Point, Pose, PoseWithCovarianceStamped,
    Quaternion, TFMessage, Transform, TransformStamped, TwistWithCovariance, Vector3,
};

use crate::{lidar::Scan, planar::Planar};

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

/// `nav_msgs/Odometry` of what wheels and gyro say. The twist's covariance is left at zero, which in ROS means that
/// it is not known.
pub fn odometry(at: Timestamp, sensors: &SensorData) -> Odometry {
    Odometry {
        header: to_header(at, ODOMETRY_FRAME),
        child_frame_id: BASE_FRAME.to_owned(),
        pose: to_pose_with_covariance(&sensors.odometry),
        twist: TwistWithCovariance { twist: to_twist(sensors.velocity), covariance: Covariance::default() },
    }
}

/// `geometry_msgs/PoseWithCovarianceStamped` of where the robot is on the map, as localization says it.
pub fn localized(at: Timestamp, sensors: &SensorData) -> PoseWithCovarianceStamped {
    PoseWithCovarianceStamped {
        header: to_header(at, MAP_FRAME),
        pose: to_pose_with_covariance(&sensors.pose),
    }
}

/// `tf2_msgs/TFMessage` of all frames: the map's, odometry's, the base's and the lidar's.
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

/// `nav_msgs/OccupancyGrid` of the map.
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
