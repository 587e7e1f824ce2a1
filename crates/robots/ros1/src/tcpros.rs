//! TCPROS, the protocol of messages and service calls: connection headers, and frames in a stream of bytes.
//!
//! Source: ROS wiki, "ROS/TCPROS" and "ROS/Connection Header".

use std::{collections::BTreeMap, io, ops::Range};

use crate::buffers::Buffers;

/// Longest connection header, bytes.
pub const MAX_HEADER_LEN: usize = 1 << 20;
/// Longest message, bytes. A map of 8,000 × 8,000 cells fits.
pub const MAX_MESSAGE_LEN: usize = 64 << 20;
/// Size of the length before each frame, bytes.
pub const LENGTH_LEN: usize = 4;

/// Reason why bytes are not TCPROS.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum TcprosError {
    /// A frame is longer than the limit.
    #[error("a frame of {length} bytes is over the limit of {limit}")]
    LongFrame {
        /// Claimed length, bytes.
        length: usize,
        /// The limit, bytes.
        limit: usize,
    },
    /// A field of the header ends beyond it.
    #[error("a field of the connection header ends beyond it")]
    FieldLength,
    /// A field of the header has no `=`.
    #[error("a field of the connection header is not `name=value`")]
    Field,
}

/// The fields of a connection header. Bytes that are not UTF-8 are replaced, as in messages.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Header(BTreeMap<String, String>);

impl Header {
    /// A header with these fields.
    pub fn new<const N: usize>(fields: [(&str, &str); N]) -> Self {
        Self(fields.into_iter().map(|(name, value)| (name.to_owned(), value.to_owned())).collect())
    }

    /// Returns the value of a field.
    pub fn get(&self, name: &str) -> Option<&str> {
        self.0.get(name).map(String::as_str)
    }

    /// Whether a field is `1`.
    pub fn flag(&self, name: &str) -> bool {
        self.get(name) == Some("1")
    }

    /// Encodes the header as a frame, with its length.
    pub fn to_frame(&self) -> Vec<u8> {
        frame(|buffer| {
            for (name, value) in &self.0 {
                let length = u32::try_from(name.len() + 1 + value.len()).unwrap_or(u32::MAX);
                buffer.extend_from_slice(&length.to_le_bytes());
                buffer.extend_from_slice(name.as_bytes());
                buffer.push(b'=');
                buffer.extend_from_slice(value.as_bytes());
            }
        })
    }

    /// Decodes a frame without its length.
    ///
    /// # Errors
    /// [`TcprosError`] if it is not a connection header.
    pub fn from_bytes(mut bytes: &[u8]) -> Result<Self, TcprosError> {
        let mut fields = BTreeMap::new();
        while !bytes.is_empty() {
            let (length, rest) = bytes.split_first_chunk().ok_or(TcprosError::FieldLength)?;
            let length = u32::from_le_bytes(*length) as usize;
            let (field, rest) = rest.split_at_checked(length).ok_or(TcprosError::FieldLength)?;
            let equals = field.iter().position(|byte| *byte == b'=').ok_or(TcprosError::Field)?;
            let text = |bytes| String::from_utf8_lossy(bytes).into_owned();
            fields.insert(text(&field[..equals]), text(&field[equals + 1..]));
            bytes = rest;
        }
        Ok(Self(fields))
    }
}

/// Builds a frame of the bytes that `write` appends, with their length in front.
pub fn frame(write: impl FnOnce(&mut Vec<u8>)) -> Vec<u8> {
    let mut buffer = vec![0; LENGTH_LEN];
    write(&mut buffer);
    let length =
        u32::try_from(buffer.len() - LENGTH_LEN).expect("a frame of 4 GiB does not fit ROS, nor memory");
    buffer[..LENGTH_LEN].copy_from_slice(&length.to_le_bytes());
    buffer
}

/// Splits a stream of bytes into frames. Memory grows with received bytes, not with claimed lengths.
#[derive(Debug)]
pub struct FrameReader {
    /// Zeroed, so that there is always room for reading.
    buffer: Vec<u8>,
    /// Received bytes that were not taken.
    filled: Range<usize>,
    limit: usize,
    /// Size that the buffer counts as.
    held: Buffers,
}

impl FrameReader {
    const ROOM: usize = 16 << 10;

    /// Starts at the beginning of a stream. Frames have `limit` bytes at most.
    pub fn new(limit: usize, held: Buffers) -> Self {
        Self { buffer: Vec::new(), filled: 0..0, limit, held }
    }

    /// Changes the limit for the next frames.
    pub fn set_limit(&mut self, limit: usize) {
        self.limit = limit;
    }

    /// Reads from `source` once. Returns the number of bytes; zero at its end.
    ///
    /// # Errors
    /// The error of `source`; `OutOfMemory` if its peer has no room for a longer buffer.
    pub fn read_from(&mut self, source: &mut impl io::Read) -> io::Result<usize> {
        if self.filled.is_empty() {
            self.filled = 0..0;
            // Frees the memory of a long message.
            if self.buffer.len() > 64 * Self::ROOM {
                self.buffer = Vec::new();
                self.held.hold(0);
            }
        }
        if self.filled.end == self.buffer.len() && self.filled.start > 0 {
            self.buffer.copy_within(self.filled.clone(), 0);
            self.filled = 0..self.filled.len();
        }
        if self.filled.end == self.buffer.len() {
            let room = (2 * self.buffer.len()).max(Self::ROOM);
            if !self.held.hold(room) {
                let reason = "its messages under way take all room";
                return Err(io::Error::new(io::ErrorKind::OutOfMemory, reason));
            }
            self.buffer.resize(room, 0);
        }
        let read = source.read(&mut self.buffer[self.filled.end..])?;
        self.filled.end += read;
        Ok(read)
    }

    /// Returns the next frame without its length, or `None` if it is incomplete.
    ///
    /// # Errors
    /// [`TcprosError::LongFrame`]. The stream cannot be used any more.
    pub fn next_frame(&mut self) -> Result<Option<&[u8]>, TcprosError> {
        let bytes = &self.buffer[self.filled.clone()];
        let Some((length, rest)) = bytes.split_first_chunk() else { return Ok(None) };
        let length = u32::from_le_bytes(*length) as usize;
        if length > self.limit {
            return Err(TcprosError::LongFrame { length, limit: self.limit });
        }
        if rest.len() < length {
            return Ok(None);
        }
        let start = self.filled.start + LENGTH_LEN;
        self.filled.start = start + length;
        Ok(Some(&self.buffer[start..start + length]))
    }
}

#[cfg(test)]
mod tests {
    use std::net::Ipv4Addr;

    use proptest::prelude::*;

    use super::*;
    use crate::buffers::Held;

    fn held() -> Buffers {
        Buffers::new(&Held::new(usize::MAX, usize::MAX), Ipv4Addr::LOCALHOST.into())
    }

    #[test]
    fn a_message_takes_no_more_room_than_its_peer_has() {
        let held = Held::new(usize::MAX, 100_000);
        let mut readers = [0, 1].map(|last| {
            let held = Buffers::new(&held, Ipv4Addr::new(10, 77, 0, last).into());
            FrameReader::new(MAX_MESSAGE_LEN, held)
        });
        // A message of 64 MiB that never ends.
        let [endless, other] = &mut readers;
        let begin = (MAX_MESSAGE_LEN as u32).to_le_bytes();
        endless.read_from(&mut &begin[..]).unwrap();
        let error = loop {
            if let Err(error) = endless.read_from(&mut io::repeat(7)) {
                break error;
            }
        };
        assert_eq!(error.kind(), io::ErrorKind::OutOfMemory);
        other.read_from(&mut &[1, 0, 0, 0, 9][..]).unwrap();
        assert_eq!(other.next_frame().unwrap(), Some(&[9][..]), "another peer");
    }

    #[test]
    fn header_equals_that_of_the_specification() {
        // Source: the first two fields of the example in the wiki's "ROS/Connection Header".
        let header = Header::new([("callerid", "/a"), ("topic", "/b")]);
        let bytes = b"\x1b\0\0\0\x0b\0\0\0callerid=/a\x08\0\0\0topic=/b";
        assert_eq!(header.to_frame(), bytes);
        assert_eq!(Header::from_bytes(&bytes[4..]), Ok(header));
    }

    #[test]
    fn values_may_contain_the_separator() {
        let header = Header::new([("message_definition", "uint8 A=1\nuint8 b\n")]);
        assert_eq!(Header::from_bytes(&header.to_frame()[4..]), Ok(header));
    }

    #[test]
    fn headers_with_false_lengths_are_rejected() {
        assert_eq!(Header::from_bytes(b"\xff\xff\xff\xffa=b"), Err(TcprosError::FieldLength));
        assert_eq!(Header::from_bytes(b"\x03\0"), Err(TcprosError::FieldLength));
        assert_eq!(Header::from_bytes(b"\x03\0\0\0abc"), Err(TcprosError::Field));
    }

    #[test]
    fn long_frames_are_rejected_before_they_arrive() {
        let mut frames = FrameReader::new(10, held());
        frames.read_from(&mut [11, 0, 0, 0].as_slice()).unwrap();
        assert_eq!(frames.next_frame(), Err(TcprosError::LongFrame { length: 11, limit: 10 }));
    }

    /// A stream that returns a number of bytes at a time.
    struct Pieces<'a>(&'a [u8], std::iter::Cycle<std::slice::Iter<'a, usize>>);

    impl io::Read for Pieces<'_> {
        fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
            let count = (*self.1.next().unwrap()).min(buffer.len());
            self.0.read(&mut buffer[..count])
        }
    }

    /// Returns so many bytes that count up. Drawing each would take seconds.
    fn counting((length, first): (u32, u8)) -> Vec<u8> {
        (0..length).map(|place| first.wrapping_add((place % 251) as u8)).collect()
    }

    proptest! {
        #[test]
        fn frames_come_out_as_they_went_in(
            messages in proptest::collection::vec((0..50_000u32, any::<u8>()).prop_map(counting), 0..6),
            sizes in proptest::collection::vec(1usize..40_000, 1..5),
        ) {
            let bytes: Vec<u8> = messages.iter().flat_map(|m| frame(|buffer| buffer.extend_from_slice(m))).collect();
            let mut source = Pieces(&bytes, sizes.iter().cycle());
            let mut frames = FrameReader::new(MAX_MESSAGE_LEN, held());
            let mut read = Vec::new();
            while frames.read_from(&mut source).unwrap() > 0 {
                while let Some(message) = frames.next_frame().unwrap() {
                    read.push(message.to_vec());
                }
            }
            prop_assert_eq!(read, messages);
        }

        #[test]
        fn no_bytes_panic(bytes in any::<Vec<u8>>()) {
            let _ = Header::from_bytes(&bytes);
            let mut frames = FrameReader::new(100, held());
            frames.read_from(&mut bytes.as_slice()).unwrap();
            while let Ok(Some(_)) = frames.next_frame() {}
        }
    }
}
