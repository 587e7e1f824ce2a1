//! `cotorra bench vnf`: CPU time of requests, as samples of a demand.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{fs, path::Path, process::Output};

use tempfile::TempDir;

use crate::harness::{corridor, corridor_ending_in, cotorra, stderr, stdout};

/// Answers each datagram after 5 ms of CPU time.
const BURNING: &str = r#"
import os, socket, time
own = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
own.bind(("127.0.0.1", int(os.environ["COTORRA_PORT"])))
while True:
    request, sender = own.recvfrom(2048)
    until = time.process_time() + 0.005
    while time.process_time() < until:
        pass
    own.sendto(b"done", sender)
"#;

fn bench(folder: &Path, file: &Path, arguments: &[&str]) -> Output {
    let file = file.to_str().unwrap();
    cotorra(["bench", "vnf", file]).args(arguments).current_dir(folder).output().unwrap()
}

/// Returns the times in a file, ms.
fn times_ms(file: &Path) -> Vec<f64> {
    let text = fs::read_to_string(file).unwrap();
    let lines = text.strip_prefix("cpu_time_ms\n").unwrap_or_else(|| panic!("{text}"));
    lines.lines().map(|line| line.parse().unwrap()).collect()
}

#[test]
fn measured_times_are_samples_of_a_demand() {
    let folder = TempDir::new().unwrap();
    let out = folder.path().join("demand.csv");
    for (vnf, requests) in [("navigation", "60"), ("localization", "8")] {
        let done =
            bench(folder.path(), &corridor(), &["--vnf", vnf, "--requests", requests, "--out", "demand.csv"]);
        assert!(done.status.success(), "{}", stderr(&done));
        let (shown, times) = (stdout(&done), times_ms(&out));
        println!("{shown}");
        assert!(shown.starts_with(&format!("{vnf}, {} requests", times.len())), "{shown}");
        assert!(shown.contains("median") && shown.contains("demand: { samples: demand.csv }"), "{shown}");
        // The first request does not count.
        assert!(times.len() < requests.parse().unwrap() && times.len() > 3, "{times:?}");
        assert!(times.iter().all(|ms| *ms > 0.0), "{times:?}");
    }
    let file = corridor_ending_in("", folder.path());
    let text = fs::read_to_string(&file).unwrap();
    let with = text.replace("program: navigation", "program: navigation, demand: { samples: demand.csv }");
    assert_ne!(with, text);
    fs::write(&file, with).unwrap();
    let checked = cotorra(["check"]).arg(&file).output().unwrap();
    assert!(checked.status.success(), "{}", stderr(&checked));
}

#[test]
fn a_command_takes_the_place_of_the_program() {
    let folder = TempDir::new().unwrap();
    fs::write(folder.path().join("burning.py"), BURNING).unwrap();
    let arguments =
        ["--vnf", "navigation", "--requests", "21", "--out", "demand.csv", "--", "python3", "burning.py"];
    let done = bench(folder.path(), &corridor(), &arguments);
    assert!(done.status.success(), "{}", stderr(&done));
    let times = times_ms(&folder.path().join("demand.csv"));
    println!("{}", stdout(&done));
    assert_eq!(times.len(), 20);
    assert!(times.iter().all(|ms| (4.99..15.0).contains(ms)), "{times:?}");
}

#[test]
fn programs_that_cannot_be_measured_are_named() {
    let folder = TempDir::new().unwrap();
    for (arguments, part) in [
        (&["--vnf", "brain"][..], "the testbed has no VNF `brain`"),
        (&["--vnf", "robot-driver"], "VNF `robot-driver` is no bundled VNF, navigation or localization"),
        (&["--vnf", "navigation", "--", "false"], "the program ended with exit status: 1"),
        (&["--vnf", "navigation", "--", "/no/such/program"], "cannot start the program"),
    ] {
        let done = bench(folder.path(), &corridor(), arguments);
        assert_eq!(done.status.code(), Some(1), "{}", stdout(&done));
        assert!(stderr(&done).contains(part), "{}", stderr(&done));
    }
}
