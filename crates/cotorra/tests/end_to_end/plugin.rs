//! A plug-in of anyone's: a Python script that uses the API and nothing else.

use std::{
    fs,
    process::{Command, Stdio},
};

use crate::harness::{Run, corridor, project_file, wait_until};

#[test]
fn the_python_example_runs_against_a_live_testbed() {
    let script = project_file("examples/strongest_signal.py");
    assert!(fs::read_to_string(&script).unwrap().lines().count() < 60);
    let run = Run::start(&corridor(), &["--until", "5min"]);
    run.wait_for_service();
    let mut python = Command::new("python3");
    python.arg(script).env("COTORRA_API", &run.api).env("COTORRA_PLUGIN", "strongest-signal");
    let mut python = python.stdout(Stdio::null()).spawn().unwrap();
    // It asks for scans, and what it asks for is done.
    wait_until(|| {
        python.try_wait().unwrap().is_some()
            || run.get("/api/v1/robots/robot")["attachments"]
                .as_array()
                .unwrap()
                .iter()
                .filter(|attachment| attachment["signal"].is_number())
                .count()
                > 1
    });
    assert!(python.try_wait().unwrap().is_none(), "it ended by itself");
    python.kill().unwrap();
    python.wait().unwrap();
}
