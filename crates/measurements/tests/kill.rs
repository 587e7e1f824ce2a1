//! What was acknowledged survives kill -9, whenever it comes.
#![allow(clippy::unwrap_used, reason = "a test says so by failing")]

use std::{
    io::{BufRead, BufReader, Write},
    process::{Command, Stdio},
};

use cotorra_graph::{Event, Stamped, Timestamp};
use cotorra_measurements::{History, PageRequest, RunId, RunInfo};

const PATH: &str = "COTORRA_TEST_HISTORY";

/// The process that is killed: records numbers for ever, and says how far it has been told that they are durable.
#[test]
#[ignore = "is started and killed by the test below"]
fn records_until_it_is_killed() {
    let Some(path) = std::env::var_os(PATH) else { return };
    let history = History::open(path).unwrap();
    let info = RunInfo { name: "killed".into(), seed: 1, started_at_unix_ns: 0, testbed: String::new() };
    let run = history.begin_run(&info).unwrap();
    let recorder = history.recorder(run).unwrap();
    let mut acknowledge = std::io::stdout();
    writeln!(acknowledge, "\nrun {run}").unwrap();
    for n in 0_u64.. {
        recorder.record(numbered(n));
        if n % 61 == 0 {
            recorder.flush().unwrap();
            writeln!(acknowledge, "durable {n}").unwrap();
        }
    }
}

fn numbered(n: u64) -> Stamped {
    let event = Event::Notice { message: format!("number {n}") };
    Stamped { at: Timestamp::from_nanos(n * 1000), event }
}

#[test]
fn what_was_acknowledged_survives_kill_9() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("history.sqlite");
    // One file, killed again and again: between acknowledgements, soon after the start, and late.
    let acknowledged: Vec<(RunId, u64)> = [0, 1, 2, 3, 5, 8, 40, 100]
        .into_iter()
        .map(|acknowledgements| kill_after(acknowledgements, &path))
        .collect();

    let history = History::open(&path).unwrap();
    assert_eq!(history.runs(None, 100).unwrap().len(), acknowledged.len());
    for (run, durable) in acknowledged {
        let mut found = 0;
        let mut request = PageRequest::first(1000);
        loop {
            let page = history.events(run, &[], .., request).unwrap();
            for stamped in page.items {
                assert_eq!(stamped, numbered(found), "nothing is missing in between");
                found += 1;
            }
            let Some(next) = page.next else { break };
            request = PageRequest::after(next, 1000);
        }
        assert!(found > durable, "run {run}: {durable} was acknowledged, but only {found} are there");
        assert_eq!(history.run(run).unwrap().ended, None);
    }
}

/// Gives back the run, and the last number that was acknowledged before the process died.
fn kill_after(acknowledgements: usize, path: &std::path::Path) -> (RunId, u64) {
    let mut child = Command::new(std::env::current_exe().unwrap())
        .args(["records_until_it_is_killed", "--exact", "--ignored", "--nocapture"])
        .env(PATH, path)
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines().map_while(Result::ok);
    let run = lines.find_map(|line| line.strip_prefix("run ").map(|run| run.parse().unwrap())).unwrap();
    let mut durable = lines.filter_map(|line| line.strip_prefix("durable ").map(|n| n.parse().unwrap()));
    let mut last: u64 = durable.next().unwrap();
    for _ in 0..acknowledgements {
        last = durable.next().unwrap();
    }
    child.kill().unwrap();
    child.wait().unwrap();
    // What it said until it died counts as well.
    (run, durable.last().unwrap_or(last))
}
