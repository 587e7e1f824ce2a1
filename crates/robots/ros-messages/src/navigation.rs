//! `nav_msgs`: odometry, paths and maps.

use crate::{Header, Pose, PoseStamped, PoseWithCovariance, Time, TwistWithCovariance, message};

message! {
    /// Pose and velocity by the wheels.
    #[derive(Default)]
    pub struct Odometry = "nav_msgs" / "Odometry" {
        /// Time; the frame of the pose.
        header: Header,
        /// The frame of the twist.
        child_frame_id: String,
        /// Pose since the start.
        pose: PoseWithCovariance,
        /// Velocity, in the child frame.
        twist: TwistWithCovariance,
    }
}

message! {
    /// A planned path.
    #[derive(Default)]
    pub struct Path = "nav_msgs" / "Path" {
        /// Time and frame of the path.
        header: Header,
        /// Poses from its beginning to its end.
        poses: Vec<PoseStamped>,
    }
}

message! {
    /// Size and place of a map's grid.
    #[derive(Default)]
    pub struct MapMetaData = "nav_msgs" / "MapMetaData" {
        /// Time at which the map was loaded.
        map_load_time: Time,
        /// Side of a cell, m.
        resolution: f32,
        /// Cells along x.
        width: u32,
        /// Cells along y.
        height: u32,
        /// Pose of the lower left corner of cell (0, 0).
        origin: Pose,
    }
}

message! {
    /// A map of occupied cells.
    #[derive(Default)]
    pub struct OccupancyGrid = "nav_msgs" / "OccupancyGrid" {
        /// Time and frame of the map.
        header: Header,
        /// Size and place of the grid.
        info: MapMetaData,
        /// Probability that a cell is occupied, in 0..=100, row by row from (0, 0); -1 if it is unknown.
        data: Vec<i8>,
    }
}
