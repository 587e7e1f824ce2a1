//! Offloads: super-packets are cut as a network card would cut them, checksums are completed where needed, and false
//! headers do no harm.

use cotorra_fabric::{Checksum, Frame, Malformed, Offload, Segmentation, SegmentationKind};
use cotorra_graph::{Conditions, Loss, Probability, QueueDiscipline, QueueLimit, Rate, Timestamp};
use proptest::prelude::*;

use crate::common::{A, B, Network, context, delay, ms, pair, rate, run};
use cotorra_graph::HostAddress;

const FIN: u8 = 0x01;
const PSH: u8 = 0x08;
const ACK: u8 = 0x10;
const CWR: u8 = 0x80;

/// The checksum by the text of RFC 1071, independent of the one under test.
fn ones_complement(bytes: &[u8], begin: u32) -> u16 {
    let mut sum = begin;
    for pair in bytes.chunks(2) {
        sum += u32::from(pair[0]) << 8 | u32::from(*pair.get(1).unwrap_or(&0));
        sum = (sum & 0xffff) + (sum >> 16);
    }
    sum as u16
}

fn ethernet(ethertype: u16) -> Vec<u8> {
    let mut bytes = HostAddress::of(1).mac.to_vec();
    bytes.extend(HostAddress::of(0).mac);
    bytes.extend(ethertype.to_be_bytes());
    bytes
}

fn ipv4(id: u16, protocol: u8, transport: &[u8]) -> Vec<u8> {
    let mut header = vec![0x45, 0x02];
    header.extend((20 + transport.len() as u16).to_be_bytes());
    header.extend(id.to_be_bytes());
    header.extend([0x40, 0, 64, protocol, 0, 0, 10, 77, 0, 1, 10, 77, 0, 2]);
    let checksum = !ones_complement(&header, 0);
    header[10..12].copy_from_slice(&checksum.to_be_bytes());
    [ethernet(0x0800), header, transport.to_vec()].concat()
}

fn ipv6(protocol: u8, transport: &[u8]) -> Vec<u8> {
    let mut header = vec![0x60, 0, 0, 0];
    header.extend((transport.len() as u16).to_be_bytes());
    header.extend([protocol, 64]);
    header.extend(HostAddress::of(0).ipv6.octets());
    header.extend(HostAddress::of(1).ipv6.octets());
    [ethernet(0x86dd), header, transport.to_vec()].concat()
}

fn pseudo4(protocol: u8, length: usize) -> u16 {
    ones_complement(&[10, 77, 0, 1, 10, 77, 0, 2, 0, protocol], length as u32)
}

fn pseudo6(protocol: u8, length: usize) -> u16 {
    let addresses = [HostAddress::of(0).ipv6.octets(), HostAddress::of(1).ipv6.octets()].concat();
    ones_complement(&addresses, u32::from(protocol) + length as u32)
}

/// A TCP header with a time stamp option and a given checksum, and its payload.
fn tcp(sequence: u32, flags: u8, checksum: u16, payload: &[u8]) -> Vec<u8> {
    let mut bytes = vec![0x1f, 0x90, 0xc3, 0x50];
    bytes.extend(sequence.to_be_bytes());
    bytes.extend([0, 0, 0, 9, 0x80, flags, 1, 0]);
    bytes.extend(checksum.to_be_bytes());
    bytes.extend([0, 0, 1, 1, 8, 10, 0, 0, 0, 1, 0, 0, 0, 2]);
    bytes.extend(payload);
    bytes
}

fn udp(checksum: u16, payload: &[u8]) -> Vec<u8> {
    let mut bytes = vec![0x1e, 0x1f, 0x1e, 0x1f];
    bytes.extend((8 + payload.len() as u16).to_be_bytes());
    bytes.extend(checksum.to_be_bytes());
    bytes.extend(payload);
    bytes
}

/// A packet of a flow, with its checksum (`done`) or the sum of the pseudo header in its place.
fn packet(
    kind: SegmentationKind,
    v6: bool,
    i: u16,
    sequence: u32,
    flags: u8,
    payload: &[u8],
    done: bool,
) -> Vec<u8> {
    let (protocol, header) = if kind == SegmentationKind::Udp { (17, 8) } else { (6, 32) };
    let length = header + payload.len();
    let pseudo = if v6 { pseudo6(protocol, length) } else { pseudo4(protocol, length) };
    let transport = |checksum| match kind {
        SegmentationKind::Udp => udp(checksum, payload),
        _ => tcp(sequence, flags, checksum, payload),
    };
    let checksum = if done { !ones_complement(&transport(0), u32::from(pseudo)) } else { pseudo };
    let transport = transport(checksum);
    if v6 { ipv6(protocol, &transport) } else { ipv4(0xfffe_u16.wrapping_add(i), protocol, &transport) }
}

fn offload(kind: SegmentationKind, v6: bool, size: u16) -> Offload {
    let start = if v6 { 54 } else { 34 };
    let offset = if kind == SegmentationKind::Udp { 6 } else { 16 };
    Offload {
        checksum: Some(Checksum { start, offset }),
        // A kernel's value is a hint, and often more than the headers.
        segmentation: Some(Segmentation { kind, size, header_len: 200 }),
    }
}

fn payload(length: usize) -> Vec<u8> {
    (0..length).map(|i| (i * 7 % 251) as u8).collect()
}

const FLOWS: [(SegmentationKind, bool); 4] = [
    (SegmentationKind::Tcp4, false),
    (SegmentationKind::Tcp6, true),
    (SegmentationKind::Udp, false),
    (SegmentationKind::Udp, true),
];

const SEQUENCE: u32 = u32::MAX - 1000;
const FLAGS: u8 = CWR | ACK | PSH | FIN;

fn super_packet(kind: SegmentationKind, v6: bool, length: usize) -> Frame {
    let bytes = packet(kind, v6, 0, SEQUENCE, FLAGS, &payload(length), false);
    Frame::with_offload(bytes, offload(kind, v6, 1000))
}

/// The packets that a network card would send.
fn on_the_wire(kind: SegmentationKind, v6: bool, length: usize, done: bool) -> Vec<Vec<u8>> {
    let payload = payload(length);
    let parts: Vec<_> = payload.chunks(1000).collect();
    let flags = |i: usize| {
        let first = if i == 0 { CWR } else { 0 };
        let last = if i + 1 == parts.len() { PSH | FIN } else { 0 };
        ACK | first | last
    };
    let one = |(i, part): (usize, &&[u8])| {
        packet(kind, v6, i as u16, SEQUENCE.wrapping_add(i as u32 * 1000), flags(i), part, done)
    };
    parts.iter().enumerate().map(one).collect()
}

#[test]
fn super_packets_are_cut_as_a_network_card_would() {
    for (kind, v6) in FLOWS {
        for length in [1001, 3000, 2999, 9001] {
            let mut packets = Vec::new();
            super_packet(kind, v6, length).segment(&mut packets).unwrap();
            let partial: Vec<_> = packets.iter().map(|p| p.bytes().to_vec()).collect();
            assert_eq!(partial, on_the_wire(kind, v6, length, false));
            packets.iter_mut().for_each(|p| p.complete_checksum().unwrap());
            let done: Vec<_> = packets.iter().map(|p| p.bytes().to_vec()).collect();
            assert_eq!(done, on_the_wire(kind, v6, length, true));
            assert!(packets.iter().all(|p| p.offload() == Offload::NONE));
        }
    }
}

#[test]
fn packets_of_a_super_packet_with_a_checksum_have_one() {
    for (kind, v6) in FLOWS {
        let whole = super_packet(kind, v6, 2500);
        let offload = Offload { checksum: None, ..whole.offload() };
        let mut packets = Vec::new();
        Frame::with_offload(whole.into_bytes(), offload).segment(&mut packets).unwrap();
        let bytes: Vec<_> = packets.iter().map(|p| p.bytes().to_vec()).collect();
        assert_eq!(bytes, on_the_wire(kind, v6, 2500, true));
    }
}

#[test]
fn tags_and_extension_headers_are_copied() {
    let mut bytes = packet(SegmentationKind::Tcp4, false, 0, SEQUENCE, FLAGS, &payload(2500), false);
    bytes.splice(12..12, [0x81, 0x00, 0x00, 0x2a]);
    let mut offload4 = offload(SegmentationKind::Tcp4, false, 1000);
    offload4.checksum = Some(Checksum { start: 38, offset: 16 });
    let mut packets = Vec::new();
    Frame::with_offload(bytes, offload4).segment(&mut packets).unwrap();
    for (packet, expected) in packets.iter().zip(on_the_wire(SegmentationKind::Tcp4, false, 2500, false)) {
        assert_eq!(packet.bytes()[12..16], [0x81, 0x00, 0x00, 0x2a]);
        assert_eq!(packet.bytes()[16..], expected[12..]);
    }

    // Eight bytes of hop-by-hop options.
    let mut bytes = packet(SegmentationKind::Tcp6, true, 0, SEQUENCE, FLAGS, &payload(2500), false);
    bytes.splice(54..54, [6, 0, 1, 4, 0, 0, 0, 0]);
    bytes[20] = 0;
    let length = (bytes.len() - 54) as u16;
    bytes[18..20].copy_from_slice(&length.to_be_bytes());
    let mut offload6 = offload(SegmentationKind::Tcp6, true, 1000);
    offload6.checksum = Some(Checksum { start: 62, offset: 16 });
    let mut packets = Vec::new();
    Frame::with_offload(bytes, offload6).segment(&mut packets).unwrap();
    assert_eq!(packets.len(), 3);
    for (packet, expected) in packets.iter().zip(on_the_wire(SegmentationKind::Tcp6, true, 2500, false)) {
        assert_eq!(packet.bytes()[62..], expected[54..]);
        assert_eq!(packet.bytes()[18..20], ((packet.len() - 54) as u16).to_be_bytes());
    }
}

#[test]
fn super_packets_stay_whole_on_links_that_allow_it() {
    let network = Network::new().servers(&["a", "b"]).switches(&["s"]);
    let fast = Conditions { rate: rate(10_000.0), ..delay(1) };
    let mut fabric = network.link("a", "s", delay(1)).link("s", "b", fast).fabric(1);
    let sent = super_packet(SegmentationKind::Tcp4, false, 60_000);
    fabric.push(ms(0.0), A, sent.clone());
    let out = run(&mut fabric, ms(0.0), ms(10.0));
    assert_eq!((out.len(), out[0].frame.bytes()), (1, sent.bytes()));
    assert_eq!(out[0].frame.offload().segmentation.unwrap().header_len, 66);
    let counters = context(&mut fabric, ms(10.0), "s-b").counters;
    let wire = 60_000 + 60 * 66;
    assert_eq!((counters.packets, counters.bytes), (60, wire));
    // The headers of all its packets count.
    assert_eq!(out[0].at, Timestamp::from_nanos(2_000_000 + wire * 8 / 10));
}

#[test]
fn super_packets_are_cut_for_links_that_need_packets() {
    let p = |p| Probability::new(p).unwrap();
    for conditions in [
        Conditions { rate: rate(100.0), ..delay(1) },
        Conditions { loss: Loss::Independent { rate: p(0.5) }, ..delay(1) },
        Conditions { duplication: p(0.5), ..delay(1) },
        Conditions { reordering: p(0.5), ..delay(1) },
        Conditions { corruption: p(0.5), ..delay(1) },
    ] {
        let mut fabric = pair(conditions, 1);
        fabric.push(ms(0.0), A, super_packet(SegmentationKind::Udp, true, 60_000));
        let out = run(&mut fabric, ms(0.0), ms(100.0));
        assert!(out.iter().all(|d| d.frame.wire_packets() == 1));
        let c = context(&mut fabric, ms(100.0), "a-b").counters;
        assert_eq!(c.packets + c.lost, 60 + c.duplicated);
        assert_eq!(out.len() as u64, c.packets);
    }
}

#[test]
fn super_packets_are_cut_for_queues_that_decide_on_packets() {
    let queue_discipline = QueueDiscipline::Codel(Default::default());
    for (rate, packets) in [(rate(1000.0), 60), (Rate::Unlimited, 1)] {
        let mut fabric = pair(Conditions { rate, queue_discipline, ..Conditions::default() }, 1);
        fabric.push(ms(0.0), A, super_packet(SegmentationKind::Tcp4, false, 60_000));
        assert_eq!(run(&mut fabric, ms(0.0), ms(100.0)).len(), packets);
    }
}

#[test]
fn a_super_packet_fills_the_queue_like_its_packets() {
    for (queue, kept) in [(QueueLimit::Packets(100), 160), (QueueLimit::Bytes(100 * 1066), 160)] {
        let mut fabric = pair(Conditions { rate: rate(1000.0), queue, ..Conditions::default() }, 1);
        (0..4).for_each(|_| fabric.push(ms(0.0), A, super_packet(SegmentationKind::Tcp4, false, 60_000)));
        let out = run(&mut fabric, ms(0.0), ms(100.0));
        let counters = context(&mut fabric, ms(100.0), "a-b").counters;
        // The first is sent, the second waits, and the third is cut to what fits.
        assert_eq!((counters.packets, counters.overflowed), (kept, 240 - kept));
        assert_eq!(out.len(), 42);
    }
}

#[test]
fn a_waiting_super_packet_is_cut_when_its_link_becomes_lossy() {
    let mut fabric = pair(Conditions { rate: rate(1000.0), ..Conditions::default() }, 1);
    (0..3).for_each(|_| fabric.push(ms(0.0), A, super_packet(SegmentationKind::Tcp4, false, 60_000)));
    let change = cotorra_graph::ConditionChange {
        loss: Some(Loss::Independent { rate: Probability::new(0.5).unwrap() }),
        ..Default::default()
    };
    fabric.change(ms(0.1), &"a-b".parse().unwrap(), None, &change).unwrap();
    assert_eq!(fabric.in_flight(), 180);
    let out = run(&mut fabric, ms(0.1), ms(100.0));
    assert!(out.iter().all(|d| d.frame.wire_packets() == 1));
    let counters = context(&mut fabric, ms(100.0), "a-b").counters;
    assert_eq!(counters.packets + counters.lost, 180);
    assert!((60..120).contains(&counters.lost));
}

#[test]
fn only_corruption_completes_a_checksum() {
    let whole = packet(SegmentationKind::Udp, false, 0, 0, 0, &payload(300), false);
    let offload = Offload { segmentation: None, ..offload(SegmentationKind::Udp, false, 1) };
    let sent = Frame::with_offload(whole, offload);
    let mut fabric = pair(delay(1), 1);
    fabric.push(ms(0.0), A, sent.clone());
    assert_eq!(run(&mut fabric, ms(0.0), ms(10.0))[0].frame, sent);

    let mut fabric = pair(Conditions { corruption: Probability::ONE, ..delay(1) }, 1);
    (0..100).for_each(|_| fabric.push(ms(0.0), A, sent.clone()));
    let mut done = sent;
    done.complete_checksum().unwrap();
    for delivery in run(&mut fabric, ms(0.0), ms(10.0)) {
        assert_eq!(delivery.frame.offload(), Offload::NONE);
        let differ = delivery.frame.bytes().iter().zip(done.bytes()).map(|(a, b)| (a ^ b).count_ones());
        assert_eq!(differ.sum::<u32>(), 1);
    }
}

#[test]
fn a_udp_checksum_of_zero_is_sent_as_all_ones() {
    // Chosen so that the sum is ffff.
    let mut bytes = ethernet(0x0800);
    bytes.extend([0xff, 0xff, 0, 0]);
    let checksum = Some(Checksum { start: 14, offset: 2 });
    let mut frame = Frame::with_offload(bytes, Offload { checksum, segmentation: None });
    frame.complete_checksum().unwrap();
    assert_eq!(frame.bytes()[16..], [0xff, 0xff]);
}

#[test]
fn frames_with_false_headers_are_dropped_and_counted() {
    let whole = super_packet(SegmentationKind::Tcp4, false, 3000);
    let with = |change: &dyn Fn(&mut Vec<u8>, &mut Offload)| {
        let (mut bytes, mut offload) = (whole.bytes().to_vec(), whole.offload());
        change(&mut bytes, &mut offload);
        Frame::with_offload(bytes, offload)
    };
    let segmentation = whole.offload().segmentation.unwrap();
    let kind = |kind| Some(Segmentation { kind, ..segmentation });
    let cases = [
        (with(&|_, o| o.segmentation = Some(Segmentation { size: 0, ..segmentation })), Malformed::NoSize),
        (with(&|_, o| o.segmentation = kind(SegmentationKind::Tcp6)), Malformed::Headers),
        (with(&|_, o| o.segmentation = kind(SegmentationKind::Udp)), Malformed::Headers),
        (with(&|b, _| b[16..18].copy_from_slice(&[0, 99])), Malformed::Headers),
        (with(&|b, _| b.truncate(60)), Malformed::Headers),
        (with(&|b, _| b[46] = 0x40), Malformed::Headers),
        (with(&|b, _| b[20] = 0x20), Malformed::Headers),
        (with(&|_, o| o.checksum = Some(Checksum { start: 30, offset: 16 })), Malformed::ChecksumElsewhere),
        (with(&|_, o| o.checksum = Some(Checksum { start: 34, offset: 6 })), Malformed::ChecksumElsewhere),
        (with(&|_, o| o.checksum = Some(Checksum { start: 9000, offset: 16 })), Malformed::ChecksumBeyondEnd),
        (
            with(&|_, o| o.checksum = Some(Checksum { start: u16::MAX, offset: u16::MAX })),
            Malformed::ChecksumBeyondEnd,
        ),
        (with(&|b, _| b.truncate(13)), Malformed::Short),
    ];
    let mut fabric = pair(Conditions { rate: Rate::Unlimited, ..Conditions::default() }, 1);
    for (i, (frame, why)) in cases.into_iter().enumerate() {
        assert_eq!(frame.clone().check(), Err(why), "case {i}");
        assert!(frame.clone().segment(&mut Vec::new()).is_err());
        fabric.push(ms(0.0), A, frame);
        assert_eq!(fabric.drops().malformed, i as u64 + 1);
    }
    assert!(run(&mut fabric, ms(0.0), ms(1.0)).is_empty());
}

fn any_offload() -> impl Strategy<Value = Offload> {
    let kinds =
        prop_oneof![Just(SegmentationKind::Tcp4), Just(SegmentationKind::Tcp6), Just(SegmentationKind::Udp)];
    let checksum =
        prop::option::of((0u16..200, 0u16..40).prop_map(|(start, offset)| Checksum { start, offset }));
    let segmentation = prop::option::of(
        (kinds, 0u16..300, any::<u16>()).prop_map(|(kind, size, header_len)| Segmentation {
            kind,
            size,
            header_len,
        }),
    );
    (checksum, segmentation).prop_map(|(checksum, segmentation)| Offload { checksum, segmentation })
}

proptest! {
    #[test]
    fn no_offload_of_a_sender_causes_a_panic(
        flow in 0usize..4,
        length in 0usize..2000,
        changes in prop::collection::vec((0usize..120, any::<u8>()), 0..6),
        cut in prop::option::of(0usize..200),
        offload in prop::option::of(any_offload()),
    ) {
        let (kind, v6) = FLOWS[flow];
        let whole = super_packet(kind, v6, length.max(1));
        let offload = offload.unwrap_or(whole.offload());
        let mut bytes = whole.into_bytes();
        bytes.truncate(cut.unwrap_or(bytes.len()));
        for (at, value) in changes {
            if let Some(byte) = bytes.get_mut(at) {
                *byte = value;
            }
        }
        let frame = Frame::with_offload(bytes, offload);
        let well = frame.clone().check().is_ok();
        let mut packets = Vec::new();
        prop_assert_eq!(frame.clone().segment(&mut packets).is_ok(), well);
        let conditions = Conditions {
            corruption: Probability::ONE, duplication: Probability::ONE, rate: rate(100.0), ..delay(1)
        };
        let mut fabric = pair(conditions, 1);
        fabric.disable_port_security(&"a".parse().unwrap());
        fabric.push(ms(0.0), A, frame);
        let out = run(&mut fabric, ms(0.0), ms(1000.0));
        let drops = fabric.drops();
        prop_assert_eq!(drops.malformed, u64::from(!well));
        if drops == Default::default() {
            prop_assert_eq!(out.iter().filter(|d| d.port == B).count(), 2 * packets.len());
        }
    }
}
