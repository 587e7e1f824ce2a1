//! The older format of captures (draft-ietf-opsawg-pcap).

use crate::{
    order::Order,
    packet::{Packet, ReadError},
};

/// Length of the file's header, and of a packet's.
const FILE_HEADER: usize = 24;
const PACKET_HEADER: usize = 16;
/// First number of a file whose times have microseconds, and of one with nanoseconds.
const MICROSECONDS: u32 = 0xa1b2_c3d4;
const NANOSECONDS: u32 = 0xa1b2_3c4d;

/// Reads a capture.
pub(crate) fn read<'a, E: From<ReadError>>(
    bytes: &'a [u8],
    mut take: impl FnMut(Packet<'a>) -> Result<(), E>,
) -> Result<(), E> {
    let (order, unit_ns) = [Order::Little, Order::Big]
        .into_iter()
        .find_map(|order| match order.u32_at(bytes, 0)? {
            MICROSECONDS => Some((order, 1000)),
            NANOSECONDS => Some((order, 1)),
            _ => None,
        })
        .ok_or(ReadError::NoCapture)?;
    // The upper half is about checksums behind the frames.
    let link_type = order.u32_at(bytes, 20).ok_or(ReadError::CutOff)? as u16;
    let mut rest = bytes.get(FILE_HEADER..).unwrap_or_default();
    let field = |rest: &[u8], at| order.u32_at(rest, at);
    while let (Some(seconds), Some(part)) = (field(rest, 0), field(rest, 4))
        && let (Some(kept), Some(original)) = (field(rest, 8), field(rest, 12))
        && let Some(end) = PACKET_HEADER.checked_add(kept as usize)
        && let Some(bytes) = rest.get(PACKET_HEADER..end)
    {
        let at_ns = i64::from(seconds) * 1_000_000_000 + i64::from(part) * unit_ns;
        take(Packet { link_type, at_ns, bytes, original })?;
        rest = &rest[end..];
    }
    Ok(())
}
