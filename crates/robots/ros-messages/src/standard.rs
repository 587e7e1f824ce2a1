//! `std_msgs` and `rosgraph_msgs`.

use crate::{Duration, Time, message};

message! {
    /// Text.
    #[derive(Default)]
    pub struct Text = "std_msgs" / "String" {
        /// The text.
        data: String,
    }
}

message! {
    /// A flag.
    #[derive(Default)]
    pub struct Bool = "std_msgs" / "Bool" {
        /// The flag.
        data: bool,
    }
}

message! {
    /// A number.
    #[derive(Default)]
    pub struct Float64 = "std_msgs" / "Float64" {
        /// The number.
        data: f64,
    }
}

message! {
    /// A whole number from 0 on.
    #[derive(Default)]
    pub struct UInt32 = "std_msgs" / "UInt32" {
        /// The number.
        data: u32,
    }
}

message! {
    /// A signal without content.
    #[derive(Default)]
    pub struct Empty = "std_msgs" / "Empty" {}
}

message! {
    /// A time span. Only ROS 1 has it; ROS 2 has [`Duration`] alone.
    #[derive(Default)]
    pub struct Span = "std_msgs" / "Duration" {
        /// The time span.
        data: Duration,
    }
}

message! {
    /// The time and the coordinate frame of a measurement.
    #[derive(Default)]
    pub struct Header = "std_msgs" / "Header" {
        /// Consecutive number. Publishers of roscpp and rospy count it; nothing relies on it.
        seq: u32 [Ros1 only],
        /// Time of the measurement.
        stamp: Time,
        /// Name of the coordinate frame.
        frame_id: String,
    }
}

impl Header {
    /// A header for a time and a coordinate frame.
    pub fn new(stamp: Time, frame_id: &str) -> Self {
        Self { seq: 0, stamp, frame_id: frame_id.to_owned() }
    }
}

message! {
    /// The time in a simulation, published on `/clock`.
    #[derive(Default)]
    pub struct Clock = "rosgraph_msgs" / "Clock" {
        /// The time.
        clock: Time,
    }
}

message! {
    /// A colour; each part from 0 to 1.
    #[derive(Copy, Default)]
    pub struct ColorRGBA = "std_msgs" / "ColorRGBA" {
        /// Red.
        r: f32,
        /// Green.
        g: f32,
        /// Blue.
        b: f32,
        /// Opacity.
        a: f32,
    }
}

message! {
    /// A dimension of an array.
    #[derive(Default)]
    pub struct MultiArrayDimension = "std_msgs" / "MultiArrayDimension" {
        /// Its name.
        label: String,
        /// Its size.
        size: u32,
        /// Distance between two of its elements.
        stride: u32,
    }
}

message! {
    /// The layout of an array in memory.
    #[derive(Default)]
    pub struct MultiArrayLayout = "std_msgs" / "MultiArrayLayout" {
        /// Dimensions, the outermost first.
        dim: Vec<MultiArrayDimension>,
        /// Elements before the first.
        data_offset: u32,
    }
}

message! {
    /// An array of numbers.
    #[derive(Default)]
    pub struct Float64MultiArray = "std_msgs" / "Float64MultiArray" {
        /// Their layout.
        layout: MultiArrayLayout,
        /// The numbers.
        data: Vec<f64>,
    }
}
