//! Takes IP packets out of Ethernet frames, and UDP and TCP out of these.

use std::net::{IpAddr, Ipv4Addr, Ipv6Addr};

/// An Ethernet frame at the port.
#[derive(Debug, Clone, Copy)]
pub struct Frame<'a> {
    /// The frame, destination address first.
    pub bytes: &'a [u8],
    /// Whether the transport's checksum is left to whoever needs it.
    pub checksum_left: bool,
    /// Of a super-packet: how many bytes of payload one of its packets has.
    pub segment: Option<u16>,
}

pub(crate) const TCP: u8 = 6;
pub(crate) const UDP: u8 = 17;
pub(crate) const UDP_HEADER: usize = 8;

pub(crate) fn u16_at(bytes: &[u8], at: usize) -> Option<u16> {
    bytes.get(at..)?.first_chunk().copied().map(u16::from_be_bytes)
}

fn u32_at(bytes: &[u8], at: usize) -> Option<u32> {
    bytes.get(at..)?.first_chunk().copied().map(u32::from_be_bytes)
}

/// An IP packet, or a fragment of one.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Packet<'a> {
    pub source: IpAddr,
    pub destination: IpAddr,
    pub protocol: u8,
    /// What follows the header and its extensions.
    pub payload: &'a [u8],
    pub fragment: Option<Fragment>,
}

/// Which part of a packet this is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Fragment {
    pub id: u32,
    /// Where it begins.
    pub offset: usize,
    /// Whether others come after it.
    pub more: bool,
}

impl<'a> Packet<'a> {
    /// The packet in a frame, behind up to two VLAN tags; `None` if there is none, or its receiver would drop it because a bit
    /// of it is flipped.
    pub fn of(frame: &Frame<'a>) -> Option<Self> {
        let bytes = frame.bytes;
        let mut at = 12;
        for _ in 0..3 {
            let packet = bytes.get(at + 2..);
            match u16_at(bytes, at)? {
                0x8100 | 0x88a8 => at += 4,
                0x0800 => {
                    return Self::v4(packet?, frame.checksum_left).filter(|packet| packet.is_intact(frame));
                }
                0x86dd => return Self::v6(packet?).filter(|packet| packet.is_intact(frame)),
                _ => return None,
            }
        }
        None
    }

    fn v4(bytes: &'a [u8], checksum_left: bool) -> Option<Self> {
        let first = *bytes.first()?;
        let header = bytes.get(..usize::from(first & 0x0f) * 4).filter(|header| header.len() >= 20)?;
        if first >> 4 != 4 || (!checksum_left && sum(header, 0) != 0xffff) {
            return None;
        }
        let place = u16_at(header, 6)?;
        let (offset, more) = (usize::from(place & 0x1fff) * 8, place & 0x2000 != 0);
        let id = u32::from(u16_at(header, 4)?);
        let address = |at: usize| u32_at(header, at).map(|bits| IpAddr::V4(Ipv4Addr::from_bits(bits)));
        Some(Self {
            source: address(12)?,
            destination: address(16)?,
            protocol: header[9],
            payload: bytes.get(header.len()..usize::from(u16_at(header, 2)?))?,
            fragment: (more || offset > 0).then_some(Fragment { id, offset, more }),
        })
    }

    fn v6(bytes: &'a [u8]) -> Option<Self> {
        if bytes.first()? >> 4 != 6 {
            return None;
        }
        let bytes = bytes.get(..40 + usize::from(u16_at(bytes, 4)?))?;
        let address = |at: usize| Some(IpAddr::V6(Ipv6Addr::from(*bytes.get(at..)?.first_chunk::<16>()?)));
        let (mut protocol, mut at, mut fragment) = (bytes[6], 40, None);
        // RFC 8200, 4.1: hop-by-hop options, routing, fragment, destination options.
        while let 0 | 43 | 44 | 60 = protocol {
            let header = bytes.get(at..at + 8)?;
            let length = if protocol == 44 {
                let place = u16_at(header, 2)?;
                let (offset, more) = (usize::from(place & 0xfff8), place & 1 != 0);
                let id = u32_at(header, 4)?;
                fragment = (more || offset > 0).then_some(Fragment { id, offset, more });
                8
            } else {
                (usize::from(header[1]) + 1) * 8
            };
            (protocol, at) = (header[0], at + length);
            if fragment.is_some_and(|fragment| fragment.offset > 0) {
                break;
            }
        }
        Some(Self {
            source: address(8)?,
            destination: address(24)?,
            protocol,
            payload: bytes.get(at..)?,
            fragment,
        })
    }

    /// Whether the transport's checksum is right, left to others, or cannot be told.
    fn is_intact(&self, frame: &Frame<'_>) -> bool {
        if frame.checksum_left || self.fragment.is_some() {
            return true;
        }
        match self.protocol {
            UDP if u16_at(self.payload, 6) == Some(0) => return true,
            UDP | TCP => {}
            _ => return true,
        }
        let pseudo = [self.source, self.destination].map(|address| match address {
            IpAddr::V4(address) => sum(&address.octets(), 0),
            IpAddr::V6(address) => sum(&address.octets(), 0),
        });
        let length = self.payload.len() as u64;
        sum(self.payload, pseudo.map(u64::from).iter().sum::<u64>() + u64::from(self.protocol) + length)
            == 0xffff
    }
}

/// The ones' complement sum of these bytes and what was summed up before (RFC 1071).
fn sum(bytes: &[u8], before: u64) -> u16 {
    let (words, rest) = bytes.as_chunks::<2>();
    let mut sum = before + words.iter().map(|word| u64::from(u16::from_be_bytes(*word))).sum::<u64>();
    sum += rest.first().map_or(0, |last| u64::from(*last) << 8);
    while sum > 0xffff {
        sum = (sum & 0xffff) + (sum >> 16);
    }
    sum as u16
}

/// A TCP segment.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Segment<'a> {
    pub from: u16,
    pub to: u16,
    pub sequence: u32,
    /// What its sender has of the other direction, if it says.
    pub acknowledged: Option<u32>,
    pub syn: bool,
    pub fin: bool,
    pub reset: bool,
    pub payload: &'a [u8],
}

impl<'a> Segment<'a> {
    pub fn of(bytes: &'a [u8]) -> Option<Self> {
        let header = usize::from(bytes.get(12)? >> 4) * 4;
        let flags = *bytes.get(13)?;
        Some(Self {
            from: u16_at(bytes, 0)?,
            to: u16_at(bytes, 2)?,
            sequence: u32_at(bytes, 4)?,
            acknowledged: u32_at(bytes, 8).filter(|_| flags & 0x10 != 0),
            fin: flags & 0x01 != 0,
            syn: flags & 0x02 != 0,
            reset: flags & 0x04 != 0,
            payload: bytes.get(header.max(20)..)?,
        })
    }
}
