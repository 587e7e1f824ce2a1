//! UDP datagrams in IPv4 in Ethernet, as hosts of the emulated network send them.

use std::net::Ipv4Addr;

use cotorra_fabric::PortId;
use cotorra_graph::HostAddress;

const ETHERNET: usize = 14;
const IPV4: usize = 20;
const UDP: usize = 8;

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
    let length =
        |bytes: usize| u16::try_from(bytes).expect("the service's packets fit in one frame").to_be_bytes();
    frame.clear();
    frame.extend_from_slice(&receiver.mac);
    frame.extend_from_slice(&sender.mac);
    frame.extend_from_slice(&[0x08, 0x00, 0x45, 0]);
    frame.extend_from_slice(&length(IPV4 + UDP + payload.len()));
    // No fragments, 64 hops, UDP; the checksum follows below.
    frame.extend_from_slice(&[0, 0, 0x40, 0, 64, 17, 0, 0]);
    frame.extend_from_slice(&sender.ipv4.octets());
    frame.extend_from_slice(&receiver.ipv4.octets());
    let sum: u32 =
        frame[ETHERNET..].chunks_exact(2).map(|word| u32::from(u16::from_be_bytes([word[0], word[1]]))).sum();
    let folded = (sum & 0xffff) + (sum >> 16);
    let checksum = !((folded & 0xffff) + (folded >> 16)) as u16;
    frame[ETHERNET + 10..ETHERNET + 12].copy_from_slice(&checksum.to_be_bytes());
    frame.extend_from_slice(&from.1.to_be_bytes());
    frame.extend_from_slice(&to.1.to_be_bytes());
    frame.extend_from_slice(&length(UDP + payload.len()));
    frame.extend_from_slice(&[0, 0]);
    frame.extend_from_slice(payload);
}

/// Returns the datagram in a frame; `None` if there is none.
pub(super) fn parse(frame: &[u8]) -> Option<Datagram<'_>> {
    let packet = frame.get(ETHERNET..).filter(|_| frame[12..14] == [0x08, 0x00])?;
    let header = packet.get(..IPV4).filter(|header| header[0] == 0x45 && header[9] == 17)?;
    let udp = packet.get(IPV4..)?;
    let word = |at: usize| Some(u16::from_be_bytes([*udp.get(at)?, *udp.get(at + 1)?]));
    let payload = udp.get(UDP..usize::from(word(4)?))?;
    let sender = Ipv4Addr::new(header[12], header[13], header[14], header[15]);
    Some(Datagram { sender, from: word(0)?, to: word(2)?, payload })
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
