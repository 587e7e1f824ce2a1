//! The messages that mobile robots speak. Types, fields and their order are those of ROS 1 (Noetic); units are
//! REP 103's: metres, radians, seconds.

use crate::{Duration, Service, Time, message};

message! {
    /// Text.
    pub struct Text = "std_msgs/String" {
        /// The text.
        data: String,
    }
}

message! {
    /// A flag.
    pub struct Bool = "std_msgs/Bool" {
        /// The flag.
        data: bool,
    }
}

message! {
    /// A number.
    pub struct Float64 = "std_msgs/Float64" {
        /// The number.
        data: f64,
    }
}

message! {
    /// Nothing but that it came.
    pub struct Empty = "std_msgs/Empty" {}
}

message! {
    /// When and in which frame.
    pub struct Header = "std_msgs/Header" {
        /// Consecutively increasing number; roscpp and rospy publishers count it, nobody relies on it.
        seq: u32,
        /// When.
        stamp: Time,
        /// Name of the coordinate frame.
        frame_id: String,
    }
}

message! {
    /// What time it is in a simulation; sent to `/clock`.
    pub struct Clock = "rosgraph_msgs/Clock" {
        /// The time.
        clock: Time,
    }
}

message! {
    /// A direction with a length.
    #[derive(Copy)]
    pub struct Vector3 = "geometry_msgs/Vector3" {
        /// Along x.
        x: f64,
        /// Along y.
        y: f64,
        /// Along z.
        z: f64,
    }
}

message! {
    /// A place, metres.
    #[derive(Copy)]
    pub struct Point = "geometry_msgs/Point" {
        /// Along x.
        x: f64,
        /// Along y.
        y: f64,
        /// Along z.
        z: f64,
    }
}

message! {
    /// A rotation as a unit quaternion. The default, all zero, is none.
    #[derive(Copy)]
    pub struct Quaternion = "geometry_msgs/Quaternion" {
        /// i.
        x: f64,
        /// j.
        y: f64,
        /// k.
        z: f64,
        /// The real part.
        w: f64,
    }
}

message! {
    /// Position and orientation.
    #[derive(Copy)]
    pub struct Pose = "geometry_msgs/Pose" {
        /// Metres.
        position: Point,
        /// A unit quaternion.
        orientation: Quaternion,
    }
}

message! {
    /// A pose, when and in which frame: a goal, for one.
    pub struct PoseStamped = "geometry_msgs/PoseStamped" {
        /// When and in which frame.
        header: Header,
        /// The pose.
        pose: Pose,
    }
}

message! {
    /// A pose and how sure it is.
    pub struct PoseWithCovariance = "geometry_msgs/PoseWithCovariance" {
        /// The pose.
        pose: Pose,
        /// Row-major 6 × 6, of x, y, z and the rotations about x, y, z.
        covariance: [f64; 36],
    }
}

message! {
    /// A pose, how sure it is, when and in which frame: what localization publishes.
    pub struct PoseWithCovarianceStamped = "geometry_msgs/PoseWithCovarianceStamped" {
        /// When and in which frame.
        header: Header,
        /// The pose.
        pose: PoseWithCovariance,
    }
}

message! {
    /// Where particles of a filter are, for one.
    pub struct PoseArray = "geometry_msgs/PoseArray" {
        /// When and in which frame.
        header: Header,
        /// The poses.
        poses: Vec<Pose>,
    }
}

message! {
    /// Linear and angular velocity: what drives a base.
    #[derive(Copy)]
    pub struct Twist = "geometry_msgs/Twist" {
        /// m/s.
        linear: Vector3,
        /// rad/s.
        angular: Vector3,
    }
}

message! {
    /// A velocity, when and in which frame.
    pub struct TwistStamped = "geometry_msgs/TwistStamped" {
        /// When and in which frame.
        header: Header,
        /// The velocity.
        twist: Twist,
    }
}

message! {
    /// A velocity and how sure it is.
    pub struct TwistWithCovariance = "geometry_msgs/TwistWithCovariance" {
        /// The velocity.
        twist: Twist,
        /// Row-major 6 × 6, of x, y, z and the rotations about x, y, z.
        covariance: [f64; 36],
    }
}

message! {
    /// A movement of one frame into another.
    #[derive(Copy)]
    pub struct Transform = "geometry_msgs/Transform" {
        /// Metres.
        translation: Vector3,
        /// A unit quaternion.
        rotation: Quaternion,
    }
}

message! {
    /// Where one frame is in another.
    pub struct TransformStamped = "geometry_msgs/TransformStamped" {
        /// When; the frame in which.
        header: Header,
        /// The frame that is there.
        child_frame_id: String,
        /// Where it is.
        transform: Transform,
    }
}

message! {
    /// Where frames are in others; sent to `/tf` and `/tf_static`.
    pub struct TFMessage = "tf2_msgs/TFMessage" {
        /// Each.
        transforms: Vec<TransformStamped>,
    }
}

message! {
    /// Where the wheels say that a robot is, and how it moves.
    pub struct Odometry = "nav_msgs/Odometry" {
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
    /// A way to go.
    pub struct Path = "nav_msgs/Path" {
        /// When and in which frame.
        header: Header,
        /// From its beginning to its end.
        poses: Vec<PoseStamped>,
    }
}

message! {
    /// What is known about a map's grid.
    pub struct MapMetaData = "nav_msgs/MapMetaData" {
        /// When the map was loaded.
        map_load_time: Time,
        /// Side of a cell, m.
        resolution: f32,
        /// Cells along x.
        width: u32,
        /// Cells along y.
        height: u32,
        /// Of the lower left corner of cell (0, 0).
        origin: Pose,
    }
}

message! {
    /// A map: how likely each cell is occupied.
    pub struct OccupancyGrid = "nav_msgs/OccupancyGrid" {
        /// When and in which frame.
        header: Header,
        /// Of the grid.
        info: MapMetaData,
        /// Row by row from (0, 0) on, in 0..=100; -1 where it is not known.
        data: Vec<i8>,
    }
}

message! {
    /// One turn of a planar lidar.
    pub struct LaserScan = "sensor_msgs/LaserScan" {
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
    /// What a gyroscope and an accelerometer say.
    pub struct Imu = "sensor_msgs/Imu" {
        /// When and in which frame.
        header: Header,
        /// A unit quaternion.
        orientation: Quaternion,
        /// Row-major 3 × 3, about x, y, z; -1 first where there is no estimate.
        orientation_covariance: [f64; 9],
        /// rad/s.
        angular_velocity: Vector3,
        /// Row-major 3 × 3, about x, y, z.
        angular_velocity_covariance: [f64; 9],
        /// m/s².
        linear_acceleration: Vector3,
        /// Row-major 3 × 3, x, y, z.
        linear_acceleration_covariance: [f64; 9],
    }
}

message! {
    /// How full a battery is, and how it is.
    pub struct BatteryState = "sensor_msgs/BatteryState"
    const {
        /// Nobody knows.
        POWER_SUPPLY_STATUS_UNKNOWN: u8 = 0,
        /// It is being charged.
        POWER_SUPPLY_STATUS_CHARGING: u8 = 1,
        /// It is in use.
        POWER_SUPPLY_STATUS_DISCHARGING: u8 = 2,
        /// It is neither.
        POWER_SUPPLY_STATUS_NOT_CHARGING: u8 = 3,
        /// It is full.
        POWER_SUPPLY_STATUS_FULL: u8 = 4,
        /// Nobody knows.
        POWER_SUPPLY_HEALTH_UNKNOWN: u8 = 0,
        /// As it should be.
        POWER_SUPPLY_HEALTH_GOOD: u8 = 1,
        /// Too hot.
        POWER_SUPPLY_HEALTH_OVERHEAT: u8 = 2,
        /// At its end.
        POWER_SUPPLY_HEALTH_DEAD: u8 = 3,
        /// Its voltage is too high.
        POWER_SUPPLY_HEALTH_OVERVOLTAGE: u8 = 4,
        /// It failed, and does not say how.
        POWER_SUPPLY_HEALTH_UNSPEC_FAILURE: u8 = 5,
        /// Too cold.
        POWER_SUPPLY_HEALTH_COLD: u8 = 6,
        /// Its watchdog was not served.
        POWER_SUPPLY_HEALTH_WATCHDOG_TIMER_EXPIRE: u8 = 7,
        /// Its safety timer ran out.
        POWER_SUPPLY_HEALTH_SAFETY_TIMER_EXPIRE: u8 = 8,
        /// Nobody knows.
        POWER_SUPPLY_TECHNOLOGY_UNKNOWN: u8 = 0,
        /// Nickel-metal hydride.
        POWER_SUPPLY_TECHNOLOGY_NIMH: u8 = 1,
        /// Lithium-ion.
        POWER_SUPPLY_TECHNOLOGY_LION: u8 = 2,
        /// Lithium polymer.
        POWER_SUPPLY_TECHNOLOGY_LIPO: u8 = 3,
        /// Lithium iron phosphate.
        POWER_SUPPLY_TECHNOLOGY_LIFE: u8 = 4,
        /// Nickel-cadmium.
        POWER_SUPPLY_TECHNOLOGY_NICD: u8 = 5,
        /// Lithium manganese.
        POWER_SUPPLY_TECHNOLOGY_LIMN: u8 = 6,
    }
    {
        /// When.
        header: Header,
        /// V.
        voltage: f32,
        /// °C; NaN if it is not measured.
        temperature: f32,
        /// A, negative while it discharges; NaN if it is not measured.
        current: f32,
        /// Ah; NaN if it is not measured.
        charge: f32,
        /// Ah, when full last; NaN if it is not measured.
        capacity: f32,
        /// Ah, by design; NaN if it is not known.
        design_capacity: f32,
        /// In 0..=1; NaN if it is not measured.
        percentage: f32,
        /// `POWER_SUPPLY_STATUS_…`.
        power_supply_status: u8,
        /// `POWER_SUPPLY_HEALTH_…`.
        power_supply_health: u8,
        /// `POWER_SUPPLY_TECHNOLOGY_…`.
        power_supply_technology: u8,
        /// Whether there is one.
        present: bool,
        /// V, of each cell.
        cell_voltage: Vec<f32>,
        /// °C, of each cell.
        cell_temperature: Vec<f32>,
        /// Where it sits.
        location: String,
        /// Which one it is.
        serial_number: String,
    }
}

message! {
    /// A picture, pixel by pixel.
    pub struct Image = "sensor_msgs/Image" {
        /// When, and in which frame: z looks ahead, x to the right.
        header: Header,
        /// Rows.
        height: u32,
        /// Columns.
        width: u32,
        /// What a pixel is, such as `rgb8`.
        encoding: String,
        /// Whether numbers of more than a byte begin with the highest one: 0 or 1.
        is_bigendian: u8,
        /// Bytes of a row.
        step: u32,
        /// Row by row from the top.
        data: Vec<u8>,
    }
}

message! {
    /// A picture as a file.
    pub struct CompressedImage = "sensor_msgs/CompressedImage" {
        /// When and in which frame.
        header: Header,
        /// Such as `jpeg`.
        format: String,
        /// The file.
        data: Vec<u8>,
    }
}

message! {
    /// A dimension of an array.
    pub struct MultiArrayDimension = "std_msgs/MultiArrayDimension" {
        /// Its name.
        label: String,
        /// Its size.
        size: u32,
        /// From one element of it to the next.
        stride: u32,
    }
}

message! {
    /// How an array lies in memory.
    pub struct MultiArrayLayout = "std_msgs/MultiArrayLayout" {
        /// The outermost first.
        dim: Vec<MultiArrayDimension>,
        /// Elements before the first.
        data_offset: u32,
    }
}

message! {
    /// Numbers.
    pub struct Float64MultiArray = "std_msgs/Float64MultiArray" {
        /// How they lie.
        layout: MultiArrayLayout,
        /// The numbers.
        data: Vec<f64>,
    }
}

message! {
    /// How long something takes; `std_msgs/Duration`.
    pub struct Span = "std_msgs/Duration" {
        /// How long.
        data: Duration,
    }
}

message! {
    /// Asks for something that needs no details.
    pub struct EmptyRequest = "std_srvs/EmptyRequest" {}
}

message! {
    /// It was done.
    pub struct EmptyResponse = "std_srvs/EmptyResponse" {}
}

/// Does something that needs no details; `std_srvs/Empty`.
#[derive(Debug, Clone, Copy)]
pub struct EmptyService;

impl Service for EmptyService {
    const TYPE_NAME: &'static str = "std_srvs/Empty";
    type Request = EmptyRequest;
    type Response = EmptyResponse;
}

message! {
    /// Asks to switch.
    pub struct SetBoolRequest = "std_srvs/SetBoolRequest" {
        /// On or off.
        data: bool,
    }
}

message! {
    /// How switching went.
    pub struct SetBoolResponse = "std_srvs/SetBoolResponse" {
        /// Whether it was done.
        success: bool,
        /// What there is to say about it.
        message: String,
    }
}

/// Switches something on or off; `std_srvs/SetBool`.
#[derive(Debug, Clone, Copy)]
pub struct SetBool;

impl Service for SetBool {
    const TYPE_NAME: &'static str = "std_srvs/SetBool";
    type Request = SetBoolRequest;
    type Response = SetBoolResponse;
}

message! {
    /// Asks for the map.
    pub struct GetMapRequest = "nav_msgs/GetMapRequest" {}
}

message! {
    /// The map.
    pub struct GetMapResponse = "nav_msgs/GetMapResponse" {
        /// The map.
        map: OccupancyGrid,
    }
}

/// Asks for the map; `nav_msgs/GetMap`, as `/static_map` serves it.
#[derive(Debug, Clone, Copy)]
pub struct GetMap;

impl Service for GetMap {
    const TYPE_NAME: &'static str = "nav_msgs/GetMap";
    type Request = GetMapRequest;
    type Response = GetMapResponse;
}

#[cfg(test)]
mod tests;
