//! Builds frames for tests, as a host's kernel does.

use std::{net::Ipv4Addr, time::Duration};

use crate::{
    Frame, Meter, Sample,
    checksum::{complement, sum},
    headers::{Ipv4, PROTOCOL_TCP, PROTOCOL_UDP, UDP, UDP_CHECKSUM, pseudo_header_sum, udp_header},
};

pub(crate) mod rtps;

/// The last byte of a host's address, and a port.
pub(crate) type End = (u8, u16);

pub(crate) const SYN: u8 = 0x02;
pub(crate) const FIN: u8 = 0x01;
pub(crate) const RST: u8 = 0x04;
const ACK: u8 = 0x10;

pub(crate) fn ms(ms: u64) -> Duration {
    Duration::from_millis(ms)
}

fn address(host: u8) -> Ipv4Addr {
    Ipv4Addr::new(10, 0, 0, host)
}

fn ipv4(from: u8, to: u8, protocol: u8, fragment: u16, payload: &[u8]) -> Vec<u8> {
    let (source, destination) = (address(from), address(to));
    let header = Ipv4 { identification: 7, fragment, ttl: 64, protocol, source, destination };
    let ethernet = [2, 0, 0, 0, 0, to, 2, 0, 0, 0, 0, from, 8, 0];
    [&ethernet[..], &header.header(payload.len()), payload].concat()
}

/// The checksum of a transport's header and payload.
fn checksum(from: u8, to: u8, protocol: u8, transport: &[u8]) -> [u8; 2] {
    let addresses = [address(from).octets(), address(to).octets()].concat();
    complement(sum(transport) + pseudo_header_sum(&addresses, protocol, transport.len())).to_be_bytes()
}

fn datagram(from: End, to: End, payload: &[u8]) -> Vec<u8> {
    let mut udp = [&udp_header(from.1, to.1, payload.len())[..], payload].concat();
    let sum = checksum(from.0, to.0, PROTOCOL_UDP, &udp);
    udp[UDP_CHECKSUM..UDP].copy_from_slice(&sum);
    udp
}

pub(crate) fn udp(from: End, to: End, payload: &[u8]) -> Vec<u8> {
    ipv4(from.0, to.0, PROTOCOL_UDP, 0, &datagram(from, to, payload))
}

/// Builds the fragments of a datagram. `size` is in bytes, a multiple of eight.
pub(crate) fn udp_fragments(from: End, to: End, payload: &[u8], size: usize) -> Vec<Vec<u8>> {
    let datagram = datagram(from, to, payload);
    let last = datagram.len().div_ceil(size) - 1;
    let fragment = |(i, part): (usize, &[u8])| {
        let more = if i == last { 0 } else { 0x2000 };
        ipv4(from.0, to.0, PROTOCOL_UDP, more | (i * size / 8) as u16, part)
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
    let sum = checksum(from.0, to.0, PROTOCOL_TCP, &tcp);
    tcp[16..18].copy_from_slice(&sum);
    ipv4(from.0, to.0, PROTOCOL_TCP, 0, &tcp)
}

pub(crate) fn frame(bytes: &[u8]) -> Frame<'_> {
    Frame { bytes, checksum_left: false, segment: None }
}

/// Returns a meter's samples: sequence number, time of entry and duration, ms.
pub(crate) fn samples(meter: &mut Meter) -> Vec<(u32, u64, Option<u64>)> {
    let samples = std::iter::from_fn(|| meter.poll());
    let plain = |Sample { sequence, entered, took, .. }: Sample| {
        (sequence, entered.as_millis() as u64, took.map(|took| took.as_millis() as u64))
    };
    samples.map(plain).collect()
}

/// A client's connection, with the next sequence number of each end.
pub(crate) struct Talk {
    pub client: End,
    pub server: End,
    pub next: [u32; 2],
}

impl Talk {
    /// Opens the connection.
    pub fn begin(meter: &mut Meter, at: u64, client: End, server: End) -> Self {
        // Sequence numbers wrap around.
        let first = [u32::MAX - 20, u32::MAX - 40];
        meter.entered(ms(at), &frame(&tcp(client, server, first[0], 0, SYN, b"")), 0);
        let next = first.map(|first| first.wrapping_add(1));
        meter.delivered(ms(at), &frame(&tcp(server, client, first[1], next[0], SYN, b"")));
        meter.entered(ms(at), &frame(&tcp(client, server, next[0], next[1], 0, b"")), 0);
        Self { client, server, next }
    }

    /// Builds the client's next frame.
    pub fn client_sends(&mut self, flags: u8, bytes: &[u8]) -> Vec<u8> {
        let sent = tcp(self.client, self.server, self.next[0], self.next[1], flags, bytes);
        self.next[0] = self.next[0].wrapping_add(bytes.len() as u32);
        sent
    }

    /// Builds the server's next frame.
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
