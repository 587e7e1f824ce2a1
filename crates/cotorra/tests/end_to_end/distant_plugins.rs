//! Contexts and instructions of plug-ins that are away from the core, in real time: between nodes, as real packets over the
//! emulated network, and with a fixed delay.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{fs, path::PathBuf};

use serde_json::Value;
use tempfile::TempDir;

use crate::harness::{Run, wait_until};

/// A robot that stands still, the core at `edge`, and a plug-in behind a link of 100 ms. `CLOUD` are further conditions of it.
const TESTBED: &str = "
name: far
wireless: { lab: {} }
nodes:
  robot: { kind: robot, position: [0, 0], roaming: instructed }
  R1: { kind: radio_unit, position: [0, 3], channel: 1 }
  lan: { kind: switch }
  edge: { kind: server, tier: edge, cpus: 1, memory: 1 GB }
  cloud: { kind: server, tier: cloud, cpus: 1, memory: 1 GB }
links:
  - { ends: [lan, [R1, edge]], delay: 1 ms }
  - { ends: [lan, cloud], delay: 100 ms, rate: 20 Mbit/sCLOUD }
core: { node: edge }
plugins:
";

/// Twice the delay of the slow link alone, ms.
const BOTH_WAYS_MS: f64 = 200.0;

/// Instructions of the program.
const INSTRUCTIONS: usize = 40;

/// Gives an instruction for each context of a robot that its stream has, up to a number. The reason has the number of the
/// instruction, and the time of the context.
const PROGRAM: &str = r#"
import json, os, sys
from urllib import request

API, MOST = os.environ["COTORRA_API"] + "/api/v1", int(sys.argv[1])
HEADERS = {"Content-Type": "application/json", "Authorization": "Bearer " + os.environ["COTORRA_TOKEN"]}
http = request.build_opener(request.ProxyHandler({}))
ask = lambda path, body=None: http.open(request.Request(API + path, body, HEADERS))

given = 0
for line in ask("/events?kinds=robot"):
    if not line.startswith(b"data: {") or given == MOST:
        continue
    context = json.loads(line.removeprefix(b"data: "))
    assert context["event"] == "robot"
    given += 1
    slow = {"instruction": "limit_speed", "robot": "robot", "speed_limit_mps": given / 100}
    body = {"instruction": slow, "reason": f"{given} {context['at_ns']}"}
    ask("/instructions", json.dumps(body).encode()).close()
"#;

/// Writes the testbed with a plug-in.
fn testbed(folder: &TempDir, cloud: &str, plugin: &str) -> PathBuf {
    let file = folder.path().join("far.yaml");
    fs::write(&file, format!("{}  - {plugin}\n", TESTBED.replace("CLOUD", cloud))).unwrap();
    file
}

/// Writes the testbed with the program, this far away.
fn with_program(folder: &TempDir, cloud: &str, distance: &str) -> PathBuf {
    let script = folder.path().join("program.py");
    fs::write(&script, PROGRAM).unwrap();
    let command = format!("command: [python3, {}, '{INSTRUCTIONS}']", script.display());
    testbed(folder, cloud, &format!("{{ id: mine, {command}, {distance} }}"))
}

fn events(run: &Run, kinds: &str) -> Vec<Value> {
    let page = run.get(&format!("/api/v1/measurements/events?kinds={kinds}&limit=10000"));
    page["items"].as_array().unwrap().clone()
}

/// Waits for so many decisions, and returns them.
fn decisions(run: &Run, most: usize) -> Vec<Value> {
    let mut all = Vec::new();
    wait_until(|| {
        all = events(run, "decision");
        assert_eq!(events(run, "plugin_fault"), [Value::Null; 0]);
        all.len() >= most
    });
    all
}

/// Returns the ages of the youngest contexts of robots at the plug-in's decisions, ms.
fn ages(run: &Run) -> Vec<f64> {
    let all = events(run, "staleness");
    let of_robots = all.iter().filter(|its| its["kind"] == "robot");
    of_robots.map(|its| its["youngest_ms"].as_f64().unwrap()).collect()
}

/// Asserts that the program's instructions were carried out once and in order, on contexts as old as their ways.
fn assert_once_and_in_order(decisions: &[Value]) {
    for (decision, number) in decisions.iter().zip(1..) {
        let reason = decision["reason"].as_str().unwrap();
        let (given, sampled_ns) = reason.split_once(' ').unwrap();
        assert_eq!((given.parse(), &decision["plugin"]), (Ok(number), &"mine".into()), "{decision}");
        assert!(decision.get("refused").is_none_or(Value::is_null), "{decision}");
        let age_ns = decision["at_ns"].as_u64().unwrap() - sampled_ns.parse::<u64>().unwrap();
        assert!(age_ns as f64 >= BOTH_WAYS_MS * 1e6, "{decision}");
    }
    assert_eq!(decisions.len(), INSTRUCTIONS);
}

#[test]
fn contexts_and_instructions_of_a_bundled_plugin_cross_the_network() {
    let folder = TempDir::new().unwrap();
    let plugin = "{ bundled: probing, node: cloud, settings: { interval: [1 s, 1 s] } }";
    let run = Run::start_beside(&testbed(&folder, "", plugin), &["--until", "5min"]);
    let decisions = decisions(&run, 5);
    assert!(decisions.iter().all(|decision| decision["plugin"] == "probing"), "{decisions:?}");
    wait_until(|| ages(&run).len() >= 3);
    let ages = ages(&run);
    assert!(ages.iter().all(|age| *age >= BOTH_WAYS_MS), "{ages:?}");
    // Both directions carry packets that nothing else sends.
    let packets = |direction: &str| {
        let links = run.get("/api/v1/network/links");
        let its = |link: &&Value| link["link"] == "lan-cloud" && link["direction"] == direction;
        links.as_array().unwrap().iter().find(its).unwrap()["counters"]["packets"].as_u64().unwrap()
    };
    wait_until(|| packets("forward") as usize >= 10 && packets("backward") as usize >= 10);
}

#[test]
fn instructions_of_a_program_on_a_node_arrive_once_and_in_order_whatever_is_lost() {
    for cloud in ["", ", loss: 30 %"] {
        let folder = TempDir::new().unwrap();
        let run = Run::start_beside(&with_program(&folder, cloud, "node: cloud"), &["--until", "5min"]);
        assert_once_and_in_order(&decisions(&run, INSTRUCTIONS));
        let ages = ages(&run);
        assert!(ages.len() >= INSTRUCTIONS - 1 && ages.iter().all(|age| *age >= BOTH_WAYS_MS), "{ages:?}");
    }
}

#[test]
fn events_and_instructions_of_a_program_take_its_delay() {
    let folder = TempDir::new().unwrap();
    let testbed = with_program(&folder, "", "control_delay: 100 ms");
    let run = Run::start_beside(&testbed, &["--until", "5min"]);
    assert_once_and_in_order(&decisions(&run, INSTRUCTIONS));
}

#[test]
fn a_program_beside_the_core_has_events_at_once_and_no_ages() {
    let folder = TempDir::new().unwrap();
    let run = Run::start_beside(&with_program(&folder, "", "node: edge"), &["--until", "5min"]);
    let decisions = decisions(&run, INSTRUCTIONS);
    assert_eq!((decisions.len(), events(&run, "staleness")), (INSTRUCTIONS, Vec::new()));
}
