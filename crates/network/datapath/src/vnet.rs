//! The header before each frame at a port, which describes the work that the sender left to its network card. It is
//! `virtio_net_hdr` in its legacy form, 10 bytes in the machine's byte order (virtio 1.2, 5.1.6).

use cotorra_fabric::{Checksum, Offload, Segmentation, SegmentationKind};

/// Length of the header, bytes.
pub(crate) const LENGTH: usize = 10;

const NEEDS_CSUM: u8 = 1;
const GSO_NONE: u8 = 0;
const GSO_TCPV4: u8 = 1;
const GSO_TCPV6: u8 = 4;
const GSO_UDP_L4: u8 = 5;
/// Set beside a TCP kind when the first segment carries CWR, which its own header shows as well.
const GSO_ECN: u8 = 0x80;

/// Decodes a header. Returns `None` for a kind of super-packet that our ports do not let through.
pub(crate) fn decode(header: &[u8; LENGTH]) -> Option<Offload> {
    let word = |at: usize| u16::from_ne_bytes([header[at], header[at + 1]]);
    let kind = match header[1] & !GSO_ECN {
        GSO_NONE => None,
        GSO_TCPV4 => Some(SegmentationKind::Tcp4),
        GSO_TCPV6 => Some(SegmentationKind::Tcp6),
        GSO_UDP_L4 => Some(SegmentationKind::Udp),
        _ => return None,
    };
    Some(Offload {
        checksum: (header[0] & NEEDS_CSUM != 0).then(|| Checksum { start: word(6), offset: word(8) }),
        segmentation: kind.map(|kind| Segmentation { kind, size: word(4), header_len: word(2) }),
    })
}

/// Encodes a header.
pub(crate) fn encode(offload: Offload) -> [u8; LENGTH] {
    let mut header = [0; LENGTH];
    let mut put = |at: usize, value: u16| header[at..at + 2].copy_from_slice(&value.to_ne_bytes());
    let mut flags = 0;
    let mut kind = GSO_NONE;
    if let Some(checksum) = offload.checksum {
        flags = NEEDS_CSUM;
        put(6, checksum.start);
        put(8, checksum.offset);
    }
    if let Some(segmentation) = offload.segmentation {
        kind = match segmentation.kind {
            SegmentationKind::Tcp4 => GSO_TCPV4,
            SegmentationKind::Tcp6 => GSO_TCPV6,
            SegmentationKind::Udp => GSO_UDP_L4,
        };
        put(2, segmentation.header_len);
        put(4, segmentation.size);
    }
    header[0] = flags;
    header[1] = kind;
    header
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn encoded_headers_decode() {
        let checksum = Some(Checksum { start: 34, offset: 16 });
        for kind in [SegmentationKind::Tcp4, SegmentationKind::Tcp6, SegmentationKind::Udp] {
            let segmentation = Some(Segmentation { kind, size: 1448, header_len: 66 });
            for offload in [
                Offload { checksum, segmentation },
                Offload { checksum, segmentation: None },
                Offload { checksum: None, segmentation },
                Offload::NONE,
            ] {
                assert_eq!(decode(&encode(offload)), Some(offload));
            }
        }
    }

    #[test]
    fn unknown_super_packets_are_rejected() {
        const UFO: u8 = 3;
        let mut header = encode(Offload::NONE);
        header[1] = UFO;
        assert_eq!(decode(&header), None);
        header[1] = GSO_TCPV4 | GSO_ECN;
        assert!(decode(&header).is_some_and(|o| o.segmentation.is_some()));
    }
}
