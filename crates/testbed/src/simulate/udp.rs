//! UDP datagrams in IPv4 in Ethernet, as hosts of the emulated network send them.

use std::net::Ipv4Addr;

use cotorra_fabric::PortId;
use cotorra_flows::headers::{ETHERNET, ETHERTYPE_IPV4, IPV4, Ipv4, PROTOCOL_UDP, UDP, u16_at, udp_header};
use cotorra_graph::HostAddress;

/// A datagram in a frame.
pub(super) struct Datagram<'a> {
    pub(super) sender: Ipv4Addr,
    pub(super) from: u16,
    pub(super) to: u16,
    pub(super) payload: &'a [u8],
}

/// Replaces `frame` by a frame with a datagram. RFC 894, RFC 791, RFC 768; without a UDP checksum, as RFC 768 allows.
pub(super) fn build(frame: &mut Vec<u8>, from: (PortId, u16), to: (PortId, u16), payload: &[u8]) {
    let (sender, receiver) = (HostAddress::of(from.0.0), HostAddress::of(to.0.0));
    let (source, destination) = (sender.ipv4, receiver.ipv4);
    let (fragment, protocol) = (Ipv4::DONT_FRAGMENT, PROTOCOL_UDP);
    let header = Ipv4 { identification: 0, fragment, ttl: 64, protocol, source, destination };
    frame.clear();
    frame.extend_from_slice(&receiver.mac);
    frame.extend_from_slice(&sender.mac);
    frame.extend_from_slice(&ETHERTYPE_IPV4.to_be_bytes());
    frame.extend_from_slice(&header.header(UDP + payload.len()));
    frame.extend_from_slice(&udp_header(from.1, to.1, payload.len()));
    frame.extend_from_slice(payload);
}

/// Returns the datagram in a frame; `None` if there is none.
pub(super) fn parse(frame: &[u8]) -> Option<Datagram<'_>> {
    let packet = frame.get(ETHERNET..).filter(|_| u16_at(frame, 12) == Some(ETHERTYPE_IPV4))?;
    let header = packet.get(..IPV4).filter(|header| header[0] == 0x45 && header[9] == PROTOCOL_UDP)?;
    let udp = packet.get(IPV4..)?;
    let payload = udp.get(UDP..usize::from(u16_at(udp, 4)?))?;
    let sender = Ipv4Addr::new(header[12], header[13], header[14], header[15]);
    Some(Datagram { sender, from: u16_at(udp, 0)?, to: u16_at(udp, 2)?, payload })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_built_frame_parses_and_its_header_sums_to_zero() {
        let mut frame = vec![1, 2, 3];
        build(&mut frame, (PortId(0), 40_000), (PortId(7), 7711), b"where to?");
        let datagram = parse(&frame).unwrap();
        assert_eq!((datagram.from, datagram.to, datagram.payload), (40_000, 7711, &b"where to?"[..]));
        assert_eq!(datagram.sender, HostAddress::of(0).ipv4);
        let words = frame[ETHERNET..ETHERNET + IPV4].chunks_exact(2);
        let sum: u32 = words.map(|w| u32::from(u16::from_be_bytes([w[0], w[1]]))).sum();
        assert_eq!((sum & 0xffff) + (sum >> 16), 0xffff);
    }

    #[test]
    fn other_frames_have_no_datagram() {
        let mut frame = Vec::new();
        build(&mut frame, (PortId(0), 1), (PortId(1), 2), b"x");
        for end in 0..frame.len() {
            assert!(parse(&frame[..end]).is_none(), "{end} bytes");
        }
        frame[23] = 6;
        assert!(parse(&frame).is_none());
    }
}
