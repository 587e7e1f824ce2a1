//! The packets of probes and throughput tests. Their Ethernet header keeps network stacks and bridges from handling them.

use cotorra_flows::{
    checksum::{complement, fold, sum},
    headers::{ETHERNET, IPV4, Ipv4, PROTOCOL_UDP, UDP, pseudo_header_sum, udp_header},
};
use cotorra_stamp::{BASE_LENGTH, PORT};

use crate::frame::Frame;

/// The EtherType of packets that measure a link: the first for local experiments (IEEE 802-2014, 9.2.4), which network
/// stacks ignore.
pub const MEASURING_ETHERTYPE: u16 = 0x88b5;

/// Ethernet header of packets that measure a link. The destination is the nearest bridge, which never forwards it
/// (IEEE 802.1Q-2018, table 8-1). The source is a locally administered address that no host has.
const MEASURING: [u8; ETHERNET] = {
    let [high, low] = MEASURING_ETHERTYPE.to_be_bytes();
    [0x01, 0x80, 0xc2, 0x00, 0x00, 0x0e, 0x02, 0x78, 0x00, 0x00, 0x00, 0x01, high, low]
};

/// Bytes of all headers of a probe.
pub(super) const HEADERS: usize = ETHERNET + IPV4 + UDP;
const _: () = assert!(HEADERS + BASE_LENGTH == cotorra_probes::FRAME_BYTES);
const UDP_CHECKSUM: usize = HEADERS - 2;

/// Builds the frame of a probe: STAMP over UDP and IPv4 with TTL 255 (RFC 8762). Its addresses are zero, because nothing
/// routes by them.
pub(super) fn probe(stamp: &[u8], mut bytes: Vec<u8>) -> Frame {
    bytes.extend(MEASURING);
    let length = UDP + stamp.len();
    bytes.extend(Ipv4 { ttl: 255, protocol: PROTOCOL_UDP, ..Ipv4::default() }.header(length));
    bytes.extend(udp_header(PORT, PORT, stamp.len()));
    bytes.extend(stamp);
    let checksum = complement(udp_sum(&bytes));
    bytes[UDP_CHECKSUM..HEADERS].copy_from_slice(&checksum.to_be_bytes());
    Frame::new(bytes)
}

/// Returns the STAMP packet in a probe's frame; `None` if it is damaged.
pub(super) fn stamp(bytes: &[u8]) -> Option<&[u8]> {
    let is_whole = bytes.len() >= HEADERS + BASE_LENGTH
        && bytes.starts_with(&MEASURING)
        && fold(sum(&bytes[ETHERNET..ETHERNET + IPV4])) == 0xffff
        && fold(udp_sum(bytes)) == 0xffff;
    is_whole.then(|| &bytes[HEADERS..])
}

/// Returns the sum behind UDP's checksum (RFC 768).
fn udp_sum(bytes: &[u8]) -> u64 {
    let udp = &bytes[ETHERNET + IPV4..];
    sum(udp) + pseudo_header_sum(&[], PROTOCOL_UDP, udp.len())
}

/// Builds a packet of a throughput test, `length` bytes long with its Ethernet header.
pub(super) fn filler(length: usize, mut bytes: Vec<u8>) -> Frame {
    bytes.extend(MEASURING);
    bytes.resize(length, 0);
    Frame::new(bytes)
}
