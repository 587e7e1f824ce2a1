use std::{path::Path, time::Duration};

use cotorra_fabric::{Fabric, Frame, Offload, PortId, Segmentation, SegmentationKind};
use cotorra_flows::headers::{Ipv4, udp_header};
use cotorra_graph::{HardwareGraph, HostAddress, Timestamp};

use super::*;

const LEFT: PortId = PortId(0);

/// Two hosts, `left` and `right`, 5 ms apart.
fn graph() -> HardwareGraph {
    let text = "
name: captured
nodes:
  left: { kind: server, tier: fog, cpus: 1, memory: 1 GB }
  right: { kind: server, tier: edge, cpus: 1, memory: 1 GB }
links: [{ ends: [left, right], delay: 5 ms, queue: 2 packets, rate: 1 Gbit/s }]
";
    cotorra_testbed_file::parse("captured.yaml", text, Path::new("")).unwrap().graph
}

/// A datagram from `left` to `right`.
fn datagram(port: u16, payload: &[u8]) -> Vec<u8> {
    let [source, destination] = [0, 1].map(HostAddress::of);
    let ip = Ipv4 { protocol: 17, source: source.ipv4, destination: destination.ipv4, ..Ipv4::default() };
    let ip = ip.header(8 + payload.len());
    let udp = udp_header(4000, port, payload.len());
    [&destination.mac[..], &source.mac, &[0x08, 0x00], &ip, &udp, payload].concat()
}

fn ms(ms: u64) -> Timestamp {
    Timestamp::ZERO + Duration::from_millis(ms)
}

/// A packet of a capture.
#[derive(Debug, PartialEq)]
struct Packet {
    interface: u32,
    at_ns: u64,
    length: u32,
    bytes: Vec<u8>,
    comment: String,
    missed: u64,
}

/// Returns the names of the interfaces and the packets of a capture.
fn read(mut bytes: &[u8]) -> (Vec<String>, Vec<Packet>) {
    let (mut interfaces, mut packets) = (Vec::new(), Vec::new());
    let u32_at = |bytes: &[u8], at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
    let options = |mut bytes: &[u8]| {
        let mut all = Vec::new();
        loop {
            let (code, length) = (u32_at(bytes, 0) & 0xffff, (u32_at(bytes, 0) >> 16) as usize);
            if code == 0 {
                return all;
            }
            all.push((code, bytes[4..4 + length].to_vec()));
            bytes = &bytes[4 + length.next_multiple_of(4)..];
        }
    };
    while !bytes.is_empty() {
        let length = u32_at(bytes, 4) as usize;
        let (block, rest) = bytes.split_at(length);
        assert_eq!(u32_at(block, length - 4) as usize, length);
        bytes = rest;
        match u32_at(block, 0) {
            0x0a0d_0d0a => assert_eq!((u32_at(block, 8), &block[12..16]), (0x1a2b_3c4d, &[1, 0, 0, 0][..])),
            1 => {
                let options = options(&block[16..]);
                assert_eq!((options[0].0, options[1].clone()), (2, (9, vec![9])));
                interfaces.push(String::from_utf8(options[0].1.clone()).unwrap());
            }
            _ => {
                let kept = u32_at(block, 20) as usize;
                let options = options(&block[28 + kept.next_multiple_of(4)..]);
                assert_eq!((options[0].0, options[1].0), (1, 4));
                packets.push(Packet {
                    interface: u32_at(block, 8),
                    at_ns: u64::from(u32_at(block, 12)) << 32 | u64::from(u32_at(block, 16)),
                    length: u32_at(block, 24),
                    bytes: block[28..28 + kept].to_vec(),
                    comment: String::from_utf8(options[0].1.clone()).unwrap(),
                    missed: u64::from_le_bytes(options[1].1.as_slice().try_into().unwrap()),
                });
            }
        }
    }
    (interfaces, packets)
}

/// Returns what a capture has to hand out now.
fn drain(capture: &mut Capture) -> Vec<u8> {
    let mut all = Vec::new();
    let mut context = Context::from_waker(std::task::Waker::noop());
    while let Poll::Ready(Some(Ok(bytes))) = Pin::new(&mut *capture).poll_next(&mut context) {
        all.extend(bytes);
    }
    all
}

/// Captures this link or node of a fabric.
fn begin(fabric: &mut Fabric, filter: Option<&str>, snap: u32) -> Capture {
    let filter = filter.map(|filter| Filter::parse(filter, &graph()).unwrap());
    let (capture, reader) = Capture::new(filter, snap);
    fabric.tap("left-right", reader).unwrap();
    capture
}

#[test]
fn packets_have_their_times_and_the_losses_before_them() {
    let mut fabric = Fabric::new(&graph(), 1).unwrap();
    let mut capture = begin(&mut fabric, None, 262_144);
    let (first, other) = (datagram(7, b"first"), datagram(8, &[0; 1000]));
    fabric.push(ms(1), LEFT, Frame::new(first.clone()));
    fabric.poll(ms(8), &mut |_, _| {});
    // One is sent, two are queued, three overflow.
    (0..6).for_each(|_| fabric.push(ms(10), LEFT, Frame::new(other.clone())));
    fabric.poll(ms(20), &mut |_, _| {});
    let (interfaces, packets) = read(&drain(&mut capture));
    assert_eq!(interfaces, ["left-right forward"]);
    // 47 bytes take 376 ns at 1 Gbit/s.
    let expected = Packet {
        interface: 0,
        at_ns: 6_000_376,
        length: 47,
        bytes: first,
        comment: "entered 0.001000000 s, due 0.006000376 s, delivered 0.008000000 s".to_owned(),
        missed: 0,
    };
    assert_eq!(packets[0], expected);
    let comments: Vec<_> =
        packets[1..].iter().map(|packet| packet.comment.split_once(" s, d").unwrap().0).collect();
    assert_eq!(comments, ["entered 0.010000000"; 3]);
    let overflowed = |packet: &Packet| packet.comment.ends_with(", 3 overflowed before it");
    assert_eq!(packets.iter().map(overflowed).collect::<Vec<_>>(), [false, true, false, false]);
}

#[test]
fn captures_keep_the_selected_packets_up_to_the_snap_length() {
    let mut fabric = Fabric::new(&graph(), 1).unwrap();
    let mut capture = begin(&mut fabric, Some("udp dst port 8 and src host left"), 21);
    for port in [7, 8] {
        fabric.push(ms(1), LEFT, Frame::new(datagram(port, b"payload")));
    }
    fabric.poll(ms(20), &mut |_, _| {});
    let (_, packets) = read(&drain(&mut capture));
    assert_eq!(packets.len(), 1);
    assert_eq!((packets[0].length, &packets[0].bytes), (49, &datagram(8, b"payload")[..21].to_vec()));
}

#[test]
fn super_packets_are_shown_as_they_are_on_the_wire() {
    let mut fabric = Fabric::new(&graph(), 1).unwrap();
    let mut capture = begin(&mut fabric, None, 262_144);
    let segmentation = Segmentation { kind: SegmentationKind::Udp, size: 1000, header_len: 42 };
    let offload = Offload { checksum: None, segmentation: Some(segmentation) };
    fabric.push(ms(1), LEFT, Frame::with_offload(datagram(8, &[1; 2500]), offload));
    fabric.poll(ms(20), &mut |_, _| {});
    let (_, packets) = read(&drain(&mut capture));
    assert_eq!(packets.iter().map(|packet| packet.length).collect::<Vec<_>>(), [1042, 1042, 542]);
}

#[test]
fn packets_that_a_slow_reader_misses_are_counted() {
    let mut fabric = Fabric::new(&graph(), 1).unwrap();
    let mut capture = begin(&mut fabric, None, 64);
    let mut send = |from_ms: u64, packets: u64, length: usize| {
        for at in from_ms..from_ms + packets {
            fabric.push(ms(at), LEFT, Frame::new(datagram(8, &vec![0; length])));
        }
        fabric.poll(ms(from_ms + packets + 20), &mut |_, _| {});
    };
    // Too many packets.
    send(0, MOST_WAITING as u64 + 5, 10);
    assert_eq!(read(&drain(&mut capture)).1.len(), MOST_WAITING);
    send(20_000, 1, 10);
    assert_eq!(read(&drain(&mut capture)).1[0].missed, 5);
    // Too many bytes.
    let length = 60_000;
    let fit = MOST_WAITING_BYTES / (length + 42);
    send(30_000, fit as u64 + 3, length);
    assert_eq!(read(&drain(&mut capture)).1.len(), fit);
    send(40_000, 1, 10);
    assert_eq!(read(&drain(&mut capture)).1[0].missed, 3);
}

#[test]
fn a_capture_that_nobody_reads_ends() {
    let mut fabric = Fabric::new(&graph(), 1).unwrap();
    let capture = begin(&mut fabric, None, 64);
    let waiting = Arc::downgrade(&capture.waiting);
    drop(capture);
    assert!(waiting.upgrade().is_some());
    fabric.push(ms(1), LEFT, Frame::new(datagram(8, b"")));
    fabric.poll(ms(20), &mut |_, _| {});
    assert!(waiting.upgrade().is_none());
}
