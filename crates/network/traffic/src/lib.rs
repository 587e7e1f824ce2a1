#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]
#![warn(missing_docs)]

mod bbr;
mod receiver;
mod rtt;
mod segment;
mod sender;
mod tcp;
mod udp;
mod window;

use std::collections::HashMap;

use cotorra_flows::headers::{ETHERNET, IPV4, u16_at};
use cotorra_graph::{Load, NodeId, Timestamp, TrafficId, TrafficSource};
use cotorra_numbers::{Draws, Gathered, Quantiles};
use serde::Serialize;

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

/// What arrived of a source's traffic.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Measured {
    /// The source.
    pub source: TrafficId,
    /// The host that sends.
    pub from: NodeId,
    /// The host that receives.
    pub to: NodeId,
    /// Packets with data that were sent, those that were sent again included.
    pub sent_packets: u64,
    /// Bytes of payload that arrived: of datagrams each once, of a connection in order.
    pub bytes: u64,
    /// Their rate while the source sent, bit/s.
    pub goodput_bps: f64,
    /// Their rate in each second of the run, bit/s.
    pub goodput_by_second_bps: Vec<u64>,
    /// Figures of a source of datagrams.
    #[serde(flatten)]
    pub udp: Option<UdpMeasured>,
    /// Figures of a connection.
    #[serde(flatten)]
    pub tcp: Option<TcpMeasured>,
}

/// Figures of a source of datagrams.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct UdpMeasured {
    /// Datagrams that arrived.
    pub received_packets: u64,
    /// Datagrams that did not arrive, those under way at the end included.
    pub lost: u64,
    /// Time from one host to the other, of those that arrived, milliseconds.
    pub delay_ms: Option<Quantiles>,
}

/// Figures of a connection.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TcpMeasured {
    /// Packets that were sent again.
    pub retransmitted_packets: u64,
    /// Retransmission timeouts.
    pub timeouts: u64,
    /// Smoothed round trip at the end, milliseconds.
    pub smoothed_round_trip_ms: Option<f64>,
    /// Round trips of packets that were sent once, milliseconds.
    pub round_trip_ms: Option<Quantiles>,
    /// Time from the start until all bytes were acknowledged, milliseconds, if they were.
    pub finished_after_ms: Option<f64>,
}

impl Measured {
    /// Describes it in a sentence.
    pub fn sentence(&self) -> String {
        let Self { sent_packets: sent, goodput_bps, udp, tcp, .. } = self;
        let mut text = format!("{:.2} Mbit/s", goodput_bps / 1e6);
        let mut times = None;
        if let Some(UdpMeasured { received_packets, delay_ms, .. }) = udp {
            text += &format!("; {received_packets} of {sent} packets arrived");
            times = delay_ms.map(|delay| ("delay", delay));
        }
        if let Some(TcpMeasured {
            retransmitted_packets, timeouts, round_trip_ms, finished_after_ms, ..
        }) = tcp
        {
            let s = if *timeouts == 1 { "" } else { "s" };
            text += &format!("; {retransmitted_packets} of {sent} packets sent again, {timeouts} timeout{s}");
            if let Some(ms) = finished_after_ms {
                text += &format!("; all arrived after {:.2} s", ms / 1e3);
            }
            times = round_trip_ms.map(|trip| ("round trip", trip));
        }
        if let Some((what, Quantiles { p50, p95, p99, .. })) = times {
            text += &format!("; {what} median {p50:.2} ms, p95 {p95:.2} ms, p99 {p99:.2} ms");
        }
        text
    }
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

/// Adds a time to samples in milliseconds.
fn gather(samples: &mut Gathered, time: std::time::Duration) {
    samples.add(time.as_secs_f64() * 1e3);
}

#[cfg(test)]
mod tests;
