//! Output and exit status of a run whose figures are not valid, or that does not get on.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{
    fs,
    io::{BufRead as _, BufReader, Write as _},
    net::TcpStream,
    path::{Path, PathBuf},
    process::{Output, Stdio},
};

use serde_json::Value;
use tempfile::TempDir;

use crate::harness::{Run, corridor, corridor_ending_in, cotorra, output, stderr, stdout};

/// A script that fails at its first import, after a line that it leaves in Python's buffer.
const FAILS: &str = "print('about to begin')\nimport no_such_module\n";
/// A script that follows the run for a while, prints a line, and is killed.
const IS_KILLED: &str = "import os\nprint('last words')\nos.kill(os.getpid(), 9)\n";

/// A script whose only instruction is rejected, and which then follows the run.
const IS_REJECTED: &str = r#"
import json, os
from urllib import error, request
def ask(path, body=None):
    headers = {"Content-Type": "application/json", "X-Cotorra-Plugin": os.environ["COTORRA_PLUGIN"]}
    if token := os.environ.get("COTORRA_TOKEN"):
        headers["Authorization"] = f"Bearer {token}"
    return request.urlopen(request.Request(os.environ["COTORRA_API"] + "/api/v1/" + path, body, headers))
try:
    ask("instructions", json.dumps({"instruction": {"instruction": "attach", "robot": "robot", "radio_unit": "R9"}}).encode())
except error.HTTPError:
    pass
for line in ask("events?kinds=robot"):
    if line.startswith(b"id: "):
        ask(f"marks/{int(line[4:])}", b"{}")
"#;

/// Writes the corridor with this script as its only plug-in.
fn corridor_with(script: &str, keys: &str, folder: &Path) -> PathBuf {
    let file = folder.join("script.py");
    fs::write(&file, script).unwrap();
    let plugin = format!("plugins:\n  - {{ id: mine, command: [python3, {}]{keys} }}\n", file.display());
    corridor_ending_in(&plugin, folder)
}

/// Runs a testbed in virtual time. Returns the output and the run's folder.
fn simulate(testbed: &Path, out: &Path, arguments: &[&str]) -> (Output, PathBuf) {
    let runs = out.join("runs");
    let places = ["run".as_ref(), testbed.as_os_str(), "--out".as_ref(), runs.as_os_str()];
    let done = output(
        places
            .into_iter()
            .chain(["--simulate", "--headless"].map(AsRef::as_ref))
            .chain(arguments.iter().map(AsRef::as_ref)),
    );
    let newest = fs::read_dir(&runs).unwrap().flatten().map(|run| run.path()).max();
    (done, newest.unwrap())
}

fn summary(folder: &Path) -> Value {
    serde_json::from_str(&fs::read_to_string(folder.join("summary.json")).unwrap()).unwrap()
}

#[test]
fn a_plugin_that_fails_at_its_first_import_voids_the_run() {
    let out = TempDir::new().unwrap();
    let testbed = corridor_with(FAILS, "", out.path());
    let (done, folder) = simulate(&testbed, out.path(), &["--until", "5s"]);
    let said = stdout(&done);
    assert_eq!(done.status.code(), Some(3), "{said}\n{}", stderr(&done));
    let second = said.lines().nth(1).unwrap();
    assert!(
        second.contains("NOT VALID: plug-in mine was cut off: its program ended: exit status: 1"),
        "{said}"
    );
    let summary = summary(&folder);
    assert!(summary["void"][0].as_str().unwrap().contains("logs/plugins/mine.log"), "{summary}");
    let log = fs::read_to_string(folder.join("logs/plugins/mine.log")).unwrap();
    assert!(log.contains("about to begin") && log.contains("no_such_module"), "{log}");
    assert!(fs::read_to_string(folder.join("service_time.svg")).unwrap().contains("NOT VALID"));
    let events = output([
        "history".as_ref(),
        "events".as_ref(),
        folder.as_os_str(),
        "--kinds".as_ref(),
        "notice".as_ref(),
    ]);
    assert!(
        stdout(&events).contains("the figures are not valid: plug-in mine was cut off"),
        "{}",
        stdout(&events)
    );
    let path = folder.to_str().unwrap();
    let difference = stdout(&output(["history", "diff", path, path]));
    let verdict = difference.lines().find(|line| line.contains("verdict")).unwrap();
    assert_eq!(verdict.matches("NOT VALID: plug-in mine was cut off").count(), 2, "{difference}");
    let listed = stdout(&output(["history", "runs", "--runs", folder.parent().unwrap().to_str().unwrap()]));
    assert!(listed.lines().nth(1).unwrap().ends_with("NOT VALID"), "{listed}");
}

#[test]
fn a_plugin_whose_instructions_are_all_rejected_is_named() {
    let out = TempDir::new().unwrap();
    let testbed = corridor_with(IS_REJECTED, "", out.path());
    let (done, folder) = simulate(&testbed, out.path(), &["--until", "5s"]);
    let said = stdout(&done);
    assert!(said.contains("plug-in mine  1 instruction, all rejected, the last because "), "{said}");
    assert_eq!(summary(&folder)["plugins"][0]["refused"], 1, "{said}");
}

#[test]
fn an_optional_plugin_that_ends_is_reported_and_what_a_killed_one_printed_is_kept() {
    let out = TempDir::new().unwrap();
    let testbed = corridor_with(IS_KILLED, ", optional: true", out.path());
    let (done, folder) = simulate(&testbed, out.path(), &["--until", "12s"]);
    let said = stdout(&done);
    assert_eq!(done.status.code(), Some(0), "{said}\n{}", stderr(&done));
    assert!(said.contains("optional plug-in mine was cut off: its program ended: signal: 9"), "{said}");
    assert_eq!(summary(&folder)["void"], serde_json::json!([]));
    let log = fs::read_to_string(folder.join("logs/plugins/mine.log")).unwrap();
    assert_eq!(log, "last words\n");
}

#[test]
fn a_plugin_whose_program_ends_voids_a_run_with_real_packets() {
    let out = TempDir::new().unwrap();
    let go = out.path().join("go");
    let script = format!("import os, time\nwhile not os.path.exists({:?}): time.sleep(0.01)\n", go.display());
    let testbed = corridor_with(&script, "", out.path());
    let mut run = Run::start_beside(&testbed, &[]);
    let mut faults = run.follow_only("?kinds=plugin_fault");
    fs::write(&go, "").unwrap();
    assert!(faults.next().is_some());
    run.signal("INT");
    let (_, printed, _) = run.wait();
    let summary = summary(&run.folder);
    let void = summary["void"].as_array().unwrap();
    let reason = "plug-in mine was cut off: its program ended: exit status: 0 (logs/plugins/mine.log)";
    assert!(void.iter().any(|its| its == reason), "{summary}");
    assert!(printed.contains("NOT VALID: plug-in mine"), "{printed}");
}

/// A robot that starts far from its radio unit.
const DEAF: &str = "
name: deaf
wireless: { lab: { path_loss: { model: log_distance, exponent: 3.0 } } }
nodes:
  r1: { kind: robot }
  A: { kind: radio_unit, position: [0, 0], channel: 1 }
  s: { kind: server, tier: edge, cpus: 4, memory: 8 GB }
links:
  - { ends: [A, s] }
services:
  navigation:
    robot: r1
    kpis: { service_time: 15 ms }
    vnfs:
      driver: { program: robot_driver, pinned_to: r1 }
      navigation: { program: navigation, node: s }
walks:
  r1: { waypoints: [[9000, 0], [1, 0]] }
";

#[test]
fn a_walk_without_progress_ends_with_the_robots_and_a_status_of_its_own() {
    let out = TempDir::new().unwrap();
    let testbed = out.path().join("deaf.yaml");
    fs::write(&testbed, DEAF).unwrap();
    let (done, folder) = simulate(&testbed, out.path(), &[]);
    let (said, told) = (stdout(&done), stderr(&done));
    assert!(told.contains("`r1` starts at (9000.0, 0.0), where it hears no radio unit"), "{told}");
    assert_eq!(summary(&folder)["ended"], "no robot made progress for 60 s");
    let stand = "NO PROGRESS: r1 is at (9000.0, 0.0), on its way to waypoint";
    assert!(said.contains(stand), "{said}");
    let void = summary(&folder)["void"].clone();
    assert_eq!((done.status.code(), void), (Some(5), serde_json::json!([])), "{said}\n{told}");
}

#[test]
fn a_history_at_its_limit_ends_the_run_in_order() {
    let out = TempDir::new().unwrap();
    let testbed = out.path().join("deaf.yaml");
    fs::write(&testbed, DEAF).unwrap();
    let (done, folder) = simulate(&testbed, out.path(), &["--until", "1h", "--history-limit", "2MB"]);
    assert_eq!(done.status.code(), Some(1), "{}", stdout(&done));
    assert!(stdout(&done).contains("its history reached 2 MB"), "{}", stdout(&done));
    assert_eq!(summary(&folder)["ended"], "the history reached its limit");
}

#[test]
fn a_replay_that_its_plugin_leaves_has_the_status_of_void_figures() {
    let out = TempDir::new().unwrap();
    let (_, folder) = simulate(&corridor(), out.path(), &["--until", "3s"]);
    let mut replay = cotorra(["replay", "--speed", "max", "--no-token", "--api", "127.0.0.1:0"]);
    let mut replay = replay.arg(&folder).stderr(Stdio::piped()).spawn().unwrap();
    let mut said = BufReader::new(replay.stderr.take().unwrap()).lines().map_while(Result::ok);
    let address =
        said.find_map(|line| Some(line.strip_prefix("API on http://")?.split_once(',')?.0.to_owned()));
    let mut plugin = TcpStream::connect(address.unwrap()).unwrap();
    let follow = "GET /api/v1/events HTTP/1.1\r\nHost: 127.0.0.1\r\nX-Cotorra-Plugin: mine\r\n\r\n";
    plugin.write_all(follow.as_bytes()).unwrap();
    // It follows once it gets something.
    assert!(BufReader::new(plugin).lines().map_while(Result::ok).any(|line| line.starts_with("data: ")));
    assert!(said.any(|line| line.contains("no plug-in follows any more")));
    assert_eq!(replay.wait().unwrap().code(), Some(3));
}
