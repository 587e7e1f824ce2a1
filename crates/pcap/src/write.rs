//! Writes pcapng (draft-ietf-opsawg-pcapng), block by block: a [`section`], each [`interface`] before its first packet, and
//! [`packet`]s. Times are in nanoseconds.

use crate::pcapng::{BYTE_ORDER_MAGIC, INTERFACE, PACKET, SECTION, TIME_RESOLUTION};

/// Codes of options.
const COMMENT: u16 = 1;
const USER_APPLICATION: u16 = 4;
const INTERFACE_NAME: u16 = 2;
pub(crate) const DROP_COUNT: u16 = 4;

/// A packet to write.
#[derive(Debug, Clone, Copy)]
pub struct Record<'a> {
    /// The number of its interface, in the order in which they were written, from 0.
    pub interface: u32,
    /// Its time, ns since 1970, or since the begin of a run.
    pub at_ns: u64,
    /// Its first bytes, or all.
    pub bytes: &'a [u8],
    /// Its whole length, bytes.
    pub original: u32,
    /// A comment for people.
    pub comment: &'a str,
    /// Packets that the capture missed before it.
    pub missed: u64,
}

/// Begins a file.
pub fn section(out: &mut Vec<u8>, application: &str) {
    block(out, SECTION, |out| {
        out.extend(BYTE_ORDER_MAGIC.to_le_bytes());
        // Version 1.0, and a section of unknown length.
        out.extend([1, 0, 0, 0]);
        out.extend(u64::MAX.to_le_bytes());
        option(out, USER_APPLICATION, application.as_bytes());
        end_options(out);
    });
}

/// Describes an interface whose packets have at most their first `snap` bytes.
pub fn interface(out: &mut Vec<u8>, link_type: u16, snap: u32, name: &str) {
    block(out, INTERFACE, |out| {
        out.extend(link_type.to_le_bytes());
        out.extend([0; 2]);
        out.extend(snap.to_le_bytes());
        option(out, INTERFACE_NAME, name.as_bytes());
        // Nanoseconds: 10 to the power of minus 9.
        option(out, TIME_RESOLUTION, &[9]);
        end_options(out);
    });
}

/// Writes a packet.
pub fn packet(out: &mut Vec<u8>, record: &Record<'_>) {
    let Record { interface, at_ns, bytes, original, comment, missed } = *record;
    block(out, PACKET, |out| {
        out.extend(interface.to_le_bytes());
        out.extend(((at_ns >> 32) as u32).to_le_bytes());
        out.extend((at_ns as u32).to_le_bytes());
        out.extend((bytes.len() as u32).to_le_bytes());
        out.extend(original.to_le_bytes());
        out.extend(bytes);
        pad(out, bytes.len());
        option(out, COMMENT, comment.as_bytes());
        option(out, DROP_COUNT, &missed.to_le_bytes());
        end_options(out);
    });
}

/// Writes a block with its length at both ends.
fn block(out: &mut Vec<u8>, kind: u32, body: impl FnOnce(&mut Vec<u8>)) {
    let begin = out.len();
    out.extend(kind.to_le_bytes());
    out.extend([0; 4]);
    body(out);
    let length = ((out.len() - begin + 4) as u32).to_le_bytes();
    out.extend(length);
    out[begin + 4..begin + 8].copy_from_slice(&length);
}

fn option(out: &mut Vec<u8>, code: u16, value: &[u8]) {
    out.extend(code.to_le_bytes());
    out.extend((value.len() as u16).to_le_bytes());
    out.extend(value);
    pad(out, value.len());
}

fn end_options(out: &mut Vec<u8>) {
    out.extend([0; 4]);
}

/// Pads a field of this length to 32 bits.
fn pad(out: &mut Vec<u8>, length: usize) {
    out.resize(out.len() + length.next_multiple_of(4) - length, 0);
}
