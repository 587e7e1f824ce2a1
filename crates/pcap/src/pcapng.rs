//! The newer format of captures (draft-ietf-opsawg-pcapng).

use crate::{
    order::Order,
    packet::{Packet, ReadError},
};

/// Types of blocks.
pub(crate) const SECTION: u32 = 0x0a0d_0d0a;
pub(crate) const INTERFACE: u32 = 1;
pub(crate) const PACKET: u32 = 6;
/// Number that shows the order of bytes.
pub(crate) const BYTE_ORDER_MAGIC: u32 = 0x1a2b_3c4d;
/// Length of a block's type and both lengths.
const LEAST_BLOCK: usize = 12;
/// Places at which the options of an interface and the bytes of a packet begin.
const INTERFACE_OPTIONS: usize = 16;
pub(crate) const PACKET_BYTES: usize = 28;
/// Codes of options of an interface.
pub(crate) const TIME_RESOLUTION: u16 = 9;
const TIME_OFFSET: u16 = 14;
/// Most interfaces of a section.
const MAX_INTERFACES: usize = 4096;

const NANOSECONDS: u128 = 1_000_000_000;

/// An interface of a section.
#[derive(Debug, Clone, Copy)]
struct Interface {
    link_type: u16,
    /// Units of time in a second.
    units: u128,
    /// Seconds that are added to all times.
    offset_s: i64,
}

impl Interface {
    /// Reads the block of an interface.
    fn read(block: &[u8], order: Order) -> Option<Self> {
        let mut interface = Self { link_type: order.u16_at(block, 8)?, units: 1_000_000, offset_s: 0 };
        let mut at = INTERFACE_OPTIONS;
        while let (Some(code), Some(length)) = (order.u16_at(block, at), order.u16_at(block, at + 2)) {
            match code {
                0 => break,
                TIME_RESOLUTION => interface.units = units(*block.get(at + 4)?)?,
                TIME_OFFSET => interface.offset_s = order.i64_at(block, at + 4)?,
                _ => {}
            }
            at += 4 + usize::from(length).next_multiple_of(4);
        }
        Some(interface)
    }

    /// Returns a time in ns since 1970.
    fn nanoseconds(&self, time: u64) -> Option<i64> {
        let ns = u128::from(time) * NANOSECONDS / self.units;
        i64::try_from(ns).ok()?.checked_add(self.offset_s.checked_mul(NANOSECONDS as i64)?)
    }
}

/// Returns the units in a second: a negative power of two if the highest bit is set, or of ten.
fn units(resolution: u8) -> Option<u128> {
    let power = u32::from(resolution & 0x7f);
    if resolution & 0x80 == 0 { 10_u128.checked_pow(power) } else { 1_u128.checked_shl(power) }
}

/// Whether a file begins as a pcapng capture.
pub(crate) fn is_pcapng(bytes: &[u8]) -> bool {
    Order::Little.u32_at(bytes, 0) == Some(SECTION)
}

/// Reads a capture. Blocks without a time, and those of unknown types, are skipped.
pub(crate) fn read<'a, E: From<ReadError>>(
    bytes: &'a [u8],
    mut take: impl FnMut(Packet<'a>) -> Result<(), E>,
) -> Result<(), E> {
    let (mut rest, mut order, mut interfaces) = (bytes, Order::Little, Vec::new());
    let damaged = |rest: &[u8]| ReadError::Damaged(bytes.len() - rest.len());
    while let Some(kind) = order.u32_at(rest, 0) {
        if kind == SECTION {
            let orders = [Order::Little, Order::Big];
            let is_it = |order: &Order| order.u32_at(rest, 8) == Some(BYTE_ORDER_MAGIC);
            order = orders.into_iter().find(is_it).ok_or_else(|| damaged(rest))?;
            interfaces.clear();
        }
        let Some(length) = order.u32_at(rest, 4) else { break };
        let length = length as usize;
        if length < LEAST_BLOCK || !length.is_multiple_of(4) {
            return Err(damaged(rest).into());
        }
        let Some(block) = rest.get(..length) else { break };
        match kind {
            INTERFACE if interfaces.len() < MAX_INTERFACES => {
                interfaces.push(Interface::read(&block[..length - 4], order).ok_or_else(|| damaged(rest))?);
            }
            PACKET => take(read_packet(block, order, &interfaces).ok_or_else(|| damaged(rest))?)?,
            _ => {}
        }
        rest = &rest[length..];
    }
    Ok(())
}

/// Reads the block of a packet; `None` if it is damaged.
fn read_packet<'a>(block: &'a [u8], order: Order, interfaces: &[Interface]) -> Option<Packet<'a>> {
    let field = |at| order.u32_at(block, at);
    let interface = interfaces.get(field(8)? as usize)?;
    let time = (u64::from(field(12)?) << 32) | u64::from(field(16)?);
    let bytes = block.get(PACKET_BYTES..)?.get(..field(20)? as usize)?;
    let at_ns = interface.nanoseconds(time)?;
    Some(Packet { link_type: interface.link_type, at_ns, bytes, original: field(24)? })
}
