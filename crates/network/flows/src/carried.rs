//! Finds the bytes that a frame carries for a program, without a check of their checksum.

use std::hash::{DefaultHasher, Hash, Hasher};

use crate::{
    headers::{PROTOCOL_TCP, PROTOCOL_UDP, UDP, u16_at},
    packet::{Frame, Packet, Segment},
};

/// Bytes of a program in a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Carried<'a> {
    /// Ports of the sender and the receiver.
    pub ports: [u16; 2],
    /// Place in a TCP connection; `None` for a datagram.
    pub place: Option<Place>,
    /// The bytes.
    pub payload: &'a [u8],
}

/// Place of bytes in one direction of a TCP connection.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Place {
    /// Identifies the connection and the direction.
    pub stream: u64,
    /// Sequence number of the first byte.
    pub sequence: u32,
}

impl<'a> Carried<'a> {
    /// Finds the bytes in a frame; `None` for other protocols, segments without bytes, and fragments after the first.
    pub fn of(frame: &Frame<'a>) -> Option<Self> {
        let packet = Packet::unchecked(frame)?;
        if packet.fragment.is_some_and(|fragment| fragment.offset > 0) {
            return None;
        }
        match packet.protocol {
            PROTOCOL_UDP => Some(Self {
                ports: [u16_at(packet.payload, 0)?, u16_at(packet.payload, 2)?],
                place: None,
                payload: packet.payload.get(UDP..)?,
            }),
            PROTOCOL_TCP => {
                let segment = Segment::of(packet.payload).filter(|segment| !segment.payload.is_empty())?;
                let ports = [segment.from, segment.to];
                let mut stream = DefaultHasher::new();
                (packet.source, packet.destination, ports).hash(&mut stream);
                let place = Place { stream: stream.finish(), sequence: segment.sequence };
                Some(Self { ports, place: Some(place), payload: segment.payload })
            }
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{SYN, frame, tcp, udp, udp_fragments};

    const CLIENT: (u8, u16) = (1, 4000);
    const SERVER: (u8, u16) = (2, 80);

    fn carried(bytes: &[u8]) -> Option<Carried<'_>> {
        Carried::of(&frame(bytes))
    }

    #[test]
    fn bytes_of_programs_are_found_and_nothing_else() {
        let datagram = udp(CLIENT, SERVER, b"hello");
        let expected = Carried { ports: [4000, 80], place: None, payload: b"hello" };
        assert_eq!(carried(&datagram), Some(expected));
        let fragments = udp_fragments(CLIENT, SERVER, &[7; 40], 16);
        assert_eq!(carried(&fragments[0]).unwrap().payload, [7; 8]);
        assert_eq!(carried(&fragments[1]), None);
        assert_eq!(carried(&tcp(CLIENT, SERVER, 9, 1, SYN, b"")), None);
        assert_eq!(carried(&datagram[..20]), None);
    }

    #[test]
    fn each_direction_of_a_connection_is_a_stream() {
        let place =
            |from, to, sequence| carried(&tcp(from, to, sequence, 1, 0, b"x")).unwrap().place.unwrap();
        let first = place(CLIENT, SERVER, 9);
        assert_eq!(first.sequence, 9);
        assert_eq!(place(CLIENT, SERVER, 10).stream, first.stream);
        for other in [place(SERVER, CLIENT, 9), place((1, 4001), SERVER, 9), place((3, 4000), SERVER, 9)] {
            assert_ne!(other.stream, first.stream);
        }
    }
}
