//! Parses IP packets in Ethernet frames, and TCP segments in IP packets.

use std::net::{IpAddr, Ipv4Addr, Ipv6Addr};

use crate::{
    checksum::{fold, sum},
    headers::{
        self, IPV6, IpVersion, PROTOCOL_TCP, PROTOCOL_UDP, find_ip, pseudo_header_sum, u16_at, u32_at,
    },
};

/// An Ethernet frame at a host's port.
#[derive(Debug, Clone, Copy)]
pub struct Frame<'a> {
    /// The frame, destination address first.
    pub bytes: &'a [u8],
    /// Whether the sender left the transport's checksum to the network card.
    pub checksum_left: bool,
    /// Payload bytes per packet of a super-packet; `None` for a single packet.
    pub segment: Option<u16>,
}

/// An IP packet, or a fragment of one.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Packet<'a> {
    pub source: IpAddr,
    pub destination: IpAddr,
    pub protocol: u8,
    /// Bytes behind the header and its extensions.
    pub payload: &'a [u8],
    pub fragment: Option<Fragment>,
}

/// The place of a fragment in its packet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Fragment {
    pub id: u32,
    /// Offset in the packet's payload, bytes.
    pub offset: usize,
    /// Whether more fragments follow.
    pub more: bool,
}

impl<'a> Packet<'a> {
    /// Parses the packet in a frame, behind up to two VLAN tags. `None` if there is none, or if its receiver would drop it
    /// because of a wrong checksum or length.
    pub fn of(frame: &Frame<'a>) -> Option<Self> {
        Self::unchecked(frame)?.trimmed(frame).filter(|packet| packet.is_intact(frame))
    }

    /// Cuts what is behind a datagram away, by UDP's own length. `None` if the packet is shorter than that.
    fn trimmed(mut self, frame: &Frame<'_>) -> Option<Self> {
        if self.protocol == PROTOCOL_UDP && self.fragment.is_none() && frame.segment.is_none() {
            let length = usize::from(u16_at(self.payload, 4)?);
            self.payload = self.payload.get(..length).filter(|datagram| datagram.len() >= headers::UDP)?;
        }
        Some(self)
    }

    /// [`Packet::of`] without a check of the transport's checksum.
    pub fn unchecked(frame: &Frame<'a>) -> Option<Self> {
        let (at, version) = find_ip(frame.bytes)?;
        let bytes = frame.bytes.get(at..)?;
        match version {
            IpVersion::V4 => Self::v4(bytes, frame.checksum_left),
            IpVersion::V6 => Self::v6(bytes),
        }
    }

    fn v4(bytes: &'a [u8], checksum_left: bool) -> Option<Self> {
        let first = *bytes.first()?;
        let header =
            bytes.get(..usize::from(first & 0x0f) * 4).filter(|header| header.len() >= headers::IPV4)?;
        if first >> 4 != 4 || (!checksum_left && fold(sum(header)) != 0xffff) {
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
        let bytes = bytes.get(..IPV6 + usize::from(u16_at(bytes, 4)?))?;
        let address = |at: usize| Some(IpAddr::V6(Ipv6Addr::from(*bytes.get(at..)?.first_chunk::<16>()?)));
        let (mut protocol, mut at, mut fragment) = (bytes[6], IPV6, None);
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

    /// Whether the transport's checksum is correct, left to the network card, or unknown.
    fn is_intact(&self, frame: &Frame<'_>) -> bool {
        if frame.checksum_left || self.fragment.is_some() {
            return true;
        }
        match self.protocol {
            // Without a checksum; IPv6 needs one (RFC 8200, 8.1).
            PROTOCOL_UDP if u16_at(self.payload, 6) == Some(0) => return self.source.is_ipv4(),
            PROTOCOL_UDP | PROTOCOL_TCP => {}
            _ => return true,
        }
        let pseudo = [self.source, self.destination].map(|address| match address {
            IpAddr::V4(address) => sum(&address.octets()),
            IpAddr::V6(address) => sum(&address.octets()),
        });
        let pseudo = pseudo.iter().sum::<u64>() + pseudo_header_sum(&[], self.protocol, self.payload.len());
        fold(sum(self.payload) + pseudo) == 0xffff
    }
}

/// A TCP segment.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Segment<'a> {
    pub from: u16,
    pub to: u16,
    pub sequence: u32,
    /// Acknowledgment number, if the segment has one.
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
            payload: bytes.get(header.max(headers::TCP)..)?,
        })
    }
}
