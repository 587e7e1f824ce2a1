//! Sends the packets of a link's queue: at once, at a fixed rate, or by a trace of delivery opportunities.

use std::{sync::Arc, time::Duration};

use cotorra_flows::headers::ETHERNET;
use cotorra_graph::{BitRate, Rate, Timestamp, Trace};

const NANOS: u128 = 1_000_000_000;
const NANOS_PER_MS: u64 = 1_000_000;

/// Sends packets of type `P`, one after the other.
#[derive(Debug)]
pub(crate) enum Transmitter<P> {
    /// Takes no time.
    Unlimited,
    /// Sends at a fixed rate.
    Fixed(Fixed<P>),
    /// Sends at a trace's opportunities.
    Traced(Traced<P>),
}

/// Sends at a fixed rate. The rate is exact over consecutive packets: the part of a packet's last nanosecond that it did
/// not need is carried over to the next packet.
#[derive(Debug)]
pub(crate) struct Fixed<P> {
    rate: BitRate,
    carried: u64,
    /// The current packet, and when its last bit is sent.
    sending: Option<(P, Timestamp)>,
}

/// Sends by delivery opportunities, as Mahimahi does (Netravali et al., USENIX ATC 2015). Each opportunity delivers 1504
/// bytes of the waiting packets, whole or in parts. The unused rest of an opportunity is lost. A packet counts as at
/// Mahimahi's TUN interface: its IP packet and a header of 4 bytes. So an opportunity delivers one packet of 1500 bytes.
#[derive(Debug)]
pub(crate) struct Traced<P> {
    trace: Arc<Trace>,
    /// Start of the trace.
    origin: Timestamp,
    /// The next opportunity: the period, and the index in it.
    next: (u64, usize),
    /// Time of the current opportunity, and its bytes left.
    at_hand: (Timestamp, u64),
    /// The current packet, and its counted bytes left to send.
    sending: Option<(P, u64)>,
}

/// Bytes of the header that the TUN interface of Mahimahi puts before an IP packet.
const TUN: u64 = 4;
/// Bytes that one opportunity delivers.
const OPPORTUNITY: u64 = TUN + Trace::BYTES as u64;
/// Bytes of an Ethernet frame that do not count.
const UNCOUNTED: u64 = ETHERNET as u64 - TUN;

impl<P> Transmitter<P> {
    /// Creates an idle transmitter. A trace begins `now`.
    pub(crate) fn new(rate: &Rate, now: Timestamp) -> Self {
        match rate {
            // Settings reject a trace of which only the name is known.
            Rate::Unlimited | Rate::NamedTrace(_) => Self::Unlimited,
            Rate::Fixed { bits_per_second } => {
                Self::Fixed(Fixed { rate: *bits_per_second, carried: 0, sending: None })
            }
            Rate::Trace { trace } => Self::Traced(Traced {
                trace: Arc::clone(trace),
                origin: now,
                next: (0, 0),
                at_hand: (now, 0),
                sending: None,
            }),
        }
    }

    /// Whether a packet is being sent.
    pub(crate) fn is_busy(&self) -> bool {
        match self {
            Self::Unlimited => false,
            Self::Fixed(fixed) => fixed.sending.is_some(),
            Self::Traced(traced) => traced.sending.is_some(),
        }
    }

    /// Returns the packet that is being sent.
    pub(crate) fn sending(&self) -> Option<&P> {
        match self {
            Self::Unlimited => None,
            Self::Fixed(fixed) => fixed.sending.as_ref().map(|(packet, _)| packet),
            Self::Traced(traced) => traced.sending.as_ref().map(|(packet, _)| packet),
        }
    }

    /// Prepares for a packet that finds the transmitter idle. Fractions and opportunities of the past expire.
    pub(crate) fn wake(&mut self, now: Timestamp) {
        match self {
            Self::Unlimited => {}
            Self::Fixed(fixed) => fixed.carried = 0,
            Self::Traced(traced) => traced.seek(now),
        }
    }

    /// Starts to send the last `bits` of a packet, right after the one before or after [`Self::wake`]. Returns the packet
    /// if that takes no time.
    pub(crate) fn begin(&mut self, now: Timestamp, packet: P, bits: u64) -> Option<P> {
        debug_assert!(!self.is_busy());
        match self {
            Self::Unlimited => return Some(packet),
            Self::Fixed(fixed) => {
                let rate = u128::from(fixed.rate.bits_per_second());
                let scaled = u128::from(bits) * NANOS + u128::from(fixed.carried);
                fixed.carried = (scaled % rate) as u64;
                fixed.sending = Some((packet, now + Duration::from_nanos((scaled / rate) as u64)));
            }
            Self::Traced(traced) => {
                traced.sending = Some((packet, bits.div_ceil(8).saturating_sub(UNCOUNTED)));
            }
        }
        None
    }

    /// Returns when the packet, or a part of it, is sent; `None` if idle.
    pub(crate) fn deadline(&self) -> Option<Timestamp> {
        match self {
            Self::Unlimited => None,
            Self::Fixed(fixed) => fixed.sending.as_ref().map(|(_, end)| *end),
            Self::Traced(traced) => traced.sending.as_ref().map(|_| match traced.at_hand {
                (_, 0) => traced.time_of_next(),
                (time, _) => time,
            }),
        }
    }

    /// Takes the packet whose last bit is sent by `at`, with the time of that.
    pub(crate) fn finish(&mut self, at: Timestamp) -> Option<(P, Timestamp)> {
        match self {
            Self::Unlimited => None,
            Self::Fixed(fixed) => fixed.sending.take_if(|(_, end)| *end <= at),
            Self::Traced(traced) => traced.finish(at),
        }
    }

    /// Stops sending. Returns the current packet and its bits left.
    pub(crate) fn stop(&mut self, now: Timestamp) -> Option<(P, u64)> {
        match self {
            Self::Unlimited => None,
            Self::Fixed(Fixed { rate, sending, .. }) => sending.take().map(|(packet, end)| {
                let bits = end.since(now).as_nanos() * u128::from(rate.bits_per_second());
                (packet, bits.div_ceil(NANOS) as u64)
            }),
            Self::Traced(traced) => {
                traced.sending.take().map(|(packet, bytes)| (packet, (bytes + UNCOUNTED) * 8))
            }
        }
    }
}

impl<P> Traced<P> {
    fn time_of_next(&self) -> Timestamp {
        let (period, index) = self.next;
        let ms = period * self.trace.period_ms() + self.trace.opportunities_ms()[index];
        self.origin + Duration::from_nanos(ms.saturating_mul(NANOS_PER_MS))
    }

    /// Moves to the first opportunity after `now`. One at `now` itself belongs to packets that were there before.
    fn seek(&mut self, now: Timestamp) {
        self.at_hand.1 = 0;
        let since_ms = now.since(self.origin).as_nanos() as u64 / NANOS_PER_MS;
        // Opportunities are at whole milliseconds, the last one at the end of the period.
        let into = since_ms % self.trace.period_ms();
        let index = self.trace.opportunities_ms().partition_point(|ms| *ms <= into);
        self.next = (since_ms / self.trace.period_ms(), index);
    }

    /// Takes the next opportunity.
    fn seize(&mut self) {
        self.at_hand = (self.time_of_next(), OPPORTUNITY);
        let (period, index) = self.next;
        let wraps = index + 1 == self.trace.opportunities_ms().len();
        self.next = if wraps { (period + 1, 0) } else { (period, index + 1) };
    }

    fn finish(&mut self, at: Timestamp) -> Option<(P, Timestamp)> {
        let (packet, mut left) = self.sending.take()?;
        loop {
            if self.at_hand.1 == 0 {
                if self.time_of_next() > at {
                    self.sending = Some((packet, left));
                    return None;
                }
                self.seize();
            }
            let bytes = self.at_hand.1.min(left);
            self.at_hand.1 -= bytes;
            left -= bytes;
            if left == 0 {
                return Some((packet, self.at_hand.0));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ms(ms: f64) -> Timestamp {
        Timestamp::from_nanos((ms * 1e6) as u64)
    }

    fn fixed(bits_per_second: u64) -> Rate {
        Rate::Fixed { bits_per_second: BitRate::from_bits_per_second(bits_per_second).unwrap() }
    }

    fn traced(text: &str) -> Rate {
        Rate::Trace { trace: Arc::new(Trace::parse(text).unwrap()) }
    }

    /// Returns when each of `packets` packets is sent if all are there at `now`.
    fn back_to_back(rate: &Rate, now: Timestamp, packets: usize, bytes: u64) -> Vec<Timestamp> {
        let mut transmitter = Transmitter::new(rate, Timestamp::ZERO);
        transmitter.wake(now);
        let mut begins = now;
        let mut send = |i| {
            assert!(transmitter.begin(begins, i, bytes * 8).is_none());
            loop {
                let deadline = transmitter.deadline().unwrap();
                if let Some((packet, end)) = transmitter.finish(deadline) {
                    assert_eq!((packet, end), (i, deadline));
                    begins = end;
                    return end;
                }
            }
        };
        (0..packets).map(&mut send).collect()
    }

    #[test]
    fn a_fixed_rate_is_exact_over_many_packets() {
        for (rate, bytes) in [(10_000_000_000, 64), (3_333_333_333, 60), (8_000_000, 1514), (7, 1)] {
            let packets = 10_000;
            let end = *back_to_back(&fixed(rate), ms(3.0), packets, bytes).last().unwrap();
            let exact = (packets as u64 * bytes * 8) as f64 * 1e9 / rate as f64;
            assert!((end.since(ms(3.0)).as_nanos() as f64 - exact).abs() <= 1.0);
        }
    }

    #[test]
    fn opportunities_carry_whole_packets_and_parts() {
        // Of frames of 1010 bytes, 1000 count: those and 504 of the next, its other 496 and 1000 of the third. Of the
        // fourth, 8 bytes; the rest waits for the next.
        let sent = back_to_back(&traced("1\n1\n5"), Timestamp::ZERO, 4, 1010);
        assert_eq!(sent, [1.0, 1.0, 1.0, 5.0].map(ms));
        // A packet larger than an opportunity takes several, round the trace's end.
        let sent = back_to_back(&traced("1\n1\n5"), Timestamp::ZERO, 2, 4000);
        assert_eq!(sent, [5.0, 10.0].map(ms));
    }

    #[test]
    fn unused_opportunities_are_lost() {
        let rate = traced("1\n1\n5");
        // The second at 1 ms was there before the packet was; so was the one at 5 ms.
        assert_eq!(back_to_back(&rate, ms(1.0), 1, 100), [ms(5.0)]);
        assert_eq!(back_to_back(&rate, ms(1.2), 1, 100), [ms(5.0)]);
        assert_eq!(back_to_back(&rate, ms(5.0), 1, 100), [ms(6.0)]);
        assert_eq!(back_to_back(&rate, ms(7_000_003.0), 1, 100), [ms(7_000_005.0)]);
        // An opportunity at 0 comes again at each period's end.
        assert_eq!(back_to_back(&traced("0\n4"), ms(3.9), 3, 1514), [4.0, 4.0, 8.0].map(ms));
    }

    #[test]
    fn a_packet_of_1500_bytes_takes_exactly_one_opportunity() {
        let opportunities: Vec<_> = (1..=1000).collect();
        let rate = Rate::Trace { trace: Arc::new(opportunities.clone().try_into().unwrap()) };
        let sent = back_to_back(&rate, Timestamp::ZERO, 1000, 1514);
        assert_eq!(sent, opportunities.into_iter().map(|at| ms(at as f64)).collect::<Vec<_>>());
        // Of one more byte, the last takes a second one, whose rest the next packet uses.
        let sent = back_to_back(&rate, Timestamp::ZERO, 3, 1515);
        assert_eq!(sent, [2.0, 3.0, 4.0].map(ms));
    }

    /// Mahimahi's rule, packet by packet: each opportunity takes bytes off the head of the queue.
    fn as_mahimahi(opportunities: &[u64], ip_bytes: &[u64]) -> Vec<u64> {
        let (mut sent, mut waiting) =
            (Vec::new(), ip_bytes.iter().map(|bytes| bytes + 4).collect::<Vec<_>>());
        waiting.reverse();
        for at in opportunities {
            let mut left = 1504;
            while left > 0
                && let Some(packet) = waiting.last_mut()
            {
                let bytes = left.min(*packet);
                (left, *packet) = (left - bytes, *packet - bytes);
                if *packet == 0 {
                    waiting.pop();
                    sent.push(*at);
                }
            }
        }
        sent
    }

    #[test]
    fn packets_of_any_size_leave_when_they_leave_mahimahi() {
        let opportunities = [1, 1, 2, 5, 5, 9, 30, 31, 32, 33];
        let sizes = [1500, 40, 1500, 700, 28, 1464, 1500, 1200, 1500, 52, 900, 1500];
        let rate = Rate::Trace { trace: Arc::new(opportunities.to_vec().try_into().unwrap()) };
        let mut transmitter = Transmitter::new(&rate, Timestamp::ZERO);
        transmitter.wake(Timestamp::ZERO);
        let sent = sizes.map(|ip_bytes| {
            assert!(transmitter.begin(Timestamp::ZERO, (), (ip_bytes + 14) * 8).is_none());
            loop {
                let deadline = transmitter.deadline().unwrap();
                if let Some(((), end)) = transmitter.finish(deadline) {
                    return end;
                }
            }
        });
        let expected: Vec<_> =
            as_mahimahi(&opportunities, &sizes).into_iter().map(|at| ms(at as f64)).collect();
        assert_eq!(sent.to_vec(), expected);
    }

    #[test]
    fn the_rest_of_an_opportunity_is_lost() {
        let mut transmitter = Transmitter::new(&traced("1\n5"), Timestamp::ZERO);
        transmitter.wake(Timestamp::ZERO);
        assert!(transmitter.begin(Timestamp::ZERO, 'a', 800).is_none());
        assert_eq!(transmitter.finish(ms(1.0)), Some(('a', ms(1.0))));
        transmitter.wake(ms(1.0));
        assert!(transmitter.begin(ms(1.0), 'b', 800).is_none());
        assert_eq!(transmitter.deadline(), Some(ms(5.0)));
    }

    #[test]
    fn stopping_returns_the_packet_and_its_bits_left() {
        let mut transmitter = Transmitter::new(&fixed(8_000_000), Timestamp::ZERO);
        assert!(transmitter.begin(Timestamp::ZERO, 'a', 8000).is_none());
        assert_eq!(transmitter.stop(ms(0.25)), Some(('a', 6000)));
        assert!(!transmitter.is_busy());
        let mut transmitter = Transmitter::new(&traced("1\n5"), Timestamp::ZERO);
        assert!(transmitter.begin(Timestamp::ZERO, 'a', 2000 * 8).is_none());
        assert_eq!(transmitter.finish(ms(1.0)), None);
        // 1990 bytes count, of which an opportunity has delivered 1504.
        assert_eq!(transmitter.stop(ms(2.0)), Some(('a', 496 * 8)));
    }
}
