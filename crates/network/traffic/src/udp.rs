//! Datagrams at a rate, at random, or whenever there is room, and the counts of those that arrive.

use std::{collections::BTreeSet, time::Duration};

use cotorra_flows::{
    Datagram, Frame,
    headers::{PROTOCOL_UDP, UDP, UDP_CHECKSUM, udp_checksum, udp_header},
};
use cotorra_graph::{Arrivals, BitRate, DatagramSize, HostAddress, OnOff, Replay, Timestamp, UdpRate};
use cotorra_numbers::{Distribution, Draws, Gathered};

use crate::{
    measured::gather,
    segment::{Ends, address},
};

/// Packets that a saturated source keeps at its first link: more than an aggregate of 802.11n has.
pub(crate) const SATURATED: usize = 128;
/// Time after which a saturated source tries again when its host took no packet.
const RETRY: Duration = Duration::from_millis(1);
/// Longest time until a datagram or a transfer, seconds: more than runs take.
const LONGEST: f64 = 1e9;
/// Missing datagrams that may still arrive. Older ones are lost.
const MOST_MISSING: usize = 10_000;

/// A source of datagrams.
#[derive(Debug, Clone)]
pub(crate) struct Source {
    pub sent: u64,
    /// Bytes of the latest datagram's payload.
    pub size: u16,
    pace: Pace,
    next: Timestamp,
    /// How late datagrams with a time are sent, µs; `None` in virtual time, where none is.
    pub lateness_us: Option<Gathered>,
}

#[derive(Debug, Clone)]
enum Pace {
    Timed(Sizes, Timing),
    /// Packets that were at the first link before the last one was sent.
    Saturated(Sizes, Option<usize>),
    Replay(Playback),
}

/// Sizes of datagrams, and the random numbers for them.
#[derive(Debug, Clone)]
struct Sizes(DatagramSize, Box<Draws>);

impl Sizes {
    fn draw(&mut self) -> u16 {
        self.0.sample(&mut self.1)
    }
}

/// Times between datagrams.
#[derive(Debug, Clone)]
enum Timing {
    Constant(BitRate),
    Poisson(Distribution, Box<Draws>),
    OnOff(Box<Periods>),
}

/// Periods with and without datagrams, in turns.
#[derive(Debug, Clone)]
struct Periods {
    spec: OnOff,
    /// Rate of payloads in periods with datagrams, bit/s.
    peak_bps: f64,
    /// Rest of the current period with datagrams, seconds.
    left: f64,
    draws: Draws,
}

impl Periods {
    /// Begins in a period with datagrams as often as there is one.
    fn new(spec: OnOff, rate: BitRate, mut draws: Draws) -> Self {
        let share = spec.share_on();
        let left = if draws.unit() < share { spec.on.sample(&mut draws) } else { 0.0 };
        Self { spec, peak_bps: rate.bits_per_second() as f64 / share, left, draws }
    }

    /// Returns the time in which periods with datagrams have passed for so long.
    fn pass(&mut self, mut on: f64) -> f64 {
        let mut passed = 0.0;
        while on > self.left {
            on -= self.left;
            passed += self.left + self.spec.off.sample(&mut self.draws);
            self.left = self.spec.on.sample(&mut self.draws);
        }
        self.left -= on;
        passed + on
    }
}

impl Timing {
    fn new(rate: BitRate, mean_size: f64, arrivals: Arrivals, draws: Draws) -> Self {
        match arrivals {
            Arrivals::Constant => Self::Constant(rate),
            Arrivals::Poisson => {
                let gaps = Distribution::exponential(mean_gap(rate, mean_size));
                Self::Poisson(gaps.expect("a rate is finite and above 0"), Box::new(draws))
            }
            Arrivals::OnOff(spec) => Self::OnOff(Box::new(Periods::new(spec, rate, draws))),
        }
    }

    /// Returns the time until the first datagram. Only one at a constant rate comes at once.
    fn first(&mut self, mean_size: f64) -> Duration {
        match self {
            Self::Constant(_) => Duration::ZERO,
            // A Poisson process does not begin with an arrival.
            Self::Poisson(gaps, draws) => duration(gaps.sample(draws)),
            Self::OnOff(periods) => {
                let phase = periods.draws.unit();
                duration(periods.pass(phase * mean_size * 8.0 / periods.peak_bps))
            }
        }
    }

    /// Returns the time from a datagram of so many bytes to the next.
    fn gap(&mut self, size: u16) -> Duration {
        match self {
            Self::Constant(rate) => rate.serialisation(size.into()),
            Self::Poisson(gaps, draws) => duration(gaps.sample(draws)),
            Self::OnOff(periods) => duration(periods.pass(f64::from(size) * 8.0 / periods.peak_bps)),
        }
    }
}

/// Returns the mean time between datagrams, seconds. Of whole bytes, it is that of their serialisation.
fn mean_gap(rate: BitRate, mean_size: f64) -> f64 {
    if mean_size.fract() == 0.0 {
        rate.serialisation(mean_size as usize).as_secs_f64()
    } else {
        mean_size * 8.0 / rate.bits_per_second() as f64
    }
}

/// Returns a time that no run outlasts if it is longer.
pub(crate) fn duration(seconds: f64) -> Duration {
    Duration::from_secs_f64(seconds.min(LONGEST))
}

/// A recording that is sent again.
#[derive(Debug, Clone)]
struct Playback {
    replay: Replay,
    place: usize,
    /// When it began anew.
    began: Timestamp,
}

impl Playback {
    /// Returns when the datagram at the place is due; never behind the end of one that comes once.
    fn due(&self) -> Timestamp {
        let datagram = self.replay.datagrams.get(self.place);
        datagram.map_or(Timestamp::MAX, |datagram| self.began + datagram.at)
    }

    /// Moves to the next datagram, and returns the size of the last.
    fn advance(&mut self) -> u16 {
        let size = self.replay.datagrams[self.place].size;
        self.place += 1;
        if let Some(period) = self.replay.period.filter(|_| self.place == self.replay.datagrams.len()) {
            self.place = 0;
            self.began = self.began + period;
        }
        size
    }
}

impl Source {
    /// Creates a source of datagrams of a size at a rate.
    pub(crate) fn new(
        start: Timestamp,
        rate: UdpRate,
        size: DatagramSize,
        arrivals: Arrivals,
        [draws, of_sizes]: [Draws; 2],
    ) -> Self {
        let (sizes, mean) = (Sizes(size, Box::new(of_sizes)), size.mean());
        let (pace, first) = match rate {
            UdpRate::Saturated => (Pace::Saturated(sizes, None), Duration::ZERO),
            UdpRate::Rate(rate) => {
                let mut timing = Timing::new(rate, mean, arrivals, draws);
                let first = timing.first(mean);
                (Pace::Timed(sizes, timing), first)
            }
        };
        Self { sent: 0, size: 0, pace, next: start + first, lateness_us: None }
    }

    /// Creates a source of recorded datagrams.
    pub(crate) fn replay(start: Timestamp, replay: Replay) -> Self {
        let playback = Playback { replay, place: 0, began: start };
        Self { sent: 0, size: 0, next: playback.due(), pace: Pace::Replay(playback), lateness_us: None }
    }

    /// Returns when [`Self::poll`] may have a datagram.
    pub(crate) fn deadline(&self) -> Timestamp {
        self.next
    }

    /// Whether to send a datagram now, with so many packets at the host's first link. Call it until it is false.
    pub(crate) fn poll(&mut self, now: Timestamp, waiting: impl FnOnce() -> usize) -> bool {
        let due = self.next;
        match &mut self.pace {
            Pace::Saturated(sizes, before) => {
                let waiting = waiting();
                let is_taken = before.is_none_or(|before| waiting > before);
                if waiting >= SATURATED || !is_taken {
                    *before = None;
                    self.next = now + RETRY;
                    return false;
                }
                *before = Some(waiting);
                self.size = sizes.draw();
            }
            _ if self.next > now => return false,
            Pace::Timed(sizes, timing) => {
                self.size = sizes.draw();
                self.next = self.next + timing.gap(self.size);
            }
            Pace::Replay(playback) => {
                self.size = playback.advance();
                self.next = playback.due();
            }
        }
        if let (Some(lateness), Pace::Timed(..) | Pace::Replay(_)) = (&mut self.lateness_us, &self.pace) {
            lateness.add(now.since(due).as_secs_f64() * 1e6);
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
        let (HostAddress { mac, ipv4, .. }, sender) = (address(ends.to.0), address(ends.from.0));
        let frame = Frame { bytes: frame, checksum_left: false, segment: None };
        let datagram = Datagram::received(&frame, mac, ipv4)?;
        let from = (*datagram.from.ip(), datagram.from.port());
        if from != (sender.ipv4, ends.from.1) || datagram.to != ends.to.1 {
            return None;
        }
        let (number, rest) = datagram.payload.split_first_chunk()?;
        let (number, sent) = (u64::from_be_bytes(*number), u64::from_be_bytes(*rest.first_chunk()?));
        if !self.is_new(number) {
            return None;
        }
        self.received += 1;
        gather(&mut self.delays, now.since(Timestamp::from_nanos(sent)));
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

    const ENDS: Ends = Ends { from: (1, 61_000), to: (2, 61_000) };

    fn source(rate: UdpRate, arrivals: Arrivals) -> Source {
        let draws = ["udp", "sizes"].map(|label| Draws::new(1, label));
        Source::new(Timestamp::ZERO, rate, DatagramSize::Constant(1250), arrivals, draws)
    }

    fn rate(mbps: f64) -> UdpRate {
        UdpRate::Rate(BitRate::from_mbps(mbps).unwrap())
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
