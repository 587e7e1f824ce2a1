//! The older format of captures (draft-ietf-opsawg-pcap).

use super::{Order, Packets, unreadable};
use crate::error::CalibrateError;

/// Length of the file's header, and of a packet's.
const FILE_HEADER: usize = 24;
const PACKET_HEADER: usize = 16;
/// First number of a file whose times have microseconds, and of one with nanoseconds.
const MICROSECONDS: u32 = 0xa1b2_c3d4;
const NANOSECONDS: u32 = 0xa1b2_3c4d;

/// Reads a capture.
pub(super) fn read<'a>(bytes: &'a [u8], packets: &mut Packets<'a>) -> Result<(), CalibrateError> {
    let (order, unit_ns) = [Order::Little, Order::Big]
        .into_iter()
        .find_map(|order| match order.u32_at(bytes, 0)? {
            MICROSECONDS => Some((order, 1000)),
            NANOSECONDS => Some((order, 1)),
            _ => None,
        })
        .ok_or_else(|| unreadable("it is no capture: give a file of `tcpdump -w`, i.e. pcap or pcapng"))?;
    // The upper half tells of checksums behind the frames.
    let link_type =
        order.u32_at(bytes, 20).ok_or_else(|| unreadable("the header of the capture is cut off"))? as u16;
    let mut rest = bytes.get(FILE_HEADER..).unwrap_or_default();
    let field = |rest: &[u8], at| order.u32_at(rest, at);
    while let (Some(seconds), Some(part)) = (field(rest, 0), field(rest, 4))
        && let (Some(kept), Some(original)) = (field(rest, 8), field(rest, 12))
        && let Some(end) = PACKET_HEADER.checked_add(kept as usize)
        && let Some(packet) = rest.get(PACKET_HEADER..end)
    {
        let at_ns = i64::from(seconds) * 1_000_000_000 + i64::from(part) * unit_ns;
        packets.add(link_type, at_ns, packet, original)?;
        rest = &rest[end..];
    }
    Ok(())
}
