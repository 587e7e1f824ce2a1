//! Datagrams at a rate, at random, or whenever there is room, and the counts of those that arrive.

use std::{collections::BTreeSet, time::Duration};

use cotorra_flows::{
    Datagram, Frame,
    headers::{PROTOCOL_UDP, UDP, UDP_CHECKSUM, udp_checksum, udp_header},
};
use cotorra_graph::{Arrivals, HostAddress, Timestamp, UdpRate};
use cotorra_numbers::{Draws, Gathered};

use crate::segment::Ends;

/// Packets that a saturated source keeps at its first link: more than an aggregate of 802.11n has.
pub(crate) const SATURATED: usize = 128;
/// Time after which a saturated source tries again when its host took no packet.
const RETRY: Duration = Duration::from_millis(1);
/// Missing datagrams that may still arrive. Older ones are lost.
const MOST_MISSING: usize = 10_000;

/// A source of datagrams.
#[derive(Debug, Clone)]
pub(crate) struct Source {
    pub size: u16,
    pub sent: u64,
    pace: Pace,
    next: Timestamp,
}

#[derive(Debug, Clone)]
enum Pace {
    Constant(Duration),
    Poisson(f64, Box<Draws>),
    /// Packets that were at the first link before the last one was sent.
    Saturated(Option<usize>),
}

impl Source {
    pub(crate) fn new(start: Timestamp, rate: UdpRate, size: u16, arrivals: Arrivals, draws: Draws) -> Self {
        let pace = match rate {
            UdpRate::Saturated => Pace::Saturated(None),
            UdpRate::Rate(rate) => {
                let interval = rate.serialisation(size.into());
                match arrivals {
                    Arrivals::Constant => Pace::Constant(interval),
                    Arrivals::Poisson => Pace::Poisson(interval.as_secs_f64(), Box::new(draws)),
                }
            }
        };
        let mut source = Self { size, sent: 0, pace, next: start };
        // A Poisson process does not begin with an arrival.
        if let Pace::Poisson(..) = source.pace {
            source.next = start + source.gap();
        }
        source
    }

    fn gap(&mut self) -> Duration {
        match &mut self.pace {
            Pace::Constant(interval) => *interval,
            Pace::Poisson(mean, draws) => Duration::from_secs_f64(-*mean * (1.0 - draws.unit()).ln()),
            Pace::Saturated(_) => RETRY,
        }
    }

    /// Returns when [`Self::poll`] may have a datagram.
    pub(crate) fn deadline(&self) -> Timestamp {
        self.next
    }

    /// Whether to send a datagram now, with so many packets at the host's first link. Call it until it is false.
    pub(crate) fn poll(&mut self, now: Timestamp, waiting: impl FnOnce() -> usize) -> bool {
        if let Pace::Saturated(before) = &mut self.pace {
            let waiting = waiting();
            let is_taken = before.is_none_or(|before| waiting > before);
            if waiting >= SATURATED || !is_taken {
                *before = None;
                self.next = now + RETRY;
                return false;
            }
            *before = Some(waiting);
        } else if self.next > now {
            return false;
        } else {
            self.next = self.next + self.gap();
        }
        self.sent += 1;
        true
    }

    /// Replaces `frame` by the frame of the latest datagram.
    pub(crate) fn write(&self, now: Timestamp, ends: Ends, frame: &mut Vec<u8>) {
        let payload = usize::from(self.size);
        let addresses = ends.begin(frame, PROTOCOL_UDP, UDP + payload);
        let at = frame.len();
        frame.extend_from_slice(&udp_header(ends.from.1, ends.to.1, payload));
        frame.extend_from_slice(&(self.sent - 1).to_be_bytes());
        frame.extend_from_slice(&now.as_nanos().to_be_bytes());
        frame.resize(at + UDP + payload, 0);
        let checksum = udp_checksum(&addresses, &frame[at..]);
        frame[at + UDP_CHECKSUM..at + UDP].copy_from_slice(&checksum);
    }
}

/// A sink of datagrams.
#[derive(Debug, Default)]
pub(crate) struct Sink {
    /// Datagrams that arrived, each once.
    pub received: u64,
    /// Delays, ms.
    pub delays: Gathered,
    next: u64,
    missing: BTreeSet<u64>,
}

impl Sink {
    /// Takes a frame. Returns the bytes of the payload, unless it is not for this sink, or came before.
    pub(crate) fn handle(&mut self, now: Timestamp, ends: Ends, frame: &[u8]) -> Option<u64> {
        let HostAddress { mac, ipv4, .. } = HostAddress::of(ends.to.0);
        let frame = Frame { bytes: frame, checksum_left: false, segment: None };
        let datagram = Datagram::received(&frame, mac, ipv4)?;
        let from = (*datagram.from.ip(), datagram.from.port());
        if from != (HostAddress::of(ends.from.0).ipv4, ends.from.1) || datagram.to != ends.to.1 {
            return None;
        }
        let (number, rest) = datagram.payload.split_first_chunk()?;
        let (number, sent) = (u64::from_be_bytes(*number), u64::from_be_bytes(*rest.first_chunk()?));
        if !self.is_new(number) {
            return None;
        }
        self.received += 1;
        self.delays.add(now.since(Timestamp::from_nanos(sent)).as_secs_f64() * 1e3);
        Some(datagram.payload.len() as u64)
    }

    fn is_new(&mut self, number: u64) -> bool {
        if number < self.next {
            return self.missing.remove(&number);
        }
        let oldest = number.saturating_sub(MOST_MISSING as u64);
        self.missing.extend(self.next.max(oldest)..number);
        while self.missing.len() > MOST_MISSING {
            self.missing.pop_first();
        }
        self.next = number + 1;
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use cotorra_graph::BitRate;

    const ENDS: Ends = Ends { from: (1, 61_000), to: (2, 61_000) };

    fn source(rate: UdpRate, arrivals: Arrivals) -> Source {
        Source::new(Timestamp::ZERO, rate, 1250, arrivals, Draws::new(1, "udp"))
    }

    fn rate(mbps: f64) -> UdpRate {
        UdpRate::Rate(BitRate::from_mbps(mbps).unwrap())
    }

    #[test]
    fn gaps_of_a_poisson_source_are_exponential() {
        let mut source = source(rate(10.0), Arrivals::Poisson);
        let mut gaps: Vec<f64> = (0..20_000).map(|_| source.gap().as_secs_f64()).collect();
        let mean = gaps.iter().sum::<f64>() / gaps.len() as f64;
        assert!((mean - 1e-3).abs() < 0.03e-3, "{mean}");
        gaps.sort_by(f64::total_cmp);
        // The distance from the exponential distribution (Kolmogorov and Smirnov); 1 % of samples exceed 1.63 / √n.
        let count = gaps.len() as f64;
        let distance = gaps.iter().enumerate().map(|(i, gap)| {
            let expected = 1.0 - (-gap / 1e-3).exp();
            (expected - i as f64 / count).abs().max((expected - (i + 1) as f64 / count).abs())
        });
        assert!(distance.fold(0.0, f64::max) < 1.63 / count.sqrt());
    }

    #[test]
    fn a_constant_source_keeps_its_rate_and_its_datagrams_arrive_once() {
        let mut source = source(rate(10.0), Arrivals::Constant);
        let (mut sink, mut frame) = (Sink::default(), Vec::new());
        let mut now = Timestamp::ZERO;
        while now < Timestamp::from_nanos(1_000_000_000) {
            assert!(source.poll(now, || 0) && !source.poll(now, || 0));
            source.write(now, ENDS, &mut frame);
            let arrives = now + Duration::from_millis(7);
            assert_eq!(sink.handle(arrives, ENDS, &frame), Some(1250));
            assert_eq!(sink.handle(arrives, ENDS, &frame), None, "a duplicate");
            assert_eq!(sink.handle(arrives, ENDS.reversed(), &frame), None, "another's");
            now = source.deadline();
        }
        assert_eq!((source.sent, sink.received), (1000, 1000));
        assert_eq!(sink.delays.sorted().unwrap().quantile(0.5).value, 7.0);
    }

    #[test]
    fn late_datagrams_count_and_lost_ones_do_not() {
        let mut sink = Sink::default();
        let new: Vec<_> = [0, 1, 4, 3, 3, 0, 6, 2].map(|number| sink.is_new(number)).into();
        assert_eq!(new, [true, true, true, true, false, false, true, true]);
        assert_eq!(sink.missing.iter().copied().collect::<Vec<_>>(), [5]);
        assert!(sink.is_new(1 << 40) && sink.missing.len() <= MOST_MISSING);
    }

    #[test]
    fn a_saturated_source_fills_its_first_link_and_no_more() {
        let mut source = source(UdpRate::Saturated, Arrivals::Constant);
        let waiting = std::cell::Cell::new(0);
        let fill = |source: &mut Source, takes: bool| {
            while source.poll(Timestamp::ZERO, || waiting.get()) {
                waiting.set(waiting.get() + usize::from(takes));
            }
        };
        fill(&mut source, true);
        assert_eq!((waiting.get(), source.sent), (SATURATED, SATURATED as u64));
        waiting.set(100);
        fill(&mut source, false);
        assert_eq!(source.sent, SATURATED as u64 + 1, "a host that drops packets is tried once at a time");
    }
}
