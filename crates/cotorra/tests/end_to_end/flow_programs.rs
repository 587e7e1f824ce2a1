//! A robot and a server whose programs know nothing of cotorra, and the service times of what they say to each other.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{collections::BTreeMap, fs, path::Path, process::Command};

use cotorra_testing::process::Process;

use crate::harness::{Run, cotorra, wait_until};

/// Delay of two crossings of the air and of the wire, ms.
pub(crate) const DELAYS_MS: f64 = 2.0 * (1.0 + 4.0);
/// Time by which frames may be delivered before the time that counts: up to 15 µs, in ms.
const EARLY_MS: f64 = 0.015;

/// Runs a robot and a server with services for flows, each with a target of one second.
pub(crate) fn flows(folder: &Path, flows: &[(&str, &str)]) -> Run {
    let service = |(name, flow): &(&str, &str)| {
        format!(
            "  {name}: {{ robot: robot, kpis: {{ service_time: 1 s, flow: {{ {flow} }} }}, vnfs: {{}} }}\n"
        )
    };
    let file = folder.join("flows.yaml");
    let place = "
name: flows
wireless: { lab: { delay: 1 ms } }
nodes:
  unit: { kind: radio_unit, position: [5, 0], channel: 1 }
  edge: { kind: server, tier: edge, cpus: 2, memory: 4 GB }
  robot: { kind: robot, position: [0, 0] }
links:
  - { ends: [unit, edge], delay: 4 ms, rate: 100 Mbit/s }
services:
";
    fs::write(&file, format!("{place}{}", flows.iter().map(service).collect::<String>())).unwrap();
    Run::start_beside(&file, &["--until", "5min"])
}

/// Returns a command that runs its arguments in a node.
pub(crate) fn inside(run: &Run, node: &str) -> Command {
    cotorra(["exec", "--api", run.address(), node, "--"])
}

/// Returns the measurements that a client printed for a name, by number.
fn measured(client: &Process, name: &str) -> BTreeMap<u64, f64> {
    let said = client.output();
    // The last line may be incomplete.
    let whole = said.rfind('\n').map_or("", |end| &said[..end]);
    let lines = whole.lines().filter_map(|line| {
        let mut words = line.split_whitespace();
        let is_its = words.next() == Some(name);
        is_its.then(|| (words.next().unwrap().parse().unwrap(), words.next().unwrap().parse().unwrap()))
    });
    lines.collect()
}

/// Returns the service times of a service by number, in ms, without lost requests.
pub(crate) fn samples(run: &Run, service: &str) -> BTreeMap<u64, f64> {
    let page = run.get("/api/v1/measurements/service-times?limit=10000");
    let all = page["items"].as_array().unwrap().iter().filter(|sample| sample["service"] == service);
    let answered = all.filter_map(|sample| {
        let took = sample["service_time_ms"].as_f64()?;
        let places = [&sample["robot"], &sample["server"], &sample["attachment"]];
        assert_eq!(places, ["robot", "edge", "unit"], "{sample}");
        Some((sample["sequence"].as_u64().unwrap(), took))
    });
    answered.collect()
}

/// Waits for service times, each of which must lie between the network's delay `least` and the client's measurement.
pub(crate) fn compare(run: &Run, service: &str, client: &Process, name: &str, least: f64) {
    let mut both = Vec::new();
    wait_until(|| {
        let (took, itself) = (samples(run, service), measured(client, name));
        both = took.iter().filter_map(|(number, took)| Some((*took, *itself.get(number)?))).collect();
        both.len() > 10
    });
    for (took, itself) in both {
        assert!(
            (least..=itself + EARLY_MS).contains(&took),
            "{service}: {took} ms, by the client {itself} ms"
        );
    }
}
