//! UDP datagrams in IPv4 in Ethernet, as hosts of the emulated network send and receive them.

use cotorra_fabric::PortId;
use cotorra_flows::{
    Datagram, Frame,
    headers::{ETHERTYPE_IPV4, Ipv4, PROTOCOL_UDP, UDP, UDP_CHECKSUM, udp_checksum, udp_header},
};
use cotorra_graph::HostAddress;

/// Replaces `frame` by a frame with a datagram. RFC 894, RFC 791, RFC 768.
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
    let datagram = frame.len();
    frame.extend_from_slice(&udp_header(from.1, to.1, payload.len()));
    frame.extend_from_slice(payload);
    let addresses = [source.octets(), destination.octets()].concat();
    let checksum = udp_checksum(&addresses, &frame[datagram..]);
    frame[datagram + UDP_CHECKSUM..datagram + UDP].copy_from_slice(&checksum);
}

/// Returns the datagram in a frame that a host receives; `None` if there is none, or if the host drops it.
pub(super) fn receive(frame: &[u8], at: PortId) -> Option<Datagram<'_>> {
    let HostAddress { mac, ipv4, .. } = HostAddress::of(at.0);
    Datagram::received(&Frame { bytes: frame, checksum_left: false, segment: None }, mac, ipv4)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_built_frame_is_received_by_its_host_only() {
        let mut frame = vec![1, 2, 3];
        build(&mut frame, (PortId(0), 40_000), (PortId(7), 7711), b"where to?");
        let datagram = receive(&frame, PortId(7)).unwrap();
        assert_eq!((datagram.to, datagram.payload), (7711, &b"where to?"[..]));
        assert_eq!((*datagram.from.ip(), datagram.from.port()), (HostAddress::of(0).ipv4, 40_000));
        assert_eq!(receive(&frame, PortId(6)), None);
        assert_ne!(frame[40..42], [0, 0], "a datagram without a checksum protects nothing");
    }
}
