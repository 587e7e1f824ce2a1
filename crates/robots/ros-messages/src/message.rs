//! Messages, and the macro that declares them.

use crate::{
    codec::{DecodeError, Reader, Version, Writer},
    description::Description,
    field::Field,
};

/// Bytes before a CDR body that name its encoding: representation identifier and options (DDSI-RTPS 2.5, 10.2.1.2).
const ENCAPSULATION_LEN: usize = 4;
/// Plain CDR, big endian.
const CDR_BE: [u8; 2] = [0, 0];
/// Plain CDR, little endian.
const CDR_LE: [u8; 2] = [0, 1];
/// A writer may pad a CDR payload to a multiple of four bytes.
const MAX_PADDING: usize = 3;

/// A ROS message, declared by [`message!`](crate::message!).
pub trait Message: Field + Send + 'static {
    /// The type's name in ROS 1, such as `geometry_msgs/Twist`.
    const ROS1_NAME: &'static str;
    /// The type's name in ROS 2, such as `geometry_msgs/msg/Twist`.
    const ROS2_NAME: &'static str;

    /// Describes the type.
    fn description() -> Description;

    /// Appends the message in ROS 1's serialization.
    fn encode_ros1(&self, buffer: &mut Vec<u8>) {
        self.encode(&mut Writer::new(Version::Ros1, buffer));
    }

    /// Reads a message in ROS 1's serialization. Allocates in proportion to `bytes`, whatever counts they claim.
    ///
    /// # Errors
    /// [`DecodeError`] if `bytes` are not exactly one message of this type.
    fn decode_ros1(bytes: &[u8]) -> Result<Self, DecodeError> {
        decode(&mut Reader::new(Version::Ros1, bytes), 0)
    }

    /// Appends the message as plain CDR (XCDR1), little endian, with its 4-byte encapsulation header.
    fn encode_cdr(&self, buffer: &mut Vec<u8>) {
        buffer.extend_from_slice(&CDR_LE);
        buffer.extend_from_slice(&[0, 0]);
        self.encode(&mut Writer::new(Version::Ros2, buffer));
    }

    /// Reads a message as plain CDR (XCDR1) in either byte order, with its encapsulation header. Allocates in proportion
    /// to `payload`, whatever counts it claims.
    ///
    /// # Errors
    /// [`DecodeError`] if `payload` is not exactly one message of this type, padding aside.
    fn decode_cdr(payload: &[u8]) -> Result<Self, DecodeError> {
        let (header, body) = payload.split_at_checked(ENCAPSULATION_LEN).ok_or(DecodeError::Encapsulation)?;
        let mut reader = match [header[0], header[1]] {
            CDR_LE => Reader::new(Version::Ros2, body),
            CDR_BE => Reader::big_endian(body),
            _ => return Err(DecodeError::Encapsulation),
        };
        decode(&mut reader, MAX_PADDING)
    }
}

/// Reads one message, behind which `padding` bytes may follow.
fn decode<M: Field>(reader: &mut Reader<'_>, padding: usize) -> Result<M, DecodeError> {
    let message = M::decode(reader)?;
    match reader.left() {
        count if count > padding => Err(DecodeError::Trailing { count }),
        _ => Ok(message),
    }
}

/// Declares a message: a struct with public fields in the order of the `.msg` file, after its constants. Its fields are
/// [`Field`]s and have defaults; [`Covariance`](crate::Covariance) stands for `float64[36]`, which has none.
///
/// A field that one version lacks is marked behind its type: `[Ros1 only]` or `[Ros2 only]`. In the other version it is
/// neither written nor read, and reads as its default.
///
/// ```
/// cotorra_ros_messages::message! {
///     /// The state of a battery.
///     pub struct Battery = "my_robot" / "Battery"
///     const {
///         /// It is being charged.
///         CHARGING: u8 = 1,
///     }
///     {
///         /// V.
///         voltage: f32,
///         /// One of the constants.
///         state: u8,
///         /// Number of the pack, which only the old driver knows.
///         pack: u32 [Ros1 only],
///     }
/// }
/// use cotorra_ros_messages::Message;
/// let description = Battery::description();
/// assert_eq!(description.ros1_text(), "uint8 CHARGING=1\nfloat32 voltage\nuint8 state\nuint32 pack\n");
/// assert_eq!(description.ros2_text(), "float32 voltage\nuint8 state\n");
/// ```
#[macro_export]
macro_rules! message {
    (
        $(#[$meta:meta])*
        $visibility:vis struct $name:ident = $package:literal / $ros:literal
        $(const { $($(#[$constant_meta:meta])* $constant:ident: $constant_kind:ty = $value:literal,)* })?
        {
            $($(#[$field_meta:meta])* $field:ident: $kind:ty $([$only:ident only])?,)*
        }
    ) => {
        $(#[$meta])*
        #[derive(Debug, Clone, PartialEq)]
        $visibility struct $name { $($(#[$field_meta])* pub $field: $kind,)* }

        impl $name {
            $($($(#[$constant_meta])* pub const $constant: $constant_kind = $value;)*)?
        }

        impl $crate::Message for $name {
            const ROS1_NAME: &'static str = concat!($package, "/", $ros);
            const ROS2_NAME: &'static str = concat!($package, "/msg/", $ros);

            fn description() -> $crate::Description {
                $crate::Description {
                    package: $package,
                    name: $ros,
                    constants: vec![$($($crate::Constant {
                        kind: <$constant_kind as $crate::Field>::field_type(),
                        name: stringify!($constant),
                        value: stringify!($value),
                    },)*)?],
                    fields: vec![$($crate::FieldDescription {
                        // ROS calls a field `type` that Rust calls `r#type`.
                        name: stringify!($field).trim_start_matches("r#"),
                        kind: <$kind as $crate::Field>::field_type(),
                        only: [$(Some($crate::Version::$only),)? None][0],
                    },)*],
                }
            }
        }

        impl $crate::Field for $name {
            const MIN_LEN: usize =
                0 $(+ $crate::min_len::<$kind>([$(Some($crate::Version::$only),)? None][0]))*;

            fn field_type() -> $crate::FieldType {
                $crate::FieldType::message(<Self as $crate::Message>::description())
            }

            fn encode(&self, writer: &mut $crate::Writer<'_>) {
                const FIELDS: &[&str] = &[$(stringify!($field)),*];
                if FIELDS.is_empty() {
                    writer.put_dummy();
                }
                $(if writer.version().has([$(Some($crate::Version::$only),)? None][0]) {
                    $crate::Field::encode(&self.$field, writer);
                })*
            }

            fn decode(reader: &mut $crate::Reader<'_>) -> Result<Self, $crate::DecodeError> {
                const FIELDS: &[&str] = &[$(stringify!($field)),*];
                if FIELDS.is_empty() {
                    reader.take_dummy()?;
                }
                Ok(Self { $($field: if reader.version().has([$(Some($crate::Version::$only),)? None][0]) {
                    $crate::Field::decode(reader)?
                } else {
                    <$kind as Default>::default()
                },)* })
            }
        }
    };
}
