//! The two encodings of ROS messages. [`Writer`] and [`Reader`] hide what differs between them.
//!
//! ROS 1 packs values in little endian, with a 32-bit count before text and arrays of variable length. ROS 2 has plain
//! CDR (XCDR1): the same, but each number is aligned to its size, text ends with a zero byte that its count includes,
//! and the byte order is the sender's.
//!
//! Sources: ROS wiki, "msg", section 2, and "roscpp/Overview/MessagesSerializationAndAdaptingTypes"; DDSI-RTPS 2.5,
//! 10.2; DDS-XTypes 1.3, 7.4.1.

/// A generation of ROS, with its encoding and its names.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Version {
    /// ROS 1, Noetic.
    Ros1,
    /// ROS 2, Jazzy.
    Ros2,
}

impl Version {
    /// Whether this version has a field that only `only` has; `None` stands for both.
    pub fn has(self, only: Option<Self>) -> bool {
        only.is_none_or(|only| only == self)
    }
}

/// Reason why bytes are not the expected message.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum DecodeError {
    /// CDR without an encapsulation header, or another encoding than plain CDR.
    #[error(
        "a message begins with the encapsulation header of plain CDR, 00 00 or 00 01 and two bytes of options"
    )]
    Encapsulation,
    /// The message ends early.
    #[error("the message ends {missing} bytes early")]
    Short {
        /// Missing bytes, at least.
        missing: usize,
    },
    /// A count claims more elements than the remaining bytes can hold.
    #[error("an array claims {count} elements, and only {left} bytes follow")]
    Count {
        /// Claimed elements.
        count: usize,
        /// Remaining bytes.
        left: usize,
    },
    /// CDR text that is not UTF-8.
    #[error("the message has text that is not UTF-8")]
    Text,
    /// A CDR flag other than 0 and 1.
    #[error("a flag is 0 or 1, not {0}")]
    Bool(u8),
    /// More bytes follow the message than padding explains.
    #[error("{count} bytes follow the message")]
    Trailing {
        /// Number of those bytes.
        count: usize,
    },
}

/// Appends values to a buffer.
#[derive(Debug)]
pub struct Writer<'a> {
    buffer: &'a mut Vec<u8>,
    /// Position from which alignment counts.
    start: usize,
    version: Version,
}

impl<'a> Writer<'a> {
    /// Writes behind what `buffer` holds. Alignment counts from there.
    pub fn new(version: Version, buffer: &'a mut Vec<u8>) -> Self {
        Self { start: buffer.len(), buffer, version }
    }

    /// The version whose encoding is written.
    pub fn version(&self) -> Version {
        self.version
    }

    /// Appends bytes as they are.
    pub fn put(&mut self, bytes: &[u8]) {
        self.buffer.extend_from_slice(bytes);
    }

    /// Appends the member that a ROS 2 message without fields has in CDR.
    #[doc(hidden)]
    pub fn put_dummy(&mut self) {
        if self.version == Version::Ros2 {
            self.buffer.push(0);
        }
    }

    pub(crate) fn put_number<const N: usize>(&mut self, little_endian: [u8; N]) {
        self.align(N);
        self.put(&little_endian);
    }

    /// Room for so many numbers of `size` bytes.
    pub(crate) fn put_numbers(&mut self, count: usize, size: usize) -> &mut [u8] {
        if count > 0 {
            self.align(size);
        }
        let from = self.buffer.len();
        self.buffer.resize(from + count * size, 0);
        &mut self.buffer[from..]
    }

    /// Appends the count before text or an array.
    pub(crate) fn put_count(&mut self, count: usize) {
        let count = u32::try_from(count).expect("a message of 4 GiB fits neither ROS nor memory");
        self.put_number(count.to_le_bytes());
    }

    fn align(&mut self, size: usize) {
        if self.version == Version::Ros2 {
            let end = self.start + (self.buffer.len() - self.start).next_multiple_of(size);
            self.buffer.resize(end, 0);
        }
    }
}

/// Takes values from the bytes of a message.
#[derive(Debug, Clone)]
pub struct Reader<'a> {
    bytes: &'a [u8],
    /// Bytes taken so far, from which alignment counts.
    taken: usize,
    version: Version,
    big_endian: bool,
}

impl<'a> Reader<'a> {
    /// Reads from the beginning of `bytes`, which are little endian.
    pub fn new(version: Version, bytes: &'a [u8]) -> Self {
        Self { bytes, taken: 0, version, big_endian: false }
    }

    /// Reads CDR in big endian.
    pub(crate) fn big_endian(bytes: &'a [u8]) -> Self {
        Self { big_endian: true, ..Self::new(Version::Ros2, bytes) }
    }

    /// The version whose encoding is read.
    pub fn version(&self) -> Version {
        self.version
    }

    pub(crate) fn is_big_endian(&self) -> bool {
        self.big_endian
    }

    /// Number of remaining bytes.
    pub fn left(&self) -> usize {
        self.bytes.len()
    }

    /// Takes the next `count` bytes.
    ///
    /// # Errors
    /// [`DecodeError::Short`] if there are fewer.
    pub fn take(&mut self, count: usize) -> Result<&'a [u8], DecodeError> {
        let short = DecodeError::Short { missing: count.saturating_sub(self.bytes.len()) };
        let (taken, rest) = self.bytes.split_at_checked(count).ok_or(short)?;
        self.bytes = rest;
        self.taken += count;
        Ok(taken)
    }

    /// Takes the member that a ROS 2 message without fields has in CDR.
    ///
    /// # Errors
    /// [`DecodeError::Short`] if it is missing.
    #[doc(hidden)]
    pub fn take_dummy(&mut self) -> Result<(), DecodeError> {
        if self.version == Version::Ros2 { self.take(1).map(drop) } else { Ok(()) }
    }

    /// Takes a number, as little endian.
    pub(crate) fn take_number<const N: usize>(&mut self) -> Result<[u8; N], DecodeError> {
        self.align(N)?;
        let mut bytes: [u8; N] = self.take(N)?.try_into().expect("`take` returns as many bytes as asked");
        if self.big_endian {
            bytes.reverse();
        }
        Ok(bytes)
    }

    /// Takes so many numbers of `size` bytes, in the message's byte order.
    pub(crate) fn take_numbers(&mut self, count: usize, size: usize) -> Result<&'a [u8], DecodeError> {
        if count > 0 {
            self.align(size)?;
        }
        self.take(count.saturating_mul(size))
    }

    /// Takes a count of elements that have `least` bytes each, at least. Rejects a count that the remaining bytes
    /// cannot hold, so that it is not allocated for.
    pub(crate) fn take_count(&mut self, least: usize) -> Result<usize, DecodeError> {
        let count = u32::from_le_bytes(self.take_number()?) as usize;
        let left = self.left();
        if count > left / least.max(1) { Err(DecodeError::Count { count, left }) } else { Ok(count) }
    }

    fn align(&mut self, size: usize) -> Result<(), DecodeError> {
        match self.version {
            Version::Ros1 => Ok(()),
            Version::Ros2 => self.take(self.taken.next_multiple_of(size) - self.taken).map(drop),
        }
    }
}
