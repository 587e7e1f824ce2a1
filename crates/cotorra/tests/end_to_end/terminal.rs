//! Text of others cannot control the terminal of who reads it.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{fs, path::Path, process::Output};

use cotorra_graph::{Event, Stamped, Timestamp, VnfEvent, VnfState};
use cotorra_measurements::{History, RunInfo};
use cotorra_plugin::runs::Runs;
use tempfile::TempDir;

use crate::harness::cotorra;

/// Sets the title of the terminal, clears it, and turns text.
const HOSTILE: &str = "evil\u{1b}]0;title\u{7}\u{9b}2J\u{202e}";
/// The same as people are shown it.
const SHOWN: &str = "evil\\u{1b}]0;title\\u{7}\\u{9b}2J\\u{202e}";

fn said(output: &Output) -> [String; 2] {
    [&output.stdout, &output.stderr].map(|bytes| String::from_utf8(bytes.clone()).unwrap())
}

/// Whether a text holds nothing that a terminal obeys.
fn is_harmless(text: &str) -> bool {
    !text.contains(['\u{1b}', '\u{7}', '\u{9b}', '\u{202e}'])
}

/// Makes a history with hostile names and reasons.
fn history(folder: &Path) -> String {
    let file = folder.join("history.sqlite");
    let history = History::open(&file).unwrap();
    let info = RunInfo { name: HOSTILE.to_owned(), seed: 1, started_at_unix_ns: 0, testbed: String::new() };
    let run = history.begin_run(&info).unwrap();
    let recorder = history.recorder(run).unwrap();
    let (vnf, node) = ("brain".parse().unwrap(), "edge".parse().unwrap());
    let failed = VnfEvent { vnf, node, state: VnfState::Failed, detail: Some(HOSTILE.to_owned()) };
    for event in [Event::Vnf(failed), Event::Notice { message: HOSTILE.to_owned() }] {
        recorder.record(Stamped { at: Timestamp::ZERO, event });
    }
    recorder.flush().unwrap();
    history.end_run(run, Timestamp::ZERO).unwrap();
    file.to_str().unwrap().to_owned()
}

#[test]
fn a_history_is_shown_with_escapes_and_its_json_is_exact() {
    let folder = TempDir::new().unwrap();
    let file = history(folder.path());
    for command in [&["runs"][..], &["events", "1"]] {
        let output = cotorra(["history"]).args(command).args(["--history", &file]).output().unwrap();
        let [printed, errors] = said(&output);
        assert!(output.status.success(), "{printed}{errors}");
        assert!(printed.contains(SHOWN) && is_harmless(&printed) && is_harmless(&errors), "{printed:?}");
    }
    let output = cotorra(["history", "events", "1", "--json", "--history", &file]).output().unwrap();
    let [printed, _] = said(&output);
    let events: Vec<Stamped> = printed.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert!(
        events.iter().any(|event| event.event == Event::Notice { message: HOSTILE.to_owned() }),
        "{printed:?}"
    );
    assert!(!printed.contains("\\u{"), "JSON has its own escapes: {printed:?}");
}

#[test]
fn errors_that_quote_a_file_are_shown_with_escapes() {
    let folder = TempDir::new().unwrap();
    let file = folder.path().join("testbed.yaml");
    fs::write(&file, format!("name: hall\nnodes:\n  \"{HOSTILE}\": {{ kind: server }}\n")).unwrap();
    let output = cotorra(["check"]).arg(&file).output().unwrap();
    let [printed, errors] = said(&output);
    assert!(!output.status.success() && errors.contains("title"), "{printed}{errors}");
    assert!(is_harmless(&printed) && is_harmless(&errors), "{printed:?}{errors:?}");
}

#[test]
fn names_of_runs_are_shown_with_escapes() {
    let folder = TempDir::new().unwrap();
    let runs = Runs::in_folder(folder.path().join("cotorra"));
    let _run = runs.announce(([127, 0, 0, 1], 7701).into(), HOSTILE, "/runs/hostile").unwrap();
    let output = cotorra(["ps"]).env("XDG_RUNTIME_DIR", folder.path()).output().unwrap();
    let [printed, errors] = said(&output);
    assert!(printed.contains(SHOWN) && is_harmless(&printed), "{printed:?}{errors:?}");
}
