//! Parses the samples, and fragments of samples, in messages of DDS (OMG, "DDS Interoperability Wire Protocol" 2.5).

use std::ops::Range;

/// A participant's prefix and an entity's number.
pub(crate) type Guid = [u8; 16];

const HEADER: usize = 20;
const PREFIX: usize = 12;
const PAD: u8 = 0x01;
const INFO_TS: u8 = 0x09;
const INFO_SRC: u8 = 0x0c;
const DATA: u8 = 0x15;
const DATA_FRAG: u8 = 0x16;

const LITTLE_ENDIAN: u8 = 0x01;
const INLINE_QOS: u8 = 0x02;
/// Flag of `DATA` for data, and of `DATA_FRAG` for a key in place of data.
const THIRD: u8 = 0x04;

const SENTINEL: u16 = 0x0001;
const TOPIC_NAME: u16 = 0x0005;
const ENDPOINT_GUID: u16 = 0x005a;
/// Parameter ids: 0x0083 by the standard, 0x800f in earlier versions of Fast DDS.
const RELATED_SAMPLE_IDENTITY: [u16; 2] = [0x0083, 0x800f];

/// Entity id of the writer that announces a participant's writers.
pub(crate) const PUBLICATIONS_WRITER: [u8; 4] = [0, 0, 0x03, 0xc2];

/// Length of the encapsulation header, which names the serialization.
pub(crate) const ENCAPSULATION: usize = 4;

/// The writer of a sample, and its sequence number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Identity {
    pub writer: Guid,
    pub sequence: u64,
}

/// A sample, or fragments of one.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Data<'a> {
    pub identity: Identity,
    /// Related sample identity: for an answer, its request; for a request, the reader of its answer.
    pub related: Option<Identity>,
    /// Fragments of the sample, from 0.
    pub fragments: Range<u64>,
    /// Number of fragments of the whole sample.
    pub count: u64,
    pub payload: &'a [u8],
}

/// Fields in the sender's byte order.
#[derive(Clone, Copy)]
struct Fields<'a> {
    bytes: &'a [u8],
    is_little: bool,
}

impl<'a> Fields<'a> {
    fn array<const N: usize>(self, at: usize) -> Option<[u8; N]> {
        self.bytes.get(at..)?.first_chunk().copied()
    }

    fn u16(self, at: usize) -> Option<u16> {
        let bytes = self.array(at)?;
        Some(if self.is_little { u16::from_le_bytes(bytes) } else { u16::from_be_bytes(bytes) })
    }

    fn u32(self, at: usize) -> Option<u32> {
        let bytes = self.array(at)?;
        Some(if self.is_little { u32::from_le_bytes(bytes) } else { u32::from_be_bytes(bytes) })
    }

    fn u64(self, at: usize) -> Option<u64> {
        let bytes = self.array(at)?;
        Some(if self.is_little { u64::from_le_bytes(bytes) } else { u64::from_be_bytes(bytes) })
    }

    /// Reads a sequence number. The high half comes first in either byte order. By the standard, numbers are signed and
    /// begin with 1.
    fn sequence(self, at: usize) -> Option<u64> {
        Some(u64::from(self.u32(at)?) << 32 | u64::from(self.u32(at + 4)?))
    }

    fn identity(self) -> Option<Identity> {
        Some(Identity { writer: self.array(0)?, sequence: self.sequence(16)? })
    }

    /// Calls `each` with every parameter of a list. Returns the list's length.
    fn parameters(self, mut each: impl FnMut(u16, Self)) -> Option<usize> {
        let mut at = 0;
        loop {
            let (id, length) = (self.u16(at)?, usize::from(self.u16(at + 2)?));
            at += 4;
            if id == SENTINEL {
                return Some(at);
            }
            let bytes = self.bytes.get(at..at + length)?;
            each(id, Self { bytes, ..self });
            at += length;
        }
    }
}

/// Calls `each` with every sample, or fragments of one, in a message.
pub(crate) fn read<'a>(message: &'a [u8], mut each: impl FnMut(Data<'a>)) {
    if !message.starts_with(b"RTPS") {
        return;
    }
    let Some((header, mut rest)) = message.split_at_checked(HEADER) else { return };
    let mut prefix = &header[HEADER - PREFIX..];
    while let Some((&[kind, flags, ..], after)) = rest.split_first_chunk::<4>() {
        let is_little = flags & LITTLE_ENDIAN != 0;
        let length = Fields { bytes: rest, is_little }.u16(2).map_or(0, usize::from);
        // The last submessage may have no length.
        let length = if length == 0 && !matches!(kind, PAD | INFO_TS) { after.len() } else { length };
        let Some((bytes, next)) = after.split_at_checked(length) else { return };
        rest = next;
        let fields = Fields { bytes, is_little };
        match kind {
            INFO_SRC => prefix = bytes.get(8..8 + PREFIX).unwrap_or(prefix),
            DATA if flags & THIRD != 0 => data(prefix, flags, fields, false).into_iter().for_each(&mut each),
            DATA_FRAG if flags & THIRD == 0 => {
                data(prefix, flags, fields, true).into_iter().for_each(&mut each);
            }
            _ => {}
        }
    }
}

fn data<'a>(prefix: &[u8], flags: u8, fields: Fields<'a>, is_part: bool) -> Option<Data<'a>> {
    let mut writer = Guid::default();
    writer[..PREFIX].copy_from_slice(prefix);
    writer[PREFIX..].copy_from_slice(&fields.array::<4>(8)?);
    let sequence = fields.sequence(12).filter(|sequence| (1..1 << 63).contains(sequence))?;
    let (fragments, count) = if is_part {
        let first = u64::from(fields.u32(20)?.checked_sub(1)?);
        let size = fields.u16(26).filter(|size| *size > 0)?;
        (first..first + u64::from(fields.u16(24)?), u64::from(fields.u32(28)?.div_ceil(u32::from(size))))
    } else {
        (0..1, 1)
    };
    if fragments.is_empty() || fragments.end > count {
        return None;
    }
    // The offset counts from behind its own field.
    let mut at = 4 + usize::from(fields.u16(2)?);
    let mut related = None;
    if flags & INLINE_QOS != 0 {
        let list = Fields { bytes: fields.bytes.get(at..)?, ..fields };
        at += list.parameters(|id, value| {
            if RELATED_SAMPLE_IDENTITY.contains(&id) {
                related = related.or(value.identity());
            }
        })?;
    }
    let payload = fields.bytes.get(at..)?;
    Some(Data { identity: Identity { writer, sequence }, related, fragments, count, payload })
}

/// Returns the fields of serialized data.
fn serialized(payload: &[u8]) -> Option<Fields<'_>> {
    let (encapsulation, bytes) = payload.split_first_chunk::<ENCAPSULATION>()?;
    Some(Fields { bytes, is_little: encapsulation[1] & 1 != 0 })
}

/// Returns the writer and the topic that a sample of [`PUBLICATIONS_WRITER`] announces.
pub(crate) fn announced(payload: &[u8]) -> Option<(Guid, &[u8])> {
    let (mut guid, mut topic) = (None, None);
    serialized(payload)?.parameters(|id, value| match id {
        ENDPOINT_GUID => guid = value.array(0),
        // The name ends with a zero.
        TOPIC_NAME => {
            let length = value.u32(0).and_then(|length| (length as usize).checked_sub(1));
            topic = length.and_then(|length| value.bytes.get(4..)?.get(..length));
        }
        _ => {}
    });
    Some((guid?, topic?))
}

/// Returns the first two numbers of serialized data.
pub(crate) fn numbers(payload: &[u8]) -> Option<[u64; 2]> {
    let fields = serialized(payload)?;
    Some([fields.u64(0)?, fields.u64(8)?])
}

#[cfg(test)]
mod tests;
