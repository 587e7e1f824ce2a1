//! No frames make a flow's meter panic, nor lose count: each request is in one sample, or counted as in none.
#![no_main]

use std::{collections::BTreeSet, time::Duration};

use cotorra_flows::{Counts, Frame, Id, Meter, Protocol};
use libfuzzer_sys::fuzz_target;

const TIMEOUT: Duration = Duration::from_millis(50);
const PORT: u16 = 80;

/// A TCP segment between the client, which has one of a few ports, and the server.
fn segment(of_client: bool, port: u8, flags: u8, sequence: u16, payload: &[u8]) -> Vec<u8> {
    let mut frame = vec![0; 12];
    frame.extend_from_slice(&[8, 0, 0x45, 0]);
    frame.extend_from_slice(&(40 + payload.len() as u16).to_be_bytes());
    frame.extend_from_slice(&[0, 0, 0, 0, 64, 6, 0, 0, 10, 0, 0, 1, 10, 0, 0, 1]);
    let mut ports = [0x8000 + u16::from(port % 4), PORT];
    // In ROS both ends open connections.
    if of_client == (port & 0x80 != 0) {
        ports.reverse();
    }
    frame.extend(ports.iter().flat_map(|port| port.to_be_bytes()));
    // Across the end of the range.
    frame.extend_from_slice(&u32::from(sequence).wrapping_sub(0x8000).to_be_bytes());
    frame.extend_from_slice(&[0, 0, 0, 0, 0x50, flags, 0, 0, 0, 0, 0, 0]);
    frame.extend_from_slice(payload);
    frame
}

/// A datagram of DDS between the client and the server: `port` says of which writer, `flags` what it has of a sample.
fn rtps(of_client: bool, port: u8, flags: u8, sequence: u16, payload: &[u8]) -> Vec<u8> {
    const TOPICS: [&str; 8] = [
        "rt/a",
        "rt/b",
        "rq/aRequest",
        "rr/aReply",
        "rq/a/_action/send_goalRequest",
        "rr/a/_action/send_goalReply",
        "rq/a/_action/get_resultRequest",
        "rr/a/_action/get_resultReply",
    ];
    let writer = port % 8;
    let mut message = b"RTPS\x02\x03\x01\x10".to_vec();
    message.extend_from_slice(&[u8::from(of_client); 12]);
    let mut submessage = |kind: u8, flags: u8, parts: &[&[u8]]| {
        message.extend_from_slice(&[kind, flags | 1]);
        message.extend_from_slice(&(parts.iter().map(|part| part.len()).sum::<usize>() as u16).to_le_bytes());
        parts.iter().for_each(|part| message.extend_from_slice(part));
    };
    let topic = TOPICS[usize::from(writer)];
    let mut name = (topic.len() as u32 + 1).to_le_bytes().to_vec();
    name.extend_from_slice(topic.as_bytes());
    name.resize(name.len().next_multiple_of(4) + 4, 0);
    let guid = [&[u8::from(of_client); 12][..], &[0, 0, writer, 3]].concat();
    let announced =
        [&[0, 3, 0, 0, 5, 0, name.len() as u8, 0][..], &name, &[0x5a, 0, 16, 0], &guid, &[1, 0, 0, 0]]
            .concat();
    let head = [0, 0, 16, 0, 0, 0, 0, 0, 0, 0, 3, 0xc2, 0, 0, 0, 0, 1, 0, 0, 0];
    submessage(0x15, 0x04, &[&head, &announced]);
    let sequence = [0, 0, 0, 0, sequence as u8, (sequence >> 8) as u8, 0, 0];
    match flags % 4 {
        0 => submessage(0x15, 0x04, &[&[0, 0, 16, 0, 0, 0, 0, 0, 0, 0, writer, 3], &sequence, payload]),
        // With parameters.
        1 => submessage(0x15, 0x06, &[&[0, 0, 16, 0, 0, 0, 0, 0, 0, 0, writer, 3], &sequence, payload]),
        // One of two fragments.
        2 => {
            let fragment = [1 + (flags >> 7), 0, 0, 0, 1, 0, 64, 0, 65 + (flags >> 2 & 63), 0, 0, 0];
            submessage(
                0x16,
                0,
                &[&[0, 0, 28, 0, 0, 0, 0, 0, 0, 0, writer, 3], &sequence, &fragment, payload],
            );
        }
        _ => submessage(flags, port, &[payload]),
    }
    let mut frame = vec![0; 12];
    frame.extend_from_slice(&[8, 0, 0x45, 0]);
    frame.extend_from_slice(&(28 + message.len() as u16).to_be_bytes());
    frame.extend_from_slice(&[0, 0, 0, 0, 64, 17, 0, 0, 10, 0, 0, 1, 10, 0, 0, 1, 0x1c, 0xe9, 0x1c, 0xe9]);
    frame.extend_from_slice(&(8 + message.len() as u16).to_be_bytes());
    frame.extend_from_slice(&[0, 0]);
    frame.extend_from_slice(&message);
    frame
}

/// What happens: a kind, the ends, how much later, and bytes.
type Step<'a> = (u8, u8, u8, u16, &'a [u8]);

fuzz_target!(|input: (u8, Vec<Step<'_>>)| {
    let (kind, events) = input;
    let names = || ("/a".to_owned(), "/b".to_owned());
    let is_ros2 = kind >= 192;
    let protocol = match kind % 8 {
        0 | 1 if is_ros2 => Protocol::Ros2Service { service: names().0 },
        2..5 if is_ros2 => Protocol::Ros2Action { action: names().0 },
        _ if is_ros2 => {
            let ((request, answer), id) = (names(), (kind % 2 == 0).then_some(Id { offset: 0, length: 1 }));
            Protocol::Ros2 { request, answer, id }
        }
        0 => Protocol::Udp { port: PORT, id: None },
        1 => Protocol::Udp { port: PORT, id: Some(Id { offset: 1, length: 2 }) },
        2 => Protocol::Tcp { port: PORT },
        3 => Protocol::Http { port: PORT, path: None },
        4 => Protocol::Http { port: PORT, path: Some("/a".to_owned()) },
        5 => Protocol::Ros1Service { service: "/a".to_owned() },
        6 => Protocol::Ros1 { request: "/a".to_owned(), answer: "/b".to_owned(), id: None },
        _ => {
            let id = Some(Id { offset: 0, length: 1 });
            Protocol::Ros1 { request: "/a".to_owned(), answer: "/b".to_owned(), id }
        }
    };
    let mut meter = Meter::new(protocol, TIMEOUT);
    let (mut now, mut samples, mut numbers) = (Duration::ZERO, 0, BTreeSet::new());
    let mut poll = |meter: &mut Meter| {
        while let Some(sample) = meter.poll() {
            assert!(sample.took.is_none_or(|took| took < TIMEOUT));
            assert!(numbers.insert(sample.sequence), "{} is told twice", sample.sequence);
            samples += 1;
        }
        samples
    };
    for (how, port, flags, sequence, bytes) in events {
        now += Duration::from_millis(u64::from(how >> 4));
        let entered = how & 1 == 0;
        let frame = if how & 2 == 0 {
            bytes.to_vec()
        } else if is_ros2 {
            rtps(entered, port, flags, sequence, &bytes[..bytes.len().min(1 << 15)])
        } else {
            segment(entered, port, flags, sequence, &bytes[..bytes.len().min(1 << 15)])
        };
        let segment = (how & 8 == 0 && how & 2 == 0).then_some(sequence);
        let frame = Frame { bytes: &frame, checksum_left: how & 6 != 0, segment };
        if entered {
            meter.entered(now, &frame, 0);
        } else {
            meter.delivered(now, &frame);
        }
        poll(&mut meter);
    }
    meter.expire(now + TIMEOUT);
    assert_eq!(meter.deadline(), None);
    let Counts { requests, unclear, forgotten, rejected, .. } = meter.counts();
    assert_eq!(poll(&mut meter) + unclear + forgotten + rejected, requests);
});
