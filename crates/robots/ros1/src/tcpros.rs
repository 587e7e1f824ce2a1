//! TCPROS, in which messages and service calls travel: connection headers, and frames out of a stream of bytes.
//!
//! Source: ROS wiki, "ROS/TCPROS" and "ROS/Connection Header".

use std::{collections::BTreeMap, io, ops::Range};

/// A connection header is no longer.
pub const MAX_HEADER_LEN: usize = 1 << 20;
/// A message is no longer; a map of 8,000 × 8,000 cells still fits.
pub const MAX_MESSAGE_LEN: usize = 64 << 20;
/// Bytes of the length before each frame.
pub const LENGTH_LEN: usize = 4;

/// Why bytes are no TCPROS.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum TcprosError {
    /// A frame is longer than is let in.
    #[error("a frame of {length} bytes is over the limit of {limit}")]
    LongFrame {
        /// What it claims.
        length: usize,
        /// What is let in.
        limit: usize,
    },
    /// A header's field ends beyond the header.
    #[error("a field of the connection header ends beyond it")]
    FieldLength,
    /// A header's field has no `=`.
    #[error("a field of the connection header is no `name=value`")]
    Field,
}

/// The fields of a connection header. Values that are no UTF-8 are replaced, as in messages.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Header(BTreeMap<String, String>);

impl Header {
    /// A header of those fields.
    pub fn new<const N: usize>(fields: [(&str, &str); N]) -> Self {
        Self(fields.into_iter().map(|(name, value)| (name.to_owned(), value.to_owned())).collect())
    }

    /// The value of a field.
    pub fn get(&self, name: &str) -> Option<&str> {
        self.0.get(name).map(String::as_str)
    }

    /// Whether a field says yes, which it does by `1`.
    pub fn flag(&self, name: &str) -> bool {
        self.get(name) == Some("1")
    }

    /// As a frame, with its length.
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

    /// From a frame, without its length.
    ///
    /// # Errors
    /// [`TcprosError`] if it is none.
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

/// A frame: what `write` appends, behind its length.
pub fn frame(write: impl FnOnce(&mut Vec<u8>)) -> Vec<u8> {
    let mut buffer = vec![0; LENGTH_LEN];
    write(&mut buffer);
    let length =
        u32::try_from(buffer.len() - LENGTH_LEN).expect("a frame of 4 GiB does not fit ROS, nor memory");
    buffer[..LENGTH_LEN].copy_from_slice(&length.to_le_bytes());
    buffer
}

/// Frames out of a stream of bytes. Memory grows with what arrived, not with what a length claims.
#[derive(Debug)]
pub struct FrameReader {
    /// Zeroed, so that there is always room to read into.
    buffer: Vec<u8>,
    /// What of it arrived and was not taken.
    filled: Range<usize>,
    limit: usize,
}

impl FrameReader {
    const ROOM: usize = 16 << 10;

    /// From the beginning of a stream; frames are no longer than `limit`.
    pub fn new(limit: usize) -> Self {
        Self { buffer: Vec::new(), filled: 0..0, limit }
    }

    /// From now on, frames are no longer than that.
    pub fn set_limit(&mut self, limit: usize) {
        self.limit = limit;
    }

    /// Reads once, as much as `source` gives at once. Returns how much that was; zero at its end.
    ///
    /// # Errors
    /// What `source` fails with.
    pub fn read_from(&mut self, source: &mut impl io::Read) -> io::Result<usize> {
        if self.filled.is_empty() {
            self.filled = 0..0;
            // What a long message took is not kept for short ones.
            if self.buffer.len() > 64 * Self::ROOM {
                self.buffer = Vec::new();
            }
        }
        if self.filled.end == self.buffer.len() && self.filled.start > 0 {
            self.buffer.copy_within(self.filled.clone(), 0);
            self.filled = 0..self.filled.len();
        }
        if self.filled.end == self.buffer.len() {
            let room = (2 * self.buffer.len()).max(Self::ROOM);
            self.buffer.resize(room, 0);
        }
        let read = source.read(&mut self.buffer[self.filled.end..])?;
        self.filled.end += read;
        Ok(read)
    }

    /// The next frame, without its length; `None` if more of it is to come.
    ///
    /// # Errors
    /// [`TcprosError::LongFrame`]; the stream is of no use from then on.
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
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn a_header_is_the_one_of_the_specification() {
        // The example of the wiki's "ROS/Connection Header", its first two fields.
        let header = Header::new([("callerid", "/a"), ("topic", "/b")]);
        let bytes = b"\x1b\0\0\0\x0b\0\0\0callerid=/a\x08\0\0\0topic=/b";
        assert_eq!(header.to_frame(), bytes);
        assert_eq!(Header::from_bytes(&bytes[4..]), Ok(header));
    }

    #[test]
    fn a_value_may_hold_what_separates() {
        let header = Header::new([("message_definition", "uint8 A=1\nuint8 b\n")]);
        assert_eq!(Header::from_bytes(&header.to_frame()[4..]), Ok(header));
    }

    #[test]
    fn headers_that_lie_are_refused() {
        assert_eq!(Header::from_bytes(b"\xff\xff\xff\xffa=b"), Err(TcprosError::FieldLength));
        assert_eq!(Header::from_bytes(b"\x03\0"), Err(TcprosError::FieldLength));
        assert_eq!(Header::from_bytes(b"\x03\0\0\0abc"), Err(TcprosError::Field));
    }

    #[test]
    fn a_long_frame_is_refused_before_it_arrives() {
        let mut frames = FrameReader::new(10);
        frames.read_from(&mut [11, 0, 0, 0].as_slice()).unwrap();
        assert_eq!(frames.next_frame(), Err(TcprosError::LongFrame { length: 11, limit: 10 }));
    }

    /// A stream that gives so many bytes at a time.
    struct Pieces<'a>(&'a [u8], std::iter::Cycle<std::slice::Iter<'a, usize>>);

    impl io::Read for Pieces<'_> {
        fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
            let count = (*self.1.next().unwrap()).min(buffer.len());
            self.0.read(&mut buffer[..count])
        }
    }

    proptest! {
        #[test]
        fn frames_come_out_as_they_went_in(
            messages in proptest::collection::vec(proptest::collection::vec(any::<u8>(), 0..50_000), 0..6),
            sizes in proptest::collection::vec(1usize..40_000, 1..5),
        ) {
            let bytes: Vec<u8> = messages.iter().flat_map(|m| frame(|buffer| buffer.extend_from_slice(m))).collect();
            let mut source = Pieces(&bytes, sizes.iter().cycle());
            let mut frames = FrameReader::new(MAX_MESSAGE_LEN);
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
            let mut frames = FrameReader::new(100);
            frames.read_from(&mut bytes.as_slice()).unwrap();
            while let Ok(Some(_)) = frames.next_frame() {}
        }
    }
}
