//! A federation at the word of the robot's brain, with real packets.

use serde_json::Value;

use crate::harness::{Run, project_file, wait_until};

#[test]
fn the_brain_triggers_a_federation_across_the_emulated_network() {
    // From there, the walk leaves coverage within the lead.
    let settings =
        ["plugins.orchestrator-1.settings.trigger=brain", "walks.robot.waypoints=[[16, 0], [34, 0]]"];
    let [trigger, walk] = settings;
    let arguments = ["--until", "10min", "--set", trigger, "--set", walk];
    let run = Run::start_beside(&project_file("testbeds/federation.yaml"), &arguments);
    let first = |kind: &str, is: fn(&Value) -> bool| {
        let page = run.get(&format!("/api/v1/measurements/events?kinds={kind}"));
        page["items"].as_array()?.iter().find(|event| is(event))?.get("at_ns")?.as_u64()
    };
    let requested = || first("federation_requested", |event| event["robot"] == "robot");
    let announced = || first("decision", |event| event["instruction"]["step"] == "announced");
    wait_until(|| announced().is_some());
    assert!(requested() <= announced(), "{:?}, announced {:?}", requested(), announced());
    assert!(requested().is_some(), "the plug-in waits for the brain");
}
