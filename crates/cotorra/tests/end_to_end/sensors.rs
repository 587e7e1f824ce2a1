//! A robot that declares sensors, with real packets and in virtual time.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{fs, path::PathBuf};

use serde_json::json;

use crate::harness::{Run, output, project_file, stderr, stdout, wait_until};

/// `testbeds/two-paths.yaml` with sensors, in a folder.
fn testbed(folder: &tempfile::TempDir) -> PathBuf {
    let text = fs::read_to_string(project_file("testbeds/two-paths.yaml")).unwrap();
    let with_sensors = text.replace(
        "robot: { kind: robot }",
        "robot: { kind: robot, sensors: { pack: { kind: battery, rate: 5 Hz, charge: 50 % }, imu: { kind: imu },
                gripper: { kind: vector, size: 2, unit: N } } }",
    );
    assert_ne!(text, with_sensors);
    let file = folder.path().join("sensing.yaml");
    fs::write(&file, with_sensors).unwrap();
    file
}

#[test]
fn sensors_are_read_followed_and_reported_over_the_api_and_kept() {
    let folder = tempfile::tempdir().unwrap();
    let mut run = Run::start(&testbed(&folder), &["--until", "600s"]);
    let last = |sensor: &str| {
        let all = run.get("/api/v1/robots/robot/sensors");
        all.as_array().unwrap().iter().find(|one| one["declared"]["sensor"] == sensor).unwrap()["last"]
            .clone()
    };
    wait_until(|| last("imu").is_object() && last("pack").is_object());
    let charge = last("pack")["values"]["charge"].as_f64().unwrap();
    assert!((0.4..=0.5).contains(&charge), "{charge}");
    wait_until(|| last("pack")["values"]["charge"].as_f64().unwrap() < charge);
    assert!(last("gripper").is_null());

    let mut told = run.follow().filter(|event| event["event"] == "sensor" && event["sensor"] == "gripper");
    let report = |values: serde_json::Value| {
        let instruction =
            json!({ "instruction": "report", "robot": "robot", "sensor": "gripper", "values": values });
        run.post("/api/v1/instructions", &json!({ "instruction": instruction }).to_string())
    };
    assert_eq!(report(json!([1.5])).0, 409);
    assert_eq!(report(json!([1.5, -2.0])).0, 200);
    let reading = told.next().unwrap();
    assert_eq!(reading["values"], json!({ "0": 1.5, "1": -2.0 }));
    assert!(reading["measured_ns"].as_u64().unwrap() <= reading["at_ns"].as_u64().unwrap());
    assert_eq!(last("gripper")["values"], reading["values"]);

    run.signal("INT");
    run.wait();
    let listed = stdout(&output(["history", "events", run.folder.to_str().unwrap(), "--kinds", "decision"]));
    assert!(listed.contains("report [1.5, -2.0] as gripper of robot"), "{listed}");
}

#[test]
fn readings_are_listed_drawn_exported_and_rolled_up() {
    let folder = tempfile::tempdir().unwrap();
    let (file, out) = (testbed(&folder), folder.path().join("runs"));
    let ran = output([
        "run".as_ref(),
        file.as_os_str(),
        "--headless".as_ref(),
        "--simulate".as_ref(),
        "--until".as_ref(),
        "60s".as_ref(),
        "--out".as_ref(),
        out.as_os_str(),
    ]);
    assert!(ran.status.success(), "{}", stderr(&ran));
    let run = fs::read_dir(&out).unwrap().next().unwrap().unwrap().path();
    let run = run.to_str().unwrap();
    let ask = |arguments: &[&str]| {
        let answer = output([&["history"], arguments].concat());
        assert!(answer.status.success(), "{arguments:?}: {}", stderr(&answer));
        stdout(&answer)
    };
    let state = ask(&["state", run, "--at", "30s"]);
    assert!(state.contains("Sensors") && state.contains("charge 0.49"), "{state}");
    let events = ask(&["events", run, "--kinds", "sensor", "--to", "1s"]);
    assert!(
        events.contains("robot pack: charge 0.4") && events.contains("robot imu: acceleration_x"),
        "{events}"
    );
    let counted = || -> u64 {
        let drawn = ask(&["series", run, "sensor:robot:pack:charge", "--csv"]);
        drawn.lines().skip(1).map(|row| row.split(',').nth(2).unwrap().parse::<u64>().unwrap()).sum()
    };
    let before = counted();
    assert!((295..=301).contains(&before), "{before}");

    let pruned = ask(&["prune", run, "--raw", "20s", "--kinds", "sensor", "--yes"]);
    assert_eq!(counted(), before, "{pruned}");
    let left = ask(&["events", run, "--kinds", "sensor", "--to", "35s", "--limit", "10000"]).lines().count();
    assert!((60..=75).contains(&left), "{left} readings of two sensors are left of 35 s: {pruned}");

    let tables = folder.path().join("tables");
    ask(&["export", run, "--out", tables.to_str().unwrap()]);
    let values = fs::read_to_string(tables.join("sensor_value.csv")).unwrap();
    assert!(values.lines().any(|row| row.contains(",voltage_v,14.")), "{values}");
    let kept = folder.path().join("kept.sqlite");
    ask(&["import", tables.to_str().unwrap(), "--history", kept.to_str().unwrap()]);
    let state = ask(&["state", "1", "--at", "59s", "--history", kept.to_str().unwrap()]);
    assert!(state.contains("charge 0.49"), "{state}");
}
