//! Frames for tests, as a host's kernel makes them.

use std::time::Duration;

use crate::{Frame, Meter, Sample};

pub(crate) mod rtps;

/// A host's last byte and a port.
pub(crate) type End = (u8, u16);

pub(crate) const SYN: u8 = 0x02;
pub(crate) const FIN: u8 = 0x01;
pub(crate) const RST: u8 = 0x04;
const ACK: u8 = 0x10;

pub(crate) fn ms(ms: u64) -> Duration {
    Duration::from_millis(ms)
}

fn checksum(parts: &[&[u8]]) -> [u8; 2] {
    let mut all = Vec::new();
    for part in parts {
        all.extend_from_slice(part);
        all.resize(all.len().next_multiple_of(2), 0);
    }
    let sum: u32 = all.chunks(2).map(|word| u32::from(u16::from_be_bytes([word[0], word[1]]))).sum();
    let folded = (sum & 0xffff) + (sum >> 16);
    (!((folded & 0xffff) + (folded >> 16)) as u16).to_be_bytes()
}

fn ipv4(from: u8, to: u8, protocol: u8, place: u16, payload: &[u8]) -> Vec<u8> {
    let mut header = vec![0x45, 0];
    header.extend_from_slice(&(20 + payload.len() as u16).to_be_bytes());
    header.extend_from_slice(&[0, 7]);
    header.extend_from_slice(&place.to_be_bytes());
    header.extend_from_slice(&[64, protocol, 0, 0, 10, 0, 0, from, 10, 0, 0, to]);
    let sum = checksum(&[&header]);
    header[10..12].copy_from_slice(&sum);
    let mut frame = vec![2, 0, 0, 0, 0, to, 2, 0, 0, 0, 0, from, 8, 0];
    frame.extend_from_slice(&header);
    frame.extend_from_slice(payload);
    frame
}

fn pseudo(from: u8, to: u8, protocol: u8, length: usize) -> Vec<u8> {
    let length = (length as u16).to_be_bytes();
    vec![10, 0, 0, from, 10, 0, 0, to, 0, protocol, length[0], length[1]]
}

fn datagram(from: End, to: End, payload: &[u8]) -> Vec<u8> {
    let mut udp = Vec::new();
    for word in [from.1, to.1, 8 + payload.len() as u16, 0] {
        udp.extend_from_slice(&word.to_be_bytes());
    }
    udp.extend_from_slice(payload);
    let sum = checksum(&[&pseudo(from.0, to.0, 17, udp.len()), &udp]);
    udp[6..8].copy_from_slice(&sum);
    udp
}

pub(crate) fn udp(from: End, to: End, payload: &[u8]) -> Vec<u8> {
    ipv4(from.0, to.0, 17, 0, &datagram(from, to, payload))
}

/// The same, in fragments of so many bytes: a multiple of eight.
pub(crate) fn udp_fragments(from: End, to: End, payload: &[u8], size: usize) -> Vec<Vec<u8>> {
    let datagram = datagram(from, to, payload);
    let last = datagram.len().div_ceil(size) - 1;
    let fragment = |(i, part): (usize, &[u8])| {
        let more = if i == last { 0 } else { 0x2000 };
        ipv4(from.0, to.0, 17, more | (i * size / 8) as u16, part)
    };
    datagram.chunks(size).enumerate().map(fragment).collect()
}

pub(crate) fn tcp(
    from: End,
    to: End,
    sequence: u32,
    acknowledged: u32,
    flags: u8,
    payload: &[u8],
) -> Vec<u8> {
    let mut tcp = Vec::new();
    tcp.extend_from_slice(&from.1.to_be_bytes());
    tcp.extend_from_slice(&to.1.to_be_bytes());
    tcp.extend_from_slice(&sequence.to_be_bytes());
    tcp.extend_from_slice(&acknowledged.to_be_bytes());
    let is_first = flags & SYN != 0 && acknowledged == 0;
    tcp.extend_from_slice(&[0x50, flags | if is_first { 0 } else { ACK }, 0xff, 0xff, 0, 0, 0, 0]);
    tcp.extend_from_slice(payload);
    let sum = checksum(&[&pseudo(from.0, to.0, 6, tcp.len()), &tcp]);
    tcp[16..18].copy_from_slice(&sum);
    ipv4(from.0, to.0, 6, 0, &tcp)
}

pub(crate) fn frame(bytes: &[u8]) -> Frame<'_> {
    Frame { bytes, checksum_left: false, segment: None }
}

/// What a meter says of requests: their number, when they entered, and what they took, in ms.
pub(crate) fn told(meter: &mut Meter) -> Vec<(u32, u64, Option<u64>)> {
    let samples = std::iter::from_fn(|| meter.poll());
    let plain = |Sample { sequence, entered, took, .. }: Sample| {
        (sequence, entered.as_millis() as u64, took.map(|took| took.as_millis() as u64))
    };
    samples.map(plain).collect()
}

/// A client's connection, and both of its ends' next bytes.
pub(crate) struct Talk {
    pub client: End,
    pub server: End,
    pub next: [u32; 2],
}

impl Talk {
    /// Connects.
    pub fn begin(meter: &mut Meter, at: u64, client: End, server: End) -> Self {
        // Sequence numbers pass the end of their range.
        let first = [u32::MAX - 20, u32::MAX - 40];
        meter.entered(ms(at), &frame(&tcp(client, server, first[0], 0, SYN, b"")), 0);
        let next = first.map(|first| first.wrapping_add(1));
        meter.delivered(ms(at), &frame(&tcp(server, client, first[1], next[0], SYN, b"")));
        meter.entered(ms(at), &frame(&tcp(client, server, next[0], next[1], 0, b"")), 0);
        Self { client, server, next }
    }

    /// What the client sends next, as a frame.
    pub fn client_sends(&mut self, flags: u8, bytes: &[u8]) -> Vec<u8> {
        let sent = tcp(self.client, self.server, self.next[0], self.next[1], flags, bytes);
        self.next[0] = self.next[0].wrapping_add(bytes.len() as u32);
        sent
    }

    /// What the server sends next, as a frame.
    pub fn server_sends(&mut self, flags: u8, bytes: &[u8]) -> Vec<u8> {
        let sent = tcp(self.server, self.client, self.next[1], self.next[0], flags, bytes);
        self.next[1] = self.next[1].wrapping_add(bytes.len() as u32);
        sent
    }

    pub fn say(&mut self, meter: &mut Meter, at: u64, bytes: &[u8]) {
        let sent = self.client_sends(0, bytes);
        meter.entered(ms(at), &frame(&sent), 0);
    }

    pub fn hear(&mut self, meter: &mut Meter, at: u64, bytes: &[u8]) {
        let sent = self.server_sends(0, bytes);
        meter.delivered(ms(at), &frame(&sent));
    }
}
