//! What robots say, and what they are told: `sensor_msgs`, `nav_msgs`, `tf2_msgs` and `rosgraph_msgs`.

use super::{Header, Pose, PoseWithCovariance, Time, TransformStamped, TwistWithCovariance, message};

message! {
    /// Where the wheels say that a robot is, and how it moves.
    #[derive(Default)]
    pub struct Odometry = "nav_msgs/msg/Odometry" {
        /// When; the frame of the pose.
        header: Header,
        /// The frame of the twist.
        child_frame_id: String,
        /// From the start.
        pose: PoseWithCovariance,
        /// In the child frame.
        twist: TwistWithCovariance,
    }
}

message! {
    /// One turn of a planar lidar.
    #[derive(Default)]
    pub struct LaserScan = "sensor_msgs/msg/LaserScan" {
        /// When the first ray was cast; the frame in which angle 0 points along x.
        header: Header,
        /// Of the first ray, rad.
        angle_min: f32,
        /// Of the last ray, rad.
        angle_max: f32,
        /// Between two rays, rad.
        angle_increment: f32,
        /// Between two rays, s.
        time_increment: f32,
        /// Between two scans, s.
        scan_time: f32,
        /// Ranges below are to be dropped, m.
        range_min: f32,
        /// Ranges above are to be dropped, m; +∞ says that nothing was hit (REP 117).
        range_max: f32,
        /// m.
        ranges: Vec<f32>,
        /// The device's own unit; empty if it has none.
        intensities: Vec<f32>,
    }
}

message! {
    /// Where frames are in each other; sent to `/tf`, and to `/tf_static` if they never move.
    #[derive(Default)]
    pub struct TFMessage = "tf2_msgs/msg/TFMessage" {
        /// Each where it is.
        transforms: Vec<TransformStamped>,
    }
}

message! {
    /// What a grid's cells are.
    #[derive(Default)]
    pub struct MapMetaData = "nav_msgs/msg/MapMetaData" {
        /// When the map was loaded.
        map_load_time: Time,
        /// Side of a cell, metres.
        resolution: f32,
        /// Cells along x.
        width: u32,
        /// Cells along y.
        height: u32,
        /// Of the corner of cell (0, 0).
        origin: Pose,
    }
}

message! {
    /// A map of where something stands.
    #[derive(Default)]
    pub struct OccupancyGrid = "nav_msgs/msg/OccupancyGrid" {
        /// When and in which frame.
        header: Header,
        /// Of the grid.
        info: MapMetaData,
        /// Row by row from (0, 0) on, in 0..=100; -1 where it is not known.
        data: Vec<i8>,
    }
}

message! {
    /// What time it is in a simulation; sent to `/clock`.
    #[derive(Default)]
    pub struct Clock = "rosgraph_msgs/msg/Clock" {
        /// The time.
        clock: Time,
    }
}
