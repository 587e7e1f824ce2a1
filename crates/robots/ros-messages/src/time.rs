//! Times and durations: built-in types in ROS 1, messages of `builtin_interfaces` in ROS 2.

use crate::{
    codec::{DecodeError, Reader, Version, Writer},
    description::{Description, FieldDescription, FieldType},
    field::Field,
    message::Message,
};

/// A point in time, of the wall clock or of `/clock`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub struct Time {
    /// Whole seconds. ROS 1 counts them without a sign: those after 2038 are read as [`i32::MAX`].
    pub sec: i32,
    /// Nanoseconds on top, in 0..10⁹.
    pub nanosec: u32,
}

/// A time span, which may be negative.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub struct Duration {
    /// Whole seconds.
    pub sec: i32,
    /// Nanoseconds on top, in 0..10⁹.
    pub nanosec: u32,
}

impl Time {
    /// The time so many nanoseconds after zero. Saturates after 68 years.
    pub fn from_nanos(nanos: u64) -> Self {
        Self {
            sec: i32::try_from(nanos / 1_000_000_000).unwrap_or(i32::MAX),
            nanosec: (nanos % 1_000_000_000) as u32,
        }
    }
}

macro_rules! times {
    ($($kind:ident $name:literal $ros1:literal $sec:expr;)*) => { $(
        impl Message for $kind {
            const ROS1_NAME: &'static str = $ros1;
            const ROS2_NAME: &'static str = concat!("builtin_interfaces/msg/", $name);

            fn description() -> Description {
                let field = |name, kind| FieldDescription { name, kind, only: None };
                Description {
                    package: "builtin_interfaces",
                    name: $name,
                    constants: Vec::new(),
                    fields: vec![field("sec", i32::field_type()), field("nanosec", u32::field_type())],
                }
            }
        }

        impl Field for $kind {
            const MIN_LEN: usize = 8;

            fn field_type() -> FieldType {
                FieldType::time($ros1, Self::description())
            }

            fn encode(&self, writer: &mut Writer<'_>) {
                self.sec.encode(writer);
                self.nanosec.encode(writer);
            }

            fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
                let sec: fn(&mut Reader<'_>) -> Result<i32, DecodeError> = $sec;
                Ok(Self { sec: sec(reader)?, nanosec: u32::decode(reader)? })
            }
        }
    )* };
}

times! {
    Time "Time" "time" |reader| match reader.version() {
        Version::Ros1 => Ok(i32::try_from(u32::decode(reader)?).unwrap_or(i32::MAX)),
        Version::Ros2 => i32::decode(reader),
    };
    Duration "Duration" "duration" i32::decode;
}
