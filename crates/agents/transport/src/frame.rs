//! Format of a connection, in both directions: a kind (one byte), a length (four bytes, big endian), and so many bytes.

use std::io::{self, Write};

/// Bytes before those of the message.
const HEADER: usize = 5;
/// Longest message, bytes. The protocol has a lower bound for most.
pub const LONGEST: usize = 1 << 20;

/// Kind of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum Kind {
    /// Nothing: this end is there.
    Quiet,
    /// The name of an agent, which it says first.
    Hello,
    /// The number of the agent's process, eight bytes, big endian.
    Alive,
    /// To the core: a `Report`.
    Report,
    /// To the core: a `MachineReading`.
    Context,
    /// To the core: a `RobotReading`.
    Reading,
    /// To the core: a `RobotTurn`.
    Turn,
    /// To the core: a [number](numbered), and the SHA-256 of a file in hexadecimal digits.
    Fetch,
    /// To an agent: a `Wanted`.
    Wanted,
    /// To an agent: a `Beat`.
    Beat,
    /// To an agent: a `RobotCommand`.
    Command,
    /// To an agent: the number of a `Fetch`, and the next bytes of the file; none at its end.
    Part,
    /// To an agent: the number of a `Fetch` that fails.
    Missing,
}

impl Kind {
    /// All kinds, by their numbers.
    pub const ALL: [Self; 13] = [
        Self::Quiet,
        Self::Hello,
        Self::Alive,
        Self::Report,
        Self::Context,
        Self::Reading,
        Self::Turn,
        Self::Fetch,
        Self::Wanted,
        Self::Beat,
        Self::Command,
        Self::Part,
        Self::Missing,
    ];
}

/// A kind and its message.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Frame {
    pub kind: Kind,
    pub message: Vec<u8>,
}

impl Frame {
    /// Writes the frame. A frame that another end would reject is written all the same.
    ///
    /// # Errors
    /// That of the writer.
    pub fn write(&self, mut to: impl Write) -> io::Result<()> {
        let length = u32::try_from(self.message.len()).map_err(io::Error::other)?;
        let mut header = [self.kind as u8; HEADER];
        header[1..].copy_from_slice(&length.to_be_bytes());
        to.write_all(&header)?;
        to.write_all(&self.message)
    }
}

/// Returns the message of a [`Kind::Fetch`], [`Kind::Part`] or [`Kind::Missing`].
pub fn numbered(number: u32, rest: &[u8]) -> Vec<u8> {
    [&number.to_be_bytes()[..], rest].concat()
}

/// Splits the message that [`numbered`] made.
pub fn number(message: &[u8]) -> Option<(u32, &[u8])> {
    let (number, rest) = message.split_first_chunk()?;
    Some((u32::from_be_bytes(*number), rest))
}

/// Bytes that are no frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum FrameError {
    #[error("a message of unknown kind {0}")]
    Kind(u8),
    #[error("a message of {length} bytes, of at most {longest}")]
    TooLong { length: usize, longest: usize },
}

/// Finds the frames in a stream of bytes.
#[derive(Debug, Default)]
pub struct Decoder {
    bytes: Vec<u8>,
    /// Bytes of these that belong to frames that were returned.
    taken: usize,
}

impl Decoder {
    /// Takes the next bytes of the stream.
    pub fn push(&mut self, bytes: &[u8]) {
        self.bytes.drain(..std::mem::take(&mut self.taken));
        self.bytes.extend_from_slice(bytes);
    }

    /// Returns the next frame; `None` before it is complete.
    ///
    /// # Errors
    /// [`FrameError`] as soon as a header is not valid, or its message would be longer than `longest` bytes. The stream is of
    /// no use then.
    pub fn poll(&mut self, longest: usize) -> Result<Option<Frame>, FrameError> {
        let Some((header, rest)) = self.bytes[self.taken..].split_first_chunk::<HEADER>() else {
            return Ok(None);
        };
        let [kind, length @ ..] = *header;
        let kind = *Kind::ALL.get(usize::from(kind)).ok_or(FrameError::Kind(kind))?;
        let length = u32::from_be_bytes(length) as usize;
        if length > longest {
            return Err(FrameError::TooLong { length, longest });
        }
        let Some(message) = rest.get(..length) else { return Ok(None) };
        let frame = Frame { kind, message: message.to_vec() };
        self.taken += HEADER + length;
        Ok(Some(frame))
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn frames() -> impl Strategy<Value = Vec<Frame>> {
        let kind = prop::sample::select(&Kind::ALL[..]);
        let frame = (kind, prop::collection::vec(any::<u8>(), 0..50))
            .prop_map(|(kind, message)| Frame { kind, message });
        prop::collection::vec(frame, 0..10)
    }

    #[test]
    fn kinds_have_the_numbers_of_their_places() {
        assert!(Kind::ALL.iter().enumerate().all(|(place, kind)| *kind as usize == place));
    }

    proptest! {
        #[test]
        fn frames_are_found_however_the_bytes_are_cut(frames in frames(), cut in 1_usize..30) {
            let mut bytes = Vec::new();
            frames.iter().for_each(|frame| frame.write(&mut bytes).unwrap());
            let (mut decoder, mut found) = (Decoder::default(), Vec::new());
            for part in bytes.chunks(cut) {
                decoder.push(part);
                while let Some(frame) = decoder.poll(50).unwrap() {
                    found.push(frame);
                }
            }
            prop_assert_eq!(found, frames);
        }

        #[test]
        fn a_longer_message_is_rejected_by_its_header(kind in 0_u8..13, longest in 0_usize..1000, more in 1_u32..1000) {
            let length = longest as u32 + more;
            let mut decoder = Decoder::default();
            decoder.push(&[kind]);
            decoder.push(&length.to_be_bytes());
            prop_assert_eq!(decoder.poll(longest), Err(FrameError::TooLong { length: length as usize, longest }));
        }

        #[test]
        fn an_unknown_kind_is_rejected(kind in 13_u8..) {
            let mut decoder = Decoder::default();
            decoder.push(&[kind, 0, 0, 0, 0]);
            prop_assert_eq!(decoder.poll(LONGEST), Err(FrameError::Kind(kind)));
        }
    }
}
