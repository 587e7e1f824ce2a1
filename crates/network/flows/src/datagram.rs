//! Datagrams as a host's network stack receives them.

use std::net::{IpAddr, Ipv4Addr, SocketAddrV4};

use crate::{
    headers::{ETHERNET, ETHERTYPE_IPV4, PROTOCOL_UDP, UDP, u16_at},
    packet::{Frame, Packet},
};

/// Version 4, and a header without options.
const VERSION_AND_LENGTH: u8 = 0x45;

/// A UDP datagram over IPv4.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Datagram<'a> {
    /// Its sender.
    pub from: SocketAddrV4,
    /// The port that it is for.
    pub to: u16,
    /// Its content.
    pub payload: &'a [u8],
}

impl<'a> Datagram<'a> {
    /// Returns the datagram in a frame, if the host with these addresses hands it to a socket.
    ///
    /// Decides as Linux does. It drops frames for others, packets for others or from senders that cannot be, and packets
    /// whose length or checksum is wrong. A datagram without a checksum is taken. Fragments and packets with options are
    /// dropped, too: no host of a testbed sends them.
    pub fn received(frame: &Frame<'a>, mac: [u8; 6], address: Ipv4Addr) -> Option<Self> {
        let is_for_host =
            frame.bytes.starts_with(&mac) && u16_at(frame.bytes, ETHERNET - 2)? == ETHERTYPE_IPV4;
        if !is_for_host || *frame.bytes.get(ETHERNET)? != VERSION_AND_LENGTH {
            return None;
        }
        let packet = Packet::of(frame)?;
        let (IpAddr::V4(source), IpAddr::V4(destination)) = (packet.source, packet.destination) else {
            return None;
        };
        let is_sender = !(source == address
            || source.octets()[0] == 0
            || source.is_loopback()
            || source.is_multicast()
            || source.is_broadcast());
        if packet.protocol != PROTOCOL_UDP
            || packet.fragment.is_some()
            || destination != address
            || !is_sender
        {
            return None;
        }
        let from = SocketAddrV4::new(source, u16_at(packet.payload, 0)?);
        Some(Self { from, to: u16_at(packet.payload, 2)?, payload: packet.payload.get(UDP..)? })
    }
}

#[cfg(test)]
mod tests {
    use proptest::{collection::vec, prelude::*};

    use super::*;
    use crate::{
        headers::{IPV4, UDP_CHECKSUM},
        testing::{frame, udp},
    };

    const MAC: [u8; 6] = [2, 0, 0, 0, 0, 2];
    const HOST: Ipv4Addr = Ipv4Addr::new(10, 0, 0, 2);

    fn received(bytes: &[u8]) -> Option<Datagram<'_>> {
        Datagram::received(&frame(bytes), MAC, HOST)
    }

    fn sent(payload: &[u8]) -> Vec<u8> {
        udp((1, 40_000), (2, 7711), payload)
    }

    #[test]
    fn a_datagram_for_the_host_is_taken_and_others_are_not() {
        let bytes = sent(b"where to?");
        let from = "10.0.0.1:40000".parse().unwrap();
        assert_eq!(received(&bytes), Some(Datagram { from, to: 7711, payload: b"where to?" }));
        assert_eq!(Datagram::received(&frame(&bytes), [2, 0, 0, 0, 0, 3], HOST), None);
        assert_eq!(Datagram::received(&frame(&bytes), MAC, Ipv4Addr::new(10, 0, 0, 3)), None);
        assert!((0..bytes.len()).all(|end| received(&bytes[..end]).is_none()));
        // An Ethernet frame may be longer than its packet.
        let padded = [&bytes[..], &[1; 9]].concat();
        assert_eq!(received(&padded), received(&bytes));
        // From itself.
        assert_eq!(received(&udp((2, 1), (2, 2), b"")), None);
    }

    #[test]
    fn a_datagram_without_a_checksum_is_taken() {
        let mut bytes = sent(b"x");
        bytes[ETHERNET + IPV4 + UDP_CHECKSUM..][..2].fill(0);
        assert_eq!(received(&bytes).map(|datagram| datagram.payload), Some(&b"x"[..]));
    }

    proptest! {
        #[test]
        fn no_flipped_bit_is_believed(payload in vec(any::<u8>(), 0..200), choice in any::<prop::sample::Index>()) {
            let intact = sent(&payload);
            let bit = choice.index((intact.len() - ETHERNET) * 8);
            let mut bytes = intact.clone();
            bytes[ETHERNET + bit / 8] ^= 1 << (bit % 8);
            // A checksum with one bit set becomes none, and the rest is as it was.
            let left = bytes[ETHERNET + IPV4 + UDP_CHECKSUM..][..2] == [0, 0];
            prop_assert_eq!(received(&bytes), received(&intact).filter(|_| left));
        }
    }
}
