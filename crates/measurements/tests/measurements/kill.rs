//! Acknowledged events survive kill -9 at any time: in a file, in a server, and in a spool.
#![allow(clippy::unwrap_used, reason = "a test says so by failing")]

use std::{
    io::{BufRead, BufReader, Write},
    process::{Child, Command, Stdio},
};

use cotorra_graph::{Event, Stamped, Timestamp};
use cotorra_measurements::{History, Location, PageRequest, RunId, RunInfo};
use cotorra_testing::mariadb::MariaDb;

const PATH: &str = "COTORRA_TEST_HISTORY";

/// Runs in the process that is killed: records numbers for ever, and prints the last one that is durable.
#[test]
#[ignore = "is started and killed by the test below"]
fn records_until_it_is_killed() {
    let Ok(location) = std::env::var(PATH) else { return };
    let mut acknowledge = std::io::stdout();
    writeln!(acknowledge, "\nopening").unwrap();
    let history = History::connect(&location.parse().unwrap()).unwrap();
    let info = RunInfo { name: "killed".into(), seed: 1, started_at_unix_ns: 0, testbed: String::new() };
    let run = history.begin_run(&info).unwrap();
    let recorder = history.recorder(run).unwrap();
    writeln!(acknowledge, "run {run}").unwrap();
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

/// The process that is killed.
struct Recording {
    child: Child,
    lines: Box<dyn Iterator<Item = String>>,
}

impl Recording {
    fn start(location: &str) -> Self {
        let mut child = Command::new(std::env::current_exe().unwrap())
            .args(["kill::records_until_it_is_killed", "--exact", "--ignored", "--nocapture"])
            .env(PATH, location)
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let lines = BufReader::new(child.stdout.take().unwrap()).lines().map_while(Result::ok);
        let mut lines = Box::new(lines);
        lines.find(|line| line == "opening").unwrap();
        Self { child, lines }
    }

    fn run(&mut self) -> RunId {
        self.lines.find_map(|line| line.strip_prefix("run ").map(|run| run.parse().unwrap())).unwrap()
    }

    /// Returns the next number that is acknowledged, if there is one.
    fn durable(&mut self) -> Option<u64> {
        self.lines.find_map(|line| line.strip_prefix("durable ").map(|n| n.parse().unwrap()))
    }

    /// Waits for a number of acknowledgements.
    fn wait(&mut self, acknowledgements: usize) {
        for _ in 0..acknowledgements {
            self.durable().unwrap();
        }
    }

    /// Kills the process, and returns the last number that it acknowledged until it died.
    fn kill(mut self) -> Option<u64> {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
        std::iter::from_fn(|| self.durable()).last()
    }
}

/// Checks that all acknowledged events are there, without gaps or duplicates.
fn check(history: &History, acknowledged: &[(RunId, u64)]) {
    for (run, durable) in acknowledged {
        let mut found = 0;
        let mut request = PageRequest::first(1000);
        loop {
            let page = history.events(*run, &[], .., request).unwrap();
            for stamped in page.items {
                assert_eq!(stamped, numbered(found));
                found += 1;
            }
            let Some(next) = page.next else { break };
            request = PageRequest::after(next, 1000);
        }
        assert!(found > *durable, "run {run}: {durable} was acknowledged, but only {found} are there");
        assert_eq!(history.run(*run).unwrap().ended, None);
    }
}

#[test]
fn acknowledged_events_survive_kill_9() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("history.sqlite");
    let mut acknowledged = Vec::new();
    // One file, killed again and again: between acknowledgements, soon after the start, and late.
    for acknowledgements in [0, 1, 2, 3, 5, 8, 40, 100] {
        let mut recording = Recording::start(path.to_str().unwrap());
        let run = recording.run();
        recording.wait(acknowledgements);
        let Some(last) = recording.durable() else { panic!("it lives until it is killed") };
        acknowledged.push((run, recording.kill().unwrap_or(last)));
    }
    let history = History::open(&path).unwrap();
    assert_eq!(history.runs(None, 100).unwrap().len(), acknowledged.len());
    check(&history, &acknowledged);
}

/// Kills the server under a process that records, then the process with its spool, then those that take the spool in. In
/// the end every event is there once.
#[test]
fn acknowledged_events_survive_kill_9_of_process_and_server() {
    let Some(server) = MariaDb::start() else { return };
    let url = server.fresh();
    let location: Location = url.parse().unwrap();
    let mut acknowledged = Vec::new();
    for (before, spooled, killed_while_taking_in) in [(5, 0, 0), (3, 30, 1), (0, 200, 3), (20, 300, 2)] {
        let mut recording = Recording::start(&url);
        let run = recording.run();
        recording.wait(before);
        server.kill();
        recording.wait(spooled);
        let Some(last) = recording.durable() else { panic!("it lives until it is killed") };
        acknowledged.push((run, recording.kill().unwrap_or(last)));
        server.resume();
        for _ in 0..killed_while_taking_in {
            Recording::start(&url).kill();
        }
    }
    // The last process is killed while it writes its own spool to the server.
    let mut recording = Recording::start(&url);
    let run = recording.run();
    server.kill();
    recording.wait(100);
    server.resume();
    recording.wait(3);
    let Some(last) = recording.durable() else { panic!("it lives until it is killed") };
    acknowledged.push((run, recording.kill().unwrap_or(last)));

    check(&History::connect(&location).unwrap(), &acknowledged);
    assert_eq!(std::fs::read_dir(server.spool()).unwrap().count(), 0, "all spools were taken in");
}
