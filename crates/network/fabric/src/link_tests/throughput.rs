//! Throughput tests of one direction of a link: sends packets at a rate for some time, and measures the rate at which they
//! come out. A shell with sockets at both ends of real links can drive them, too.

use std::{collections::BTreeMap, time::Duration};

use cotorra_graph::{LinkId, Rate, Tested, ThroughputTest, Timestamp};

use super::packet;
use crate::{frame::Frame, settings::FabricError, timers::Timers};

/// Time after the last packet was sent in which arrivals still count.
const GRACE: Duration = Duration::from_secs(1);

/// Bits of a packet, Ethernet header included.
const BITS: f64 = ThroughputTests::PACKET_BYTES as f64 * 8.0;

/// A current or finished test.
#[derive(Debug, Clone)]
struct Running {
    began: Timestamp,
    test: ThroughputTest,
    rate_bps: f64,
    sent: u64,
    /// Whether the time is over: no more packets are sent, however many were due.
    closed: bool,
    arrived: u64,
    /// Arrival of the first and the last packet.
    span: Option<[Timestamp; 2]>,
}

impl Running {
    /// Starts a test of a link with a rate of `link_bps`, bit/s.
    ///
    /// # Errors
    /// [`FabricError::TestDuration`] or [`FabricError::TestRate`] beyond the bounds.
    fn new(now: Timestamp, test: ThroughputTest, link_bps: f64) -> Result<Self, FabricError> {
        if !(ThroughputTest::SHORTEST..=ThroughputTest::LONGEST).contains(&test.duration) {
            return Err(FabricError::TestDuration(test.duration));
        }
        let fastest = ThroughputTest::FASTEST_BPS as f64;
        let rate_bps = match test.rate_limit {
            Some(limit) if limit.bits_per_second() > ThroughputTest::FASTEST_BPS => {
                return Err(FabricError::TestRate(limit));
            }
            Some(limit) => limit.bits_per_second() as f64,
            None => (link_bps * 1.1).min(fastest),
        };
        Ok(Self { began: now, test, rate_bps, sent: 0, closed: false, arrived: 0, span: None })
    }

    /// Returns when the next packet is due; `None` after the last.
    fn deadline(&self) -> Option<Timestamp> {
        let after = Duration::from_secs_f64(self.sent as f64 * BITS / self.rate_bps);
        (after < self.test.duration && !self.closed).then(|| self.began + after)
    }

    /// Returns whether a packet is due, and counts it as sent. A driver that cannot keep up sends no more once the time is
    /// over.
    fn poll(&mut self, now: Timestamp) -> bool {
        self.closed = now >= self.ended();
        let due = self.deadline().is_some_and(|at| at <= now);
        self.sent += u64::from(due);
        due
    }

    /// Records a packet that left the link.
    fn arrived(&mut self, at: Timestamp) {
        if !self.is_over(at) {
            self.arrived += 1;
            self.span = Some([self.span.map_or(at, |[first, _]| first), at]);
        }
    }

    fn ended(&self) -> Timestamp {
        self.began + self.test.duration
    }

    /// Whether later arrivals no longer count.
    fn is_over(&self, now: Timestamp) -> bool {
        now >= self.ended() + GRACE
    }

    /// Returns the time until the next test may start.
    fn rests_for(&self, now: Timestamp) -> Duration {
        (self.ended() + self.test.duration * ThroughputTest::REST).max(self.ended() + GRACE).since(now)
    }

    /// Returns the result; `None` before the test is over.
    fn tested(&self, now: Timestamp) -> Option<Tested> {
        let [first, last] = self.span.unwrap_or([self.began; 2]);
        // The span from first to last arrival has one packet less. Without a span, the throughput is reported as 0.
        let bits = self.arrived.saturating_sub(1) as f64 * BITS;
        let throughput_bps = bits / last.since(first).as_secs_f64();
        self.is_over(now).then(|| Tested {
            throughput_bps: if throughput_bps.is_finite() { throughput_bps } else { 0.0 },
            offered_bps: self.rate_bps.min(self.sent as f64 * BITS / self.test.duration.as_secs_f64()),
            age: now.since(self.ended()),
        })
    }
}

/// The throughput tests of all directions of links, by edge: two per link.
#[derive(Debug)]
pub struct ThroughputTests {
    of: BTreeMap<usize, Latest>,
    timers: Timers,
}

#[derive(Debug)]
struct Latest {
    test: Running,
    /// The test before, reported until this one is over.
    before: Option<Running>,
}

impl ThroughputTests {
    /// Octets of a packet, Ethernet header included.
    pub const PACKET_BYTES: usize = 1514;

    /// Creates the component for `edges` directions of links, without tests.
    pub fn new(edges: usize) -> Self {
        Self { of: BTreeMap::new(), timers: Timers::new(edges) }
    }

    /// Starts a test of one edge of a link. `rate` is the edge's own.
    ///
    /// # Errors
    /// [`FabricError`] for a test beyond the bounds, or one too soon after another.
    pub fn begin(
        &mut self,
        now: Timestamp,
        (edge, link): (usize, &LinkId),
        test: ThroughputTest,
        rate: &Rate,
    ) -> Result<(), FabricError> {
        let test = Running::new(now, test, rate.mean_bits_per_second())?;
        let before = self.of.get(&edge).map(|latest| latest.test.clone());
        let rest = before.as_ref().map_or(Duration::ZERO, |before| before.rests_for(now));
        if !rest.is_zero() {
            return Err(FabricError::TestTooSoon { link: link.clone(), rest });
        }
        self.timers.set(edge, test.deadline());
        self.of.insert(edge, Latest { test, before });
        Ok(())
    }

    /// Returns when the next packet is due.
    pub fn deadline(&self) -> Option<Timestamp> {
        self.timers.next().map(|(at, _)| at)
    }

    /// Returns the next packet due by `now`, in a buffer from `buffer`, and the edge that it crosses.
    pub fn poll(&mut self, now: Timestamp, buffer: impl FnOnce(usize) -> Vec<u8>) -> Option<(usize, Frame)> {
        let (_, edge) = self.timers.next().filter(|(at, _)| *at <= now)?;
        let test = &mut self.of.get_mut(&edge)?.test;
        let due = test.poll(now);
        self.timers.set(edge, test.deadline());
        due.then(|| (edge, packet::filler(Self::PACKET_BYTES, buffer(Self::PACKET_BYTES))))
    }

    /// Records a packet that crossed an edge.
    pub fn crossed(&mut self, at: Timestamp, edge: usize) {
        if let Some(latest) = self.of.get_mut(&edge) {
            latest.test.arrived(at);
        }
    }

    /// Returns the result of the last finished test of an edge.
    pub fn tested(&self, now: Timestamp, edge: usize) -> Option<Tested> {
        let Latest { test, before } = self.of.get(&edge)?;
        test.tested(now).or_else(|| before.as_ref()?.tested(now))
    }
}

#[cfg(test)]
mod tests {
    use cotorra_graph::{BitRate, Direction};

    use super::*;
    use crate::Fabric;

    /// A link with these keys of the testbed file.
    fn fabric(keys: &str) -> (Fabric, LinkId) {
        let text = format!(
            "name: lab\nnodes:\n  a: {{ kind: server, tier: edge, cpus: 1, memory: 1 GB }}\n  b: {{ kind: switch }}\n\
             links:\n  - {{ ends: [a, b], {keys} }}\n"
        );
        let testbed = cotorra_testbed_file::parse("lab.yaml", &text, ".".as_ref()).unwrap();
        (Fabric::new(&testbed.graph, 1).unwrap(), "a-b".parse().unwrap())
    }

    fn s(seconds: f64) -> Timestamp {
        Timestamp::ZERO + Duration::from_secs_f64(seconds)
    }

    fn limit(mbps: f64) -> ThroughputTest {
        ThroughputTest { rate_limit: BitRate::from_mbps(mbps), ..ThroughputTest::default() }
    }

    /// Returns the result in the context of the forward direction. The backward one was never tested.
    fn tested(fabric: &mut Fabric, now: Timestamp) -> Option<Tested> {
        let [forward, backward] = &fabric.link_contexts(now)[..] else { panic!("one link") };
        assert_eq!(backward.tested, None);
        forward.tested
    }

    #[test]
    fn a_test_measures_the_rate_of_a_saturated_link() {
        let (mut fabric, link) = fabric("delay: 5 ms, rate: 20 Mbit/s");
        fabric.test_throughput(s(1.0), &link, Direction::Forward, ThroughputTest::default()).unwrap();
        assert_eq!(tested(&mut fabric, s(2.9)), None);
        let result = tested(&mut fabric, s(3.5)).unwrap();
        assert!((result.throughput_bps / 20e6 - 1.0).abs() < 1e-6, "{result:?}");
        assert!((result.offered_bps / 22e6 - 1.0).abs() < 1e-9, "{result:?}");
        assert_eq!(result.age, Duration::from_secs_f64(1.5));
    }

    #[test]
    fn a_rate_limit_bounds_the_offered_and_measured_rate() {
        let (mut fabric, link) = fabric("delay: 5 ms, rate: 20 Mbit/s, loss: 10 %");
        fabric.test_throughput(s(0.0), &link, Direction::Forward, limit(2.0)).unwrap();
        let result = tested(&mut fabric, s(3.0)).unwrap();
        assert!((result.throughput_bps / 1.8e6 - 1.0).abs() < 0.1 && result.offered_bps == 2e6, "{result:?}");
        assert_eq!(fabric.link_contexts(s(3.0))[0].counters, Default::default());
    }

    #[test]
    fn a_driver_that_cannot_keep_up_reports_the_rate_that_it_sent() {
        let link: LinkId = "a-b".parse().unwrap();
        let mut throughput_tests = ThroughputTests::new(1);
        throughput_tests.begin(s(0.0), (0, &link), limit(2.0), &Rate::Unlimited).unwrap();
        let mut due = |at| std::iter::from_fn(|| throughput_tests.poll(at, Vec::with_capacity)).count();
        assert_eq!((due(s(0.5)), due(s(1.0))), (83, 0));
        assert_eq!(throughput_tests.deadline(), None);
        let result = throughput_tests.tested(s(2.0), 0).unwrap();
        assert!((result.offered_bps / 1e6 - 1.0).abs() < 0.01, "{result:?}");
    }

    #[test]
    fn a_link_rests_after_a_test_and_keeps_reporting_the_last() {
        let (mut fabric, link) = fabric("rate: 10 Mbit/s");
        let mut test = |at, test| fabric.test_throughput(at, &link, Direction::Forward, test);
        test(s(0.0), ThroughputTest::default()).unwrap();
        let rest = Duration::from_secs(1);
        let rejected = test(s(4.0), ThroughputTest::default());
        assert_eq!(rejected, Err(FabricError::TestTooSoon { link: link.clone(), rest }));
        test(s(5.0), limit(1.0)).unwrap();
        let result = tested(&mut fabric, s(6.0)).unwrap();
        assert!(result.throughput_bps > 9e6 && result.age == Duration::from_secs(5), "{result:?}");
        assert_eq!(tested(&mut fabric, s(7.0)).unwrap().offered_bps, 1e6);
    }

    #[test]
    fn tests_beyond_the_bounds_are_rejected() {
        let (mut fabric, link) = fabric("rate: 10 Mbit/s");
        let mut test = |link: &LinkId, test| fabric.test_throughput(s(0.0), link, Direction::Forward, test);
        for duration in [Duration::ZERO, Duration::from_secs(11)] {
            let rejected = test(&link, ThroughputTest { duration, rate_limit: None });
            assert_eq!(rejected, Err(FabricError::TestDuration(duration)));
        }
        let fast = BitRate::from_mbps(1_001.0).unwrap();
        assert_eq!(test(&link, limit(1_001.0)), Err(FabricError::TestRate(fast)));
        let other: LinkId = "c-d".parse().unwrap();
        assert_eq!(test(&other, limit(1.0)), Err(FabricError::UnknownLink(other.clone())));
    }
}
