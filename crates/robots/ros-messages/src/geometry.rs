//! `geometry_msgs` and `tf2_msgs`: poses, velocities and frames.

use crate::{
    Header,
    codec::{DecodeError, Reader, Writer},
    description::FieldType,
    field::Field,
    message,
};

message! {
    /// A vector.
    #[derive(Copy, Default)]
    pub struct Vector3 = "geometry_msgs" / "Vector3" {
        /// Along x.
        x: f64,
        /// Along y.
        y: f64,
        /// Along z.
        z: f64,
    }
}

message! {
    /// A position, metres.
    #[derive(Copy, Default)]
    pub struct Point = "geometry_msgs" / "Point" {
        /// Along x.
        x: f64,
        /// Along y.
        y: f64,
        /// Along z.
        z: f64,
    }
}

message! {
    /// A rotation as a unit quaternion.
    #[derive(Copy)]
    pub struct Quaternion = "geometry_msgs" / "Quaternion" {
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
    /// No rotation, the default of ROS 2.
    fn default() -> Self {
        Self { x: 0.0, y: 0.0, z: 0.0, w: 1.0 }
    }
}

impl Quaternion {
    /// The heading (yaw) of the rotated x axis, in (-π, π].
    pub fn heading(&self) -> f64 {
        let Self { x, y, z, w } = self;
        (2.0 * (w * z + x * y)).atan2(1.0 - 2.0 * (y * y + z * z))
    }

    /// The rotation about x by `roll`, then about y by `pitch`, then about z by `heading`, radians, about fixed axes
    /// (REP 103).
    pub fn from_angles(roll: f64, pitch: f64, heading: f64) -> Self {
        let [(sr, cr), (sp, cp), (sh, ch)] = [roll, pitch, heading].map(|angle| (angle / 2.0).sin_cos());
        Self {
            x: sr * cp * ch - cr * sp * sh,
            y: cr * sp * ch + sr * cp * sh,
            z: cr * cp * sh - sr * sp * ch,
            w: cr * cp * ch + sr * sp * sh,
        }
    }

    /// Roll in (-π, π] and pitch in [-π/2, π/2] of the rotation, radians.
    pub fn tilt(&self) -> (f64, f64) {
        let Self { x, y, z, w } = self;
        let roll = (2.0 * (w * x + y * z)).atan2(1.0 - 2.0 * (x * x + y * y));
        (roll, (2.0 * (w * y - z * x)).clamp(-1.0, 1.0).asin())
    }
}

message! {
    /// Position and orientation.
    #[derive(Copy, Default)]
    pub struct Pose = "geometry_msgs" / "Pose" {
        /// Metres.
        position: Point,
        /// A unit quaternion.
        orientation: Quaternion,
    }
}

message! {
    /// A pose with its time and frame, such as a goal.
    #[derive(Default)]
    pub struct PoseStamped = "geometry_msgs" / "PoseStamped" {
        /// Time and frame of the pose.
        header: Header,
        /// The pose.
        pose: Pose,
    }
}

/// Row-major 6 × 6 covariance of x, y, z and the rotations about x, y, z.
#[derive(Debug, Clone, PartialEq)]
pub struct Covariance(pub [f64; 36]);

impl Default for Covariance {
    /// Zero: exactly known.
    fn default() -> Self {
        Self([0.0; 36])
    }
}

impl Covariance {
    /// Indices of x, y and the rotation about z among the six.
    const PLANAR: [usize; 3] = [0, 1, 5];

    /// From the row-major covariance of (x, y, heading); the rest is zero.
    pub fn from_planar(planar: &[f64; 9]) -> Self {
        let mut full = [0.0; 36];
        for (row, i) in Self::PLANAR.into_iter().enumerate() {
            for (column, j) in Self::PLANAR.into_iter().enumerate() {
                full[6 * i + j] = planar[3 * row + column];
            }
        }
        Self(full)
    }

    /// The row-major covariance of (x, y, heading).
    pub fn planar(&self) -> [f64; 9] {
        std::array::from_fn(|k| self.0[6 * Self::PLANAR[k / 3] + Self::PLANAR[k % 3]])
    }
}

impl Field for Covariance {
    const MIN_LEN: usize = <[f64; 36]>::MIN_LEN;

    fn field_type() -> FieldType {
        <[f64; 36]>::field_type()
    }

    fn encode(&self, writer: &mut Writer<'_>) {
        self.0.encode(writer);
    }

    fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        Ok(Self(Field::decode(reader)?))
    }
}

message! {
    /// A pose with its uncertainty.
    #[derive(Default)]
    pub struct PoseWithCovariance = "geometry_msgs" / "PoseWithCovariance" {
        /// The pose.
        pose: Pose,
        /// Covariance of x, y, z and the rotations about x, y, z.
        covariance: Covariance,
    }
}

message! {
    /// A pose with its uncertainty, time and frame, as localization publishes it.
    #[derive(Default)]
    pub struct PoseWithCovarianceStamped = "geometry_msgs" / "PoseWithCovarianceStamped" {
        /// Time and frame of the pose.
        header: Header,
        /// The pose.
        pose: PoseWithCovariance,
    }
}

message! {
    /// Poses, such as those of a filter's particles.
    #[derive(Default)]
    pub struct PoseArray = "geometry_msgs" / "PoseArray" {
        /// Time and frame of the poses.
        header: Header,
        /// The poses.
        poses: Vec<Pose>,
    }
}

message! {
    /// Linear and angular velocity, such as the command to a base.
    #[derive(Copy, Default)]
    pub struct Twist = "geometry_msgs" / "Twist" {
        /// m/s.
        linear: Vector3,
        /// rad/s.
        angular: Vector3,
    }
}

message! {
    /// A velocity with its time and frame: the command to newer robots.
    #[derive(Default)]
    pub struct TwistStamped = "geometry_msgs" / "TwistStamped" {
        /// Time and frame of the velocity.
        header: Header,
        /// The velocity.
        twist: Twist,
    }
}

message! {
    /// A velocity with its uncertainty.
    #[derive(Default)]
    pub struct TwistWithCovariance = "geometry_msgs" / "TwistWithCovariance" {
        /// The velocity.
        twist: Twist,
        /// Covariance of x, y, z and the rotations about x, y, z.
        covariance: Covariance,
    }
}

message! {
    /// The pose of one frame in another.
    #[derive(Copy, Default)]
    pub struct Transform = "geometry_msgs" / "Transform" {
        /// Position of its origin, metres.
        translation: Vector3,
        /// Rotation of its axes, a unit quaternion.
        rotation: Quaternion,
    }
}

message! {
    /// The pose of a child frame in its parent.
    #[derive(Default)]
    pub struct TransformStamped = "geometry_msgs" / "TransformStamped" {
        /// Time; the parent frame.
        header: Header,
        /// The child frame.
        child_frame_id: String,
        /// Its pose in the parent.
        transform: Transform,
    }
}

message! {
    /// Poses of frames, published on `/tf`, and on `/tf_static` if they never move.
    #[derive(Default)]
    pub struct TFMessage = "tf2_msgs" / "TFMessage" {
        /// One for each frame.
        transforms: Vec<TransformStamped>,
    }
}
