//! When, where and how fast: `builtin_interfaces`, `std_msgs` and `geometry_msgs`.

use serde::{Deserialize, Serialize};

use super::{Field, FieldType, array, message};

message! {
    /// Text.
    #[derive(Default)]
    pub struct Text = "std_msgs/msg/String" {
        /// The text.
        data: String,
    }
}

message! {
    /// A point in time; here since the run began.
    #[derive(Default)]
    pub struct Time = "builtin_interfaces/msg/Time" {
        /// Whole seconds.
        sec: i32,
        /// Nanoseconds on top, in 0..10⁹.
        nanosec: u32,
    }
}

message! {
    /// When and in which frame.
    #[derive(Default)]
    pub struct Header = "std_msgs/msg/Header" {
        /// When.
        stamp: Time,
        /// Name of the coordinate frame.
        frame_id: String,
    }
}

message! {
    /// A direction with a length.
    #[derive(Default)]
    pub struct Vector3 = "geometry_msgs/msg/Vector3" {
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
    #[derive(Default)]
    pub struct Point = "geometry_msgs/msg/Point" {
        /// Along x.
        x: f64,
        /// Along y.
        y: f64,
        /// Along z.
        z: f64,
    }
}

message! {
    /// Position and orientation.
    #[derive(Default)]
    pub struct Pose = "geometry_msgs/msg/Pose" {
        /// Metres.
        position: Point,
        /// A unit quaternion.
        orientation: Quaternion,
    }
}

message! {
    /// A pose and how sure it is.
    #[derive(Default)]
    pub struct PoseWithCovariance = "geometry_msgs/msg/PoseWithCovariance" {
        /// The pose.
        pose: Pose,
        /// Of x, y, z and the rotations about x, y, z.
        covariance: Covariance,
    }
}

message! {
    /// A pose, how sure it is, when and in which frame: what localization publishes.
    #[derive(Default)]
    pub struct PoseWithCovarianceStamped = "geometry_msgs/msg/PoseWithCovarianceStamped" {
        /// When and in which frame.
        header: Header,
        /// The pose.
        pose: PoseWithCovariance,
    }
}

message! {
    /// Linear and angular velocity: what drives a base.
    #[derive(Default)]
    pub struct Twist = "geometry_msgs/msg/Twist" {
        /// m/s.
        linear: Vector3,
        /// rad/s.
        angular: Vector3,
    }
}

message! {
    /// A velocity, when and in which frame: what newer robots are driven by.
    #[derive(Default)]
    pub struct TwistStamped = "geometry_msgs/msg/TwistStamped" {
        /// When; the frame of the velocity.
        header: Header,
        /// The velocity.
        twist: Twist,
    }
}

message! {
    /// Where one frame is in another.
    #[derive(Default)]
    pub struct Transform = "geometry_msgs/msg/Transform" {
        /// Of its origin, metres.
        translation: Vector3,
        /// Of its axes.
        rotation: Quaternion,
    }
}

message! {
    /// Where one frame is in another at some time.
    #[derive(Default)]
    pub struct TransformStamped = "geometry_msgs/msg/TransformStamped" {
        /// When; the frame in which the other one is.
        header: Header,
        /// The other one.
        child_frame_id: String,
        /// Where it is.
        transform: Transform,
    }
}

message! {
    /// A velocity and how sure it is.
    #[derive(Default)]
    pub struct TwistWithCovariance = "geometry_msgs/msg/TwistWithCovariance" {
        /// The velocity.
        twist: Twist,
        /// Of x, y, z and the rotations about x, y, z.
        covariance: Covariance,
    }
}

message! {
    /// A rotation as a unit quaternion.
    pub struct Quaternion = "geometry_msgs/msg/Quaternion" {
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

impl Default for Quaternion {
    /// No rotation.
    fn default() -> Self {
        Self { x: 0.0, y: 0.0, z: 0.0, w: 1.0 }
    }
}

/// Row-major 6 × 6 covariance of x, y, z and the rotations about x, y, z.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Covariance(#[serde(with = "array")] pub [f64; 36]);

impl Default for Covariance {
    /// Zero: exactly known.
    fn default() -> Self {
        Self([0.0; 36])
    }
}

impl Field for Covariance {
    fn field_type() -> FieldType {
        f64::field_type().array(36)
    }
}
