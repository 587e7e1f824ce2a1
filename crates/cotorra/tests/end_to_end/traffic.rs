//! Sources of traffic: with real packets beside virtual time, and recordings that belong to a run.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{fs, path::Path};

use serde_json::Value;

use crate::harness::{Run, output, stderr};

const BUSY: &str = "name: busy
probes: none
nodes:
  fog: { kind: server, tier: fog, cpus: 1, memory: 1 GB }
  lan: { kind: switch }
  edge: { kind: server, tier: edge, cpus: 1, memory: 1 GB }
links:
  - { ends: [fog, lan], delay: 2 ms, rate: 20 Mbit/s }
  - { ends: [lan, edge], delay: 2 ms, rate: 20 Mbit/s }
traffic:
  video: { from: fog, to: edge, protocol: udp, rate: 2 Mbit/s }
  voice: { from: edge, to: fog, protocol: udp, rate: 0.5 Mbit/s, size: 160 B, arrivals: poisson }
  cross: { on: lan-edge, direction: forward, protocol: udp, load: 30 % }
  bulk: { from: fog, to: edge, protocol: tcp, bytes: 2 MB }
";

fn source<'a>(summary: &'a Value, name: &str) -> &'a Value {
    let sources = summary["traffic"].as_array().unwrap();
    sources.iter().find(|source| source["source"] == name).unwrap_or_else(|| panic!("{name} in {summary}"))
}

/// Simulates a testbed file, and returns its summary.
fn simulate(file: &Path, runs: &Path) -> Value {
    let run = output([
        "run".as_ref(),
        "--simulate".as_ref(),
        "--until".as_ref(),
        "8s".as_ref(),
        "--out".as_ref(),
        runs.as_os_str(),
        file.as_os_str(),
    ]);
    assert!(run.status.success(), "{}", stderr(&run));
    let folder = fs::read_dir(runs).unwrap().next().unwrap().unwrap().path();
    serde_json::from_slice(&fs::read(folder.join("summary.json")).unwrap()).unwrap()
}

/// The figures are ratios to those in virtual time. What was sent does not depend on how late it was, but for the last moment.
#[test]
fn sources_send_the_same_with_real_packets_as_in_virtual_time() {
    let place = tempfile::tempdir().unwrap();
    let file = place.path().join("busy.yaml");
    fs::write(&file, BUSY).unwrap();
    let virtual_time = simulate(&file, &place.path().join("runs"));
    let mut run = Run::start(&file, &["--seed", "1", "--until", "8s"]);
    let (real, _) = run.report();
    println!("{}", real["fidelity"]["reason"]);
    for name in ["video", "voice", "cross", "bulk"] {
        let [simulated, sent] = [&virtual_time, &real].map(|summary| source(summary, name));
        let of = |summary: &Value, figure: &str| summary[figure].as_f64().unwrap();
        let bytes = of(sent, "bytes") / of(simulated, "bytes");
        println!("{name}: {:.3} of the bytes; {}", bytes, sent["sent_lateness_us"]);
        assert!((bytes - 1.0).abs() < 0.02, "{name}: {sent} beside {simulated}");
        assert_eq!(simulated.get("sent_lateness_us"), None, "nothing is late in virtual time");
    }
    assert_eq!(source(&real, "bulk")["bytes"], 2_000_000);
    assert!(source(&real, "bulk")["finished_after_ms"].is_f64(), "{real}");
    assert_eq!(source(&real, "cross")["link"], "lan-edge");
    assert!(source(&real, "video")["sent_lateness_us"]["p99"].is_f64(), "{real}");
}
