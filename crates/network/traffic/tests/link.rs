//! Sources over one wired link of the fabric, beside closed forms of queues.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{collections::VecDeque, path::Path, time::Duration};

use cotorra_fabric::{Drops, Fabric, Frame, PortId};
use cotorra_graph::{Direction, Testbed, Timestamp};
use cotorra_numbers::{Distribution, Draws};
use cotorra_traffic::{Measured, Sources};

const SEEDS: u64 = 20;
/// Student's t at 99 %, with 19 degrees of freedom.
const STUDENT: f64 = 2.861;
/// Place of the time in a datagram's frame: behind the headers of Ethernet, IPv4 and UDP, and its number.
const SENT: usize = 14 + 20 + 8 + 8;

/// Returns two switches with a link between them. Nobody could send there without a source over the link.
fn testbed(link: &str, traffic: &str) -> Testbed {
    let text = format!(
        "name: link\nprobes: none\nnodes:\n  a: {{ kind: switch }}\n  b: {{ kind: switch }}\n\
         links:\n  - {{ ends: [a, b], {link} }}\ntraffic:\n  cross: {{ on: a-b, {traffic} }}\n"
    );
    cotorra_testbed_file::parse("link.yaml", &text, Path::new("")).unwrap()
}

struct World {
    fabric: Fabric,
    sources: Sources,
    now: Timestamp,
}

impl World {
    fn new(testbed: &Testbed, seed: u64) -> Self {
        let fabric = Fabric::new(&testbed.graph, seed).unwrap();
        let sources = Sources::new(
            &testbed.traffic,
            |source| {
                let over = source.over.as_ref()?;
                let [first, second] = fabric.link_ends(&over.link)?.map(|end| end.0);
                Some(if over.direction == Direction::Forward { [first, second] } else { [second, first] })
            },
            seed,
        );
        Self { fabric, sources, now: Timestamp::ZERO }
    }

    /// Runs until then, and calls `each` with the time and the bytes of each frame that arrives.
    fn run(&mut self, until: Timestamp, mut each: impl FnMut(Timestamp, &[u8])) {
        let Self { fabric, sources, now } = self;
        while *now < until {
            let mut arrived = Vec::new();
            fabric.push_all(*now, |fabric, buffer| {
                let waiting = |from, to| fabric.waiting(PortId(from), PortId(to)) as usize;
                sources.poll(*now, waiting, buffer).map(PortId)
            });
            let deadline = fabric.poll(*now, &mut |port, frame| arrived.push((port, frame)));
            if arrived.is_empty() {
                *now = deadline.into_iter().chain(sources.deadline(*now)).min().unwrap_or(until).max(*now);
            }
            for (port, frame) in arrived {
                each(*now, frame.bytes());
                assert!(sources.handle(*now, port.0, frame.bytes()));
                fabric.recycle(frame);
            }
        }
    }

    fn measured(&self) -> Vec<Measured> {
        assert!(self.fabric.balance().is_even(), "{:?}", self.fabric.balance());
        self.sources.measured(self.now)
    }
}

fn seconds(seconds: f64) -> Timestamp {
    Timestamp::from_secs_f64(seconds)
}

/// Checks that the mean over seeds has its closed form in its interval of 99 %.
fn assert_mean(name: &str, unit: &str, expected: f64, of: impl Fn(u64) -> f64) {
    let values: Vec<f64> = (1..=SEEDS).map(of).collect();
    let mean = values.iter().sum::<f64>() / SEEDS as f64;
    let variance = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / (SEEDS as f64 - 1.0);
    let half = STUDENT * (variance / SEEDS as f64).sqrt();
    println!("{name}: {mean:.4} ± {half:.4} {unit}, closed form {expected:.4}");
    assert!(
        (mean - expected).abs() < half && half < 0.1 * expected,
        "{name}: {mean} ± {half}, not {expected}"
    );
}

/// Returns the mean wait before its transmission of the datagrams of a source over a link of 10 Mbit/s, ms.
fn wait_ms(traffic: &str, seed: u64) -> f64 {
    let testbed = testbed("rate: 10 Mbit/s, delay: 0 ms, queue: 100000 packets", traffic);
    let (mut total, mut count) = (0.0, 0.0);
    World::new(&testbed, seed).run(seconds(100.0), |now, frame| {
        let sent = u64::from_be_bytes(*frame[SENT..].first_chunk().unwrap());
        let took = now.since(Timestamp::from_nanos(sent)).as_secs_f64();
        total += took - frame.len() as f64 * 8.0 / 10e6;
        count += 1.0;
    });
    total / count * 1e3
}

#[test]
fn datagrams_of_a_poisson_source_wait_as_in_md1() {
    for (load, share) in [("60 %", 0.6), ("80 %", 0.8)] {
        // A frame of 1250 bytes takes 1 ms.
        let traffic =
            format!("direction: forward, protocol: udp, load: {load}, size: 1208 B, arrivals: poisson");
        let expected = share / (2.0 * (1.0 - share));
        assert_mean(&format!("M/D/1 at {load}"), "ms", expected, |seed| wait_ms(&traffic, seed));
    }
}

/// Pollaczek and Khinchine: the mean wait is λ E[S²] / 2 (1 - ρ). Sizes are whole bytes from 16 to 1472.
#[test]
fn datagrams_of_random_sizes_wait_as_in_mg1() {
    let sizes = Distribution::exponential(400.0).unwrap();
    let share = |size: u16| {
        let below = |size: u16| if size == 16 { 0.0 } else { sizes.cdf(f64::from(size) - 0.5) };
        if size == 1472 { 1.0 - below(size) } else { below(size + 1) - below(size) }
    };
    let moment = |power: i32| -> f64 {
        let time = |size: u16| (f64::from(size + 42) * 8.0 / 10e6).powi(power);
        (16..=1472).map(|size| share(size) * time(size)).sum()
    };
    let expected = 0.7 / moment(1) * moment(2) / (2.0 * 0.3) * 1e3;
    let traffic =
        "direction: backward, protocol: udp, load: 70 %, size: { exponential: 400 B }, arrivals: poisson";
    assert_mean("M/G/1 at 70 %", "ms", expected, |seed| wait_ms(traffic, seed));
}

/// Frames of exponential sizes, which packets of at most 1500 bytes cannot have, wait ρ / (μ - λ).
#[test]
fn frames_of_exponential_sizes_wait_as_in_mm1() {
    let testbed =
        testbed("rate: 10 Mbit/s, delay: 0 ms, queue: 100000 packets", "protocol: udp, rate: 1 bit/s");
    for load in [0.6, 0.8] {
        // A mean of 2500 bytes takes 2 ms, so that whole bytes and the header of 14 matter little.
        let (sizes, gaps) = (Distribution::exponential(2500.0), Distribution::exponential(0.002 / load));
        let (sizes, gaps) = (sizes.unwrap(), gaps.unwrap());
        let mean_wait = |seed: u64| {
            let mut fabric = Fabric::new(&testbed.graph, seed).unwrap();
            let [first, second] = fabric.link_ends(&"a-b".parse().unwrap()).unwrap();
            let mut draws = Draws::new(seed, "queue");
            let (mut now, mut total, mut count) = (Timestamp::ZERO, 0.0, 0.0);
            let mut sent = VecDeque::new();
            let mut poll = |fabric: &mut Fabric, now: Timestamp, sent: &mut VecDeque<Timestamp>| {
                fabric.poll(now, &mut |port, frame| {
                    assert_eq!(port, second);
                    let took = now.since(sent.pop_front().unwrap()).as_secs_f64();
                    total += took - frame.wire_bytes() as f64 * 8.0 / 10e6;
                    count += 1.0;
                })
            };
            while now < seconds(200.0) {
                let next = now + Duration::from_secs_f64(gaps.sample(&mut draws));
                // All that leaves before the next arrival, when it does.
                let mut deadline = poll(&mut fabric, now, &mut sent);
                while let Some(at) = deadline.filter(|at| *at <= next) {
                    deadline = poll(&mut fabric, at, &mut sent);
                }
                let bytes = sizes.sample(&mut draws).round().max(14.0) as usize;
                sent.push_back(next);
                fabric.push(next, first, Frame::new(vec![0; bytes]));
                now = next;
            }
            assert_eq!(fabric.drops(), Drops::default());
            total / count * 1e3
        };
        assert_mean(&format!("M/M/1 at {:.0} %", load * 100.0), "ms", 2.0 * load / (1.0 - load), mean_wait);
    }
}

/// Connections that come at random share a link much as jobs share a processor, whose mean time for a size x is
/// x / (C (1 - ρ)), whatever the distribution of sizes (Kleinrock, "Queueing Systems", volume 2, 1976, section 4.4). TCP also opens
/// connections, begins slowly and loses packets, so that this is a comparison.
#[test]
fn transfers_are_slower_than_under_processor_sharing_and_large_ones_least() {
    let traffic = "direction: forward, protocol: tcp, transfers: { size: { pareto: { mean: 200 kB, shape: 1.5, most: 20 MB } }, \
                   every: { exponential: 32 ms }, most_open: 1000 }";
    let testbed = testbed("rate: 100 Mbit/s, delay: 1 ms, queue: 500 packets", traffic);
    let mut world = World::new(&testbed, 1);
    world.run(seconds(300.0), |_, _| {});
    let measured = world.measured().remove(0);
    let transfers = measured.tcp.unwrap().transfers.unwrap();
    assert_eq!(transfers.refused_transfers, 0);
    assert!(transfers.all.as_ref().unwrap().arrived_transfers > 9000, "{transfers:?}");
    // Of each frame, 1448 of 1514 bytes are payload.
    let bytes_per_s = 100e6 / 8.0 * 1448.0 / 1514.0;
    let load = 200e3 / 32e-3 / bytes_per_s;
    let ratios: Vec<f64> = transfers
        .by_size
        .iter()
        .map(|class| {
            let shared_ms = class.mean_bytes / bytes_per_s / (1.0 - load) * 1e3;
            let ratio = class.mean_completion_ms / shared_ms;
            println!(
                "up to {:?} bytes: {} transfers of {:.0} B take {:.2} ms, {shared_ms:.2} ms under processor sharing: {ratio:.2}",
                class.up_to_bytes, class.arrived_transfers, class.mean_bytes, class.mean_completion_ms
            );
            ratio
        })
        .collect();
    assert!(ratios.len() >= 3 && ratios.is_sorted_by(|a, b| a >= b), "{ratios:?}");
}

#[test]
fn both_directions_of_a_link_are_loaded_and_its_counters_show_it() {
    let testbed = testbed("rate: 10 Mbit/s, delay: 1 ms", "protocol: udp, load: 60 %, size: 958 B");
    let names: Vec<_> = testbed.traffic.iter().map(|source| source.id.to_string()).collect();
    assert_eq!(names, ["cross-forward", "cross-backward"]);
    let mut world = World::new(&testbed, 1);
    world.run(seconds(10.0), |_, _| {});
    for measured in world.measured() {
        // Of each frame of 1000 bytes, 958 are payload.
        assert!((measured.goodput_bps / (6e6 * 0.958) - 1.0).abs() < 0.001, "{measured:?}");
        assert_eq!(measured.link.unwrap().as_str(), "a-b");
    }
    for context in world.fabric.link_contexts(seconds(10.0)) {
        assert!((context.throughput_bps / 6e6 - 1.0).abs() < 0.02, "{context:?}");
        assert_eq!(context.counters.overflowed, 0);
    }
}

#[test]
fn transfers_after_a_pause_come_one_at_a_time() {
    let traffic =
        "direction: forward, protocol: tcp, transfers: { size: 100 kB, think: 100 ms }, stop: 9.95 s";
    let testbed = testbed("rate: 10 Mbit/s, delay: 5 ms", traffic);
    let mut world = World::new(&testbed, 1);
    world.run(seconds(20.0), |_, _| {});
    let measured = world.measured().remove(0);
    let transfers = measured.tcp.unwrap().transfers.unwrap();
    let all = transfers.all.unwrap();
    // Each opens a connection, of two ways of 5 ms, and sends for at least 84 ms.
    let took = all.completion_ms;
    assert!((98.0..110.0).contains(&took.p50) && took.max - took.p50 < 1.0, "{took:?}");
    // The first begins after a pause, too.
    let expected = ((9.95 - 0.1) / (0.1 + all.mean_completion_ms * 1e-3)).ceil();
    assert_eq!((all.arrived_transfers as f64, transfers.open_transfers), (expected, 0), "{all:?}");
    assert_eq!(measured.bytes, all.arrived_transfers * 100_000);
}

#[test]
fn transfers_beyond_the_most_open_ones_are_refused() {
    let traffic =
        "direction: forward, protocol: tcp, transfers: { size: 10 MB, every: 100 ms, most_open: 3 }";
    let testbed = testbed("rate: 10 Mbit/s, delay: 5 ms", traffic);
    let mut world = World::new(&testbed, 1);
    world.run(seconds(5.05), |_, _| {});
    let transfers = world.measured().remove(0).tcp.unwrap().transfers.unwrap();
    assert_eq!((transfers.all, transfers.open_transfers, transfers.refused_transfers), (None, 3, 47));
}
