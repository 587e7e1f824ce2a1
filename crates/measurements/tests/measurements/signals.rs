//! A history holds each signal that a robot heard once, whatever the number of contexts that repeat it.
#![allow(clippy::unwrap_used, reason = "a test says so by failing")]

use std::{path::Path, time::Duration};

use cotorra_graph::{Attachment, Dbm, Event, NodeId, Pose, PoseSource, RobotContext, Stamped, Timestamp};
use cotorra_graph_testing as base;
use cotorra_measurements::{CurveRequest, Figure, History, PageRequest, RunInfo};

/// Contexts, ten a second.
const CONTEXTS: u64 = 600;
/// From scan to scan, in contexts.
const SCANS: u64 = 200;
const UNITS: [&str; 6] = ["R1", "R2", "R3", "R4", "R5", "R6"];

/// κ of a robot that is at R3 and scans every 20 s, 50 ms before a context. R6 is out of reach.
fn context(n: u64) -> Stamped {
    let at = Timestamp::from_nanos(n * 100_000_000);
    let last = n / SCANS;
    let attachment = |(i, unit): (usize, &&str)| {
        let attached = *unit == "R3";
        let heard = Dbm(-60.0 - i as f64 * 0.1 - last as f64 / 3.0);
        let since = Duration::from_millis(50 + 100 * (n % SCANS));
        let (signal, age) = match *unit {
            "R3" => (Some(Dbm(-50.0 - n as f64 * 0.01)), Some(Duration::ZERO)),
            "R6" => (None, None),
            _ if last == 0 => (None, None),
            _ => (Some(heard), Some(since)),
        };
        Attachment { radio_unit: NodeId::new(unit).unwrap(), attached, signal, age }
    };
    let pose = Pose::planar(n as f64, 0.5, 0.0, [0.0; 9], PoseSource::Simulator);
    let context = RobotContext {
        attachments: UNITS.iter().enumerate().map(attachment).collect(),
        ..base::robot_context("robot", pose)
    };
    Stamped { at, event: Event::Robot(context) }
}

fn count(path: &Path, table: &str) -> i64 {
    let connection = rusqlite::Connection::open(path).unwrap();
    connection.query_row(&format!("SELECT COUNT(*) FROM {table}"), [], |row| row.get(0)).unwrap()
}

#[test]
fn a_signal_is_written_where_it_was_heard_and_read_in_every_context() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("history.sqlite");
    let history = History::open(&path).unwrap();
    let info = RunInfo { name: "walk".to_owned(), seed: 1, started_at_unix_ns: 0, testbed: String::new() };
    let run = history.begin_run(&info).unwrap();
    let recorder = history.recorder(run).unwrap();
    let written: Vec<_> = (0..CONTEXTS).map(context).collect();
    written.iter().for_each(|stamped| recorder.record(stamped.clone()));
    recorder.flush().unwrap();

    let read = history.events(run, &[], .., PageRequest::first(PageRequest::MAX)).unwrap();
    assert_eq!(read.items, written);

    // That of the own radio unit in each context, those of four others after each of two scans.
    assert_eq!(count(&path, "attachment"), CONTEXTS.cast_signed() + 2 * 4);
    assert_eq!(count(&path, "heard"), 1 + 2);

    let signal: Figure = "signal:robot:R1".parse().unwrap();
    let end = Timestamp::from_nanos(CONTEXTS * 100_000_000);
    let request = CurveRequest { points: 1, quantiles: Vec::new() };
    let curve = history.curve(run, &signal, Timestamp::ZERO..end, &request).unwrap();
    let heard = curve.points[0].values.as_ref().map(|values| values.count);
    assert_eq!(heard, Some(2), "a signal counts once, where it was heard");
}
