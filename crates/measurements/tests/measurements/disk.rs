//! Tests on disks that are really full or read-only: small file systems in memory, in a mount namespace of their own.
#![allow(clippy::unwrap_used, reason = "a test says so by failing")]

use std::{
    fs,
    io::Write,
    path::{Path, PathBuf},
    process::Command,
};

use cotorra_graph::{Event, Stamped, Timestamp};
use cotorra_measurements::{Error, History, PageRequest, RunId, RunInfo};

const FOLDER: &str = "COTORRA_TEST_FOLDER";

fn numbered(n: u64) -> Stamped {
    let event = Event::Notice { message: format!("number {n} {}", "x".repeat(200)) };
    Stamped { at: Timestamp::from_nanos(n), event }
}

fn everything(history: &History, run: RunId) -> Vec<Stamped> {
    history.events(run, &[], .., PageRequest::first(PageRequest::MAX)).unwrap().items
}

fn all(numbers: u64) -> Vec<Stamped> {
    (0..numbers).map(numbered).collect()
}

fn info() -> RunInfo {
    RunInfo { name: "disk".into(), seed: 1, started_at_unix_ns: 0, testbed: String::new() }
}

/// Returns the folder of a test that runs in a namespace.
fn folder() -> Option<PathBuf> {
    std::env::var_os(FOLDER).map(PathBuf::from)
}

/// Runs commands in a mount namespace, with a file system of 2 MB in `$COTORRA_TEST_FOLDER`. In them, `inside NAME`
/// runs one of the tests below.
fn in_a_small_file_system(commands: &str) {
    let folder = tempfile::tempdir().unwrap();
    let unshare = |script: &str| {
        Command::new("unshare")
            .args(["--map-root-user", "--mount", "sh", "-euc", script])
            .env(FOLDER, folder.path())
            .env("SELF", std::env::current_exe().unwrap())
            .output()
    };
    let mount = format!("mount -t tmpfs -o size=2M tmpfs \"${FOLDER}\"");
    if !unshare(&mount).is_ok_and(|output| output.status.success()) {
        assert!(std::env::var_os("CI").is_none(), "the kernel lets nobody make a mount namespace");
        eprintln!("skipped: the kernel lets nobody make a mount namespace");
        return;
    }
    let inside = "inside() { \"$SELF\" \"$1\" --exact --ignored --nocapture; }";
    let output = unshare(&format!("{mount}\n{inside}\n{commands}")).unwrap();
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    assert!(output.status.success(), "{}{}", text(&output.stdout), text(&output.stderr));
}

#[test]
fn a_disk_that_is_full_for_a_while_loses_nothing() {
    in_a_small_file_system("inside disk::fills_the_disk\ninside disk::opens_what_was_filled");
}

/// Fills the disk with another file.
fn ballast(folder: &Path) -> PathBuf {
    let path = folder.join("ballast");
    fs::write(&path, vec![1; 1_000_000]).unwrap();
    path
}

#[test]
#[ignore = "is run by the test above"]
fn fills_the_disk() {
    let Some(folder) = folder() else { return };
    let ballast = ballast(&folder);
    let history = History::open(folder.join("history.sqlite")).unwrap();
    let run = history.begin_run(&info()).unwrap();
    let recorder = history.recorder(run).unwrap();
    let (mut recorded, mut acknowledged, mut failures) = (0, 0, 0);
    while failures < 5 {
        for _ in 0..100 {
            recorder.record(numbered(recorded));
            recorded += 1;
        }
        match recorder.flush() {
            Ok(()) => acknowledged = recorded,
            Err(Error::Full { .. }) => failures += 1,
            Err(other) => panic!("{other}"),
        }
    }
    // Reading still works.
    assert!(acknowledged > 0 && everything(&history, run) == all(acknowledged));
    assert!(matches!(history.end_run(run, Timestamp::ZERO), Err(Error::Full { .. })));

    fs::remove_file(&ballast).unwrap();
    recorder.flush().unwrap();
    assert!(everything(&history, run) == all(recorded));
    assert_eq!(recorder.stats().dropped, 0);

    // And once more, to the end: what was acknowledged is there when the history is opened again.
    let mut rest = fs::File::create(&ballast).unwrap();
    while rest.write_all(&[1; 4096]).is_ok() {}
    for _ in 0..1000 {
        recorder.record(numbered(recorded));
        recorded += 1;
    }
    assert!(matches!(recorder.flush(), Err(Error::Full { .. })));
}

#[test]
#[ignore = "is run by the test above"]
fn opens_what_was_filled() {
    let Some(folder) = folder() else { return };
    let history = History::open(folder.join("history.sqlite")).unwrap();
    let run = history.runs(None, 1).unwrap()[0].id;
    let found = everything(&history, run);
    assert!(!found.is_empty() && found == all(found.len() as u64));
}

#[test]
fn a_read_only_file_system_causes_an_error() {
    in_a_small_file_system(
        "inside disk::makes_a_history\nmount -o remount,ro \"$COTORRA_TEST_FOLDER\"\ninside disk::is_refused",
    );
}

#[test]
#[ignore = "is run by the test above"]
fn makes_a_history() {
    let Some(folder) = folder() else { return };
    History::open(folder.join("history.sqlite")).unwrap().begin_run(&info()).unwrap();
}

#[test]
#[ignore = "is run by the test above"]
fn is_refused() {
    let Some(folder) = folder() else { return };
    let refusal = |name: &str| match History::open(folder.join(name)) {
        Ok(_) => panic!("{name} cannot be written"),
        Err(error) => error,
    };
    assert!(matches!(refusal("history.sqlite"), Error::ReadOnly { .. }));
    assert!(matches!(refusal("another.sqlite"), Error::Open { .. }));
}
