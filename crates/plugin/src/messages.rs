//! The ROS 2 messages that robots and VNFs exchange, and their CDR encoding, so that what crosses the network has the
//! size and the cost of the real thing and any ROS tool can read it.
//!
//! Types and field order follow `std_msgs`, `builtin_interfaces`, `geometry_msgs`, `nav_msgs` and `sensor_msgs` of
//! ROS 2 (Jazzy). Units are REP 103's: metres, radians, seconds.

use cdr_encoding::CdrSerializer;
use cotorra_graph::{self as graph, PoseSource, Timestamp, Velocity};
use serde::{Deserialize, Serialize, de::DeserializeOwned};

/// Bytes before a message's body that name its encoding: representation identifier and options (DDSI-RTPS 2.5,
/// 10.2.1.2).
const ENCAPSULATION_LEN: usize = 4;
/// Plain CDR, big endian.
const CDR_BE: [u8; 2] = [0, 0];
/// Plain CDR, little endian.
const CDR_LE: [u8; 2] = [0, 1];
/// A writer may pad a payload to a multiple of four bytes.
const MAX_PADDING: usize = 3;

/// Why bytes are not the message that was asked for.
#[derive(Debug, thiserror::Error)]
pub enum MessageError {
    /// Too short for an encapsulation header, or another encoding than plain CDR.
    #[error(
        "a message begins with the encapsulation header of plain CDR, 00 00 or 00 01 and two bytes of options"
    )]
    Encapsulation,
    /// The body ends early, or holds what the type cannot.
    #[error("the body is no {type_name}: {reason}")]
    Body {
        /// ROS name of the type.
        type_name: &'static str,
        /// What is wrong.
        reason: cdr_encoding::Error,
    },
    /// The body goes on behind the message.
    #[error("{count} bytes follow the {type_name}, where padding has 3 at most")]
    Trailing {
        /// ROS name of the type.
        type_name: &'static str,
        /// How many.
        count: usize,
    },
}

/// A ROS 2 message: plain CDR (XCDR1) with its 4-byte encapsulation header.
pub trait Message: Serialize + DeserializeOwned {
    /// The type's ROS name, such as `geometry_msgs/msg/Twist`.
    const TYPE_NAME: &'static str;

    /// Appends the message, little endian, to `buffer`.
    fn encode(&self, buffer: &mut Vec<u8>) {
        buffer.extend_from_slice(&CDR_LE);
        buffer.extend_from_slice(&[0, 0]);
        // Alignment counts from behind the encapsulation header, which the serialiser never sees.
        self.serialize(&mut CdrSerializer::<_, byteorder::LittleEndian>::new(buffer))
            .expect("writing to memory does not fail, and every sequence knows its length");
    }

    /// Reads a message in either byte order. Allocates in proportion to `payload`, whatever lengths it claims.
    ///
    /// # Errors
    /// [`MessageError`] if `payload` is not exactly one message of this type, padding aside.
    fn decode(payload: &[u8]) -> Result<Self, MessageError> {
        let type_name = Self::TYPE_NAME;
        let (header, body) =
            payload.split_at_checked(ENCAPSULATION_LEN).ok_or(MessageError::Encapsulation)?;
        let read = match [header[0], header[1]] {
            CDR_LE => cdr_encoding::from_bytes::<Self, byteorder::LittleEndian>(body),
            CDR_BE => cdr_encoding::from_bytes::<Self, byteorder::BigEndian>(body),
            _ => return Err(MessageError::Encapsulation),
        };
        let (message, consumed) = read.map_err(|reason| MessageError::Body { type_name, reason })?;
        match body.len() - consumed {
            0..=MAX_PADDING => Ok(message),
            count => Err(MessageError::Trailing { type_name, count }),
        }
    }
}

macro_rules! message {
    ($ros:literal, $(#[$doc:meta])* $name:ident { $($(#[$field_doc:meta])* $field:ident: $kind:ty,)* }) => {
        $(#[$doc])*
        #[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
        pub struct $name { $($(#[$field_doc])* pub $field: $kind,)* }

        impl Message for $name {
            const TYPE_NAME: &'static str = $ros;
        }
    };
}

message! { "builtin_interfaces/msg/Time",
    /// A point in time; here since the run began.
    Time {
        /// Whole seconds.
        sec: i32,
        /// Nanoseconds on top, in 0..10⁹.
        nanosec: u32,
    }
}

message! { "std_msgs/msg/Header",
    /// When and in which frame.
    Header {
        /// When.
        stamp: Time,
        /// Name of the coordinate frame.
        frame_id: String,
    }
}

message! { "geometry_msgs/msg/Vector3",
    /// A direction with a length.
    Vector3 {
        /// Along x.
        x: f64,
        /// Along y.
        y: f64,
        /// Along z.
        z: f64,
    }
}

message! { "geometry_msgs/msg/Point",
    /// A place, metres.
    Point {
        /// Along x.
        x: f64,
        /// Along y.
        y: f64,
        /// Along z.
        z: f64,
    }
}

message! { "geometry_msgs/msg/Pose",
    /// Position and orientation.
    Pose {
        /// Metres.
        position: Point,
        /// A unit quaternion.
        orientation: Quaternion,
    }
}

message! { "geometry_msgs/msg/PoseWithCovariance",
    /// A pose and how sure it is.
    PoseWithCovariance {
        /// The pose.
        pose: Pose,
        /// Of x, y, z and the rotations about x, y, z.
        covariance: Covariance,
    }
}

message! { "geometry_msgs/msg/PoseWithCovarianceStamped",
    /// A pose, how sure it is, when and in which frame: what localization publishes.
    PoseWithCovarianceStamped {
        /// When and in which frame.
        header: Header,
        /// The pose.
        pose: PoseWithCovariance,
    }
}

message! { "geometry_msgs/msg/Twist",
    /// Linear and angular velocity: what drives a base.
    Twist {
        /// m/s.
        linear: Vector3,
        /// rad/s.
        angular: Vector3,
    }
}

message! { "geometry_msgs/msg/TwistWithCovariance",
    /// A velocity and how sure it is.
    TwistWithCovariance {
        /// The velocity.
        twist: Twist,
        /// Of x, y, z and the rotations about x, y, z.
        covariance: Covariance,
    }
}

message! { "nav_msgs/msg/Odometry",
    /// Where the wheels say that a robot is, and how it moves.
    Odometry {
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

message! { "sensor_msgs/msg/LaserScan",
    /// One turn of a planar lidar.
    LaserScan {
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

/// A rotation as a unit quaternion.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Quaternion {
    /// i.
    pub x: f64,
    /// j.
    pub y: f64,
    /// k.
    pub z: f64,
    /// The real part.
    pub w: f64,
}

impl Message for Quaternion {
    const TYPE_NAME: &'static str = "geometry_msgs/msg/Quaternion";
}

impl Default for Quaternion {
    /// No rotation.
    fn default() -> Self {
        Self { x: 0.0, y: 0.0, z: 0.0, w: 1.0 }
    }
}

impl Quaternion {
    /// The rotation about z by `heading` radians.
    pub fn from_heading(heading: f64) -> Self {
        let (z, w) = (heading / 2.0).sin_cos();
        Self { x: 0.0, y: 0.0, z, w }
    }

    /// The heading (yaw) of the rotated x axis, in (-π, π].
    pub fn heading(&self) -> f64 {
        let Self { x, y, z, w } = self;
        (2.0 * (w * z + x * y)).atan2(1.0 - 2.0 * (y * y + z * z))
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

impl Covariance {
    /// Where x, y and the rotation about z stand among the six.
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

impl From<Timestamp> for Time {
    /// Saturates after 68 years.
    fn from(at: Timestamp) -> Self {
        let nanos = at.as_nanos();
        Self {
            sec: i32::try_from(nanos / 1_000_000_000).unwrap_or(i32::MAX),
            nanosec: (nanos % 1_000_000_000) as u32,
        }
    }
}

impl Header {
    /// A header for that time and frame.
    pub fn new(stamp: Timestamp, frame_id: &str) -> Self {
        Self { stamp: stamp.into(), frame_id: frame_id.to_owned() }
    }
}

impl From<Velocity> for Twist {
    fn from(velocity: Velocity) -> Self {
        Self {
            linear: Vector3 { x: velocity.linear, ..Vector3::default() },
            angular: Vector3 { z: velocity.angular, ..Vector3::default() },
        }
    }
}

impl From<&Twist> for Velocity {
    /// What a ground robot can do of it: forward, and about z.
    fn from(twist: &Twist) -> Self {
        Self { linear: twist.linear.x, angular: twist.angular.z }
    }
}

impl From<&graph::Pose> for Pose {
    fn from(pose: &graph::Pose) -> Self {
        Self {
            position: Point { x: pose.x, y: pose.y, z: 0.0 },
            orientation: Quaternion::from_heading(pose.heading),
        }
    }
}

impl Pose {
    /// The part of it in the plane, exactly known, said to come from `source`, which ROS does not carry.
    pub fn planar(&self, source: PoseSource) -> graph::Pose {
        let heading = self.orientation.heading();
        graph::Pose { x: self.position.x, y: self.position.y, heading, covariance: [0.0; 9], source }
    }
}

impl From<&graph::Pose> for PoseWithCovariance {
    fn from(pose: &graph::Pose) -> Self {
        Self { pose: pose.into(), covariance: Covariance::from_planar(&pose.covariance) }
    }
}

impl PoseWithCovariance {
    /// The part of it in the plane, said to come from `source`, which ROS does not carry.
    pub fn planar(&self, source: PoseSource) -> graph::Pose {
        graph::Pose { covariance: self.covariance.planar(), ..self.pose.planar(source) }
    }
}

/// serde for arrays of any length, which it has only up to 32; CDR writes them without a length.
mod array {
    use std::fmt;

    use serde::{
        Deserializer, Serializer,
        de::{Error, SeqAccess, Visitor},
        ser::SerializeTuple,
    };

    pub fn serialize<S: Serializer, const N: usize>(
        values: &[f64; N],
        serializer: S,
    ) -> Result<S::Ok, S::Error> {
        let mut tuple = serializer.serialize_tuple(N)?;
        for value in values {
            tuple.serialize_element(value)?;
        }
        tuple.end()
    }

    pub fn deserialize<'de, D: Deserializer<'de>, const N: usize>(
        deserializer: D,
    ) -> Result<[f64; N], D::Error> {
        struct Values<const N: usize>;

        impl<'de, const N: usize> Visitor<'de> for Values<N> {
            type Value = [f64; N];

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, "{N} numbers")
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<[f64; N], A::Error> {
                let mut values = [0.0; N];
                for (i, value) in values.iter_mut().enumerate() {
                    *value = seq.next_element()?.ok_or_else(|| A::Error::invalid_length(i, &self))?;
                }
                Ok(values)
            }
        }

        deserializer.deserialize_tuple(N, Values)
    }
}

#[cfg(test)]
mod tests;
