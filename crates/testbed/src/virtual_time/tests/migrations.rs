//! VNFs that move with their state: it crosses the network, and nobody serves for a while.

use std::path::Path;

use cotorra_graph::{Nodes, ServiceTime};

use crate::{
    MigrationSummary, Summary,
    report::{Losses, Report},
    virtual_time::*,
};

/// Time of the first order to move.
const ORDER: Duration = Duration::from_secs(5);
/// Bytes of data that a link of 100 Mbit/s carries in a second: 1448 of a frame of 1514.
const GOODPUT: f64 = 12.5e6 * 1448.0 / 1514.0;

/// A robot that stands, whose navigation is on `s` with this state. `s` and `t` have a link of 100 Mbit/s between them.
fn testbed(state: &str, more: &str) -> Testbed {
    let text = format!(
        "name: moves
currency: EUR
wireless: {{ lab: {{ access: turns, delay: 1 ms }} }}
nodes:
  r: {{ kind: robot }}
  R1: {{ kind: radio_unit, position: [2, 2], channel: 1 }}
  s: {{ kind: server, tier: edge, cpus: 1, memory: 8 GB }}
  t: {{ kind: server, tier: edge, cpus: 1, memory: 8 GB }}
  u: {{ kind: server, tier: edge, cpus: 1, memory: 8 GB }}
links:
  - {{ ends: [R1, [s, t, u]], delay: 5 ms }}
  - {{ ends: [s, t], delay: 1 ms, rate: 100 Mbit/s, cost: 1 }}
  - {{ ends: [s, u], delay: 1 ms, rate: 100 Mbit/s }}
walks:
  r: {{ waypoints: [[0, 0], [40, 0]], position_interval: 50 ms }}
services:
  navigation:
    robot: r
    kpis: {{ service_time: 100 ms }}
    vnfs:
      driver: {{ program: robot_driver, pinned_to: r, cpus: 0 }}
      brain: {{ program: navigation, node: s, cpus: 0.5, {state} }}
{more}"
    );
    cotorra_testbed_file::parse("moves.yaml", &text, Path::new("")).unwrap_or_else(|wrong| panic!("{wrong}"))
}

/// What is done to a run at a time.
type Act = fn(&mut Simulation);

struct Ran {
    summary: Summary,
    samples: Vec<ServiceTime>,
    placed: Vec<(Timestamp, NodeId)>,
}

/// Runs for so many seconds, with these acts at their times.
fn run(testbed: Testbed, seconds: u64, acts: &[(Duration, Act)]) -> Ran {
    let mut report = Report::new(&testbed, 1).in_virtual_time(&testbed);
    let mut simulation = Simulation::new(Arc::new(testbed), 1).unwrap();
    let (mut acts, mut events) = (acts.iter().peekable(), Vec::new());
    let end = Timestamp::ZERO + Duration::from_secs(seconds);
    while simulation.now() < end {
        let next = acts.peek().map_or(end, |(at, _)| Timestamp::ZERO + *at);
        simulation.set_alarm(Some(next));
        simulation.step();
        while let Some((_, act)) = acts.next_if(|(at, _)| simulation.now() >= Timestamp::ZERO + *at) {
            act(&mut simulation);
        }
        events.extend(std::iter::from_fn(|| simulation.poll_event()));
    }
    events.iter().for_each(|event| report.absorb(event));
    report.computed(simulation.computed());
    report.migrated(simulation.migrated());
    let (mut samples, mut placed) = (Vec::new(), Vec::new());
    for Stamped { at, event } in events {
        match event {
            Event::ServiceTime(sample) => samples.push(sample),
            Event::Placement(placement) if placement.vnf.as_str() == "brain" => {
                placed.push((at, placement.node.first().clone()));
            }
            _ => {}
        }
    }
    samples.sort_by_key(|sample| sample.emitted);
    Ran { summary: report.summary(end, "until", Losses::default()), samples, placed }
}

fn place(simulation: &mut Simulation, node: &str) {
    let vnf = "brain".parse().unwrap();
    let place = Instruction::Place { vnf, node: Nodes::from(node.parse::<NodeId>().unwrap()) };
    simulation.instruct(Given::new("test".parse().unwrap(), place)).unwrap();
}

fn to_t(simulation: &mut Simulation) {
    place(simulation, "t");
}

impl Ran {
    fn only(&self) -> &MigrationSummary {
        let [migration] = &self.summary.migrations[..] else { panic!("{:?}", self.summary.migrations) };
        migration
    }

    /// Returns the samples that were emitted in a time without an answer.
    fn unanswered(&self, from: Timestamp, until: Timestamp) -> [usize; 2] {
        let all = || self.samples.iter().filter(|its| its.emitted >= from && its.emitted < until);
        [all().filter(|its| its.took.is_none()).count(), all().count()]
    }
}

fn ms(ms: f64) -> Duration {
    Duration::from_secs_f64(ms / 1e3)
}

fn near(found: f64, expected: f64, within: f64) -> bool {
    println!("{found:.4}, expected {expected:.4}: {:+.2} %", 100.0 * (found / expected - 1.0));
    (found / expected - 1.0).abs() < within
}

#[test]
fn stop_and_copy_is_down_while_all_of_the_state_crosses_the_network() {
    let ran = run(testbed("state: { size: 10 MB }", ""), 15, &[(ORDER, to_t)]);
    let its = ran.only();
    assert_eq!((its.outcome, its.bytes, its.rounds), ("done", 10_000_000, 0));
    assert!(its.downtime_ms == its.duration_ms && near(its.downtime_ms / 1e3, 10e6 / GOODPUT, 0.05));
    assert!(its.downtime_ms > 800.0, "the link alone takes that long");
    let down = [its.at, its.at + ms(its.downtime_ms)];
    // One sample in 50 ms, and the robot retries none of them.
    let [unanswered, emitted] = ran.unanswered(down[0], down[1] - ms(20.0));
    assert!(emitted >= 15 && unanswered == emitted, "{unanswered} of {emitted}");
    for (from, until) in [(ms(1000.0), ORDER - ms(50.0)), (ORDER + ms(its.downtime_ms + 50.0), ms(14_000.0))]
    {
        let [unanswered, emitted] = ran.unanswered(Timestamp::ZERO + from, Timestamp::ZERO + until);
        assert!(unanswered == 0 && emitted > 50, "{unanswered} of {emitted}");
    }
    assert_eq!(ran.placed.last().unwrap().1.as_str(), "t");
}

#[test]
fn pre_copy_goes_on_to_answer() {
    let state = "state: { size: 10 MB, migration: pre_copy, dirty_rate: 20 Mbit/s, downtime: 20 ms }";
    let ran = run(testbed(state, ""), 15, &[(ORDER, to_t)]);
    let its = ran.only();
    assert!(its.outcome == "done" && its.downtime_ms < 20.0 && its.rounds > 1, "{its:?}");
    assert!(its.duration_ms > 900.0, "{its:?}");
    let [unanswered, emitted] = ran.unanswered(its.at, its.at + Duration::from_secs(2));
    assert!(unanswered <= 1 && emitted >= 35, "{unanswered} of {emitted}");
}

/// Clark et al., "Live Migration of Virtual Machines" (NSDI 2005): at rate r, with d of it that changes, round i of a state V
/// takes V·(d/r)^i/r.
#[test]
fn pre_copy_over_the_emulated_network_has_its_closed_form() {
    for (size, dirty_mbps) in [(20e6, 40.0), (50e6, 20.0), (50e6, 60.0)] {
        let ratio = dirty_mbps * 1e6 / 8.0 / GOODPUT;
        let state = format!(
            "state: {{ size: {size} B, migration: pre_copy, dirty_rate: {dirty_mbps} Mbit/s, downtime: 80 ms }}"
        );
        let ran = run(testbed(&state, ""), 20, &[(ORDER, to_t)]);
        let its = ran.only();
        let rest = |rounds: i32| size * ratio.powi(rounds) / GOODPUT;
        let rounds = (1..).find(|rounds| rest(*rounds) <= 0.08).unwrap();
        println!("{size} B, {dirty_mbps} Mbit/s: {} rounds, expected {rounds}", its.rounds);
        assert_eq!((its.outcome, its.rounds), ("done", rounds as u32));
        let total = size * (1.0 - ratio.powi(rounds + 1)) / (1.0 - ratio);
        assert!(near(its.bytes as f64, total, 0.02), "bytes");
        assert!(near(its.duration_ms / 1e3, total / GOODPUT, 0.02), "duration");
        // The last round is short, so that half a round trip counts.
        assert!(near(its.downtime_ms / 1e3, rest(rounds), 0.05), "downtime");
    }
}

#[test]
fn a_state_shares_links_with_all_other_packets() {
    let traffic = "traffic:\n  video: { from: s, to: t, protocol: udp, rate: 45 Mbit/s }\n";
    let ran = run(testbed("state: { size: 10 MB }", traffic), 15, &[(ORDER, to_t)]);
    // 45 Mbit/s of payloads of 1472 in frames of 1514.
    let left = (12.5e6 - 45e6 / 8.0 * 1514.0 / 1472.0) * 1448.0 / 1514.0;
    assert!(near(ran.only().downtime_ms / 1e3, 10e6 / left, 0.1));
}

#[test]
fn the_bytes_of_a_state_are_on_the_bill_of_its_links() {
    let ran = run(testbed("state: { size: 20 MB }", ""), 10, &[(ORDER, to_t)]);
    let bill = ran.summary.bill.as_ref().unwrap();
    let [link] = &bill.links[..] else { panic!("{bill:?}") };
    assert!(near(link.bytes as f64, 20e6 * 1514.0 / 1448.0, 0.05), "with headers and acknowledgements");
    assert!((link.price - link.bytes as f64 / 1e9).abs() < 1e-9);
}

#[test]
fn the_new_instance_serves_once_it_has_started_and_its_state_has_come() {
    let ran = run(testbed("state: { size: 10 MB }, start_time: 2 s", ""), 15, &[(ORDER, to_t)]);
    assert!((ran.only().downtime_ms - 2000.0).abs() < 1.0, "{:?}", ran.only());
    let state = "state: { size: 10 MB, migration: pre_copy, dirty_rate: 1 Mbit/s }, start_time: 2 s";
    let ran = run(testbed(state, ""), 15, &[(ORDER, to_t)]);
    let its = ran.only();
    // Of 0.25 MB, which change in 2 s.
    assert!(its.duration_ms > 2000.0 && near(its.downtime_ms / 1e3, 0.25e6 / GOODPUT, 0.1), "{its:?}");
}

#[test]
fn another_order_abandons_the_copy() {
    let acts: [(Duration, Act); 2] =
        [(ORDER, to_t), (ORDER + ms(400.0), |simulation| place(simulation, "u"))];
    let ran = run(testbed("state: { size: 10 MB }", ""), 15, &acts);
    let [first, second] = &ran.summary.migrations[..] else { panic!("{:?}", ran.summary.migrations) };
    assert_eq!((first.outcome, first.to.as_str()), ("abandoned", "t"));
    assert!((3_000_000..6_000_000).contains(&first.bytes), "{first:?}");
    assert_eq!((second.outcome, second.from.as_str(), second.to.as_str()), ("done", "s", "u"));
    assert_eq!(second.bytes, 10_000_000);
    // Back to where it is: it goes on there.
    let acts: [(Duration, Act); 2] =
        [(ORDER, to_t), (ORDER + ms(400.0), |simulation| place(simulation, "s"))];
    let ran = run(testbed("state: { size: 10 MB }", ""), 15, &acts);
    assert_eq!(ran.only().outcome, "abandoned");
    assert!((ran.only().downtime_ms - 400.0).abs() < 1.0);
    let after = Timestamp::ZERO + ORDER + ms(450.0);
    let [unanswered, emitted] = ran.unanswered(after, after + Duration::from_secs(5));
    assert!(unanswered == 0 && emitted > 90, "{unanswered} of {emitted}");
}

#[test]
fn a_vnf_moves_back_with_its_state_at_once() {
    // Within the second in which a former instance without a state would still answer.
    let acts: [(Duration, Act); 2] =
        [(ORDER, to_t), (ORDER + ms(500.0), |simulation| place(simulation, "s"))];
    let ran = run(testbed("state: { size: 1 MB }", ""), 15, &acts);
    let moves: Vec<_> = ran.summary.migrations.iter().map(|its| (its.outcome, its.to.as_str())).collect();
    assert_eq!(moves, [("done", "t"), ("done", "s")]);
    let after = Timestamp::ZERO + Duration::from_secs(7);
    let [unanswered, emitted] = ran.unanswered(after, after + Duration::from_secs(5));
    assert!(unanswered == 0 && emitted > 90, "{unanswered} of {emitted}");
}

#[test]
fn a_vnf_whose_former_instance_dies_starts_without_its_state() {
    let acts: [(Duration, Act); 2] = [
        (ORDER, to_t),
        (ORDER + ms(300.0), |simulation| {
            simulation.serving().kill_on(&"brain".parse().unwrap(), &"s".parse().unwrap());
        }),
    ];
    let ran = run(testbed("state: { size: 100 MB }", ""), 15, &acts);
    assert_eq!(ran.only().outcome, "abandoned");
    let after = Timestamp::ZERO + ORDER + ms(350.0);
    let [unanswered, emitted] = ran.unanswered(after, after + Duration::from_secs(5));
    assert!(unanswered == 0 && emitted > 90, "{unanswered} of {emitted}");
    assert_eq!(ran.placed.last().unwrap().1.as_str(), "t");
}

#[test]
fn a_paused_vnf_loses_the_requests_that_it_computes() {
    let keys = "cpu_limit: 1, demand: 200 ms, backlog: 3, state: { size: 10 MB }";
    let ran = run(testbed(keys, ""), 10, &[(ORDER, to_t)]);
    let vnfs = ran.summary.computing.unwrap().vnfs;
    let [before, after] = &vnfs[..] else { panic!("{vnfs:?}") };
    assert_eq!((before.node.as_str(), after.node.as_str()), ("s", "t"));
    assert_eq!(before.requests, before.requests_served + before.requests_dropped + before.requests_lost);
    assert!((1..=3).contains(&before.requests_lost) && after.requests_served > 10, "{vnfs:?}");
}

#[test]
fn a_vnf_without_a_state_moves_as_before() {
    let ran = run(testbed("start_time: 1 s", ""), 10, &[(ORDER, to_t)]);
    assert_eq!(ran.summary.migrations, []);
    let [unanswered, emitted] = ran.unanswered(Timestamp::ZERO + Duration::from_secs(2), Timestamp::MAX);
    assert!(unanswered == 0 && emitted > 100, "{unanswered} of {emitted}");
}
