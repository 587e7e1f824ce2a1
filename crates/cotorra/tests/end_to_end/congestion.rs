//! OKpi where the packets of a camera fill the link to the cloud, with real packets.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use serde_json::Value;

use crate::harness::{Run, events, project_file};

/// Returns a time of an event in seconds.
fn seconds(event: &Value, name: &str) -> f64 {
    event[name].as_u64().unwrap_or_else(|| panic!("{name} of {event}")) as f64 / 1e9
}

/// Returns the number of samples of navigation that were emitted in a time, and the share of them that keep 15 ms.
fn kept(samples: &[Value], from: f64, until: f64) -> (usize, f64) {
    let within = |sample: &&Value| (from..until).contains(&seconds(sample, "emitted_ns"));
    let of: Vec<_> = samples.iter().filter(within).collect();
    let in_time = |sample: &&&Value| sample["service_time_ms"].as_f64().is_some_and(|took| took <= 15.0);
    (of.len(), of.iter().filter(in_time).count() as f64 / of.len().max(1) as f64)
}

/// The shares hold for valid figures: a machine that stood still answers nothing in time. The decision and the move hold in any
/// case, because they follow from queues of the emulated link.
#[test]
fn okpi_leaves_a_link_that_real_packets_fill_and_does_not_come_back() {
    let mut run = Run::start(&project_file("testbeds/congestion.yaml"), &["--seed", "1", "--until", "40s"]);
    let (summary, _) = run.report();
    let places: Vec<_> = events(&run.folder, "decision")
        .into_iter()
        .filter(|decision| decision["instruction"]["instruction"] == "place" && decision["refused"].is_null())
        .collect();
    let moved = places.first().unwrap_or_else(|| panic!("navigation stayed: {summary}"));
    let (at, reason) = (seconds(moved, "at_ns"), moved["reason"].as_str().unwrap());
    assert_eq!(
        (&moved["instruction"]["vnf"], &moved["instruction"]["node"]),
        (&"navigation".into(), &"edge".into())
    );
    assert!(reason.contains("`unit-cloud` is") && reason.contains("slower than configured"), "{reason}");
    assert!(events(&run.folder, "placement").iter().any(|placed| placed["node"] == "edge"));

    let mut samples = events(&run.folder, "service_time");
    samples.retain(|sample| sample["service"] == "navigation");
    let ((before, missed), (after, share)) = (kept(&samples, 0.5, at), kept(&samples, at + 1.0, 40.0));
    let is_valid = summary["fidelity"]["valid"] == true;
    println!(
        "valid: {is_valid}; until {at:.1} s {missed:.3} of {before} samples keep 15 ms, then {share:.3} of {after}"
    );
    println!("{reason}");
    if is_valid {
        assert_eq!(places.len(), 1, "{places:#?}");
        assert!(after > 400 && share > 0.95 && missed < share, "{share} of {after}, {missed} of {before}");
    }
}
