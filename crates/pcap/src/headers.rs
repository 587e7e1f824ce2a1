//! Headers of captured packets: links, IP and TCP.

use std::{
    hash::{DefaultHasher, Hash, Hasher},
    net::IpAddr,
};

use crate::Order;

/// Length of an Ethernet header.
pub const ETHERNET: usize = 14;
/// Lengths of the headers of Linux's `any` interface, of both versions.
const COOKED: usize = 16;
const COOKED_2: usize = 20;
/// EtherTypes.
const IPV4: u16 = 0x0800;
const IPV6: u16 = 0x86dd;
const VLAN: [u16; 2] = [0x8100, 0x88a8];
/// IP protocol numbers.
const TCP: u8 = 6;
const UDP: u8 = 17;
/// Lengths of IP headers without options.
const IPV4_HEADER: usize = 20;
const IPV6_HEADER: usize = 40;
const TCP_HEADER: usize = 20;

/// Returns the length of what stands before the IP header, by the type of the link
/// (<https://www.tcpdump.org/linktypes.html>); `None` if the packet is not IP.
pub fn link_header(link_type: u16, bytes: &[u8]) -> Option<usize> {
    let number = |at| Order::Big.u16_at(bytes, at);
    let is_ip = |ethertype: u16| ethertype == IPV4 || ethertype == IPV6;
    match link_type {
        // Ethernet, with up to two VLAN tags (IEEE 802.1Q).
        1 => {
            let tags = (0..3)
                .find(|tags| number(ETHERNET - 2 + 4 * tags).is_some_and(|kind| !VLAN.contains(&kind)))?;
            let header = ETHERNET + 4 * tags;
            is_ip(number(header - 2)?).then_some(header)
        }
        // Raw IP.
        12 | 14 | 101 | 228 | 229 => Some(0),
        113 => is_ip(number(COOKED - 2)?).then_some(COOKED),
        276 => is_ip(number(0)?).then_some(COOKED_2),
        _ => None,
    }
}

/// The IP header of a packet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Ip<'a> {
    /// Address of its sender.
    pub source: IpAddr,
    /// Address of its receiver.
    pub destination: IpAddr,
    /// Length of the whole packet, by its header.
    pub length: usize,
    protocol: u8,
    /// Length of its IP header.
    header: usize,
    /// Whether it is a fragment behind the first one, and so has no header of a transport protocol.
    is_later_fragment: bool,
    /// The packet as far as it was captured, without padding behind it.
    bytes: &'a [u8],
}

impl<'a> Ip<'a> {
    /// Reads a packet; `None` if it is damaged or cut off within its IP header. Extension headers of IPv6 count as payload.
    pub fn read(bytes: &'a [u8]) -> Option<Self> {
        let number = |at| Order::Big.u16_at(bytes, at);
        let (source, destination, length, protocol, header, is_later_fragment);
        match bytes.first()? >> 4 {
            4 => {
                header = usize::from(bytes[0] & 0xf) * 4;
                if header < IPV4_HEADER {
                    return None;
                }
                (length, protocol) = (usize::from(number(2)?), *bytes.get(9)?);
                is_later_fragment = number(6)? & 0x1fff != 0;
                source = IpAddr::from(*bytes.get(12..)?.first_chunk::<4>()?);
                destination = IpAddr::from(*bytes.get(16..)?.first_chunk::<4>()?);
            }
            6 => {
                (header, is_later_fragment) = (IPV6_HEADER, false);
                (length, protocol) = (IPV6_HEADER + usize::from(number(4)?), *bytes.get(6)?);
                source = IpAddr::from(*bytes.get(8..)?.first_chunk::<16>()?);
                destination = IpAddr::from(*bytes.get(24..)?.first_chunk::<16>()?);
            }
            _ => return None,
        }
        if length < header {
            return None;
        }
        let bytes = &bytes[..bytes.len().min(length)];
        Some(Self { source, destination, length, protocol, header, is_later_fragment, bytes })
    }

    /// Returns the fields that no switch or router changes, of the first `kept` bytes: all but the hop limit, traffic class,
    /// flow label and checksums. The sender's checksums are often completed by its network card, behind the capture.
    pub fn fingerprint(&self, kept: usize) -> u64 {
        let mut hasher = DefaultHasher::new();
        (self.source, self.destination, self.length, self.protocol).hash(&mut hasher);
        let bytes = &self.bytes[..self.bytes.len().min(kept)];
        if self.source.is_ipv4() {
            // Identification, flags and fragment offset (RFC 791).
            bytes.get(4..8).hash(&mut hasher);
        }
        let payload = bytes.get(self.header..).unwrap_or_default();
        let checksum = match self.protocol {
            _ if self.is_later_fragment => None,
            TCP => Some(16),
            UDP => Some(6),
            _ => None,
        };
        match checksum {
            Some(at) => {
                payload[..payload.len().min(at)].hash(&mut hasher);
                payload.get(at + 2..).hash(&mut hasher);
            }
            None => payload.hash(&mut hasher),
        }
        hasher.finish()
    }

    /// Returns the TCP header; `None` if it has none or it is cut off.
    pub fn segment(&self) -> Option<Segment> {
        if self.protocol != TCP || self.is_later_fragment {
            return None;
        }
        let tcp = self.bytes.get(self.header..)?;
        let (short, long) = (|at| Order::Big.u16_at(tcp, at), |at| Order::Big.u32_at(tcp, at));
        let (header, flags) = (usize::from(*tcp.get(12)? >> 4) * 4, *tcp.get(13)?);
        let payload = self.length.checked_sub(self.header + header).filter(|_| header >= TCP_HEADER)?;
        let [fin, syn, rst, ack] = [1, 2, 4, 16].map(|flag| flags & flag != 0);
        Some(Segment {
            ports: [short(0)?, short(2)?],
            sequence: long(4)?,
            acknowledged: if ack { Some(long(8)?) } else { None },
            length: payload as u32 + u32::from(syn) + u32::from(fin),
            is_reset: rst,
            stamps: time_stamps(tcp.get(TCP_HEADER..header).unwrap_or_default()),
        })
    }
}

/// The header of a TCP segment (RFC 9293).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Segment {
    /// Ports of source and destination.
    pub ports: [u16; 2],
    /// First sequence number.
    pub sequence: u32,
    /// The next sequence number that its sender expects.
    pub acknowledged: Option<u32>,
    /// Sequence numbers that it takes.
    pub length: u32,
    /// Whether it aborts the connection.
    pub is_reset: bool,
    /// Its timestamp, and the one that it echoes (RFC 7323).
    pub stamps: Option<[u32; 2]>,
}

/// Finds the timestamps among the options of TCP (RFC 7323, 3.2).
fn time_stamps(mut options: &[u8]) -> Option<[u32; 2]> {
    const END: u8 = 0;
    const NOTHING: u8 = 1;
    const TIME_STAMPS: u8 = 8;
    loop {
        match *options.first()? {
            END => return None,
            NOTHING => options = &options[1..],
            kind => {
                let length = usize::from(*options.get(1)?);
                if kind == TIME_STAMPS && length == 10 {
                    return Some([Order::Big.u32_at(options, 2)?, Order::Big.u32_at(options, 6)?]);
                }
                options = options.get(length.max(2)..)?;
            }
        }
    }
}
