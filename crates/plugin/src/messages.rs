//! The ROS 2 messages that robots and VNFs exchange, and their CDR encoding, so that what crosses the network has the
//! size and the cost of the real thing and any ROS tool can read it.
//!
//! Types and field order follow ROS 2 (Jazzy). Units are REP 103's: metres, radians, seconds.

use cdr_encoding::CdrSerializer;
use serde::{Serialize, de::DeserializeOwned};

mod array;
mod convert;
mod description;
mod geometry;
mod robot;
mod sensors;

pub use description::{Byte, Description, Field, FieldType};
pub use geometry::*;
pub use robot::*;
pub use sensors::*;

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

    /// What it is made of.
    fn description() -> Description;

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

/// Declares a message: a struct with public fields in the order of the `.msg` file. Encoding, type hash and definition
/// follow. Who uses it depends on `serde`.
#[macro_export]
macro_rules! message {
    (
        $(#[$meta:meta])*
        pub struct $name:ident = $ros:literal { $($(#[$field_meta:meta])* $field:ident: $kind:ty,)* }
    ) => {
        $(#[$meta])*
        #[derive(Debug, Clone, PartialEq, ::serde::Serialize, ::serde::Deserialize)]
        pub struct $name { $($(#[$field_meta])* pub $field: $kind,)* }

        impl $crate::messages::Message for $name {
            const TYPE_NAME: &'static str = $ros;

            fn description() -> $crate::messages::Description {
                $crate::messages::Description {
                    type_name: $ros,
                    // `r#type` is a field that ROS calls `type`.
                    fields: vec![$((
                        stringify!($field).trim_start_matches("r#"),
                        <$kind as $crate::messages::Field>::field_type(),
                    ),)*],
                }
            }
        }

        impl $crate::messages::Field for $name {
            fn field_type() -> $crate::messages::FieldType {
                $crate::messages::FieldType::message(<Self as $crate::messages::Message>::description())
            }
        }
    };
}
pub use message;

#[cfg(test)]
mod tests;
