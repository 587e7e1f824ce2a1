//! A run is as the last one.

use std::time::Duration;

use serde_json::{Value, json};

use crate::rig::{FLOOR, Rig};

/// Largest distance of the same event in two runs: two ticks of the kernel and a little. Programs that wait for others do not
/// always read the clock equally often, and reading it takes time. mac80211 associates at a tick, so microseconds can become
/// a tick.
const APART: Duration = Duration::from_micros(8100);

/// Runs roams, a scan, a deployment and a removal. Returns what happened.
fn events() -> Option<Vec<Value>> {
    let rig = Rig::start(FLOOR)?;
    let settings = json!({ "ssid": "lab", "mobility_domain": 49266 });
    let instructions = [
        json!({ "instruction": "attach", "robot": "r1", "radio_unit": "B" }),
        json!({ "instruction": "scan", "robot": "r1" }),
        json!({ "instruction": "deploy", "radio_unit": "C", "access_point": settings }),
        json!({ "instruction": "attach", "robot": "r1", "radio_unit": "C" }),
        json!({ "instruction": "attach", "robot": "r1", "radio_unit": "A" }),
        json!({ "instruction": "remove", "radio_unit": "C" }),
    ];
    for (at, instruction) in (1..).zip(instructions) {
        rig.wait_until(Duration::from_secs(at));
        rig.instruct(instruction).unwrap();
    }
    rig.wait_until(Duration::from_secs(8));
    Some(rig.end().events)
}

#[test]
fn two_runs_have_the_same_events_at_the_same_times() {
    let Some(first) = events() else { return };
    let second = events().unwrap();
    let handovers = first.iter().filter(|event| event["event"] == "handover");
    assert_eq!(handovers.count(), 4, "the first is at the start");
    let what = |event: &Value| {
        let mut event = event.as_object().unwrap().clone();
        event.retain(|name, _| !["at_ns", "gap_ms"].contains(&name.as_str()));
        event
    };
    let whats = |events: &[Value]| events.iter().map(what).collect::<Vec<_>>();
    assert_eq!(whats(&first), whats(&second));
    let time = |event: &Value| Duration::from_nanos(event["at_ns"].as_u64().unwrap());
    let apart = first.iter().zip(&second).map(|(a, b)| time(a).abs_diff(time(b)));
    let most = apart.max().unwrap();
    println!("{} events, at most {most:?} apart", first.len());
    let both = || first.iter().zip(&second).map(|(a, b)| format!("{a}\n{b}\n")).collect::<String>();
    assert!(most <= APART, "{}", both());
}
