//! Demands of VNFs with real packets, beside virtual time.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{fs, path::Path, time::Duration};

use cotorra_computing::Demands;
use cotorra_graph::{Computing, Demand, Scheduling};
use serde_json::Value;

use crate::harness::{Run, output, stderr};

const ROBOTS: u32 = 4;
const SEED: u64 = 1;

/// Returns robots that send 20 requests a second each, and their brains, with further keys, at one CPU.
fn testbed(brain: &str) -> String {
    let each = |line: &dyn Fn(u32) -> String| (1..=ROBOTS).map(line).collect::<String>();
    format!(
        "name: crew
wireless: {{ hall: {{ access: turns, delay: 1 ms }} }}
nodes:
  unit: {{ kind: radio_unit, position: [15, 15], channel: 36 }}
  edge: {{ kind: server, tier: edge, cpus: 1, memory: 8 GB }}
{}links:
  - {{ ends: [unit, edge], delay: 1 ms }}
services:
{}walks:
{}",
        each(&|i| format!("  r{i}: {{ kind: robot }}\n")),
        each(&|i| format!(
            "  s{i}:
    robot: r{i}
    kpis: {{ service_time: 20 ms }}
    vnfs:
      driver-{i}: {{ program: robot_driver, pinned_to: r{i}, cpus: 0 }}
      brain-{i}: {{ program: navigation, node: edge, cpus: 0.1, cpu_limit: 1, memory: 64 MB{brain} }}
"
        )),
        each(&|i| format!("  r{i}: {{ waypoints: [[0, {i}], [30, {i}]], position_interval: 50 ms }}\n")),
    )
}

struct Ran {
    summary: Value,
    /// Service times of all answered requests, ms, in order.
    answered_ms: Vec<f64>,
}

impl Ran {
    fn of(folder: &Path, summary: Value) -> Self {
        let samples = crate::harness::events(folder, "service_time");
        let mut answered_ms: Vec<_> =
            samples.iter().filter_map(|sample| sample["service_time_ms"].as_f64()).collect();
        answered_ms.sort_by(f64::total_cmp);
        Self { summary, answered_ms }
    }

    fn vnf(&self, name: &str) -> &Value {
        let vnfs = self.summary["computing"]["vnfs"].as_array().unwrap();
        vnfs.iter().find(|vnf| vnf["vnf"] == name).unwrap_or_else(|| panic!("{name} in {vnfs:?}"))
    }

    fn edge(&self) -> &Value {
        &self.summary["computing"]["nodes"][0]
    }

    fn quantile(&self, p: f64) -> f64 {
        self.answered_ms[((self.answered_ms.len() - 1) as f64 * p) as usize]
    }

    fn mean(&self) -> f64 {
        self.answered_ms.iter().sum::<f64>() / self.answered_ms.len() as f64
    }
}

fn simulated(file: &Path, until: &str) -> Ran {
    let runs = tempfile::tempdir().unwrap();
    let (out, file) = (runs.path().to_str().unwrap(), file.to_str().unwrap());
    let run = output(["run", "--simulate", "--seed", "1", "--until", until, "--out", out, file]);
    assert!(run.status.success(), "{}", stderr(&run));
    let folder = fs::read_dir(runs.path()).unwrap().next().unwrap().unwrap().path();
    let summary = serde_json::from_slice(&fs::read(folder.join("summary.json")).unwrap()).unwrap();
    Ran::of(&folder, summary)
}

/// Returns a run with real packets, its terminal, and whether control groups limited it.
fn real(file: &Path, until: &str) -> (Ran, String, bool) {
    let mut run = Run::start(file, &["--seed", "1", "--until", until]);
    let is_limited = !run.notes.iter().any(|note| note.contains("have no limit of CPUs"));
    let (summary, printed) = run.report();
    (Ran::of(&run.folder, summary), printed, is_limited)
}

fn count(of: &Value, figure: &str) -> u64 {
    of[figure].as_u64().unwrap_or_else(|| panic!("{figure} of {of}"))
}

fn ms(of: &Value, figure: &str) -> f64 {
    of[figure].as_f64().unwrap_or_else(|| panic!("{figure} of {of}"))
}

/// Asserts that each request was answered, dropped or lost, or is still there at the end.
fn assert_complete(vnf: &Value) {
    let [all, served, dropped, lost] =
        ["requests", "requests_served", "requests_dropped", "requests_lost"].map(|figure| count(vnf, figure));
    assert!(all > 0, "{vnf}");
    let present = all.checked_sub(served + dropped + lost);
    assert!(present.is_some_and(|present| present <= count(vnf, "requests_present_max")), "{vnf}");
}

#[test]
fn answers_take_the_same_cpu_time_with_real_packets_as_in_virtual_time() {
    let place = tempfile::tempdir().unwrap();
    let file = place.path().join("crew.yaml");
    fs::write(&file, testbed(", demand: { exponential: 5 ms }")).unwrap();
    let virtual_time = simulated(&file, "10s");
    let (real, printed, _) = real(&file, "10s");
    for (world, ran) in [("virtual time", &virtual_time), ("real packets", &real)] {
        println!(
            "{world}: {} answers, median {:.2} ms, p95 {:.2} ms, mean {:.2} ms, edge {:.1} % busy",
            ran.answered_ms.len(),
            ran.quantile(0.5),
            ran.quantile(0.95),
            ran.mean(),
            100.0 * ms(ran.edge(), "busy")
        );
    }
    let computing = Computing {
        demand: Demand::Exponential { mean: Duration::from_millis(5) },
        per_kb: Duration::ZERO,
        scheduling: Scheduling::default(),
        backlog: Computing::BACKLOG,
        warm_up: None,
    };
    for i in 1..=ROBOTS {
        let name = format!("brain-{i}");
        for ran in [&virtual_time, &real] {
            let vnf = ran.vnf(&name);
            assert_complete(vnf);
            assert_eq!(count(vnf, "requests_dropped"), 0, "{vnf}");
            // Those that were served are the first that were drawn.
            let mut demands = Demands::new(&computing, SEED, &format!("{name} 0 1")).unwrap();
            let served = count(vnf, "requests_served");
            let drawn: Duration = (0..served).map(|_| demands.next(0)).sum();
            let drawn_ms = drawn.as_secs_f64() * 1e3 / served as f64;
            let computed_ms = ms(vnf, "computing_mean_ms");
            assert!((computed_ms / drawn_ms - 1.0).abs() < 0.02, "{drawn_ms} ms: {vnf}");
        }
    }
    let all = real.summary["computing"]["vnfs"].as_array().unwrap();
    let computed_ms: f64 = all.iter().map(|vnf| ms(vnf, "cpu_time_ms")).sum();
    assert!((ms(real.edge(), "cpu_time_ms") - computed_ms).abs() < 1.0, "{all:?}");
    let served: u64 = all.iter().map(|vnf| count(vnf, "requests_served")).sum();
    // An answer has crossed the air and the wire twice, 1 ms each, beside the CPU time that it took.
    assert!(real.mean() > computed_ms / served as f64 + 3.9, "{} ms", real.mean());
    assert!(printed.contains("of 1 CPU busy") && printed.contains("VNF brain-"), "{printed}");
}

/// Each brain gets more requests than it can serve, and all of them want more than the server's CPU.
#[test]
fn a_full_backlog_drops_requests_and_vnfs_share_the_cpu_of_their_server() {
    let place = tempfile::tempdir().unwrap();
    let file = place.path().join("crew.yaml");
    fs::write(&file, testbed(", demand: 60 ms, backlog: 1")).unwrap();
    let virtual_time = simulated(&file, "5s");
    let (real, _, is_limited) = real(&file, "5s");
    for ran in [&virtual_time, &real] {
        for i in 1..=ROBOTS {
            let vnf = ran.vnf(&format!("brain-{i}"));
            assert_complete(vnf);
            assert!(count(vnf, "requests_served") > 0 && count(vnf, "requests_dropped") > 0, "{vnf}");
            assert_eq!(count(vnf, "requests_present_max"), 1, "{vnf}");
        }
    }
    println!("edge {} with real packets, {} in virtual time", real.edge(), virtual_time.edge());
    if is_limited {
        assert!(ms(real.edge(), "busy") < 1.1, "{}", real.edge());
    } else {
        println!("this machine has no control groups");
    }
}

#[test]
fn answers_take_less_cpu_time_of_a_fast_server_and_none_is_told_without_a_demand() {
    let place = tempfile::tempdir().unwrap();
    let file = place.path().join("crew.yaml");
    let text = testbed(", demand: 8 ms, scheduling: shared")
        .replace("cpus: 1, memory: 8", "cpus: 1, speed: 4, memory: 8");
    fs::write(&file, text).unwrap();
    let (fast, ..) = real(&file, "4s");
    let vnf = fast.vnf("brain-2");
    assert_complete(vnf);
    assert!((ms(vnf, "computing_mean_ms") - 2.0).abs() < 0.04, "{vnf}");
    fs::write(&file, testbed("")).unwrap();
    let (none, ..) = real(&file, "3s");
    assert_eq!(none.summary.get("computing"), None);
    assert!(!none.answered_ms.is_empty());
}
