//! Frames of one direction of a connection of HTTP/2 (RFC 9113, 4.1 and 6).

use std::ops::Range;

/// Bytes of a frame's header.
const HEADER: usize = 9;

/// Header of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Frame {
    pub kind: u8,
    pub stream: u32,
    flags: u8,
}

impl Frame {
    const DATA: u8 = 0;
    pub const HEADERS: u8 = 1;
    pub const RST_STREAM: u8 = 3;
    const PUSH_PROMISE: u8 = 5;
    const CONTINUATION: u8 = 9;

    const END_STREAM: u8 = 0x01;
    const END_HEADERS: u8 = 0x04;
    const PADDED: u8 = 0x08;
    const PRIORITY: u8 = 0x20;

    fn has(self, flag: u8) -> bool {
        self.flags & flag != 0
    }

    /// Whether it has a part of a field section.
    pub fn has_fields(self) -> bool {
        matches!(self.kind, Self::HEADERS | Self::PUSH_PROMISE | Self::CONTINUATION)
    }

    /// Whether a field section ends with it.
    pub fn ends_fields(self) -> bool {
        self.has_fields() && self.has(Self::END_HEADERS)
    }

    /// Whether its sender's half of the stream ends with it, or with the field section that it begins.
    pub fn ends_stream(self) -> bool {
        matches!(self.kind, Self::DATA | Self::HEADERS) && self.has(Self::END_STREAM)
    }

    /// Returns where the fields are in its payload, without padding and priority; `None` if it is too short.
    pub fn fields(self, payload: &[u8]) -> Option<Range<usize>> {
        let (mut from, mut until) = (0, payload.len());
        if self.kind == Self::HEADERS {
            if self.has(Self::PADDED) {
                until = until.checked_sub(usize::from(*payload.first()?))?;
                from = 1;
            }
            if self.has(Self::PRIORITY) {
                from += 5;
            }
        }
        (from <= until).then_some(from..until)
    }
}

/// The next bytes of a frame whose header is complete.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Taken<'a> {
    pub frame: Frame,
    pub payload: &'a [u8],
    /// Whether the frame ends with them.
    pub is_over: bool,
}

/// The position in the frames of one direction.
#[derive(Debug, Default)]
pub(crate) struct Frames {
    header: [u8; HEADER],
    /// Bytes of the header so far.
    known: usize,
    /// Bytes of the payload that are still to come, once the header is complete.
    left: usize,
}

impl Frames {
    /// Takes the next bytes of one frame off the front of `bytes`; `None` if its header is not complete.
    pub fn take<'a>(&mut self, bytes: &mut &'a [u8]) -> Option<Taken<'a>> {
        if self.known < HEADER {
            let part = cut(bytes, HEADER - self.known);
            self.header[self.known..][..part.len()].copy_from_slice(part);
            self.known += part.len();
            if self.known < HEADER {
                return None;
            }
            let [high, middle, low, ..] = self.header;
            self.left = u32::from_be_bytes([0, high, middle, low]) as usize;
        }
        let [_, _, _, kind, flags, stream @ ..] = self.header;
        // The first bit is reserved.
        let frame = Frame { kind, flags, stream: u32::from_be_bytes(stream) & (u32::MAX >> 1) };
        let payload = cut(bytes, self.left);
        self.left -= payload.len();
        let is_over = self.left == 0;
        if is_over {
            self.known = 0;
        }
        Some(Taken { frame, payload, is_over })
    }
}

/// Takes at most so many bytes off the front.
fn cut<'a>(bytes: &mut &'a [u8], most: usize) -> &'a [u8] {
    let (part, rest) = bytes.split_at(most.min(bytes.len()));
    *bytes = rest;
    part
}
