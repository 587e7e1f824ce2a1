#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]
#![warn(missing_docs)]

mod bbr;
mod completions;
mod connections;
mod copies;
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
use cotorra_graph::{Load, Timestamp, TrafficSource};
use cotorra_numbers::{Draws, Gathered, Quantiles};

pub use copies::{Copies, CopyId};
pub use measured::{CompletionTimes, Measured, TcpMeasured, TransfersMeasured, UdpMeasured};

use crate::{
    connections::Connections,
    segment::{Ends, is_from},
};

/// Ports of the first source, at both ends. Each source has its own.
const FIRST_PORT: u16 = 61_000;
/// Most sources of a testbed.
pub const MOST: usize = 4000;

/// Both ends of all sources of traffic.
///
/// [`Self::poll`] gives frames to send, [`Self::handle`] takes frames that arrive at a host, and [`Self::deadline`] tells when to
/// poll again. Hosts are named by their place among all hosts, which gives their addresses. Ends of links have places behind
/// those of hosts.
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
    Udp(Box<udp::Source>, udp::Sink),
    Tcp(Box<Connections>),
}

impl Sources {
    /// Creates the sources. `places` returns the places of a source's ends; sources without are left out.
    pub fn new(
        specs: &[TrafficSource],
        places: impl Fn(&TrafficSource) -> Option<[usize; 2]>,
        seed: u64,
    ) -> Self {
        let mut sources = Self::default();
        for (spec, port) in specs.iter().take(MOST).zip(FIRST_PORT..) {
            let Some([from, to]) = places(spec) else { continue };
            let ends = Ends { from: (from, port), to: (to, port) };
            let draws =
                ["traffic", "sizes of traffic"].map(|of| Draws::new(seed, &format!("{of} {}", spec.id)));
            let start = Timestamp::ZERO + spec.start;
            let transport = match spec.load.clone() {
                Load::Udp { rate, size, arrivals } => {
                    let source = udp::Source::new(start, rate, size, arrivals, draws);
                    Transport::Udp(Box::new(source), udp::Sink::default())
                }
                Load::Replay(replay) => {
                    Transport::Udp(Box::new(udp::Source::replay(start, replay)), udp::Sink::default())
                }
                Load::Tcp { congestion_control, sends } => {
                    let connections = Connections::new(congestion_control, sends, (start, ends), draws);
                    Transport::Tcp(Box::new(connections))
                }
            };
            sources.by_port.insert(port, sources.flows.len());
            sources.flows.push(Flow {
                spec: spec.clone(),
                ends,
                start,
                stop: spec.stop.map_or(Timestamp::MAX, |stop| Timestamp::ZERO + stop),
                transport,
                seconds: Vec::new(),
            });
        }
        sources
    }

    /// Measures from now on how late datagrams are sent, which they are in real time.
    pub fn in_real_time(mut self) -> Self {
        for flow in &mut self.flows {
            if let Transport::Udp(source, _) = &mut flow.transport {
                source.lateness_us = Some(Gathered::default());
            }
        }
        self
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
        // The ports of UDP and of TCP are at the same place.
        let (Some(from), Some(to)) = (u16_at(frame, ETHERNET + IPV4), u16_at(frame, ETHERNET + IPV4 + 2))
        else {
            return false;
        };
        // A source has its port at the host that receives. At the other, each transfer has one of its own.
        for (port, client, arrives) in [(to, from, true), (from, to, false)] {
            if let Some(&place) = self.by_port.get(&port) {
                let flow = &mut self.flows[place];
                let (here, there) = if arrives {
                    (flow.ends.to.0, flow.ends.from.0)
                } else {
                    (flow.ends.from.0, flow.ends.to.0)
                };
                if here == host && is_from(frame, there) {
                    flow.handle(now, client, arrives, frame);
                    return true;
                }
            }
        }
        false
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
            Transport::Tcp(connections) => {
                if now < self.start {
                    return None;
                }
                let (segment, ends) = connections.poll(now, self.stop, self.ends)?;
                segment.write(ends, frame);
                Some(ends.from.0)
            }
        }
    }

    fn deadline(&self, now: Timestamp) -> Option<Timestamp> {
        match &self.transport {
            Transport::Udp(source, _) => Some(source.deadline().max(self.start)).filter(|&at| at < self.stop),
            Transport::Tcp(_) if now < self.start => Some(self.start),
            Transport::Tcp(connections) => connections.deadline(now, self.stop),
        }
    }

    fn handle(&mut self, now: Timestamp, client: u16, arrives: bool, frame: &[u8]) {
        let bytes = match &mut self.transport {
            Transport::Udp(_, sink) => sink.handle(now, self.ends, frame).unwrap_or(0),
            Transport::Tcp(connections) => connections.handle(now, client, arrives, frame),
        };
        if bytes > 0 {
            let second = now.as_nanos() as usize / 1_000_000_000;
            if self.seconds.len() <= second {
                self.seconds.resize(second + 1, 0);
            }
            self.seconds[second] += bytes;
        }
    }

    fn measured(&self, now: Timestamp) -> Measured {
        let bytes: u64 = self.seconds.iter().sum();
        let (sent, udp, tcp, finished) = match &self.transport {
            Transport::Udp(source, sink) => {
                let lost = source.sent.saturating_sub(sink.received);
                let delay_ms = Quantiles::gathered(&sink.delays);
                let sent_lateness_us = source.lateness_us.as_ref().and_then(Quantiles::gathered);
                let received_packets = sink.received;
                let udp = UdpMeasured { received_packets, lost, delay_ms, sent_lateness_us };
                (source.sent, Some(udp), None, None)
            }
            Transport::Tcp(connections) => {
                let (sent, tcp, finished) = connections.measured(self.start);
                (sent, None, Some(tcp), finished)
            }
        };
        let seconds = finished.unwrap_or(now.min(self.stop)).since(self.start).as_secs_f64();
        Measured {
            source: self.spec.id.clone(),
            from: self.spec.from.clone(),
            to: self.spec.to.clone(),
            link: self.spec.over.as_ref().map(|over| over.link.clone()),
            direction: self.spec.over.as_ref().map(|over| over.direction),
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
mod processes;
#[cfg(test)]
mod tests;
