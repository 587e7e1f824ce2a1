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

fuzz_target!(|input: (u8, Vec<(u8, u8, u8, u16, &[u8])>)| {
    let (kind, events) = input;
    let protocol = match kind % 8 {
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
    let Counts { requests, unclear, forgotten, .. } = meter.counts();
    assert_eq!(poll(&mut meter) + unclear + forgotten, requests);
});
