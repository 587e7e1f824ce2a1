//! Sources over a path with a bottleneck, in virtual time.

use std::{
    cmp::Reverse,
    collections::{BTreeMap, BinaryHeap},
    time::Duration,
};

use cotorra_graph::{Arrivals, BitRate, CongestionControl, DatagramSize, Sends, UdpRate};
use proptest::prelude::*;

use super::*;

const MS: Duration = Duration::from_millis(1);

/// A path with a bottleneck forth, and none back.
#[derive(Debug, Clone)]
struct Path {
    rate: Option<BitRate>,
    /// Delay of each direction.
    delay: Duration,
    /// Longest wait in the queue of the bottleneck.
    queue: Duration,
    /// Share of packets that are lost, both ways.
    loss: f64,
    /// Most additional delay, without keeping order, both ways.
    disorder: Duration,
}

impl Path {
    fn new(mbps: f64, delay: Duration, queue: Duration) -> Self {
        Self { rate: BitRate::from_mbps(mbps), delay, queue, loss: 0.0, disorder: Duration::ZERO }
    }
}

struct World {
    path: Path,
    sources: Sources,
    now: Timestamp,
    /// When the bottleneck is free.
    free: Timestamp,
    flying: BinaryHeap<Reverse<(Timestamp, u64)>>,
    frames: BTreeMap<u64, (usize, Vec<u8>)>,
    number: u64,
    draws: Draws,
    /// Waits in the queue, ms, with their times.
    waits: Vec<(Timestamp, f64)>,
}

fn id<T: std::str::FromStr<Err: std::fmt::Debug>>(name: &str) -> T {
    name.parse().unwrap()
}

fn source(name: &str, load: Load) -> TrafficSource {
    let (from, to, start) = (id("robot"), id("edge"), Duration::ZERO);
    TrafficSource { id: id(name), from, to, over: None, start, stop: None, load }
}

fn tcp(congestion_control: CongestionControl, bytes: Option<u64>) -> TrafficSource {
    source("bulk", Load::Tcp { congestion_control, sends: Sends::Stream(bytes) })
}

impl World {
    fn new(path: Path, sources: &[TrafficSource]) -> Self {
        Self {
            path,
            sources: Sources::new(sources, |_| Some([0, 1]), 1),
            now: Timestamp::ZERO,
            free: Timestamp::ZERO,
            flying: BinaryHeap::new(),
            frames: BTreeMap::new(),
            number: 0,
            draws: Draws::new(1, "channel"),
            waits: Vec::new(),
        }
    }

    fn run(&mut self, until: Timestamp) {
        loop {
            let mut frame = Vec::new();
            while let Some(host) = self.sources.poll(self.now, |_, _| 0, &mut frame) {
                self.carry(host, std::mem::take(&mut frame));
            }
            let arrival = self.flying.peek().map(|Reverse((at, _))| *at);
            let Some(next) = self.sources.deadline(self.now).into_iter().chain(arrival).min() else { return };
            if next > until {
                self.now = until;
                return;
            }
            self.now = self.now.max(next);
            while let Some(Reverse((at, number))) = self.flying.peek().copied()
                && at <= self.now
            {
                self.flying.pop();
                let (host, frame) = self.frames.remove(&number).unwrap();
                assert!(self.sources.handle(self.now, host, &frame));
            }
        }
    }

    fn carry(&mut self, from: usize, frame: Vec<u8>) {
        if self.path.loss > 0.0 && self.draws.unit() < self.path.loss {
            return;
        }
        let mut at = self.now;
        if let Some(rate) = self.path.rate.filter(|_| from == 0) {
            let wait = self.free.since(self.now);
            if wait > self.path.queue {
                return;
            }
            self.waits.push((self.now, wait.as_secs_f64() * 1e3));
            self.free = self.free.max(self.now) + rate.serialisation(frame.len());
            at = self.free;
        }
        let later = self.path.disorder.mul_f64(self.draws.unit());
        self.flying.push(Reverse((at + self.path.delay + later, self.number)));
        self.frames.insert(self.number, (1 - from, frame));
        self.number += 1;
    }

    fn measured(&self) -> Measured {
        self.sources.measured(self.now).remove(0)
    }

    /// Returns the median wait after a time, ms.
    fn wait_after(&self, at: Timestamp) -> f64 {
        let waits = self.waits.iter().filter(|(time, _)| *time >= at).map(|(_, wait)| *wait).collect();
        Quantiles::of(waits).unwrap().p50
    }
}

fn seconds(seconds: f64) -> Timestamp {
    Timestamp::from_secs_f64(seconds)
}

const ALL: [CongestionControl; 3] =
    [CongestionControl::Reno, CongestionControl::Cubic, CongestionControl::Bbr];

#[test]
fn every_congestion_control_fills_a_bottleneck_with_a_queue_of_one_bdp() {
    for control in ALL {
        let mut world = World::new(Path::new(20.0, 20 * MS, 40 * MS), &[tcp(control, None)]);
        world.run(seconds(30.0));
        let measured = world.measured();
        // 1448 of 1514 bytes of each frame are payload.
        let most = 20.0 * 1448.0 / 1514.0;
        assert!(
            (measured.goodput_bps / 1e6) > 0.9 * most && (measured.goodput_bps / 1e6) <= most,
            "{control:?}: {measured:?}"
        );
        let tcp = measured.tcp.unwrap();
        assert_eq!(tcp.timeouts, 0, "{control:?}: {tcp:?}");
    }
}

#[test]
fn bbr_leaves_a_deep_queue_nearly_empty_and_cubic_fills_it() {
    let wait = |control| {
        let mut world = World::new(Path::new(10.0, 20 * MS, 1000 * MS), &[tcp(control, None)]);
        world.run(seconds(60.0));
        assert!((world.measured().goodput_bps / 1e6) > 0.9 * 10.0 * 1448.0 / 1514.0, "{control:?}");
        world.wait_after(seconds(20.0))
    };
    let (bbr, cubic) = (wait(CongestionControl::Bbr), wait(CongestionControl::Cubic));
    // One BDP is a wait of 40 ms.
    assert!(bbr < 40.0, "{bbr}");
    assert!(cubic > 600.0, "{cubic}");
}

/// Mathis, Semke, Mahdavi and Ott, The Macroscopic Behavior of the TCP Congestion Avoidance Algorithm (1997): with independent
/// loss and an acknowledgement for every other segment, the rate is MSS / RTT · √(3 / (2 · 2 · p)) or a little less. They
/// measured within 0.8 to 1.3 of their model with SACK. Our windows grow by the bytes acknowledged, so that b is 1.
#[test]
fn reno_under_random_loss_has_the_throughput_of_mathis() {
    for loss in [0.001, 0.004] {
        let path = Path { loss, ..Path::new(1000.0, 25 * MS, 100 * MS) };
        let mut world = World::new(path, &[tcp(CongestionControl::Reno, None)]);
        world.run(seconds(400.0));
        let mathis = 1448.0 * 8e-6 / 0.05 * (1.5 / loss).sqrt();
        let share = (world.measured().goodput_bps / 1e6) / mathis;
        assert!((0.8..1.3).contains(&share), "{loss}: {share}");
    }
}

#[test]
fn a_connection_ends_when_all_its_bytes_are_acknowledged() {
    for control in ALL {
        let mut world = World::new(Path::new(8.0, 10 * MS, 50 * MS), &[tcp(control, Some(1_000_000))]);
        world.run(seconds(60.0));
        let measured = world.measured();
        assert_eq!(measured.bytes, 1_000_000, "{control:?}");
        let after = measured.tcp.unwrap().finished_after_ms.unwrap();
        assert!((1040.0..1600.0).contains(&after), "{control:?}: {after}");
        assert!(world.sources.deadline(world.now).is_none(), "nothing is left to do");
    }
}

#[test]
fn a_connection_survives_that_its_path_is_away() {
    for control in ALL {
        let mut world = World::new(Path::new(8.0, 10 * MS, 50 * MS), &[tcp(control, None)]);
        world.run(seconds(5.0));
        world.path.loss = 1.0;
        world.run(seconds(8.0));
        world.path.loss = 0.0;
        world.run(seconds(30.0));
        let measured = world.measured();
        assert!(measured.tcp.as_ref().unwrap().timeouts >= 2);
        let after = measured.goodput_by_second_bps[20..29].iter().sum::<u64>() as f64 / 9e6;
        assert!(after > 6.5, "{control:?}: {after} {measured:?}");
    }
}

#[test]
fn datagrams_beyond_the_rate_of_the_bottleneck_are_lost() {
    let rate = UdpRate::Rate(BitRate::from_mbps(20.0).unwrap());
    let load = Load::Udp { rate, size: DatagramSize::Constant(1472), arrivals: Arrivals::Constant };
    let mut spec = source("video", load);
    (spec.start, spec.stop) = (Duration::from_secs(1), Some(Duration::from_secs(11)));
    let mut world = World::new(Path::new(10.0, 20 * MS, 50 * MS), &[spec]);
    world.run(seconds(20.0));
    let measured = world.measured();
    let udp = measured.udp.as_ref().unwrap();
    assert_eq!(measured.sent_packets, (20e6 * 10.0 / 8.0 / 1472.0f64).ceil() as u64);
    assert_eq!(udp.received_packets + udp.lost, measured.sent_packets);
    assert!(((measured.goodput_bps / 1e6) - 10.0 * 1472.0 / 1514.0).abs() < 0.1, "{measured:?}");
    let delay = udp.delay_ms.unwrap();
    assert!((70.0..73.0).contains(&delay.p50), "{delay:?}");
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, ..ProptestConfig::default() })]

    /// The receiver counts bytes in order only, each once.
    #[test]
    fn all_bytes_arrive_once_and_in_order(
        control in prop::sample::select(&ALL[..]),
        bytes in 1u64..400_000,
        loss in 0.0..0.3,
        disorder in 0u32..30,
        seed in any::<u64>(),
    ) {
        let path = Path { loss, disorder: MS * disorder, ..Path::new(10.0, 5 * MS, 30 * MS) };
        let mut world = World::new(path, &[tcp(control, Some(bytes))]);
        world.draws = Draws::new(seed, "channel");
        world.run(seconds(100_000.0));
        let measured = world.measured();
        prop_assert_eq!(measured.bytes, bytes);
        prop_assert!(measured.tcp.unwrap().finished_after_ms.is_some());
    }

    /// Neither end panics, whatever the other sends, and what it never sent is not taken for acknowledged.
    #[test]
    fn no_segment_makes_an_end_panic(
        segments in prop::collection::vec((any::<bool>(), any::<bool>(), 0u32..20_000, any::<Option<u16>>(),
            prop::collection::vec((0u32..20_000, 0u32..20_000), 0..4), 0usize..1449), 0..60),
        control in prop::sample::select(&ALL[..]),
    ) {
        let mut sources = Sources::new(&[tcp(control, None)], |_| Some([0, 1]), 1);
        let (forth, mut frame) = (sources.flows[0].ends, Vec::new());
        let mut now = Timestamp::ZERO;
        for (is_forth, syn, sequence, ack, sacked, payload) in segments {
            while sources.poll(now, |_, _| 0, &mut frame).is_some() {}
            let sacked = if syn { Vec::new() } else { sacked };
            let segment = segment::Segment { syn, sequence, ack: ack.map(u32::from), sacked, payload, times: (0, 0) };
            let ends = if is_forth { forth } else { forth.reversed() };
            segment.write(ends, &mut frame);
            sources.handle(now, ends.to.0, &frame);
            now = now + 7 * MS;
        }
    }
}
