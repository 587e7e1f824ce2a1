use proptest::prelude::*;

use super::{
    write::{Record, interface, packet, section},
    *,
};

#[derive(Debug, Clone)]
struct Written {
    interface: u32,
    at_ns: u64,
    bytes: Vec<u8>,
    cut: u32,
    comment: String,
    missed: u64,
}

fn written() -> impl Strategy<Value = Written> {
    let bytes = prop::collection::vec(any::<u8>(), 0..40);
    let numbers = (0..3_u32, 0..u64::from(u32::MAX) << 20, 0..100_u32, 0..9_u64);
    (numbers, bytes, "[a-z]{0,9}").prop_map(|((interface, at_ns, cut, missed), bytes, comment)| Written {
        interface,
        at_ns,
        bytes,
        cut,
        comment,
        missed,
    })
}

fn capture(all: &[Written]) -> Vec<u8> {
    let mut out = Vec::new();
    section(&mut out, "cotorra");
    for (link_type, name) in [(ETHERNET, "lan forward"), (ETHERNET, ""), (113, "any")] {
        interface(&mut out, link_type, 65_535, name);
    }
    for Written { interface, at_ns, bytes, cut, comment, missed } in all {
        let original = bytes.len() as u32 + cut;
        let (interface, at_ns, missed) = (*interface, *at_ns, *missed);
        packet(&mut out, &Record { interface, at_ns, bytes, original, comment, missed });
    }
    out
}

fn read_all(bytes: &[u8]) -> Result<Vec<Packet<'_>>, ReadError> {
    let mut packets = Vec::new();
    read(bytes, |packet| {
        packets.push(packet);
        Ok::<_, ReadError>(())
    })?;
    Ok(packets)
}

proptest! {
    #[test]
    fn written_packets_are_read_back(all in prop::collection::vec(written(), 0..9)) {
        let bytes = capture(&all);
        let expected: Vec<_> = all
            .iter()
            .map(|its| Packet {
                link_type: [ETHERNET, ETHERNET, 113][its.interface as usize],
                at_ns: its.at_ns as i64,
                bytes: &its.bytes,
                original: its.bytes.len() as u32 + its.cut,
            })
            .collect();
        prop_assert_eq!(read_all(&bytes), Ok(expected));
        let mut blocks = Blocks::new(u64::MAX, u64::MAX);
        prop_assert_eq!(blocks.take(&bytes), &bytes);
        let missed = all.iter().map(|its| its.missed).sum::<u64>();
        prop_assert_eq!((blocks.packets(), blocks.missed()), (all.len() as u64, missed));
    }

    #[test]
    fn a_capture_that_is_cut_off_has_the_packets_before(all in prop::collection::vec(written(), 1..9), cut in 1..12_usize) {
        let bytes = capture(&all);
        let read = read_all(&bytes[..bytes.len() - cut]);
        prop_assert_eq!(read.map(|packets| packets.len()), Ok(all.len() - 1));
    }

    #[test]
    fn arbitrary_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..80), is_pcapng: bool) {
        let begin = if is_pcapng { capture(&[]) } else { 0xa1b2_c3d4_u32.to_le_bytes().to_vec() };
        _ = read_all(&[begin, bytes].concat());
    }
}

#[test]
fn what_is_no_capture_is_said() {
    assert_eq!(read_all(b"no capture"), Err(ReadError::NoCapture));
    assert_eq!(read_all(&0xa1b2_c3d4_u32.to_be_bytes()), Err(ReadError::CutOff));
    let mut damaged = capture(&[]);
    damaged[4] = 13;
    assert_eq!(read_all(&damaged), Err(ReadError::Damaged(0)));
}
