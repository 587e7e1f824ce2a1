//! VNFs with demands: their answers take the time of their server's CPUs, which they share.

use std::path::Path;

use cotorra_graph::{MachineContext, Nodes, ServiceTime};

use crate::{
    ComputerSummary, ComputingSummary, ServiceParts, Summary, VnfComputing,
    report::{Losses, Report},
    virtual_time::*,
};

/// Two robots that stand, whose navigation is on servers beside their radio unit. It has `keys`.
fn testbed(keys: &str, server: &str, nodes: [&str; 2]) -> Testbed {
    let [one, two] = nodes;
    let text = format!(
        "name: load
wireless: {{ lab: {{ access: turns, delay: 1 ms }} }}
nodes:
  a: {{ kind: robot }}
  b: {{ kind: robot }}
  R1: {{ kind: radio_unit, position: [2, 2], channel: 1 }}
  s: {{ kind: server, tier: edge, memory: 8 GB, {server} }}
  t: {{ kind: server, tier: edge, memory: 8 GB, {server} }}
links:
  - {{ ends: [R1, [s, t]], delay: 1 ms }}
walks:
  a: {{ waypoints: [[0, 0], [40, 0]], position_interval: 50 ms }}
  b: {{ waypoints: [[0, 4], [40, 4]], position_interval: 50 ms }}
services:
  one:
    robot: a
    kpis: {{ service_time: 15 ms }}
    vnfs:
      driver-a: {{ program: robot_driver, pinned_to: a, cpus: 0 }}
      brain-a: {{ program: navigation, node: {one}, cpus: 0.25, {keys} }}
  two:
    robot: b
    kpis: {{ service_time: 15 ms }}
    vnfs:
      driver-b: {{ program: robot_driver, pinned_to: b, cpus: 0 }}
      brain-b: {{ program: navigation, node: {two}, cpus: 0.25, {keys} }}
"
    );
    cotorra_testbed_file::parse("load.yaml", &text, Path::new("")).unwrap_or_else(|wrong| panic!("{wrong}"))
}

/// Runs for so many seconds, with this done after half of them.
pub(super) fn run_with(
    testbed: Testbed,
    seconds: u64,
    halfway: impl FnOnce(&mut Simulation),
) -> (Summary, Vec<Stamped>) {
    let mut report = Report::new(&testbed, 1).in_virtual_time(&testbed);
    let mut simulation = Simulation::new(Arc::new(testbed), 1).unwrap();
    let (mut halfway, mut events) = (Some(halfway), Vec::new());
    let end = Timestamp::ZERO + Duration::from_secs(seconds);
    simulation.set_alarm(Some(end));
    while simulation.now() < end {
        simulation.step();
        if simulation.now() >= Timestamp::ZERO + Duration::from_secs(seconds) / 2
            && let Some(halfway) = halfway.take()
        {
            halfway(&mut simulation);
        }
        events.extend(std::iter::from_fn(|| simulation.poll_event()));
    }
    events.iter().for_each(|event| report.absorb(event));
    report.computed(simulation.computed());
    report.sent(simulation.airtimes());
    (report.summary(end, "until", Losses::default()), events)
}

fn run(testbed: Testbed) -> (Summary, Vec<Stamped>) {
    run_with(testbed, 20, |_| {})
}

fn computing(summary: &Summary) -> &ComputingSummary {
    summary.computing.as_ref().unwrap()
}

fn busy(summary: &Summary, node: &str) -> f64 {
    let is_it = |its: &&ComputerSummary| its.node.as_str() == node;
    computing(summary).nodes.iter().find(is_it).unwrap().busy
}

fn vnf<'a>(summary: &'a Summary, name: &str, node: &str) -> &'a VnfComputing {
    let is_it = |its: &&VnfComputing| its.vnf.as_str() == name && its.node.as_str() == node;
    computing(summary).vnfs.iter().find(is_it).unwrap()
}

fn p50_ms(summary: &Summary, service: usize) -> f64 {
    summary.services[service].service_time_ms.unwrap().p50
}

const ALONE: [&str; 2] = ["s", "t"];
const TOGETHER: [&str; 2] = ["s", "s"];

#[test]
fn an_answer_takes_its_demand_by_the_speed_of_the_server() {
    let none = run(testbed("cpu_limit: 1", "cpus: 1", ALONE)).0;
    assert_eq!(none.computing, None);
    for (server, expected) in [("cpus: 1", 8.0), ("cpus: 1, speed: 2", 4.0), ("cpus: 1, speed: 0.5", 16.0)] {
        let (summary, _) = run(testbed("cpu_limit: 1, demand: 8 ms", server, ALONE));
        let later = p50_ms(&summary, 0) - p50_ms(&none, 0);
        assert!((later - expected).abs() < 0.3, "{server}: {later}");
        let its = vnf(&summary, "brain-a", "s");
        assert_eq!(its.computing_mean_ms, Some(expected));
        assert_eq!((its.requests_dropped, its.requests_lost, its.requests_present_max), (0, 0, 1));
        // One request in 50 ms.
        assert!((busy(&summary, "s") - expected / 50.0).abs() < 0.01, "{}", busy(&summary, "s"));
        assert!((its.busy - busy(&summary, "s")).abs() < 0.01 && its.waiting_ms.unwrap().max < 1e-3);
    }
}

#[test]
fn vnfs_on_a_busy_server_slow_each_other() {
    // 30 ms of each 50 ms, by two: more than one CPU has.
    let keys = "cpu_limit: 1, demand: 30 ms, backlog: 4";
    let (alone, _) = run(testbed(keys, "cpus: 1", ALONE));
    let (together, _) = run(testbed(keys, "cpus: 1", TOGETHER));
    assert!((busy(&alone, "s") - 0.6).abs() < 0.02 && (busy(&alone, "t") - 0.6).abs() < 0.02);
    assert!(busy(&together, "s") > 0.97 && busy(&together, "t") == 0.0);
    for (name, service) in [("brain-a", 0), ("brain-b", 1)] {
        let its = vnf(&together, name, "s");
        // Both get half of the CPU: 60 ms for a request that comes each 50 ms.
        assert!((its.busy - 0.5).abs() < 0.02 && its.requests_dropped > 0, "{its:?}");
        assert_eq!(its.requests_present_max, 4);
        assert!(p50_ms(&together, service) > p50_ms(&alone, service) + 100.0);
    }
    // A second CPU is as good as a second server.
    let (two_cpus, _) = run(testbed(keys, "cpus: 2", TOGETHER));
    assert!((busy(&two_cpus, "s") - 0.6).abs() < 0.02);
    assert!((p50_ms(&two_cpus, 0) - p50_ms(&alone, 0)).abs() < 0.1);
}

#[test]
fn a_vnf_uses_no_more_than_its_cpus() {
    let (summary, _) = run(testbed("demand: 4 ms", "cpus: 1", ALONE));
    let its = vnf(&summary, "brain-a", "s");
    // A quarter of a CPU takes four times as long.
    assert_eq!((its.cpu_limit, its.computing_mean_ms), (0.25, Some(4.0)));
    assert!((its.waiting_ms.unwrap().p50 - 12.0).abs() < 1e-3, "{its:?}");
    assert!((its.busy - 16.0 / 50.0).abs() < 0.01, "{its:?}");
}

#[test]
fn waiting_is_a_part_of_the_time_of_its_own() {
    let keys = "cpu_limit: 1, demand: { exponential: 20 ms }";
    let (summary, _) = run(testbed(keys, "cpus: 1", TOGETHER));
    let ServiceParts { mean, .. } = &summary.time_parts[0];
    let its = vnf(&summary, "brain-a", "s");
    assert!(mean.processor_ms > 1.0, "{mean:?}");
    // Samples that are given up are not in the parts, and in the times of the VNF.
    assert!((mean.vnf_ms / its.computing_mean_ms.unwrap() - 1.0).abs() < 0.1, "{mean:?} {its:?}");
}

#[test]
fn the_first_requests_after_a_start_cost_more_and_a_start_takes_its_time() {
    let keys = "cpu_limit: 1, demand: 2 ms, warm_up: { requests: 10, factor: 5 }, start_time: 3 s";
    let (_, events) = run(testbed(keys, "cpus: 1", ALONE));
    let samples: Vec<&ServiceTime> = events
        .iter()
        .filter_map(|stamped| match &stamped.event {
            Event::ServiceTime(sample) if sample.service.as_str() == "one" => Some(sample),
            _ => None,
        })
        .collect();
    assert!(samples[0].emitted >= Timestamp::ZERO + Duration::from_secs(3));
    let [tenth, eleventh] = [9, 10].map(|place: usize| samples[place].took.unwrap());
    let saved = tenth - eleventh;
    assert!(saved.abs_diff(Duration::from_millis(8)) < Duration::from_micros(500), "{saved:?}");
}

#[test]
fn requests_of_an_instance_that_dies_are_lost_and_counted() {
    let keys = "cpu_limit: 1, demand: 200 ms, backlog: 3";
    let (summary, _) = run_with(testbed(keys, "cpus: 1", ALONE), 20, |simulation| {
        simulation.serving().kill(&"brain-a".parse().unwrap());
    });
    let its = vnf(&summary, "brain-a", "s");
    let VnfComputing { requests, requests_served, requests_dropped, requests_lost, .. } = its;
    assert!((1..=3).contains(requests_lost), "{its:?}");
    // Those of the last instance are still with it.
    let over = requests - requests_served - requests_dropped - requests_lost;
    assert!(over <= 3 && its.busy > 0.95, "{its:?}");
}

#[test]
fn an_instance_that_moves_away_finishes_its_requests() {
    let keys = "cpu_limit: 1, demand: 200 ms, backlog: 3";
    let (summary, _) = run_with(testbed(keys, "cpus: 1", ALONE), 20, |simulation| {
        let place = Instruction::Place {
            vnf: "brain-a".parse().unwrap(),
            node: Nodes::from("t".parse::<NodeId>().unwrap()),
        };
        simulation.instruct(Given::new("test".parse().unwrap(), place)).unwrap();
    });
    let [before, after] = ["s", "t"].map(|node| vnf(&summary, "brain-a", node));
    let VnfComputing { requests, requests_served, requests_dropped, requests_lost, .. } = before;
    assert_eq!((*requests, *requests_lost), (requests_served + requests_dropped, 0), "{before:?}");
    assert!(after.requests_served > 10, "{after:?}");
}

#[test]
fn contexts_tell_plugins_how_busy_servers_are() {
    let (summary, events) = run(testbed("cpu_limit: 1, demand: 10 ms", "cpus: 2", TOGETHER));
    let contexts: Vec<&MachineContext> = events
        .iter()
        .filter_map(|stamped| match &stamped.event {
            Event::Machine(context) if context.node.as_str() == "s" => Some(context),
            _ => None,
        })
        .collect();
    assert_eq!(contexts.len(), 20);
    let shares = contexts.iter().map(|context| context.cpu.unwrap().busy.unwrap().get());
    let mean = shares.sum::<f64>() / 20.0;
    // The last context may be read before the work of its own moment is done.
    let busy = busy(&summary, "s");
    assert!((mean - busy).abs() < 1e-3 && (mean - 0.2).abs() < 0.01, "{mean} {busy}");
    let (_, events) = run(testbed("cpu_limit: 1", "cpus: 2", TOGETHER));
    assert!(!events.iter().any(|stamped| matches!(stamped.event, Event::Machine(_))));
}
