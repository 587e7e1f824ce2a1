//! Answers of the lidar: a descriptor with length and type, and then one answer, or answers until it is stopped.

use serde::{Deserialize, Serialize};

use super::capsule::{self, Capsule};

/// Two marks, 30 bits of length with two bits of mode, and the type.
const DESCRIPTOR: usize = 7;
const MARKS: [u8; 2] = [0xA5, 0x5A];
/// Bytes of a sample of a standard scan.
const NODE: usize = 5;
/// Samples in a row that must make sense before one is believed after an error: only three of 40 bits are marks.
const BELIEVED: usize = 4;

/// An answer.
#[expect(clippy::large_enum_variant, reason = "answers are passed on, and never kept")]
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Answer {
    /// Model, versions of firmware and hardware.
    Info {
        /// Number of the model.
        model: u8,
        /// Version of the firmware: major and minor.
        firmware: (u8, u8),
    },
    /// State of the device.
    Health(Health),
    /// Times between samples, microseconds.
    SampleRate {
        /// In a standard scan.
        standard: u16,
        /// In an express scan.
        express: u16,
    },
    /// A sample of a standard scan.
    Node {
        /// Whether a turn begins.
        is_first: bool,
        /// Radians clockwise from the lidar's front.
        angle: f64,
        /// Metres; 0 if none was measured.
        range: f32,
    },
    /// Samples of an express scan.
    Capsule(Capsule),
}

/// State of a lidar.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Health {
    /// It is well.
    Good,
    /// It may become worse, with this code.
    Warning(u16),
    /// It does not measure, with this code.
    Error(u16),
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
enum Mode {
    /// Searches a descriptor.
    #[default]
    Search,
    One(Kind),
    Nodes {
        is_aligned: bool,
    },
    Capsules {
        follows: bool,
    },
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Info,
    Health,
    SampleRate,
}

/// Finds answers in a byte stream.
///
/// A corrupt capsule costs itself, and the angles of the one before. A standard scan has marks instead of checksums: a
/// corrupt sample can be taken for a whole one. At most 128 bytes are kept.
#[derive(Debug, Clone, Default)]
pub struct Answers {
    buffer: Vec<u8>,
    mode: Mode,
    rejected: u64,
}

impl Answers {
    /// Takes bytes, and passes each complete answer to `each`.
    pub fn feed(&mut self, bytes: &[u8], mut each: impl FnMut(Answer)) {
        for &byte in bytes {
            self.buffer.push(byte);
            while let Some(taken) = self.step(&mut each) {
                self.buffer.drain(..taken);
            }
        }
    }

    /// Forgets all, and searches a descriptor: after a request that ends a scan.
    pub fn reset(&mut self) {
        self.buffer.clear();
        self.mode = Mode::Search;
    }

    /// Returns the number of answers so far that were torn or corrupt.
    pub fn rejected(&self) -> u64 {
        self.rejected
    }

    /// Returns how many bytes were used up; `None` if more are needed.
    fn step(&mut self, each: &mut impl FnMut(Answer)) -> Option<usize> {
        match self.mode {
            Mode::Search => {
                let head = self.buffer.first_chunk::<DESCRIPTOR>();
                if self.buffer.iter().zip(MARKS).any(|(byte, mark)| *byte != mark) {
                    return Some(1);
                }
                let [_, _, length @ .., kind] = *head?;
                let length = u32::from_le_bytes(length);
                self.mode = match (kind, length & 0x3FFF_FFFF) {
                    (0x04, 20) => Mode::One(Kind::Info),
                    (0x06, 3) => Mode::One(Kind::Health),
                    (0x15, 4) => Mode::One(Kind::SampleRate),
                    (0x81, 5) => Mode::Nodes { is_aligned: true },
                    (0x82, 84) => Mode::Capsules { follows: false },
                    // No descriptor: the marks were data.
                    _ => return Some(1),
                };
                Some(DESCRIPTOR)
            }
            Mode::One(kind) => {
                let size = kind.size();
                let data = self.buffer.get(..size)?;
                each(kind.decode(data));
                self.mode = Mode::Search;
                Some(size)
            }
            Mode::Nodes { is_aligned: true } => {
                let node = self.buffer.first_chunk::<NODE>()?;
                if let Some(answer) = decode_node(node) {
                    each(answer);
                    return Some(NODE);
                }
                self.rejected += 1;
                self.mode = Mode::Nodes { is_aligned: false };
                Some(0)
            }
            Mode::Nodes { is_aligned: false } => {
                let buffer = self.buffer.get(..NODE + BELIEVED * NODE)?;
                let makes_sense = |at: &usize| {
                    let (nodes, _) = buffer[*at..].as_chunks::<NODE>();
                    nodes.iter().take(BELIEVED).all(|node| decode_node(node).is_some())
                };
                // A corrupt sample is more likely than a torn one.
                let at = [NODE, 1, 2, 3, 4].into_iter().find(makes_sense);
                self.mode = Mode::Nodes { is_aligned: at.is_some() };
                Some(at.unwrap_or(NODE))
            }
            Mode::Capsules { follows } => {
                let is_marked = |at: usize, mark| self.buffer.get(at).is_none_or(|byte| byte >> 4 == mark);
                let is_begin = is_marked(0, 0xA) && is_marked(1, 0x5);
                let found = if is_begin {
                    Capsule::decode(self.buffer.first_chunk::<{ capsule::SIZE }>()?, follows)
                } else {
                    None
                };
                self.mode = Mode::Capsules { follows: found.is_some() };
                if let Some(capsule) = found {
                    each(Answer::Capsule(capsule));
                    return Some(capsule::SIZE);
                }
                // Each error is counted once, and not for every byte that is skipped.
                self.rejected += u64::from(follows || is_begin);
                Some(1)
            }
        }
    }
}

impl Kind {
    fn size(self) -> usize {
        match self {
            Self::Info => 20,
            Self::Health => 3,
            Self::SampleRate => 4,
        }
    }

    /// Reads an answer of this kind's size.
    fn decode(self, data: &[u8]) -> Answer {
        let short = |at: usize| u16::from_le_bytes([data[at], data[at + 1]]);
        match self {
            Self::Info => Answer::Info { model: data[0], firmware: (data[2], data[1]) },
            Self::Health => Answer::Health(match data[0] {
                0 => Health::Good,
                1 => Health::Warning(short(1)),
                _ => Health::Error(short(1)),
            }),
            Self::SampleRate => Answer::SampleRate { standard: short(0), express: short(2) },
        }
    }
}

/// Reads a sample of a standard scan; `None` if its marks are wrong.
fn decode_node(bytes: &[u8; NODE]) -> Option<Answer> {
    let [quality, angle @ .., near, far] = *bytes;
    let (is_first, is_other) = (quality & 1 != 0, quality & 2 != 0);
    let angle = u16::from_le_bytes(angle);
    let degrees = f64::from(angle >> 1) / 64.0;
    let range = f32::from(u16::from_le_bytes([near, far])) / 4000.0;
    let makes_sense = is_first != is_other && angle & 1 != 0 && degrees <= 360.0;
    makes_sense.then(|| Answer::Node { is_first, angle: degrees.to_radians(), range })
}

#[cfg(test)]
mod tests;
