//! Headers of Ethernet, IP, UDP and TCP: lengths, numbers, and the fields that several crates read or write.

use std::net::Ipv4Addr;

use crate::checksum::{complement, fold, sum};

/// Length of an Ethernet header without tags.
pub const ETHERNET: usize = 14;
/// Length of an IPv4 header without options.
pub const IPV4: usize = 20;
/// Length of an IPv6 header without extensions.
pub const IPV6: usize = 40;
/// Length of a UDP header.
pub const UDP: usize = 8;
/// Offset of the checksum in a UDP header.
pub const UDP_CHECKSUM: usize = 6;
/// Length of a TCP header without options.
pub const TCP: usize = 20;

/// The EtherType of IPv4.
pub const ETHERTYPE_IPV4: u16 = 0x0800;
/// The EtherType of IPv6.
pub const ETHERTYPE_IPV6: u16 = 0x86dd;

/// The IP protocol number of TCP.
pub const PROTOCOL_TCP: u8 = 6;
/// The IP protocol number of UDP.
pub const PROTOCOL_UDP: u8 = 17;

/// The version of an IP packet, by its EtherType.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum IpVersion {
    /// IPv4.
    V4,
    /// IPv6.
    V6,
}

/// Reads a big-endian `u16`; `None` beyond the end.
pub fn u16_at(bytes: &[u8], at: usize) -> Option<u16> {
    bytes.get(at..)?.first_chunk().copied().map(u16::from_be_bytes)
}

/// Reads a big-endian `u32`; `None` beyond the end.
pub fn u32_at(bytes: &[u8], at: usize) -> Option<u32> {
    bytes.get(at..)?.first_chunk().copied().map(u32::from_be_bytes)
}

/// Returns where the IP header of an Ethernet frame begins, behind up to two VLAN tags (IEEE 802.1Q), and its version.
pub fn find_ip(frame: &[u8]) -> Option<(usize, IpVersion)> {
    let mut at = ETHERNET - 2;
    for _ in 0..3 {
        match u16_at(frame, at)? {
            0x8100 | 0x88a8 => at += 4,
            ETHERTYPE_IPV4 => return Some((at + 2, IpVersion::V4)),
            ETHERTYPE_IPV6 => return Some((at + 2, IpVersion::V6)),
            _ => return None,
        }
    }
    None
}

/// The fields of an IPv4 header without options (RFC 791).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Ipv4 {
    /// The packet's identification.
    pub identification: u16,
    /// Flags and fragment offset.
    pub fragment: u16,
    /// Hops left.
    pub ttl: u8,
    /// The protocol of the payload.
    pub protocol: u8,
    /// The sender.
    pub source: Ipv4Addr,
    /// The receiver.
    pub destination: Ipv4Addr,
}

/// All zero.
impl Default for Ipv4 {
    fn default() -> Self {
        let nowhere = Ipv4Addr::UNSPECIFIED;
        Self { identification: 0, fragment: 0, ttl: 0, protocol: 0, source: nowhere, destination: nowhere }
    }
}

impl Ipv4 {
    /// The flag that forbids fragments, in [`Ipv4::fragment`].
    pub const DONT_FRAGMENT: u16 = 0x4000;

    /// Builds the header of a packet with `payload` bytes behind it, with its checksum.
    ///
    /// # Panics
    /// If the packet is longer than 65,535 bytes.
    pub fn header(&self, payload: usize) -> [u8; IPV4] {
        let mut header = [0; IPV4];
        header[0] = 0x45;
        header[2..4].copy_from_slice(&length(IPV4 + payload));
        header[4..6].copy_from_slice(&self.identification.to_be_bytes());
        header[6..8].copy_from_slice(&self.fragment.to_be_bytes());
        header[8..10].copy_from_slice(&[self.ttl, self.protocol]);
        header[12..16].copy_from_slice(&self.source.octets());
        header[16..20].copy_from_slice(&self.destination.octets());
        let checksum = !fold(sum(&header));
        header[10..12].copy_from_slice(&checksum.to_be_bytes());
        header
    }
}

/// Builds the UDP header of a datagram with `payload` bytes, without a checksum, as RFC 768 allows over IPv4.
///
/// # Panics
/// If the datagram is longer than 65,535 bytes.
pub fn udp_header(from: u16, to: u16, payload: usize) -> [u8; UDP] {
    let mut header = [0; UDP];
    header[0..2].copy_from_slice(&from.to_be_bytes());
    header[2..4].copy_from_slice(&to.to_be_bytes());
    header[4..6].copy_from_slice(&length(UDP + payload));
    header
}

/// Returns the checksum of a datagram whose header has none yet. `addresses` are both IP addresses as they stand in the IP
/// header.
pub fn udp_checksum(addresses: &[u8], datagram: &[u8]) -> [u8; 2] {
    complement(sum(datagram) + pseudo_header_sum(addresses, PROTOCOL_UDP, datagram.len())).to_be_bytes()
}

/// Returns the sum of the pseudo header that a transport's checksum covers (RFC 768, RFC 9293, RFC 8200, 8.1), not
/// folded. `addresses` are both IP addresses as they stand in the header; `length` is that of the transport's header and
/// payload.
pub fn pseudo_header_sum(addresses: &[u8], protocol: u8, length: usize) -> u64 {
    sum(addresses) + u64::from(protocol) + length as u64
}

fn length(bytes: usize) -> [u8; 2] {
    u16::try_from(bytes).expect("a packet's length fits in 16 bits").to_be_bytes()
}
