//! Runs that are interrupted or killed: nothing acknowledged is lost, and nothing is left behind.

use std::fs;

use rusqlite::{Connection, OpenFlags};

use crate::harness::{Run, are_held, corridor, output, stdout, wait_until};

/// Starts a run, and waits until its history has service times.
fn run_for_a_while() -> Run {
    let run = Run::start(&corridor(), &["--until", "5min"]);
    run.wait_for_service();
    run
}

fn assert_nothing_is_left(run: &Run, namespaces: &std::collections::BTreeSet<u64>) {
    wait_until(|| run.processes().is_empty());
    wait_until(|| !are_held(namespaces));
}

#[test]
fn ctrl_c_and_sigterm_end_a_run_in_order() {
    let ctrl_c = |run: &Run| run.signal_group("INT");
    let terminate = |run: &Run| run.signal("TERM");
    for interrupt in [&ctrl_c as &dyn Fn(&Run), &terminate] {
        let mut run = run_for_a_while();
        let namespaces = run.namespaces();
        assert!(are_held(&namespaces));
        assert!(run.processes().len() >= 2, "the run and its navigation VNF");
        interrupt(&run);
        let (summary, _) = run.report();
        assert!(summary["samples"].as_u64().unwrap() > 0, "{summary:#}");
        let log = fs::read_to_string(run.folder.join("logs/cotorra.log")).unwrap();
        assert!(!log.contains("WARN") && !log.contains("ERROR"), "nothing went wrong on the way:\n{log}");
        assert_nothing_is_left(&run, &namespaces);
        assert_eq!(run.control_groups(), Vec::<std::path::PathBuf>::new());
    }
}

#[test]
fn kill_9_loses_nothing_that_was_kept_and_leaves_nothing_that_runs() {
    let mut run = run_for_a_while();
    let namespaces = run.namespaces();
    assert!(run.processes().len() >= 2, "the run and its navigation VNF");
    let groups = run.control_groups();
    run.signal("KILL");
    let (status, ..) = run.wait();
    assert_eq!(status.code(), None);
    assert_nothing_is_left(&run, &namespaces);

    // Everything that the API had shown before is still there.
    let history = run.folder.join("history.sqlite");
    let history = Connection::open_with_flags(history, OpenFlags::SQLITE_OPEN_READ_WRITE).unwrap();
    let integrity: String = history.query_row("PRAGMA integrity_check", [], |row| row.get(0)).unwrap();
    assert_eq!(integrity, "ok");
    let samples: i64 = history.query_row("SELECT count(*) FROM service_time", [], |row| row.get(0)).unwrap();
    assert!(samples > 0);
    assert!(!run.folder.join("summary.json").exists(), "a killed run has no report");

    // Only control groups and its entry outlive a killed run, until the next start or `clean`.
    for group in &groups {
        let found = stdout(&output(["clean", "--dry-run"]));
        assert!(!group.exists() || found.contains(&group.display().to_string()), "{found}");
    }
    assert!(output(["clean"]).status.success());
    assert_eq!(groups.iter().filter(|group| fs::exists(group).unwrap()).count(), 0);
}
