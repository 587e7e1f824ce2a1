//! Encodings of fields.

use std::array;

use crate::{
    codec::{DecodeError, Reader, Version, Writer},
    description::FieldType,
};

/// A value that a message can hold. [`message!`](crate::message!) implements it for messages.
pub trait Field: Sized {
    /// Fewest bytes that a value takes in either encoding.
    const MIN_LEN: usize;

    /// Describes the type.
    fn field_type() -> FieldType;

    /// Appends the value.
    fn encode(&self, writer: &mut Writer<'_>);

    /// Reads a value. Allocates in proportion to the remaining bytes, whatever a count claims.
    ///
    /// # Errors
    /// [`DecodeError`] if the next bytes are not a value of this type.
    fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError>;

    /// Appends all of `values`, without their count.
    fn encode_all(values: &[Self], writer: &mut Writer<'_>) {
        values.iter().for_each(|value| value.encode(writer));
    }

    /// Reads `count` values.
    ///
    /// # Errors
    /// [`DecodeError`] if the next bytes are not that many values of this type.
    fn decode_all(count: usize, reader: &mut Reader<'_>) -> Result<Vec<Self>, DecodeError> {
        (0..count).map(|_| Self::decode(reader)).collect()
    }
}

/// Fewest bytes of a field that only one version may have.
#[doc(hidden)]
pub const fn min_len<T: Field>(only: Option<Version>) -> usize {
    if only.is_none() { T::MIN_LEN } else { 0 }
}

macro_rules! builtin {
    ($name:literal $id:literal) => {
        fn field_type() -> FieldType {
            FieldType::builtin($name, $id)
        }
    };
}

macro_rules! numbers {
    ($($kind:ident $name:literal $id:literal),*) => { $(
        impl Field for $kind {
            const MIN_LEN: usize = size_of::<Self>();

            builtin!($name $id);

            fn encode(&self, writer: &mut Writer<'_>) {
                writer.put_number(self.to_le_bytes());
            }

            fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
                Ok(Self::from_le_bytes(reader.take_number()?))
            }

            // At once: scans, maps and images are long.
            fn encode_all(values: &[Self], writer: &mut Writer<'_>) {
                let (slots, _) = writer.put_numbers(values.len(), size_of::<Self>()).as_chunks_mut();
                for (slot, value) in slots.iter_mut().zip(values) {
                    *slot = value.to_le_bytes();
                }
            }

            fn decode_all(count: usize, reader: &mut Reader<'_>) -> Result<Vec<Self>, DecodeError> {
                let (values, _) = reader.take_numbers(count, size_of::<Self>())?.as_chunks();
                Ok(if reader.is_big_endian() {
                    values.iter().map(|value| Self::from_be_bytes(*value)).collect()
                } else {
                    values.iter().map(|value| Self::from_le_bytes(*value)).collect()
                })
            }
        }
    )* };
}

numbers!(
    i8 "int8" 2, u8 "uint8" 3, i16 "int16" 4, u16 "uint16" 5, i32 "int32" 6, u32 "uint32" 7, i64 "int64" 8,
    u64 "uint64" 9, f32 "float32" 10, f64 "float64" 11
);

impl Field for bool {
    const MIN_LEN: usize = 1;

    builtin!("bool" 15);

    fn encode(&self, writer: &mut Writer<'_>) {
        writer.put(&[u8::from(*self)]);
    }

    fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        match (u8::decode(reader)?, reader.version()) {
            (flag @ 2.., Version::Ros2) => Err(DecodeError::Bool(flag)),
            (flag, _) => Ok(flag != 0),
        }
    }
}

/// ROS's `byte`, a type of its own beside `uint8`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Byte(pub u8);

impl Field for Byte {
    const MIN_LEN: usize = 1;

    builtin!("byte" 16);

    fn encode(&self, writer: &mut Writer<'_>) {
        self.0.encode(writer);
    }

    fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        Ok(Self(u8::decode(reader)?))
    }
}

/// UTF-8. ROS 1 does not define an encoding, so other bytes are replaced by U+FFFD there: a robot with one strange name
/// is still received. In ROS 2 they are an error.
impl Field for String {
    const MIN_LEN: usize = 4;

    builtin!("string" 17);

    fn encode(&self, writer: &mut Writer<'_>) {
        match writer.version() {
            Version::Ros1 => {
                writer.put_count(self.len());
                writer.put(self.as_bytes());
            }
            Version::Ros2 => {
                writer.put_count(self.len() + 1);
                writer.put(self.as_bytes());
                writer.put(&[0]);
            }
        }
    }

    fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        let count = reader.take_count(1)?;
        let bytes = reader.take(count)?;
        match reader.version() {
            Version::Ros1 => Ok(Self::from_utf8_lossy(bytes).into_owned()),
            Version::Ros2 => {
                // Some writers send empty text without the zero byte.
                let text = bytes.split_last().map_or(bytes, |(_, text)| text);
                str::from_utf8(text).map(str::to_owned).map_err(|_| DecodeError::Text)
            }
        }
    }
}

/// An array of variable length.
impl<T: Field> Field for Vec<T> {
    const MIN_LEN: usize = 4;

    fn field_type() -> FieldType {
        T::field_type().sequence()
    }

    fn encode(&self, writer: &mut Writer<'_>) {
        writer.put_count(self.len());
        T::encode_all(self, writer);
    }

    fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        let count = reader.take_count(T::MIN_LEN)?;
        T::decode_all(count, reader)
    }
}

/// An array of fixed length, without a count.
impl<T: Field, const N: usize> Field for [T; N] {
    const MIN_LEN: usize = N * T::MIN_LEN;

    fn field_type() -> FieldType {
        T::field_type().array(N)
    }

    fn encode(&self, writer: &mut Writer<'_>) {
        T::encode_all(self, writer);
    }

    fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        let mut values = T::decode_all(N, reader)?.into_iter();
        Ok(array::from_fn(|_| values.next().expect("`decode_all` returns as many values as asked")))
    }
}
