#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]
#![warn(missing_docs)]

mod bbr;
mod measured;
mod receiver;
mod rtt;
mod segment;
mod sender;
mod tcp;
mod udp;
mod window;

use std::collections::HashMap;

use cotorra_flows::headers::{ETHERNET, IPV4, u16_at};
use cotorra_graph::{Load, NodeId, Timestamp, TrafficSource};
use cotorra_numbers::{Draws, Quantiles};

pub use measured::{Measured, TcpMeasured, UdpMeasured};

use crate::{segment::Ends, tcp::Connection};

/// Ports of the first source, at both ends. Each source has its own.
const FIRST_PORT: u16 = 61_000;
/// Most sources of a testbed.
pub const MOST: usize = 4000;

/// Both ends of all sources of traffic.
///
/// [`Self::poll`] gives frames to send, [`Self::handle`] takes frames that arrive at a host, and [`Self::deadline`] tells when to
/// poll again. Hosts are named by their place among all hosts, which gives their addresses.
#[derive(Debug, Default)]
pub struct Sources {
    flows: Vec<Flow>,
    by_port: HashMap<u16, usize>,
}

#[derive(Debug)]
struct Flow {
    spec: TrafficSource,
    ends: Ends,
    start: Timestamp,
    stop: Timestamp,
    transport: Transport,
    /// Bytes of payloads that arrived, by second of the run.
    seconds: Vec<u64>,
}

#[derive(Debug)]
enum Transport {
    Udp(udp::Source, udp::Sink),
    Tcp(Box<Connection>),
}

impl Sources {
    /// Creates the sources. `place` returns the place of a host among all; sources at others are left out.
    pub fn new(specs: &[TrafficSource], place: impl Fn(&NodeId) -> Option<usize>, seed: u64) -> Self {
        let mut sources = Self::default();
        for (spec, port) in specs.iter().take(MOST).zip(FIRST_PORT..) {
            let (Some(from), Some(to)) = (place(&spec.from), place(&spec.to)) else { continue };
            let draws = Draws::new(seed, &format!("traffic {}", spec.id));
            let start = Timestamp::ZERO + spec.start;
            let transport = match spec.load {
                Load::Udp { rate, size, arrivals } => {
                    let source = udp::Source::new(start, rate, size, arrivals, draws);
                    Transport::Udp(source, udp::Sink::default())
                }
                Load::Tcp { congestion_control, bytes } => {
                    Transport::Tcp(Box::new(Connection::new(congestion_control, bytes, draws)))
                }
            };
            sources.by_port.insert(port, sources.flows.len());
            sources.flows.push(Flow {
                spec: spec.clone(),
                ends: Ends { from: (from, port), to: (to, port) },
                start,
                stop: spec.stop.map_or(Timestamp::MAX, |stop| Timestamp::ZERO + stop),
                transport,
                seconds: Vec::new(),
            });
        }
        sources
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.flows.is_empty()
    }

    /// Replaces `frame` by the next frame to send now, and returns the place of the host that sends it. `waiting` returns the
    /// packets at the first link from one host to another. Call it until there is none.
    pub fn poll(
        &mut self,
        now: Timestamp,
        mut waiting: impl FnMut(usize, usize) -> usize,
        frame: &mut Vec<u8>,
    ) -> Option<usize> {
        self.flows.iter_mut().find_map(|flow| flow.poll(now, &mut waiting, frame))
    }

    /// Returns when a source has something to send, or no less than soon.
    pub fn deadline(&self, now: Timestamp) -> Option<Timestamp> {
        self.flows.iter().filter_map(|flow| flow.deadline(now)).min()
    }

    /// Takes a frame that arrives at a host. Returns whether it is a source's.
    pub fn handle(&mut self, now: Timestamp, host: usize, frame: &[u8]) -> bool {
        // The destination of UDP and of TCP is at the same place.
        let port = u16_at(frame, ETHERNET + IPV4 + 2);
        let flow = port.and_then(|port| self.by_port.get(&port)).map(|&place| &mut self.flows[place]);
        flow.is_some_and(|flow| flow.handle(now, host, frame))
    }

    /// Returns what arrived of each source's traffic, until now.
    pub fn measured(&self, now: Timestamp) -> Vec<Measured> {
        self.flows.iter().map(|flow| flow.measured(now)).collect()
    }
}

impl Flow {
    fn poll(
        &mut self,
        now: Timestamp,
        waiting: &mut impl FnMut(usize, usize) -> usize,
        frame: &mut Vec<u8>,
    ) -> Option<usize> {
        match &mut self.transport {
            Transport::Udp(source, _) => {
                let sends = self.start <= now
                    && now < self.stop
                    && source.poll(now, || waiting(self.ends.from.0, self.ends.to.0));
                sends.then(|| source.write(now, self.ends, frame))?;
                Some(self.ends.from.0)
            }
            Transport::Tcp(connection) => {
                if now < self.start {
                    return None;
                }
                if now >= self.stop {
                    connection.stop();
                }
                let (segment, is_answer) = connection.poll(now)?;
                let ends = if is_answer { self.ends.reversed() } else { self.ends };
                segment.write(ends, frame);
                Some(ends.from.0)
            }
        }
    }

    fn deadline(&self, now: Timestamp) -> Option<Timestamp> {
        match &self.transport {
            Transport::Udp(source, _) => Some(source.deadline().max(self.start)).filter(|&at| at < self.stop),
            Transport::Tcp(_) if now < self.start => Some(self.start),
            Transport::Tcp(connection) => connection.deadline(now),
        }
    }

    fn handle(&mut self, now: Timestamp, host: usize, frame: &[u8]) -> bool {
        if host != self.ends.to.0 && host != self.ends.from.0 {
            return false;
        }
        let bytes = match &mut self.transport {
            Transport::Udp(_, sink) => sink.handle(now, self.ends, frame).unwrap_or(0),
            Transport::Tcp(connection) => {
                let forth = Some(self.ends).filter(|ends| ends.to.0 == host);
                connection.handle(now, forth, self.ends.reversed(), frame)
            }
        };
        if bytes > 0 {
            let second = now.as_nanos() as usize / 1_000_000_000;
            if self.seconds.len() <= second {
                self.seconds.resize(second + 1, 0);
            }
            self.seconds[second] += bytes;
        }
        true
    }

    fn measured(&self, now: Timestamp) -> Measured {
        let bytes: u64 = self.seconds.iter().sum();
        let (sent, udp, tcp, finished) = match &self.transport {
            Transport::Udp(source, sink) => {
                let lost = source.sent.saturating_sub(sink.received);
                let delay_ms = Quantiles::gathered(&sink.delays);
                let udp = UdpMeasured { received_packets: sink.received, lost, delay_ms };
                (source.sent, Some(udp), None, None)
            }
            Transport::Tcp(connection) => {
                let (sent, tcp, finished) = connection.measured(self.start);
                (sent, None, Some(tcp), finished)
            }
        };
        let seconds = finished.unwrap_or(now.min(self.stop)).since(self.start).as_secs_f64();
        Measured {
            source: self.spec.id.clone(),
            from: self.spec.from.clone(),
            to: self.spec.to.clone(),
            sent_packets: sent,
            bytes,
            goodput_bps: if seconds > 0.0 { bytes as f64 * 8.0 / seconds } else { 0.0 },
            goodput_by_second_bps: self.seconds.iter().map(|bytes| bytes * 8).collect(),
            udp,
            tcp,
        }
    }
}

#[cfg(test)]
mod tests;
