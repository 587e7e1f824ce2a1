//! The scenes: small testbeds, and what is known about them without running them.

use std::{iter, path::Path};

use cotorra_graph::{Direction, LinkContext};
use cotorra_numbers::median;

use super::{
    check::Check,
    observed::{Observed, Sample, World},
    scene::{Dies, Room, Scene},
};

/// Time of a small frame over the air, one way, ms. It holds the frame's airtime.
const AIR_MS: f64 = 1.0;
/// Time over the wires of a room, one way, ms.
const WIRE_MS: f64 = 5.0;
/// Time of a round trip in a room without anything else, ms.
const ROUND_TRIP_MS: f64 = 2.0 * (AIR_MS + WIRE_MS);

/// All scenes. Programs in them are this one, which is at this path.
pub fn scenes(program: &Path) -> Vec<Scene> {
    vec![
        Scene {
            name: "round-trip",
            promise: "a service time is the sum of the delays on its way",
            testbed: Room::new("delay: 5 ms").text(),
            check: |run| {
                let least = run.answered().into_iter().reduce(f64::min);
                vec![
                    Check::time("median, ms", run, ROUND_TRIP_MS, run.median(0.0..f64::MAX)),
                    Check::time("least, ms", run, ROUND_TRIP_MS, least),
                    Check::exact("without an answer", 0.0, Some(run.unanswered() as f64)),
                ]
            },
            ..Scene::DEFAULT
        },
        Scene {
            name: "two-hosts",
            promise: "probes measure the delay of each direction of a link",
            testbed: hosts("delay: 3 ms, backward: { delay: 9 ms }"),
            check: |run| {
                let delay = |direction| probed_ms(run, "left-right", direction);
                vec![
                    Check::time("forward, ms", run, 3.0, delay(Direction::Forward)),
                    Check::time("backward, ms", run, 9.0, delay(Direction::Backward)),
                ]
            },
            ..Scene::DEFAULT
        },
        Scene {
            name: "serialisation",
            promise: "a packet of 86 bytes takes 6.88 ms at 100 kbit/s, on top of the delay",
            testbed: hosts("delay: 3 ms, rate: 100 kbit/s"),
            check: |run| {
                let delay = probed_ms(run, "left-right", Direction::Forward);
                vec![Check::time("delay, ms", run, 3.0 + 86.0 * 8.0 / 100.0, delay)]
            },
            ..Scene::DEFAULT
        },
        Scene {
            name: "scales",
            promise: "ψ multiplies a delay",
            testbed: Room::new("delay: 5 ms, delay_scale: 3").text(),
            check: |run| {
                let expected = 2.0 * (AIR_MS + 3.0 * WIRE_MS);
                vec![Check::time("median, ms", run, expected, run.median(0.0..f64::MAX))]
            },
            ..Scene::DEFAULT
        },
        Scene {
            name: "schedule",
            promise: "a condition changes at its time, in place",
            testbed: Room::new("delay: 5 ms")
                .with("schedule:\n  - { at: 4 s, links: lan-edge, set: { delay: 20 ms } }\n")
                .text(),
            check: |run| {
                let after = 2.0 * (AIR_MS + 20.0);
                vec![
                    Check::time("median before, ms", run, ROUND_TRIP_MS, run.median(0.0..3900.0)),
                    Check::time("median after, ms", run, after, run.median(4100.0..f64::MAX)),
                ]
            },
            ..Scene::DEFAULT
        },
        Scene {
            name: "uniform-jitter",
            promise: "uniform jitter is uniform",
            testbed: Room::new(
                "forward: { delay: 8 ms, jitter: { deviation: 6 ms, distribution: uniform } }",
            )
            .text(),
            check: |run| {
                let distance = |ms: f64| ((ms - 2.0 * AIR_MS - 2.0) / 12.0).clamp(0.0, 1.0);
                let late = World::Real.tolerance_ms().1 / 12.0;
                vec![Check::distribution("distance", run.world, late, run.answered(), distance)]
            },
            ..Scene::DEFAULT
        },
        Scene {
            name: "normal-jitter",
            promise: "normal jitter has the mean and the deviation of the file",
            testbed: Room::new("forward: { delay: 10 ms, jitter: 2 ms }").text(),
            check: |run| {
                let (times, late) = (run.answered(), late(run));
                let (mean, deviation) = (2.0 * AIR_MS + 10.0, 2.0);
                let squares: Vec<_> = times.iter().map(|ms| (ms - average(&times)).powi(2)).collect();
                // The variance of a squared normal deviate is 2 σ⁴.
                let of_squares = (deviation * deviation, 2_f64.sqrt() * deviation * deviation);
                vec![
                    Check::mean("mean, ms", (mean, deviation), times.len() as f64, late, &times),
                    Check::mean("variance, ms²", of_squares, times.len() as f64, late, &squares),
                ]
            },
            ..Scene::DEFAULT
        },
        Scene {
            name: "loss",
            promise: "a sample is unanswered if a packet is lost on either way",
            testbed: Room::new("delay: 5 ms, loss: 10 %").text(),
            check: |run| {
                let lost = 1.0 - 0.9 * 0.9;
                vec![Check::share("without an answer, %", lost, 0.0, run.samples.len(), run.unanswered())]
            },
            ..Scene::DEFAULT
        },
        Scene {
            name: "bursts",
            promise: "losses in bursts have the rate and the mean length of the file",
            testbed: Room::new("delay: 5 ms, forward: { loss: { rate: 20 %, mean_burst: 3 } }").text(),
            check: |run| {
                // The states of Gilbert's model are correlated by 1 - 1/3 - 1/12 from one packet to the next.
                let correlation = 1.0 - 1.0 / 3.0 - 1.0 / 12.0;
                let bursts = bursts(&run.samples);
                // Lengths are geometric, with the standard deviation √(1 - p) / p.
                let length = (3.0, 6_f64.sqrt());
                vec![
                    Check::share("lost, %", 0.2, correlation, run.samples.len(), run.unanswered()),
                    Check::mean("mean burst", length, bursts.len() as f64, 0.0, &bursts),
                ]
            },
            ..Scene::DEFAULT
        },
        Scene {
            name: "corruption",
            promise: "a receiver rejects a packet with a flipped bit",
            testbed: Room::new("delay: 5 ms, corruption: 20 %").text(),
            check: |run| {
                // Only the sender's Ethernet address is in no checksum: 6 bytes of a frame. Hosts and switches do not look at it.
                let bytes = |direction| frame(run, "lan-edge", direction).unwrap_or(f64::NAN);
                let arrives = |direction| 1.0 - 0.2 * (1.0 - 6.0 / bytes(direction));
                let lost = 1.0 - arrives(Direction::Forward) * arrives(Direction::Backward);
                vec![Check::share("without an answer, %", lost, 0.0, run.samples.len(), run.unanswered())]
            },
            ..Scene::DEFAULT
        },
        Scene {
            name: "duplication",
            promise: "a packet that arrives twice is answered once",
            testbed: Room::new("delay: 5 ms, duplication: 50 %").text(),
            check: |run| {
                let twice = counted(run, "lan-edge", Direction::Forward)
                    .map(|counters| counters.duplicated as usize)
                    .unwrap_or_default();
                vec![
                    Check::share("sent twice, %", 0.5, 0.0, run.samples.len(), twice),
                    Check::time("median, ms", run, ROUND_TRIP_MS, run.median(0.0..f64::MAX)),
                    Check::exact("without an answer", 0.0, Some(run.unanswered() as f64)),
                ]
            },
            ..Scene::DEFAULT
        },
        Scene {
            name: "queue",
            promise: "packets wait in front of a link with a rate as Lindley's recursion says",
            testbed: queue(),
            check: |run| {
                let waits = waits(run);
                let wrong = waits.iter().map(|(measured, expected)| (measured - expected).abs()).collect();
                vec![Check::time("off by a median of, ms", run, 0.0, median(wrong))]
            },
            ..Scene::DEFAULT
        },
        Scene {
            name: "m-d-1",
            promise: "the mean wait is that of the queue Geo/D/1, which is M/D/1 in short slots",
            testbed: queue(),
            seconds: 10,
            // The mean needs many packets.
            virtual_seconds: Some(400),
            check: |run| {
                let (p, slots) = (KEPT, service_ms(run).unwrap_or(f64::NAN) / SLOT_MS);
                let load = p * slots;
                // The lattice of arrivals makes d (d - 1) of d², for a service of whole slots.
                let mean = SLOT_MS * load * (slots - 1.0) / (2.0 * (1.0 - load));
                let measured: Vec<_> = waits(run).iter().map(|(measured, _)| *measured).collect();
                // Waits of one busy period hang together: its mean length is 1 / (1 - load), and so is that of its memory,
                // squared.
                let independent = measured.len() as f64 * (1.0 - load).powi(2) / 2.0;
                let deviation = deviation(&measured).max(mean);
                vec![Check::mean("mean wait, ms", (mean, deviation), independent, late(run), &measured)]
            },
            ..Scene::DEFAULT
        },
        Scene {
            name: "trace",
            promise: "a packet waits for the next opportunity of a trace",
            testbed: Room::new("delay: 5 ms, forward: { trace: every-20-ms.trace }").every("20.37 ms").text(),
            files: &[("every-20-ms.trace", "20\n")],
            check: |run| {
                let (early, late) = (ROUND_TRIP_MS, World::Real.tolerance_ms().1 / 20.0);
                let distance = |ms: f64| ((ms - early) / 20.0).clamp(0.0, 1.0);
                vec![Check::distribution("distance", run.world, late, run.answered(), distance)]
            },
            ..Scene::DEFAULT
        },
        Scene {
            name: "handover",
            promise: "a gap with fast transition is a scan, authentication and reassociation",
            testbed: two_units("fast_transition: true"),
            check: |run| {
                let gap = run.report.handovers.first().map(|handover| handover.gap_ms);
                vec![
                    Check::exact("handovers", 1.0, Some(run.report.handovers.len() as f64)),
                    Check::time("gap, ms", run, 100.0 + 15.0 + 20.0, gap),
                ]
            },
            seconds: 12,
            virtual_seconds: Some(12),
            ..Scene::DEFAULT
        },
        Scene {
            name: "handover-without-ft",
            promise: "without fast transition, the gap holds the handshakes, too",
            testbed: two_units("fast_transition: false"),
            check: |run| {
                let gap = run.report.handovers.first().map(|handover| handover.gap_ms);
                vec![
                    Check::exact("handovers", 1.0, Some(run.report.handovers.len() as f64)),
                    Check::time("gap, ms", run, 100.0 + 15.0 + 20.0 + 60.0, gap),
                ]
            },
            seconds: 12,
            virtual_seconds: Some(12),
            ..Scene::DEFAULT
        },
        Scene {
            name: "replicas",
            promise: "a packet to two instances is unanswered if both ways lose it",
            testbed: replicas(),
            check: |run| {
                let lost = 0.3 * 0.3;
                vec![Check::share("without an answer, %", lost, 0.0, run.samples.len(), run.unanswered())]
            },
            ..Scene::DEFAULT
        },
        Scene {
            name: "mesh",
            promise: "each of 64 hosts has an answer from each other one",
            testbed: mesh(program),
            seconds: 16,
            virtual_seconds: None,
            dies: Dies::EitherWay,
            check: |run| {
                let answered = |host| {
                    let log = run.log(&format!("peer-{host}")).unwrap_or_default();
                    log.lines().next_back().and_then(|last| last.parse::<usize>().ok()).unwrap_or_default()
                };
                let pairs: usize = mesh_hosts().iter().map(answered).sum();
                vec![Check::exact("pairs", (MESH * (MESH - 1)) as f64, Some(pairs as f64))]
            },
            ..Scene::DEFAULT
        },
        Scene {
            name: "dead-plug-in",
            promise: "a run whose plug-in ended is void",
            testbed: Room::new("delay: 5 ms")
                .with("plugins:\n  - { id: dead, command: [\"false\"] }\n")
                .text(),
            check: |run| vec![Check::exact("exit status", 3.0, run.status())],
            dies: Dies::Void,
            ..Scene::DEFAULT
        },
        Scene {
            name: "missed-kpi",
            promise: "a run that keeps less than the file demands fails",
            testbed: Room::new("delay: 30 ms").kept("99 %").text(),
            check: |run| vec![Check::exact("exit status", 4.0, run.status())],
            dies: Dies::Missed,
            ..Scene::DEFAULT
        },
        Scene {
            name: "stopped",
            promise: "a run whose emulation stood still for two seconds is void",
            testbed: Room::new("delay: 5 ms").text(),
            virtual_seconds: None,
            check: |run| vec![Check::exact("exit status", 3.0, run.status())],
            dies: Dies::Stopped,
            ..Scene::DEFAULT
        },
    ]
}

/// By how much a mean may be too high, ms.
fn late(run: &Observed) -> f64 {
    match run.world {
        World::Virtual => 0.0,
        World::Real => run.world.tolerance_ms().1,
    }
}

fn average(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

fn deviation(values: &[f64]) -> f64 {
    let mean = average(values);
    (values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / values.len().max(1) as f64).sqrt()
}

/// Two servers with one link.
fn hosts(link: &str) -> String {
    format!(
        "name: selftest
nodes:
  left: {{ kind: server, tier: edge, cpus: 1, memory: 1 GB }}
  right: {{ kind: server, tier: edge, cpus: 1, memory: 1 GB }}
links:
  - {{ ends: [left, right], {link} }}
probes: {{ interval: 100 ms }}
"
    )
}

/// A robot that drives from one radio unit to another. At equal power, the second is stronger by the hysteresis of 4 dB where its
/// distance is 10^(-4/30) of the other's.
fn two_units(fast: &str) -> String {
    Room::new("delay: 5 ms")
        .wireless(&format!(
            "{fast}, handover: {{ scan: 100 ms, authenticate: 15 ms, reassociate: 20 ms, handshake: 60 ms, variation: 0 % }}"
        ))
        .unit("other: { kind: radio_unit, position: [6, 0], channel: 6 }", "other")
        .roaming("signal")
        .speed("0.6 m/s")
        .text()
}

/// A service with two instances, each behind a link that loses 30 % of the packets to it.
fn replicas() -> String {
    Room::new("delay: 5 ms, forward: { loss: 30 % }")
        .node("fog: { kind: server, tier: fog, cpus: 1, memory: 1 GB }")
        .link("{ ends: [lan, fog], delay: 5 ms, forward: { loss: 30 % } }")
        .requests_to_all("[edge, fog]")
        .text()
}

/// Number of hosts that talk to each other. They have 4,032 neighbours together: four times as many as the kernel's table has room
/// for by default.
const MESH: usize = 64;

/// Returns the names of the hosts of [`mesh`].
fn mesh_hosts() -> Vec<String> {
    (1..MESH).map(|server| format!("s{server}")).chain(["robot".to_owned()]).collect()
}

/// Hosts at one switch, of which one is a robot, and which all run [`peer`](super::peer).
fn mesh(program: &Path) -> String {
    let hosts = mesh_hosts();
    let servers = &hosts[..MESH - 1];
    let program = program.to_string_lossy();
    let lines = |line: &dyn Fn(&String) -> String| servers.iter().map(line).collect::<String>();
    let nodes =
        lines(&|server| format!("  {server}: {{ kind: server, tier: edge, cpus: 1, memory: 1 GB }}\n"));
    let links = lines(&|server| format!("  - {{ ends: [lan, {server}], delay: 1 ms }}\n"));
    let vnf = |host: &String, place: &str| {
        let words = ["selftest", "--peer", host].into_iter().chain(hosts.iter().map(String::as_str));
        let command: Vec<_> = iter::once(&*program).chain(words).collect();
        let command = serde_json::to_string(&command).expect("words are valid JSON");
        format!("      peer-{host}: {{ command: {command}, {place}: {host}, cpus: 0 }}\n")
    };
    let vnfs = lines(&|server| vnf(server, "node")) + &vnf(&hosts[MESH - 1], "pinned_to");
    let port = super::peer::PORT;
    format!(
        "name: selftest
wireless:
  lab: {{ delay: 1 ms, shadowing: {{ deviation: 0 dB, correlation: 5 m }} }}
nodes:
  robot: {{ kind: robot, position: [1, 0] }}
  unit: {{ kind: radio_unit, position: [0, 0], channel: 1 }}
  lan: {{ kind: switch }}
{nodes}links:
  - {{ ends: [unit, lan] }}
{links}services:
  mesh:
    robot: robot
    kpis: {{ service_time: 100 ms, flow: {{ protocol: udp, port: {port}, id: {{ offset: 0, length: 4 }} }} }}
    vnfs:
{vnfs}probes: none
"
    )
}

/// Interval of the position packets in front of the queue, ms.
const SLOT_MS: f64 = 5.0;
/// Share of them that comes to the queue.
const KEPT: f64 = 0.1;
/// Rate of the queue's link, kbit/s.
const RATE_KBPS: f64 = 40.0;

/// A queue in front of a link with a rate, to which packets come at random: a link before it loses nine in ten.
fn queue() -> String {
    Room::new(&format!("delay: 5 ms, forward: {{ rate: {RATE_KBPS} kbit/s }}"))
        .access("forward: { loss: 90 % }")
        .every(&format!("{SLOT_MS} ms"))
        .with("probes: none\n")
        .text()
}

/// Returns the time that a packet takes at the queue's rate, ms.
fn service_ms(run: &Observed) -> Option<f64> {
    Some(frame(run, "lan-edge", Direction::Forward)? * 8.0 / RATE_KBPS)
}

/// Returns how long each answered packet waited in the queue, and how long it had to wait (Lindley, 1952), ms.
fn waits(run: &Observed) -> Vec<(f64, f64)> {
    let Some(service) = service_ms(run) else { return Vec::new() };
    let mut free_at = f64::MIN;
    let answered = run.samples.iter().filter_map(|sample| Some((sample.emitted_ms, sample.took_ms?)));
    let wait = |(emitted, took): (f64, f64)| {
        let expected = (free_at - emitted).max(0.0);
        free_at = emitted + expected + service;
        (took - ROUND_TRIP_MS - service, expected)
    };
    answered.map(wait).collect()
}

/// Returns the lengths of the runs of samples without an answer.
fn bursts(samples: &[Sample]) -> Vec<f64> {
    let runs = samples.chunk_by(|a, b| a.took_ms.is_none() == b.took_ms.is_none());
    runs.filter(|run| run[0].took_ms.is_none()).map(|run| run.len() as f64).collect()
}

/// Returns the last context of a direction of a link.
fn last<'a>(run: &'a Observed, link: &str, direction: Direction) -> Option<&'a LinkContext> {
    run.links.iter().rfind(|context| context.link.as_str() == link && context.direction == direction)
}

fn counted(run: &Observed, link: &str, direction: Direction) -> Option<cotorra_graph::LinkCounters> {
    last(run, link, direction).map(|context| context.counters)
}

/// Returns the mean size of the frames that crossed a link, bytes.
fn frame(run: &Observed, link: &str, direction: Direction) -> Option<f64> {
    let counters = counted(run, link, direction).filter(|counters| counters.packets > 0)?;
    Some(counters.bytes as f64 / counters.packets as f64)
}

/// Returns the delay by probes, ms.
fn probed_ms(run: &Observed, link: &str, direction: Direction) -> Option<f64> {
    let delay = last(run, link, direction)?.probed.as_ref()?.delay?;
    Some(delay.as_secs_f64() * 1e3)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn each_scene_is_a_testbed_with_a_name_of_its_own() {
        let scenes = scenes(Path::new("/bin/cotorra"));
        let names: BTreeSet<_> = scenes.iter().map(|scene| scene.name).collect();
        assert_eq!((names.len(), scenes.len()), (21, 21));
        for scene in &scenes {
            let folder = tempfile::tempdir().unwrap();
            let file = scene.write(folder.path()).unwrap();
            if let Err(mistakes) = cotorra_testbed_file::load(&file) {
                panic!("{}: {mistakes:?}\n{}", scene.name, scene.testbed);
            }
        }
    }

    #[test]
    fn bursts_are_runs_of_samples_without_an_answer() {
        let lengths = |answered: &[bool]| {
            let sample = |is: &bool| Sample { emitted_ms: 0.0, took_ms: is.then_some(1.0) };
            bursts(&answered.iter().map(sample).collect::<Vec<_>>())
        };
        assert_eq!(lengths(&[true, false, false, true, false]), [2.0, 1.0]);
        assert!(lengths(&[true]).is_empty());
    }
}
