//! No frame and no offload that lies about it makes the fabric panic; what it cuts fits the wire.
#![no_main]

use cotorra_fabric::{Checksum, Frame, Offload, Segmentation, SegmentationKind};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|input: ([u16; 4], u8, Vec<u8>)| {
    let ([start, offset, size, header_len], kind, bytes) = input;
    let segmentation = match kind % 4 {
        0 => None,
        1 => Some(SegmentationKind::Tcp4),
        2 => Some(SegmentationKind::Tcp6),
        _ => Some(SegmentationKind::Udp),
    };
    let offload = Offload {
        checksum: (kind & 4 == 0).then_some(Checksum { start, offset }),
        segmentation: segmentation.map(|kind| Segmentation { kind, size, header_len }),
    };
    let _ = Frame::with_offload(bytes.clone(), offload).complete_checksum();
    let mut frame = Frame::with_offload(bytes, offload);
    if frame.check().is_ok() {
        let promised = frame.wire_packets();
        let mut packets = Vec::new();
        if frame.segment(&mut packets).is_ok() {
            assert_eq!(packets.len() as u32, promised);
        }
    }
});
