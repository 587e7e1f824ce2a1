//! ROS 1's serialisation: little endian, packed, and a 32-bit count before whatever varies in length. Values know
//! their own encoding and what `.msg` text calls them, so that a message is declared once.
//!
//! Source: ROS wiki, "msg", section 2, and "roscpp/Overview/MessagesSerializationAndAdaptingTypes".

use std::borrow::Cow;

use crate::definition::Definition;

/// Why bytes are not the message that was asked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum DecodeError {
    /// They end early.
    #[error("the message ends {missing} bytes early")]
    Short {
        /// How many bytes are missing, at least.
        missing: usize,
    },
    /// A count says that more elements follow than the message has bytes for.
    #[error("an array claims {count} elements, and only {left} bytes follow")]
    Count {
        /// What it claims.
        count: usize,
        /// What follows.
        left: usize,
    },
    /// They go on behind the message.
    #[error("{count} bytes follow the message")]
    Trailing {
        /// How many.
        count: usize,
    },
}

/// What is left to be decoded.
#[derive(Debug, Clone)]
pub struct Reader<'a>(&'a [u8]);

impl<'a> Reader<'a> {
    /// Reads from the beginning of `bytes`.
    pub fn new(bytes: &'a [u8]) -> Self {
        Self(bytes)
    }

    /// How many bytes are left.
    pub fn left(&self) -> usize {
        self.0.len()
    }

    /// The next `count` bytes.
    ///
    /// # Errors
    /// [`DecodeError::Short`] if there are fewer.
    pub fn take(&mut self, count: usize) -> Result<&'a [u8], DecodeError> {
        let short = DecodeError::Short { missing: count.saturating_sub(self.0.len()) };
        let (taken, rest) = self.0.split_at_checked(count).ok_or(short)?;
        self.0 = rest;
        Ok(taken)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], DecodeError> {
        Ok(self.take(N)?.try_into().expect("`take` gives as many bytes as it is asked for"))
    }

    /// A count of elements that take `least` bytes each, at least; so none that would make anyone allocate for
    /// elements that cannot follow.
    fn count(&mut self, least: usize) -> Result<usize, DecodeError> {
        let count = u32::from_le_bytes(self.array()?) as usize;
        let left = self.left();
        if count > left / least.max(1) { Err(DecodeError::Count { count, left }) } else { Ok(count) }
    }
}

/// What `.msg` text calls a type.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FieldType {
    /// Such as `float32[]` or `std_msgs/Header`.
    pub name: Cow<'static, str>,
    /// Of the message that it is, or has as elements.
    pub message: Option<Definition>,
}

impl FieldType {
    const fn builtin(name: &'static str) -> Self {
        Self { name: Cow::Borrowed(name), message: None }
    }

    fn array(self, size: &str) -> Self {
        Self { name: Cow::Owned(format!("{}[{size}]", self.name)), ..self }
    }
}

/// A value that a ROS 1 message can hold. Implemented for what `.msg` text can say, and for messages by
/// [`message!`](crate::message!).
pub trait Field: Sized {
    /// The fewest bytes that it takes.
    const MIN_LEN: usize;

    /// What it is if nobody says: zero and empty, as in ROS.
    fn zero() -> Self;

    /// What `.msg` text calls it.
    fn field_type() -> FieldType;

    /// Appends it to `buffer`.
    fn encode(&self, buffer: &mut Vec<u8>);

    /// Reads one. Allocates in proportion to what is left to read, whatever is claimed.
    ///
    /// # Errors
    /// [`DecodeError`] if what follows is none.
    fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError>;

    /// Appends all of `values`, without their number.
    fn encode_all(values: &[Self], buffer: &mut Vec<u8>) {
        for value in values {
            value.encode(buffer);
        }
    }

    /// Reads `count` of them.
    ///
    /// # Errors
    /// [`DecodeError`] if what follows is not as many.
    fn decode_all(count: usize, reader: &mut Reader<'_>) -> Result<Vec<Self>, DecodeError> {
        (0..count).map(|_| Self::decode(reader)).collect()
    }
}

macro_rules! numbers {
    ($($kind:ident $ros:literal),*) => { $(
        impl Field for $kind {
            const MIN_LEN: usize = size_of::<Self>();

            fn zero() -> Self {
                Self::default()
            }

            fn field_type() -> FieldType {
                FieldType::builtin($ros)
            }

            fn encode(&self, buffer: &mut Vec<u8>) {
                buffer.extend_from_slice(&self.to_le_bytes());
            }

            fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
                Ok(Self::from_le_bytes(reader.array()?))
            }

            fn encode_all(values: &[Self], buffer: &mut Vec<u8>) {
                buffer.reserve(size_of_val(values));
                for value in values {
                    buffer.extend_from_slice(&value.to_le_bytes());
                }
            }

            // In one piece: scans and maps are long.
            fn decode_all(count: usize, reader: &mut Reader<'_>) -> Result<Vec<Self>, DecodeError> {
                let bytes = reader.take(count.saturating_mul(size_of::<Self>()))?;
                let (values, _) = bytes.as_chunks();
                Ok(values.iter().map(|value| Self::from_le_bytes(*value)).collect())
            }
        }
    )* };
}

numbers!(
    i8 "int8", u8 "uint8", i16 "int16", u16 "uint16", i32 "int32", u32 "uint32", i64 "int64", u64 "uint64",
    f32 "float32", f64 "float64"
);

impl Field for bool {
    const MIN_LEN: usize = 1;

    fn zero() -> Self {
        false
    }

    fn field_type() -> FieldType {
        FieldType::builtin("bool")
    }

    fn encode(&self, buffer: &mut Vec<u8>) {
        buffer.push(u8::from(*self));
    }

    fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        Ok(u8::decode(reader)? != 0)
    }
}

/// ROS 1 does not say how text is encoded. It is UTF-8 here; what is not is replaced by U+FFFD, so that a robot with a
/// strange name in one field is still heard.
impl Field for String {
    const MIN_LEN: usize = 4;

    fn zero() -> Self {
        Self::new()
    }

    fn field_type() -> FieldType {
        FieldType::builtin("string")
    }

    fn encode(&self, buffer: &mut Vec<u8>) {
        encode_count(self.len(), buffer);
        buffer.extend_from_slice(self.as_bytes());
    }

    fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        let count = reader.count(1)?;
        Ok(Self::from_utf8_lossy(reader.take(count)?).into_owned())
    }
}

/// An array of any length. Elements that take no bytes, which no message in use has, are refused when read.
impl<T: Field> Field for Vec<T> {
    const MIN_LEN: usize = 4;

    fn zero() -> Self {
        Self::new()
    }

    fn field_type() -> FieldType {
        T::field_type().array("")
    }

    fn encode(&self, buffer: &mut Vec<u8>) {
        encode_count(self.len(), buffer);
        T::encode_all(self, buffer);
    }

    fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        let count = reader.count(T::MIN_LEN)?;
        T::decode_all(count, reader)
    }
}

/// An array of fixed length, which has no count before it.
impl<T: Field, const N: usize> Field for [T; N] {
    const MIN_LEN: usize = N * T::MIN_LEN;

    fn zero() -> Self {
        std::array::from_fn(|_| T::zero())
    }

    fn field_type() -> FieldType {
        T::field_type().array(&N.to_string())
    }

    fn encode(&self, buffer: &mut Vec<u8>) {
        T::encode_all(self, buffer);
    }

    fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        let values = T::decode_all(N, reader)?;
        Ok(values
            .try_into()
            .unwrap_or_else(|_| unreachable!("`decode_all` gives as many as it is asked for")))
    }
}

/// A count, as it stands before what varies in length.
fn encode_count(count: usize, buffer: &mut Vec<u8>) {
    let count = u32::try_from(count).expect("a message of 4 GiB does not fit ROS, nor memory");
    count.encode(buffer);
}

/// A point in time: of the wall clock, or of `/clock`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub struct Time {
    /// Whole seconds.
    pub sec: u32,
    /// Nanoseconds on top, in 0..10⁹.
    pub nsec: u32,
}

impl Field for Time {
    const MIN_LEN: usize = 8;

    fn zero() -> Self {
        Self::default()
    }

    fn field_type() -> FieldType {
        FieldType::builtin("time")
    }

    fn encode(&self, buffer: &mut Vec<u8>) {
        self.sec.encode(buffer);
        self.nsec.encode(buffer);
    }

    fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        Ok(Self { sec: u32::decode(reader)?, nsec: u32::decode(reader)? })
    }
}

/// A span of time, which may be negative.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub struct Duration {
    /// Whole seconds.
    pub sec: i32,
    /// Nanoseconds on top, in 0..10⁹.
    pub nsec: i32,
}

impl Field for Duration {
    const MIN_LEN: usize = 8;

    fn zero() -> Self {
        Self::default()
    }

    fn field_type() -> FieldType {
        FieldType::builtin("duration")
    }

    fn encode(&self, buffer: &mut Vec<u8>) {
        self.sec.encode(buffer);
        self.nsec.encode(buffer);
    }

    fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        Ok(Self { sec: i32::decode(reader)?, nsec: i32::decode(reader)? })
    }
}
