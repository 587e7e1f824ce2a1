//! What sensors say: `sensor_msgs`, and numbers of `std_msgs`.

use std::fmt;

use serde::{Deserialize, Deserializer, Serialize, Serializer, de::Visitor};

use super::{Field, FieldType, Header, Quaternion, Vector3, message};

/// Bytes, ROS's `uint8[]`: read and written in one piece, because images are long.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Bytes(pub Vec<u8>);

impl Field for Bytes {
    fn field_type() -> FieldType {
        u8::field_type().sequence()
    }
}

impl Serialize for Bytes {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_bytes(&self.0)
    }
}

impl<'de> Deserialize<'de> for Bytes {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Whole;

        impl Visitor<'_> for Whole {
            type Value = Bytes;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("bytes")
            }

            fn visit_byte_buf<E>(self, bytes: Vec<u8>) -> Result<Bytes, E> {
                Ok(Bytes(bytes))
            }
        }

        deserializer.deserialize_byte_buf(Whole)
    }
}

message! {
    /// What a gyroscope and an accelerometer say.
    #[derive(Default)]
    pub struct Imu = "sensor_msgs/msg/Imu" {
        /// When and in which frame.
        header: Header,
        /// A unit quaternion.
        orientation: Quaternion,
        /// Row-major 3 × 3, about x, y, z; -1 first where there is no estimate.
        orientation_covariance: [f64; 9],
        /// rad/s.
        angular_velocity: Vector3,
        /// Row-major 3 × 3, about x, y, z; -1 first where there is no estimate.
        angular_velocity_covariance: [f64; 9],
        /// m/s².
        linear_acceleration: Vector3,
        /// Row-major 3 × 3, x, y, z; -1 first where there is no estimate.
        linear_acceleration_covariance: [f64; 9],
    }
}

message! {
    /// How full a battery is, and how it is.
    #[derive(Default)]
    pub struct BatteryState = "sensor_msgs/msg/BatteryState" {
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
        /// A constant of the type, as the next two.
        power_supply_status: u8,
        /// How it is.
        power_supply_health: u8,
        /// What it is made of.
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
    #[derive(Default)]
    pub struct Image = "sensor_msgs/msg/Image" {
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
        data: Bytes,
    }
}

message! {
    /// A picture as a file.
    #[derive(Default)]
    pub struct CompressedImage = "sensor_msgs/msg/CompressedImage" {
        /// When and in which frame.
        header: Header,
        /// Such as `jpeg`.
        format: String,
        /// The file.
        data: Bytes,
    }
}

message! {
    /// A dimension of an array.
    #[derive(Default)]
    pub struct MultiArrayDimension = "std_msgs/msg/MultiArrayDimension" {
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
    #[derive(Default)]
    pub struct MultiArrayLayout = "std_msgs/msg/MultiArrayLayout" {
        /// The outermost first.
        dim: Vec<MultiArrayDimension>,
        /// Elements before the first.
        data_offset: u32,
    }
}

message! {
    /// Numbers.
    #[derive(Default)]
    pub struct Float64MultiArray = "std_msgs/msg/Float64MultiArray" {
        /// How they lie.
        layout: MultiArrayLayout,
        /// The numbers.
        data: Vec<f64>,
    }
}
