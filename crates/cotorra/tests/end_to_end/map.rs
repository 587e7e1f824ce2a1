//! Virtual links that are mapped to paths, with real packets.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use serde_json::{Value, json};

use crate::harness::{Run, output, project_file, stdout, wait_until};

/// Waits for at least `count` service times of packets from a sequence number on. Returns them sorted, in ms; a request
/// without an answer is infinite.
fn service_times(run: &Run, from: u64, count: usize) -> Vec<f64> {
    let mut took = Vec::new();
    wait_until(|| {
        let all = run.get("/api/v1/measurements/service-times?limit=1000")["items"].clone();
        let later =
            all.as_array().unwrap().iter().filter(|sample| sample["sequence"].as_u64().unwrap() >= from);
        took = later.map(|sample| sample["service_time_ms"].as_f64().unwrap_or(f64::INFINITY)).collect();
        took.len() >= count
    });
    took.sort_unstable_by(f64::total_cmp);
    took
}

/// Returns the sequence number of the next position packet that is emitted after the last instruction.
fn next(run: &Run) -> u64 {
    let all = run.get("/api/v1/measurements/service-times?limit=1000")["items"].clone();
    // After the last known packet, one may be under way.
    all.as_array().unwrap().last().map_or(0, |sample| sample["sequence"].as_u64().unwrap() + 2)
}

fn map(run: &Run, from: &str, to: &str, links: &[&str]) -> (u16, Value) {
    let map = json!({ "instruction": { "instruction": "map", "from": from, "to": to, "links": links } });
    run.post("/api/v1/instructions", &map.to_string())
}

/// Returns the number of packets that crossed a link in either direction.
fn carried(run: &Run, link: &str) -> u64 {
    let links = run.get("/api/v1/network/links");
    let both = links.as_array().unwrap().iter().filter(|context| context["link"] == link);
    both.map(|context| context["counters"]["packets"].as_u64().unwrap()).sum()
}

#[test]
fn a_mapped_path_keeps_the_target_that_the_shortest_misses() {
    const TARGET_MS: f64 = 100.0;
    let mut run = Run::start_beside(&project_file("testbeds/two-paths.yaml"), &["--until", "600s"]);
    let slow = service_times(&run, 0, 8);
    // The rate of 10 kbit/s alone takes twice the target.
    assert!(slow[slow.len() / 2] > TARGET_MS, "{slow:?}");

    let (status, body) = map(&run, "robot", "edge", &["robot~unit", "unit-narrow", "narrow-edge"]);
    assert!(status == 409 && body["refused"].as_str().unwrap().contains("are needed"), "{status}: {body}");
    let (status, body) = map(&run, "robot", "edge", &["robot~unit", "edge-wide"]);
    assert!(
        status == 409 && body["refused"].as_str().unwrap().contains("does not go on"),
        "{status}: {body}"
    );
    let (status, body) = map(&run, "robot", "edge", &["robot~unit", "unit-wide", "edge-wide"]);
    assert_eq!(status, 200, "{body}");
    let (status, body) = map(&run, "edge", "robot", &["edge-wide", "unit-wide", "robot~unit"]);
    assert_eq!(status, 200, "{body}");

    let from = next(&run);
    let before = ["unit-narrow", "unit-wide"].map(|link| carried(&run, link));
    let fast = service_times(&run, from, 15);
    assert!(fast[fast.len() / 2] < TARGET_MS, "{fast:?}");
    // Counters of links are updated once a second.
    let wide = || carried(&run, "unit-wide") - before[1];
    wait_until(|| wide() >= 20);
    // Broadcasts, such as neighbour discovery, stay on the shortest path.
    let narrow = carried(&run, "unit-narrow") - before[0];
    assert!(narrow * 2 < wide(), "{narrow} packets on the narrow path, {} on the wide one", wide());

    let mapped = run.get("/api/v1/network/virtual-links");
    let path = json!(["robot~unit", "unit-wide", "edge-wide"]);
    let there = mapped.as_array().unwrap().iter().find(|mapping| mapping["from"] == "driver").unwrap();
    assert_eq!((&there["links"], &there["path"]), (&path, &json!("mapped")));

    run.signal("INT");
    run.wait();
    let run_folder = run.folder.to_str().unwrap();
    let state = stdout(&output(["history", "state", run_folder]));
    let line =
        state.lines().find(|line| line.trim_start().starts_with("driver ") && line.contains("navigation"));
    let line = line.unwrap_or_else(|| panic!("{state}"));
    assert!(line.contains("robot~unit, unit-wide, edge-wide") && line.contains("mapped"), "{state}");
    let decisions = stdout(&output(["history", "events", run_folder, "--kinds", "decision"]));
    assert!(decisions.contains("map robot to edge over robot~unit, unit-wide, edge-wide"), "{decisions}");
}
