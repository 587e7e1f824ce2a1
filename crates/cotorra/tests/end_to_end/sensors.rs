//! Robots with declared sensors, with real packets and in virtual time.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{
    fs,
    io::{BufRead, BufReader},
    path::{Path, PathBuf},
    process::{Command, Stdio},
};

use serde_json::json;

use crate::harness::{Run, cotorra, output, project_file, stderr, stdout, wait_until};

const SENSORS: &str = "pack: { kind: battery, rate: 5 Hz, charge: 50 % }, imu: { kind: imu },
    gripper: { kind: vector, size: 2, unit: N }";

/// Writes `testbeds/two-paths.yaml` with sensors to a folder.
fn testbed(folder: &tempfile::TempDir, sensors: &str) -> PathBuf {
    let text = fs::read_to_string(project_file("testbeds/two-paths.yaml")).unwrap();
    let robot = format!("robot: {{ kind: robot, sensors: {{ {sensors} }} }}");
    let with_sensors = text.replace("robot: { kind: robot }", &robot);
    assert_ne!(text, with_sensors);
    let file = folder.path().join("sensing.yaml");
    fs::write(&file, with_sensors).unwrap();
    file
}

#[test]
fn sensors_are_read_followed_and_reported_over_the_api_and_kept() {
    let folder = tempfile::tempdir().unwrap();
    let mut run = Run::start_beside(&testbed(&folder, SENSORS), &["--until", "600s"]);
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
    let (file, out) = (testbed(&folder, SENSORS), folder.path().join("runs"));
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

/// Returns the size of all files in a folder in bytes. A file that is removed meanwhile counts as empty.
fn on_disk(folder: &Path) -> u64 {
    let files = fs::read_dir(folder).into_iter().flatten().flatten();
    files.map(|file| file.metadata().map_or(0, |file| file.len())).sum()
}

const LAST: &str = r#"
import sys
from cotorra import Client, CotorraError

testbed = Client(sys.argv[1])
last = testbed.large_data("robot", "front")
assert (last.format, last.width, last.height, len(last.data)) == ("scan", 360, 1, 1500), last
assert last.measured_ns > 0 and testbed.large_data("robot", "front", last.sequence) == last
try:
    testbed.large_data("robot", "front", 0)
except CotorraError as error:
    assert "410" in str(error), error
else:
    sys.exit("it is not gone")
"#;

/// Runs a Python program against an API.
fn python(program: &str, api: &str) {
    let mut python = Command::new("python3");
    python.args(["-c", program, api]).env("PYTHONPATH", project_file("clients/python"));
    let ran = python.env("PYTHONDONTWRITEBYTECODE", "1").output().unwrap();
    assert!(ran.status.success(), "{}", stderr(&ran));
}

#[test]
fn scans_of_a_lidar_are_followed_fetched_and_kept_within_their_bound() {
    const KEEP: u64 = 40_000;
    let place = tempfile::tempdir().unwrap();
    let sensors = format!("{SENSORS}, front: {{ kind: lidar, keep: 40 kB }}");
    let mut run = Run::start_beside(&testbed(&place, &sensors), &["--until", "600s"]);
    let folder = run.folder.join("sensors/robot/front");
    let path = |reading: &str| format!("/api/v1/robots/robot/sensors/front/{reading}");
    let mut fetched = Vec::new();
    let mut before = None;
    for event in run.follow_only("?kinds=sensor&sensors=front").take(35) {
        let (sensor, data) = (event["sensor"].as_str().unwrap(), &event["data"]);
        let sequence = data["sequence"].as_u64().unwrap();
        assert_eq!((sensor, data["format"].as_str(), &data["bytes"]), ("front", Some("scan"), &json!(1500)));
        assert!(before.is_none_or(|before| before + 1 == sequence), "{before:?}, {sequence}");
        before = Some(sequence);
        // The data is available as soon as its event is.
        let (bytes, header) = run.bytes(&path(&sequence.to_string()));
        assert_eq!(bytes.len(), 1500);
        for (name, value) in [
            ("content-type", "application/octet-stream"),
            ("x-cotorra-format", "scan"),
            ("x-cotorra-width", "360"),
            ("x-cotorra-height", "1"),
            ("x-cotorra-sequence", &sequence.to_string()),
            ("x-cotorra-measured-ns", &event["measured_ns"].to_string()),
        ] {
            assert_eq!(header(name), value, "{name}");
        }
        fetched.push((sequence, bytes));
        let size = on_disk(&folder);
        assert!(size <= KEEP, "{size} bytes are kept");
    }
    // There is room for 25 readings, so that the first is gone.
    assert_eq!(run.ask(&path("0"), None).0, 410);
    assert_eq!(run.ask(&path("1000000"), None).0, 404);
    let (_, header) = run.bytes(&path("latest"));
    assert!(header("x-cotorra-sequence").parse::<u64>().unwrap() >= before.unwrap());
    python(LAST, &run.api);

    run.signal("INT");
    run.wait();
    let size = on_disk(&folder);
    assert!((KEEP / 8 * 7 - 2 * 1552..=KEEP).contains(&size), "{size} bytes are kept");
    let (run, file) = (run.folder.to_str().unwrap(), place.path().join("scan"));
    let ask = |sequence: &[&str]| {
        let asked = [&["history", "data", run, "robot", "front"], sequence, &["-o", file.to_str().unwrap()]];
        output(asked.concat())
    };
    let (last, bytes) = fetched.last().unwrap();
    let told = ask(&[&last.to_string()]);
    assert!(stdout(&told).starts_with(&format!("scan {last} of 360 x 1, 1500 bytes")), "{told:?}");
    assert!(fs::read(&file).unwrap() == *bytes, "the run's folder has other bytes than the API");
    assert!(ask(&[]).status.success());
    let gone = ask(&["0"]);
    assert!(!gone.status.success() && stderr(&gone).contains("no such reading"), "{gone:?}");
    let listed = stdout(&output(["history", "events", run, "--kinds", "sensor", "--limit", "10000"]));
    assert!(listed.contains(&format!("robot front: scan {last} of 360 x 1, 1500 bytes")), "{listed}");
}

const AT_TEN_SECONDS: &str = r#"
import sys
from cotorra import Client, CotorraError

testbed = Client(sys.argv[1])
last = testbed.large_data("robot", "front")
assert 9.7e9 < last.measured_ns < 10e9 and 90 < last.sequence < 110, last
assert len(testbed.large_data("robot", "front", 20).data) == 1500
try:
    testbed.large_data("robot", "front", 150)
except CotorraError as error:
    assert "404" in str(error), error
else:
    sys.exit("it tells what is to come")
"#;

#[test]
fn a_replay_gives_large_data_up_to_the_time_that_is_played() {
    let place = tempfile::tempdir().unwrap();
    let (file, out) = (testbed(&place, "front: { kind: lidar }"), place.path().join("runs"));
    let mut run = cotorra(["run", "--headless", "--simulate", "--until", "20s", "--out"]);
    let ran = run.arg(&out).arg(&file).output().unwrap();
    assert!(ran.status.success(), "{}", stderr(&ran));
    let folder = fs::read_dir(&out).unwrap().next().unwrap().unwrap().path();
    let base = project_file("testbeds");
    let mut replay =
        cotorra(["replay", "--speed", "0.001x", "--from", "10s", "--api", "127.0.0.1:0", "--base"]);
    let mut replay = replay.arg(&base).arg(&folder).stderr(Stdio::piped()).spawn().unwrap();
    let mut said = BufReader::new(replay.stderr.take().unwrap());
    let mut line = String::new();
    said.read_line(&mut line).unwrap();
    let api = line.strip_prefix("API on ").and_then(|line| line.split_once(", replay of ")).expect(&line).0;
    python(AT_TEN_SECONDS, api);
    replay.kill().unwrap();
    replay.wait().unwrap();
}
