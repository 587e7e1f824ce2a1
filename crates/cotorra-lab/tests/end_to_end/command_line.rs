//! Benchmarks and tests with faults.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{
    io::{BufRead, BufReader},
    process::{Command, Stdio},
};

use cotorra_testing::{stderr, stdout};

use crate::lab;

#[test]
fn benchmarks_are_listed_and_an_unknown_one_is_refused() {
    let listed = stdout(&lab(["bench", "--list"]).output().unwrap());
    assert!(listed.contains("round-trip"), "{listed}");
    let unknown = lab(["bench", "round-tripp"]).output().unwrap();
    assert_eq!(unknown.status.code(), Some(1));
    assert!(stderr(&unknown).contains("round-trip"), "{}", stderr(&unknown));
}

#[test]
fn a_fault_test_stopped_by_ctrl_c_prints_its_totals() {
    let mut command = lab(["fault-test", "--headless", "--runs", "100"]);
    let mut child = command.stderr(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
    let pid = child.id().to_string();
    for line in BufReader::new(child.stderr.take().unwrap()).lines().map_while(Result::ok) {
        if line.starts_with("5 of 100 runs") {
            assert!(Command::new("kill").args(["-INT", &pid]).status().unwrap().success());
        }
    }
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(130), "{}", stdout(&output));
    let summary = stdout(&output);
    assert!(summary.lines().next().unwrap().contains(" of 100 runs, "), "{summary}");
    assert!(summary.contains("packets are conserved"), "{summary}");
}

#[test]
fn the_number_of_jobs_does_not_change_a_fault_test() {
    let test = |seed: &str, jobs: &str| {
        let line = ["fault-test", "--headless", "--runs", "3", "--seed", seed, "--jobs", jobs];
        stdout(&lab(line).output().unwrap())
    };
    let printed = test("1", "1");
    assert!(printed.starts_with("3 of 3 runs, "), "{printed}");
    assert!(printed.contains("nothing acknowledged is lost"), "{printed}");
    assert_eq!(test("1", "3"), printed);
    assert_ne!(test("4", "1"), printed);
}
