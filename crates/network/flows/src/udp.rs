//! Requests and answers of one datagram each.

use std::{net::IpAddr, time::Duration};

use crate::{
    fragments::Fragments,
    headers::{PROTOCOL_UDP, UDP, u16_at},
    packet::{Frame, Packet},
    requests::{Id, Requests},
};

/// Both sockets, the client's first, and the request's id.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Key {
    ends: [(IpAddr, u16); 2],
    id: Vec<u8>,
}

/// A flow of datagrams to a port.
#[derive(Debug)]
pub(crate) struct Udp {
    port: u16,
    id: Option<Id>,
    pub requests: Requests<Key>,
    answers: Fragments,
}

/// Bytes kept of a datagram: enough for its header and any id.
const HEAD: usize = 256;

impl Udp {
    pub fn new(port: u16, id: Option<Id>, timeout: Duration) -> Self {
        Self { port, id, requests: Requests::new(timeout), answers: Fragments::new(HEAD) }
    }

    pub fn entered(&mut self, at: Duration, frame: &Frame<'_>, mark: u64) {
        let Some(packet) = Packet::of(frame).filter(|packet| packet.protocol == PROTOCOL_UDP) else { return };
        // Only the first fragment has the ports. Its time is that of the request's first byte.
        if packet.fragment.is_some_and(|fragment| fragment.offset > 0) {
            return;
        }
        let ports = [u16_at(packet.payload, 0), u16_at(packet.payload, 2)];
        let [Some(from), Some(to)] = ports else { return };
        if to != self.port || packet.destination.is_multicast() || is_broadcast(packet.destination) {
            return;
        }
        for payload in datagrams(packet.payload, frame) {
            let Some(id) = self.id(payload) else { continue };
            let key = Key { ends: [(packet.source, from), (packet.destination, to)], id };
            // A request with the id of a pending one is a retransmission.
            if self.id.is_none() || !self.requests.has(&key) {
                self.requests.begin(key, at, mark);
            }
        }
    }

    pub fn delivered(&mut self, at: Duration, frame: &Frame<'_>) {
        let Some(packet) = Packet::of(frame).filter(|packet| packet.protocol == PROTOCOL_UDP) else { return };
        match packet.fragment {
            None => {
                for payload in datagrams(packet.payload, frame) {
                    self.answer(at, (packet.source, packet.destination), packet.payload, payload);
                }
            }
            Some(fragment) => {
                let Some(whole) = self.answers.take((at, 0), &packet, fragment) else { return };
                let payload = whole.head.get(UDP..).unwrap_or_default();
                self.answer(at, (whole.source, whole.destination), &whole.head, payload);
            }
        }
    }

    fn answer(&mut self, at: Duration, (from, to): (IpAddr, IpAddr), header: &[u8], payload: &[u8]) {
        let [Some(source), Some(destination)] = [u16_at(header, 0), u16_at(header, 2)] else { return };
        if source != self.port {
            return;
        }
        if let Some(id) = self.id(payload) {
            self.requests.answer(&Key { ends: [(to, destination), (from, source)], id }, at);
        }
    }

    /// Returns the id of a datagram; `None` if the datagram ends before it.
    fn id(&self, payload: &[u8]) -> Option<Vec<u8>> {
        let Some(Id { offset, length }) = self.id else { return Some(Vec::new()) };
        let offset = usize::from(offset);
        payload.get(offset..offset + usize::from(length)).map(<[u8]>::to_vec)
    }
}

fn is_broadcast(address: IpAddr) -> bool {
    matches!(address, IpAddr::V4(address) if address.is_broadcast())
}

/// Returns the payloads of the datagrams in a packet. A super-packet has several.
pub(crate) fn datagrams<'a>(bytes: &'a [u8], frame: &Frame<'_>) -> impl Iterator<Item = &'a [u8]> {
    let payload = bytes.get(UDP..).unwrap_or_default();
    let size = frame.segment.map_or(payload.len(), usize::from).max(1);
    // A datagram may have no payload.
    let empty = payload.is_empty() && bytes.len() >= UDP;
    payload.chunks(size).chain(empty.then_some(payload))
}

#[cfg(test)]
mod tests;
