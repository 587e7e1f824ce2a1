//! TCP segments in IPv4 in Ethernet: RFC 9293, with timestamps and window scaling (RFC 7323) and SACK (RFC 2018).

use cotorra_flows::{
    checksum::{complement, sum},
    headers::{ETHERNET, ETHERTYPE_IPV4, IPV4, Ipv4, PROTOCOL_TCP, TCP, pseudo_header_sum, u16_at, u32_at},
};
use cotorra_graph::HostAddress;

/// Payload of a full segment: 1500 bytes less the headers of IPv4 and TCP and the option of timestamps.
pub const MSS: u64 = 1448;
/// Most blocks of a SACK option beside timestamps (RFC 2018, section 3).
const MOST_BLOCKS: usize = 3;
/// The shift of windows that both ends announce: 65,535 then stand for 1 GiB.
const WINDOW_SCALE: u8 = 14;
/// Place of the checksum in a TCP header.
const CHECKSUM: usize = 16;

const ACK: u8 = 0x10;
const SYN: u8 = 0x02;

/// Both ends of a connection or of a flow of datagrams: the place of each host among all hosts, and its port.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Ends {
    /// Place and port of the sender.
    pub from: (usize, u16),
    /// Place and port of the receiver.
    pub to: (usize, u16),
}

impl Ends {
    /// Returns the ends of the other direction.
    pub fn reversed(self) -> Self {
        Self { from: self.to, to: self.from }
    }

    /// Replaces `frame` by headers of Ethernet and IPv4, for a payload of so many bytes. Returns both IP addresses.
    pub(crate) fn begin(self, frame: &mut Vec<u8>, protocol: u8, payload: usize) -> [u8; 8] {
        let (sender, receiver) = (address(self.from.0), address(self.to.0));
        let (source, destination) = (sender.ipv4, receiver.ipv4);
        let fragment = Ipv4::DONT_FRAGMENT;
        let header = Ipv4 { identification: 0, fragment, ttl: 64, protocol, source, destination };
        frame.clear();
        frame.extend_from_slice(&receiver.mac);
        frame.extend_from_slice(&sender.mac);
        frame.extend_from_slice(&ETHERTYPE_IPV4.to_be_bytes());
        frame.extend_from_slice(&header.header(payload));
        let mut addresses = [0; 8];
        addresses[..4].copy_from_slice(&source.octets());
        addresses[4..].copy_from_slice(&destination.octets());
        addresses
    }
}

/// Returns the addresses of a host, or of an end of a link. Frames that cross a link from end to end are routed by nobody, so
/// that the addresses of many ends may be used twice.
pub(crate) fn address(place: usize) -> HostAddress {
    HostAddress::of(place % HostAddress::MAX_HOSTS)
}

/// Whether a frame names a host as the sender of its IPv4 packet.
pub(crate) fn is_from(frame: &[u8], host: usize) -> bool {
    frame.get(ETHERNET + 12..ETHERNET + 16).is_some_and(|source| source == address(host).ipv4.octets())
}

/// A range of sequence numbers, the end excluded.
pub type Block = (u32, u32);

/// A segment. Its payload is zeros: only its length counts.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Segment {
    /// Whether it opens the connection.
    pub syn: bool,
    /// Number of its first byte.
    pub sequence: u32,
    /// Number of the byte that the sender expects next; `None` in the first segment.
    pub ack: Option<u32>,
    /// Sender's time, ms, and the time that it answers.
    pub times: (u32, u32),
    /// Ranges that arrived beyond the expected byte, the latest first.
    pub sacked: Vec<Block>,
    /// Bytes of its payload.
    pub payload: usize,
}

impl Segment {
    /// Replaces `frame` by the segment's frame, with its checksum.
    pub fn write(&self, ends: Ends, frame: &mut Vec<u8>) {
        let mut options = Vec::with_capacity(40);
        if self.syn {
            let [high, low] = (MSS as u16 + 12).to_be_bytes();
            // Maximum segment size, SACK permitted, window scale.
            options.extend_from_slice(&[2, 4, high, low, 4, 2, 3, 3, WINDOW_SCALE, 1]);
        }
        options.extend_from_slice(if self.syn { &[8, 10] } else { &[1, 1, 8, 10] });
        options.extend_from_slice(&self.times.0.to_be_bytes());
        options.extend_from_slice(&self.times.1.to_be_bytes());
        let blocks = &self.sacked[..self.sacked.len().min(MOST_BLOCKS)];
        if !blocks.is_empty() {
            options.extend_from_slice(&[1, 1, 5, 2 + 8 * blocks.len() as u8]);
            for (start, end) in blocks {
                options.extend_from_slice(&start.to_be_bytes());
                options.extend_from_slice(&end.to_be_bytes());
            }
        }
        options.resize(options.len().next_multiple_of(4), 0);
        let header = TCP + options.len();
        let length = header + self.payload;
        let addresses = ends.begin(frame, PROTOCOL_TCP, length);
        let at = frame.len();
        frame.extend_from_slice(&ends.from.1.to_be_bytes());
        frame.extend_from_slice(&ends.to.1.to_be_bytes());
        frame.extend_from_slice(&self.sequence.to_be_bytes());
        frame.extend_from_slice(&self.ack.unwrap_or_default().to_be_bytes());
        let flags = if self.syn { SYN } else { 0 } | if self.ack.is_some() { ACK } else { 0 };
        frame.extend_from_slice(&[(header as u8 / 4) << 4, flags, 0xff, 0xff, 0, 0, 0, 0]);
        frame.extend_from_slice(&options);
        frame.resize(at + length, 0);
        let total = sum(&frame[at..]) + pseudo_header_sum(&addresses, PROTOCOL_TCP, length);
        frame[at + CHECKSUM..at + CHECKSUM + 2].copy_from_slice(&complement(total).to_be_bytes());
    }

    /// Reads the segment in a frame that this end receives; `None` if there is none, or if it is damaged.
    pub fn read(ends: Ends, frame: &[u8]) -> Option<Self> {
        let (sender, receiver) = (address(ends.from.0).ipv4, address(ends.to.0).ipv4);
        let is_tcp = u16_at(frame, ETHERNET - 2)? == ETHERTYPE_IPV4
            && *frame.get(ETHERNET)? == 0x45
            && *frame.get(ETHERNET + 9)? == PROTOCOL_TCP;
        let addresses = frame.get(ETHERNET + 12..ETHERNET + IPV4)?;
        if !is_tcp || addresses != [sender.octets(), receiver.octets()].concat() {
            return None;
        }
        let length = usize::from(u16_at(frame, ETHERNET + 2)?).checked_sub(IPV4)?;
        let segment = frame.get(ETHERNET + IPV4..)?.get(..length)?;
        if (u16_at(segment, 0)?, u16_at(segment, 2)?) != (ends.from.1, ends.to.1) {
            return None;
        }
        let total = sum(segment) + pseudo_header_sum(addresses, PROTOCOL_TCP, length);
        if complement(total) != 0xffff {
            return None;
        }
        let header = usize::from(segment.get(12)? >> 4) * 4;
        let flags = *segment.get(13)?;
        let mut read = Self {
            syn: flags & SYN != 0,
            sequence: u32_at(segment, 4)?,
            ack: (flags & ACK != 0).then_some(u32_at(segment, 8)?),
            payload: length.checked_sub(header)?,
            ..Self::default()
        };
        read.options(segment.get(TCP..header)?);
        Some(read)
    }

    /// Reads options; the rest of a malformed list is left out.
    fn options(&mut self, mut options: &[u8]) {
        while let Some((&kind, rest)) = options.split_first() {
            if kind == 0 {
                return;
            }
            if kind == 1 {
                options = rest;
                continue;
            }
            let Some(&length) = rest.first() else { return };
            let Some(value) = options.get(2..usize::from(length)) else { return };
            match kind {
                8 => {
                    let (Some(sent), Some(answered)) = (u32_at(value, 0), u32_at(value, 4)) else { return };
                    self.times = (sent, answered);
                }
                5 => {
                    let (blocks, _) = value.as_chunks::<8>();
                    let block = |b: &[u8; 8]| Some((u32_at(b, 0)?, u32_at(b, 4)?));
                    self.sacked = blocks.iter().filter_map(block).collect();
                }
                _ => {}
            }
            options = &options[usize::from(length).max(2)..];
        }
    }
}

/// Returns the position in the stream that is nearest to another and ends in these 32 bits; `None` before the beginning.
pub(crate) fn unwrap_near(near: u64, bits: u32) -> Option<u64> {
    let apart = bits.wrapping_sub(near as u32) as i32;
    near.checked_add_signed(apart.into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const ENDS: Ends = Ends { from: (0, 61_000), to: (3, 61_000) };

    fn segments() -> impl Strategy<Value = Segment> {
        let blocks = proptest::collection::vec(any::<Block>(), 0..4);
        let ack = any::<Option<u32>>();
        (any::<bool>(), any::<u32>(), ack, any::<(u32, u32)>(), blocks, 0..1449usize).prop_map(
            |(syn, sequence, ack, times, mut sacked, payload)| {
                sacked.truncate(if syn { 0 } else { 3 });
                Segment { syn, sequence, ack, times, sacked, payload }
            },
        )
    }

    #[test]
    fn a_full_segment_fills_a_packet_of_1500_bytes() {
        let mut frame = Vec::new();
        Segment { payload: MSS as usize, ack: Some(0), ..Segment::default() }.write(ENDS, &mut frame);
        assert_eq!(frame.len(), ETHERNET + 1500);
    }

    proptest! {
        #[test]
        fn what_is_written_is_read(segment in segments()) {
            let mut frame = Vec::new();
            segment.write(ENDS, &mut frame);
            prop_assert_eq!(Segment::read(ENDS, &frame), Some(segment));
            prop_assert_eq!(Segment::read(ENDS.reversed(), &frame), None);
        }

        #[test]
        fn a_changed_byte_is_found(segment in segments(), at in any::<prop::sample::Index>(), bit in 0..8) {
            let mut frame = Vec::new();
            segment.write(ENDS, &mut frame);
            let at = ETHERNET + IPV4 + at.index(frame.len() - ETHERNET - IPV4);
            frame[at] ^= 1u8 << bit;
            prop_assert_eq!(Segment::read(ENDS, &frame), None);
        }

        #[test]
        fn any_bytes_are_read_without_a_panic(bytes in proptest::collection::vec(any::<u8>(), 0..120)) {
            let mut segment = Segment { payload: 100, ..Segment::default() };
            segment.options(&bytes);
            let mut frame = Vec::new();
            segment.write(ENDS, &mut frame);
            let from = frame.len().min(ETHERNET + IPV4);
            frame.truncate(from);
            frame.extend_from_slice(&bytes);
            let _ = Segment::read(ENDS, &frame);
        }

        #[test]
        fn positions_survive_32_bits(near in any::<u32>(), apart in -0x4000_0000i64..0x4000_0000) {
            let near = u64::from(near) << 4;
            if let Some(position) = near.checked_add_signed(apart) {
                prop_assert_eq!(unwrap_near(near, position as u32), Some(position));
            }
        }
    }
}
