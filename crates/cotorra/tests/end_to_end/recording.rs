//! Recordings of runs as MCAP: independent readers find the same data as in the run's other files.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
};

use serde_json::Value;
use tempfile::TempDir;

use crate::harness::{Run, corridor, cotorra, output, project_file, stderr, stdout, wait_until};

/// Simulates and records a minute of the corridor. Returns the run's folder.
fn minute(out: &Path) -> PathBuf {
    let mut command = cotorra(["run", "--simulate", "--headless", "--until", "60s", "--out"]);
    let done = command.arg(out).arg(corridor()).arg("--record").output().unwrap();
    assert!(done.status.success(), "{}", stderr(&done));
    let told = stdout(&done);
    assert!(told.contains("recording.mcap: ") && !told.contains("lacks"), "{told}");
    PathBuf::from(told.lines().find_map(|line| line.strip_suffix('/')).expect("it names its folder"))
}

/// Reads the messages of a file by independent readers. `None` if they are not installed.
fn read(file: &Path) -> Option<Vec<Value>> {
    let python = cotorra_testing::peers("rosbags, mcap, mcap-ros2-support")?;
    let script = project_file("crates/robots/recording/tests/peers/read.py");
    let read = Command::new(python).arg(script).arg(file).output().unwrap();
    assert!(read.status.success(), "{}", stderr(&read));
    Some(stdout(&read).lines().map(|line| serde_json::from_str(line).unwrap()).collect())
}

fn on<'a>(messages: &'a [Value], topic: &str) -> Vec<&'a Value> {
    messages.iter().filter(|told| told["topic"] == topic).collect()
}

#[test]
fn a_run_in_virtual_time_is_recorded_to_the_same_bytes() {
    let place = TempDir::new().unwrap();
    let (one, other) = (minute(&place.path().join("one")), minute(&place.path().join("other")));
    let bytes = |folder: &Path| fs::read(folder.join("recording.mcap")).unwrap();
    assert!(bytes(&one) == bytes(&other), "the same seed is the same file");

    let Some(messages) = read(&one.join("recording.mcap")) else { return };
    // The lidar turns ten times a second; the last turn may end with the run.
    let scans = on(&messages, "/robot/scan");
    assert!((599..=600).contains(&scans.len()), "{} scans", scans.len());
    assert_eq!(scans[7]["value"]["ranges"].as_array().unwrap().len(), 360);
    assert_eq!(on(&messages, "/map")[0]["value"]["header"]["frame_id"], "map");

    let csv = fs::read_to_string(one.join("service_time.csv")).unwrap();
    let mut told: Vec<_> =
        on(&messages, "/robot/service_time").iter().map(|sample| &sample["value"]).collect();
    let key = |service: &str, sequence: &str| (service.to_owned(), sequence.parse::<u64>().unwrap());
    told.sort_by_cached_key(|sample| {
        key(sample["service"].as_str().unwrap(), &sample["sequence"].to_string())
    });
    let mut rows: Vec<Vec<_>> = csv.lines().skip(1).map(|line| line.split(',').collect()).collect();
    rows.sort_by_cached_key(|cells| key(cells[2], cells[3]));
    assert_eq!(told.len(), rows.len());
    for (sample, cells) in told.iter().zip(&rows) {
        assert_eq!(sample["sequence"].to_string(), cells[3]);
        match sample["service_time_ms"].as_f64() {
            Some(took) => assert!((took - cells[4].parse::<f64>().unwrap()).abs() < 1e-6, "{cells:?}"),
            None => assert_eq!((&sample["service_time_ms"], cells[4]), (&Value::from("nan"), "")),
        }
        assert_eq!(
            (&sample["attached_to"], &sample["server"]),
            (&cells[5].into(), &cells[6].into()),
            "{cells:?}"
        );
    }

    // An export from the history has all of it except scans.
    let file = place.path().join("exported.mcap");
    let export = |folder: &Path| {
        let (folder, file) = (folder.to_str().unwrap(), file.to_str().unwrap());
        let base = project_file("testbeds");
        output([
            "history",
            "export",
            folder,
            "--format",
            "mcap",
            "--out",
            file,
            "--base",
            base.to_str().unwrap(),
        ])
    };
    let done = export(&one);
    assert!(done.status.success(), "{}", stderr(&done));
    let exported = read(&file).unwrap();
    assert_eq!(exported.len(), messages.len() - scans.len());
    let without_scans = messages.iter().filter(|told| told["topic"] != "/robot/scan");
    for (exported, told) in exported.iter().zip(without_scans) {
        assert_eq!(exported, told);
    }
    let again = export(&one);
    assert!(!again.status.success() && stderr(&again).contains("exists already"), "{}", stderr(&again));
}

#[test]
fn an_emulated_run_that_is_interrupted_leaves_a_whole_recording() {
    let place = TempDir::new().unwrap();
    let file = place.path().join("mine.mcap");
    let mut run = Run::start(&corridor(), &["--record", file.to_str().unwrap()]);
    run.wait_for_service();
    run.signal("INT");
    let (_, printed) = run.report();
    assert!(printed.contains("mine.mcap: ") && !printed.contains("lacks"), "{printed}");
    let Some(messages) = read(&file) else { return };
    assert!(!on(&messages, "/robot/service_time").is_empty());
    assert!(!on(&messages, "/robot/scan").is_empty());
}

#[test]
fn an_emulated_run_that_is_killed_leaves_its_complete_chunks() {
    let mut run = Run::start(&corridor(), &["--record"]);
    let file = run.folder.join("recording.mcap");
    // Large enough for the first chunk of messages with its schemas.
    wait_until(|| fs::read(&file).is_ok_and(|bytes| bytes.len() > 20_000));
    run.signal("KILL");
    run.wait();
    let bytes = fs::read(&file).unwrap();
    assert!(bytes.starts_with(b"\x89MCAP0\r\n"));
    let Some(python) = cotorra_testing::peers("mcap") else { return };
    let script = project_file("crates/robots/recording/tests/peers/recover.py");
    let read = Command::new(python).arg(script).arg(&file).output().unwrap();
    assert!(read.status.success(), "{}", stderr(&read));
    assert!(stdout(&read).trim().parse::<u32>().unwrap() > 10, "{}", stdout(&read));
}

#[test]
fn invalid_recordings_are_rejected_before_the_run() {
    let refused = |arguments: &[&str]| {
        let place = TempDir::new().unwrap();
        let mut command = cotorra(["run", "--headless", "--out"]);
        command.arg(place.path()).arg(corridor()).args(arguments);
        let done = command.output().unwrap();
        assert!(!done.status.success());
        stderr(&done).split_whitespace().filter(|word| *word != "│").collect::<Vec<_>>().join(" ")
    };
    assert!(refused(&["--record", "testbed.yaml"]).contains("must end with .mcap"));
    assert!(refused(&["--simulate", "--foxglove"]).contains("cannot be used with"));
    assert!(refused(&["--record", "/nowhere/run.mcap"]).contains("cannot write /nowhere/run.mcap"));
}
