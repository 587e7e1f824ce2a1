//! Tests of failures in SQLite, and of what is special to it.

mod hostile;

use std::{fs, path::PathBuf};

use cotorra_graph::{
    Conditions, Dbm, Event, Jitter, JitterDistribution, LinkContext, NodeId, RadioContext, ReadingTime,
    StationContext,
};
use cotorra_graph_testing as base;
use tempfile::TempDir;

use super::*;
use crate::{
    History, Kind,
    testing::{notice, placement, run_info},
};

fn folder() -> (TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("history.sqlite");
    (folder, path)
}

fn refusal(path: &Path) -> Error {
    match Sqlite::open(path) {
        Ok(_) => panic!("{} is no history that can be opened", path.display()),
        Err(error) => error,
    }
}

fn everything(history: &History, run: RunId) -> Vec<Stamped> {
    history.events(run, &[], .., PageRequest::first(PageRequest::MAX)).unwrap().items
}

#[test]
fn events_recorded_on_a_full_disk_are_written_once_it_has_room() {
    let (_folder, path) = folder();
    let history = History::open(&path).unwrap();
    let run = history.begin_run(&run_info("full")).unwrap();
    let recorder = history.paced_recorder(run).unwrap();
    let long = "x".repeat(5000);
    let events: Vec<_> = (0..20).map(|at| notice(at, &long)).collect();
    recorder.record(events[0].clone());
    recorder.flush().unwrap();
    history.set_full(true).unwrap();
    events[1..].iter().cloned().for_each(|event| recorder.record(event));
    let refused = recorder.flush().unwrap_err();
    assert!(matches!(refused, Error::Full { .. }), "{refused}");
    assert_eq!(everything(&history, run), events[..1]);
    history.set_full(false).unwrap();
    recorder.flush().unwrap();
    assert_eq!(everything(&history, run), events);
}

#[test]
fn a_history_is_there_when_it_is_opened_again() {
    let (_folder, path) = folder();
    let history = History::open(&path).unwrap();
    let run = history.begin_run(&run_info("first")).unwrap();
    let recorder = history.recorder(run).unwrap();
    let events = [placement(0, "brain", "fog"), notice(3, "one"), placement(5, "brain", "edge")];
    for stamped in &events {
        recorder.record(stamped.clone());
    }
    history.end_run(run, Timestamp::from_nanos(9)).unwrap();
    drop((history, recorder));
    assert!(!path.with_file_name("history.sqlite-wal").exists(), "a history at rest is one file");

    let history = History::open(&path).unwrap();
    assert_eq!(history.run(run).unwrap().ended, Some(Timestamp::from_nanos(9)));
    assert_eq!(everything(&history, run), events);
    // Its run may be continued, and another begun.
    let recorder = history.recorder(run).unwrap();
    recorder.record(notice(3, "two"));
    recorder.flush().unwrap();
    assert_eq!(everything(&history, run)[2], notice(3, "two"));
    assert_ne!(history.begin_run(&run_info("second")).unwrap(), run);
}

#[test]
fn two_processes_may_share_a_file() {
    let (_folder, path) = folder();
    let both = [History::open(&path).unwrap(), History::open(&path).unwrap()];
    let runs = both.each_ref().map(|history| history.begin_run(&run_info("shared")).unwrap());
    let recorders = [0, 1].map(|i| both[i].recorder(runs[i]).unwrap());
    for t in 0..50 {
        for (recorder, node) in recorders.iter().zip(["fog", "edge"]) {
            recorder.record(placement(t, "brain", node));
            recorder.flush().unwrap();
        }
    }
    for (run, node) in runs.into_iter().zip(["fog", "edge"]) {
        let wanted: Vec<_> = (0..50).map(|t| placement(t, "brain", node)).collect();
        assert!(both.iter().all(|history| everything(history, run) == wanted));
    }
}

#[test]
fn other_files_are_rejected_and_left_alone() {
    let (folder, path) = folder();
    fs::write(&path, "# a testbed file, not a history\n".repeat(100)).unwrap();
    assert!(matches!(refusal(&path), Error::NotAHistory { .. }));
    assert!(fs::read_to_string(&path).unwrap().starts_with("# a testbed file"));

    let alien = folder.path().join("alien.sqlite");
    Connection::open(&alien).unwrap().execute_batch("CREATE TABLE songs (title TEXT)").unwrap();
    let before = fs::read(&alien).unwrap();
    assert!(matches!(refusal(&alien), Error::NotAHistory { .. }));
    assert_eq!(fs::read(&alien).unwrap(), before);

    assert!(matches!(refusal(folder.path()), Error::Open { .. }));
    assert!(matches!(refusal(&folder.path().join("no/such/folder")), Error::Open { .. }));
}

/// Covers newer versions.
#[test]
fn unknown_schemas_are_rejected_and_left_alone() {
    let (_folder, path) = folder();
    drop(Sqlite::open(&path).unwrap());
    for other in (MIGRATIONS.len() as u32 + 1..).take(5) {
        Connection::open(&path).unwrap().pragma_update(None, "user_version", other).unwrap();
        let before = fs::read(&path).unwrap();
        for error in [refusal(&path), Sqlite::open_to_read(&path).err().unwrap()] {
            let message = error.to_string();
            assert!(
                matches!(error, Error::UnknownSchema { found, known, .. } if (found, known) == (other, MIGRATIONS.len() as u32)),
                "{message}"
            );
            assert!(
                message.contains(&format!("version {other}")) && message.contains("history export"),
                "{message}"
            );
        }
        assert_eq!(fs::read(&path).unwrap(), before);
        assert_eq!(version_of(&path), other);
    }
}

fn version_of(path: &Path) -> u32 {
    Connection::open(path).unwrap().pragma_query_value(None, "user_version", |row| row.get(0)).unwrap()
}

#[test]
fn read_only_files_are_rejected() {
    let (_folder, path) = folder();
    drop(Sqlite::open(&path).unwrap());
    let mut permissions = fs::metadata(&path).unwrap().permissions();
    permissions.set_readonly(true);
    fs::set_permissions(&path, permissions).unwrap();
    // To the superuser nothing is read-only.
    if fs::OpenOptions::new().append(true).open(&path).is_err() {
        assert!(matches!(refusal(&path), Error::ReadOnly { .. }));
    }
}

/// Opens it as on a read-only medium, where no log can be created either.
#[test]
fn histories_on_read_only_media_can_be_read() {
    let (_folder, path) = folder();
    let history = History::open(&path).unwrap();
    let run = history.begin_run(&run_info("kept")).unwrap();
    let recorder = history.recorder(run).unwrap();
    recorder.record(placement(1, "brain", "fog"));
    history.end_run(run, Timestamp::from_nanos(2)).unwrap();
    drop((history, recorder));
    let place = super::immutable(&path);
    for place in [path.as_path(), place.as_path()] {
        let flags = rusqlite::OpenFlags::SQLITE_OPEN_READ_ONLY | rusqlite::OpenFlags::SQLITE_OPEN_URI;
        let connection = rusqlite::Connection::open_with_flags(place, flags).unwrap();
        let store = Sqlite {
            path: place.into(),
            name: "kept".into(),
            writer: Mutex::new(Writer::new(SqliteSession::new(
                connection,
                &"kept".into(),
                guard::Steps::default(),
            ))),
            readers: Mutex::default(),
        };
        let history = History::of(Arc::new(store)).unwrap();
        assert_eq!(everything(&history, run), [placement(1, "brain", "fog")]);
        assert!(history.begin_run(&run_info("another")).is_err());
    }
}

#[test]
fn recording_goes_on_after_writing_was_forbidden() {
    let (_folder, path) = folder();
    let store = Arc::new(Sqlite::open(&path).unwrap());
    let history = History::of(store.clone()).unwrap();
    let run = history.begin_run(&run_info("read-only")).unwrap();
    let recorder = history.recorder(run).unwrap();
    let forbid = |on: bool| {
        store.writer.lock().session.connection.pragma_update(None, "query_only", on).unwrap();
    };

    forbid(true);
    recorder.record(placement(1, "brain", "fog"));
    assert!(matches!(recorder.flush(), Err(Error::ReadOnly { .. })));
    assert!(matches!(history.begin_run(&run_info("another")), Err(Error::ReadOnly { .. })));
    assert!(everything(&history, run).is_empty());

    forbid(false);
    recorder.flush().unwrap();
    assert_eq!(everything(&history, run), [placement(1, "brain", "fog")]);
}

#[test]
fn a_full_disk_causes_an_error_and_loses_nothing() {
    let (_folder, path) = folder();
    let store = Arc::new(Sqlite::open(&path).unwrap());
    let history = History::of(store.clone()).unwrap();
    let run = history.begin_run(&run_info("full")).unwrap();
    let recorder = history.recorder(run).unwrap();
    let allow = |pages: u32| {
        let connection = &store.writer.lock().session.connection;
        connection.pragma_update_and_check(None, "max_page_count", pages, |row| row.get::<_, u32>(0)).unwrap()
    };

    let room = allow(1) + 20; // What is asked below what there is gives what there is.
    allow(room);
    let events: Vec<_> = (0..1000).map(|t| notice(t, &"x".repeat(200))).collect();
    let mut failures = 0;
    for batch in events.chunks(100) {
        for stamped in batch {
            recorder.record(stamped.clone());
        }
        match recorder.flush() {
            Ok(()) => assert_eq!(failures, 0, "what does not fit now did not fit before"),
            Err(Error::Full { .. }) => failures += 1,
            Err(other) => panic!("{other}"),
        }
    }
    assert!(failures > 0);
    let kept = everything(&history, run);
    assert!(!kept.is_empty() && kept == events[..kept.len()]);

    allow(100_000);
    recorder.flush().unwrap();
    assert!(everything(&history, run) == events);
    assert!(history.gaps(run, .., PageRequest::default()).unwrap().items.is_empty());
}

/// Names, conditions and stretches of a transaction that failed must be written again.
#[test]
fn rows_that_were_rolled_back_are_written_again() {
    let (_folder, path) = folder();
    let store = Sqlite::open(&path).unwrap();
    let run = store.begin_run(&run_info("rolled back")).unwrap();
    let entry = |run| Entry {
        run,
        stamped: Stamped {
            at: Timestamp::ZERO,
            event: Event::Link(LinkContext { queued_packets: Some(3), ..base::link_context("a-b") }),
        },
    };
    // The second one's run does not exist, so that both are rolled back.
    store.append(&[entry(run), entry(RunId(99))], &[]).unwrap_err();
    assert!(store.latest(run, i64::MAX).unwrap().is_empty());
    store.append(&[entry(run)], &[]).unwrap();
    assert_eq!(store.latest(run, i64::MAX).unwrap(), [entry(run).stamped]);
}

/// Damage anywhere leads to an error or an answer, never to a panic or a hang.
#[test]
fn a_damaged_file_causes_an_error() {
    let (_folder, path) = folder();
    let history = History::open(&path).unwrap();
    let run = history.begin_run(&run_info("damaged")).unwrap();
    let recorder = history.recorder(run).unwrap();
    for t in 0..5000 {
        recorder.record(placement(t * 10_000_000, ["brain", "map"][t as usize % 2], "fog"));
    }
    history.end_run(run, Timestamp::from_nanos(5000)).unwrap();
    drop((history, recorder));
    let whole = fs::read(&path).unwrap();
    let pages = whole.len() / 4096;
    assert!(pages > 20);

    let mut errors = 0;
    for page in (0..pages).step_by(2) {
        let mut bytes = whole.clone();
        bytes[page * 4096..][..4096].fill(0x5a);
        fs::write(&path, bytes).unwrap();
        for leftover in ["history.sqlite-wal", "history.sqlite-shm"] {
            let _ = fs::remove_file(path.with_file_name(leftover));
        }
        let ask = || -> Result<usize> {
            let history = History::open(&path)?;
            history.state_at(run, Timestamp::MAX)?;
            history.recorder(run)?.record(notice(0, "one more"));
            history.end_run(run, Timestamp::ZERO)?;
            Ok(history.events(run, &[Kind::Placement], .., PageRequest::first(10_000))?.items.len())
        };
        match ask() {
            Ok(events) => assert!(events <= 5000),
            Err(Error::Corrupt { .. } | Error::NotAHistory { .. }) => errors += 1,
            Err(Error::Engine { cause, .. }) => {
                assert!(matches!(*cause, rusqlite::Error::SqliteFailure(..)), "{cause}");
                errors += 1;
            }
            Err(other) => panic!("{other}"),
        }
    }
    assert!(errors > 0);
}

/// Events of a clock that steps back are sorted in by their times, in all answers.
#[test]
fn a_clock_may_step_back() {
    let (_folder, path) = folder();
    let history = History::open(&path).unwrap();
    let run = history.begin_run(&run_info("clock")).unwrap();
    let recorder = history.recorder(run).unwrap();
    for (second, node) in [(100, "fog"), (10, "edge"), (50, "cloud"), (10, "robot")] {
        recorder.record(placement(second * 1_000_000_000, "brain", node));
        recorder.flush().unwrap();
    }
    let at = |second: f64| {
        let state = history.state_at(run, Timestamp::from_secs_f64(second)).unwrap();
        state.placements.first().map(|sample| sample.value.node.to_string())
    };
    assert_eq!(at(9.9), None);
    assert_eq!(at(10.0).as_deref(), Some("robot"));
    assert_eq!(at(50.0).as_deref(), Some("cloud"));
    assert_eq!(at(1e6).as_deref(), Some("fog"));
    let nodes: Vec<_> = history
        .placements(run, .., PageRequest::default())
        .unwrap()
        .items
        .into_iter()
        .map(|sample| sample.value.node.to_string())
        .collect();
    assert_eq!(nodes, ["edge", "robot", "cloud", "fog"]);
}

/// NaN and infinite figures come back.
#[test]
fn odd_figures_come_back() {
    let (_folder, path) = folder();
    let history = History::open(&path).unwrap();
    let run = history.begin_run(&run_info("odd")).unwrap();
    let context = RadioContext {
        radio_unit: NodeId::new("ap1").unwrap(),
        channel: 1,
        load: None,
        stations: vec![StationContext {
            robot: NodeId::new("r1").unwrap(),
            signal: Dbm(f64::NEG_INFINITY),
            downlink_bps: f64::NAN,
            uplink_bps: 0.1 + 0.2,
            counted: Default::default(),
        }],
    };
    let recorder = history.recorder(run).unwrap();
    recorder.record(Stamped { at: Timestamp::ZERO, event: Event::Radio(context.clone()) });
    recorder.flush().unwrap();
    let found = history.all_events(run, &[Kind::Radio]).unwrap();
    assert_eq!(format!("{:?}", found[0].event), format!("{:?}", Event::Radio(context)));
}

/// No question scans a whole table, or sorts its rows.
#[test]
fn questions_use_the_keys() {
    let (_folder, path) = folder();
    let store = Sqlite::open(&path).unwrap();
    let run = store.begin_run(&run_info("plans")).unwrap();
    store.append(&[Entry { run, stamped: placement(0, "brain", "fog") }], &[]).unwrap();
    let plan = |sql: &str| -> Vec<String> {
        let connection = &store.writer.lock().session.connection;
        let mut statement = connection.prepare(&format!("EXPLAIN QUERY PLAN {sql}")).unwrap();
        let unbound = rusqlite::params_from_iter(vec![0; statement.parameter_count()]);
        statement.query_map(unbound, |row| row.get(3)).unwrap().map(|step| step.unwrap()).collect()
    };
    for kind in Kind::ALL {
        let is_series = !kind.table().series.is_empty();
        for series in [None, is_series.then_some([1, 0])] {
            let plan = plan(&sql::Select { kind, series, until: 0, limit: 1 }.sql());
            assert_eq!(plan.len(), 1, "{plan:?}");
            assert!(plan.iter().all(|step| step.starts_with("SEARCH")), "{plan:?}");
        }
    }
}

#[test]
fn brings_an_older_file_up_to_date() {
    let (_folder, path) = folder();
    let store = Sqlite::open(&path).unwrap();
    let run = store.begin_run(&run_info("old")).unwrap();
    store.append(&[Entry { run, stamped: notice(5, "from before") }], &[]).unwrap();
    drop(store);
    assert_eq!(version_of(&path), MIGRATIONS.len() as u32);

    let later = [MIGRATIONS, &["ALTER TABLE notice ADD COLUMN mood TEXT"]].concat();
    let mut connection = Connection::open(&path).unwrap();
    for _ in 0..2 {
        prepare(&mut connection, &"a history".into(), &later).unwrap();
        let found: (i64, String, Option<String>) = connection
            .query_row("SELECT at_ns, message, mood FROM notice", [], |row| {
                Ok((row.get(0)?, row.get(1)?, row.get(2)?))
            })
            .unwrap();
        assert_eq!(found, (5, "from before".to_owned(), None));
    }
    drop(connection);
    assert_eq!(version_of(&path), later.len() as u32);
}

#[test]
fn histories_without_machines_are_read_and_then_take_them() {
    let (_folder, path) = folder();
    let mut connection = Connection::open(&path).unwrap();
    prepare(&mut connection, &"a history".into(), &MIGRATIONS[..2]).unwrap();
    connection
        .execute_batch(
            "INSERT INTO run VALUES (1, 'old', 1, 0, 'name: old', NULL, 1);
             INSERT INTO notice (run, at_ns, seq, message) VALUES (1, 5, 0, 'from before');",
        )
        .unwrap();
    drop(connection);
    assert_eq!(version_of(&path), 2);

    let history = History::open(&path).unwrap();
    let run = history.runs(None, 1).unwrap()[0].id;
    assert_eq!(everything(&history, run), [notice(5, "from before")]);
    let context = base::machine_context("edge");
    let event = Stamped { at: Timestamp::from_nanos(6), event: Event::Machine(context.clone()) };
    let recorder = history.recorder(run).unwrap();
    recorder.record(event.clone());
    let mut unbounded = context;
    unbounded.wifi_left_out = 1;
    unbounded.load_average =
        Some(cotorra_graph::LoadAverage { one_minute: f64::NAN, five_minutes: 0.0, fifteen_minutes: 0.0 });
    recorder.record(Stamped { at: Timestamp::from_nanos(7), event: Event::Machine(unbounded) });
    recorder.flush().unwrap();
    assert_eq!(everything(&history, run), [notice(5, "from before"), event]);
    let gaps = history.gaps(run, .., PageRequest::default()).unwrap().items;
    assert_eq!(gaps.iter().map(|gap| (gap.from.as_nanos(), gap.events)).collect::<Vec<_>>(), [(7, 1)]);
}

#[test]
fn conditions_of_older_histories_have_drop_tail_queues_and_independent_jitter() {
    let (_folder, path) = folder();
    let mut connection = Connection::open(&path).unwrap();
    prepare(&mut connection, &"a history".into(), &MIGRATIONS[..5]).unwrap();
    connection
        .execute_batch(
            "INSERT INTO run VALUES (1, 'old', 1, 0, 'name: old', NULL, 1);
             INSERT INTO name VALUES (1, 'a-b');
             INSERT INTO conditions
             VALUES (1, 5.0, 2.0, 'uniform', 'none', NULL, NULL, 0.0, 0.0, 0.0, NULL, NULL, 9, NULL);
             INSERT INTO link (run, at_ns, seq, link, direction, throughput_bps, delay_scale, drop_scale, asked, effective,
                               packets, bytes, lost, overflowed, duplicated, corrupted)
             VALUES (1, 5, 0, 1, 0, 0.0, 1.0, 1.0, 1, 1, 0, 0, 0, 0, 0, 0);",
        )
        .unwrap();
    drop(connection);
    let history = History::open(&path).unwrap();
    assert_eq!(version_of(&path), MIGRATIONS.len() as u32);
    let run = history.runs(None, 1).unwrap()[0].id;
    let expected = Conditions {
        delay: Duration::from_millis(5),
        jitter: Some(Jitter {
            deviation: Duration::from_millis(2),
            distribution: JitterDistribution::Uniform,
            ..Jitter::default()
        }),
        queue: cotorra_graph::QueueLimit::Packets(9),
        ..Conditions::default()
    };
    match &everything(&history, run)[..] {
        [Stamped { event: Event::Link(context), .. }] => assert_eq!(context.asked, expected),
        other => panic!("{other:?}"),
    }
}

#[test]
fn machines_of_histories_without_times_of_readings_have_none() {
    let (_folder, path) = folder();
    let mut connection = Connection::open(&path).unwrap();
    prepare(&mut connection, &"a history".into(), &MIGRATIONS[..3]).unwrap();
    connection
        .execute_batch(
            "INSERT INTO run VALUES (1, 'old', 1, 0, 'name: old', NULL, 1);
             INSERT INTO name VALUES (1, 'edge');
             INSERT INTO machine (run, at_ns, seq, node, cpus, interfaces_left_out, wifi_left_out)
             VALUES (1, 5, 0, 1, 4, 0, 0);
             INSERT INTO presence VALUES (1, 18, 1, 0, 0);",
        )
        .unwrap();
    drop(connection);
    assert_eq!(version_of(&path), 3);

    let history = History::open(&path).unwrap();
    assert_eq!(version_of(&path), MIGRATIONS.len() as u32);
    let run = history.runs(None, 1).unwrap()[0].id;
    let machine_of = |stamped: &Stamped| match &stamped.event {
        Event::Machine(context) => (context.cpu.unwrap().cpus, context.reading),
        other => panic!("{other:?}"),
    };
    let [before] = &everything(&history, run)[..] else { panic!("not one event") };
    assert_eq!(machine_of(before), (4, None));
    let mut later = before.clone();
    let reading = ReadingTime { measured: Timestamp::from_nanos(6), error: Duration::from_nanos(1500) };
    later.at = Timestamp::from_nanos(7);
    if let Event::Machine(context) = &mut later.event {
        context.reading = Some(reading);
    }
    let recorder = history.recorder(run).unwrap();
    recorder.record(later);
    recorder.flush().unwrap();
    let found: Vec<_> = everything(&history, run).iter().map(machine_of).collect();
    assert_eq!(found, [(4, None), (4, Some(reading))]);
}

/// A write-ahead log that a loss of power cut off anywhere holds whole batches, from the first on.
#[test]
fn a_log_that_was_cut_off_leaves_whole_batches() {
    let (folder, path) = folder();
    let history = History::open(&path).unwrap();
    let run = history.begin_run(&run_info("cut off")).unwrap();
    let recorder = history.recorder(run).unwrap();
    let batch = 50;
    for t in 0..10 * batch {
        recorder.record(notice(t, &t.to_string()));
        if t % batch == batch - 1 {
            recorder.flush().unwrap();
        }
    }
    let log = fs::read(path.with_file_name("history.sqlite-wal")).unwrap();
    let cut = folder.path().join("cut.sqlite");
    let mut lengths = std::collections::BTreeSet::new();
    for length in (0..=log.len()).step_by(2000).chain([log.len()]) {
        fs::copy(&path, &cut).unwrap();
        fs::write(cut.with_file_name("cut.sqlite-wal"), &log[..length]).unwrap();
        let _ = fs::remove_file(cut.with_file_name("cut.sqlite-shm"));
        let history = History::open(&cut).unwrap();
        let events = if history.run(run).is_ok() { everything(&history, run) } else { Vec::new() };
        assert_eq!(events, (0..events.len() as u64).map(|t| notice(t, &t.to_string())).collect::<Vec<_>>());
        assert_eq!(events.len() as u64 % batch, 0, "a batch is there or is not");
        lengths.insert(events.len());
    }
    assert!(lengths.len() > 5 && lengths.last() == Some(&(10 * batch as usize)), "{lengths:?}");
}
