//! Tests of failures in servers, and of what is special to them.

use std::{fs, sync::Barrier};

use cotorra_testing::mariadb::MariaDb;
use mysql::{Conn, Row, prelude::Queryable};
use proptest::prelude::*;

use super::*;
use crate::{
    History, Kind, Location,
    location::Server,
    schema::MIGRATIONS,
    testing::{notice, placement, run_info},
};

/// Limits with room in the spool for few batches.
const SMALL: Limits = Limits { spool: 20_000, ..Limits::USUAL };

fn place(url: &str) -> Server {
    match url.parse().unwrap() {
        Location::Server(server) => server,
        Location::File(_) => panic!("{url} is a server"),
    }
}

fn client(url: &str) -> Conn {
    connect(&place(url), LONG_PATIENCE).unwrap()
}

fn refusal(url: &str) -> Error {
    match Remote::open(&place(url)) {
        Ok(_) => panic!("no history can be opened there"),
        Err(error) => error,
    }
}

impl Remote {
    pub fn place(&self) -> &Server {
        &self.shared.server
    }

    /// Waits until the server has all spooled events.
    fn wait_until_caught_up(&self) {
        let mut state = self.shared.state.lock();
        while state.direct.is_none() {
            self.shared.changed.wait(&mut state);
        }
    }

    fn spools(&self) -> bool {
        self.shared.state.lock().direct.is_none()
    }
}

fn everything(history: &History, run: RunId) -> Vec<Stamped> {
    let mut all = Vec::new();
    let mut request = PageRequest::first(PageRequest::MAX);
    loop {
        let page = history.events(run, &[], .., request).unwrap();
        all.extend(page.items);
        let Some(next) = page.next else { return all };
        request = PageRequest::after(next, PageRequest::MAX);
    }
}

fn numbered(n: u64) -> Stamped {
    if n.is_multiple_of(10) {
        placement(n, "brain", ["fog", "edge"][n as usize / 10 % 2])
    } else {
        notice(n, &n.to_string())
    }
}

/// Records some numbers, with flushes between them.
fn record(history: &History, run: RunId, numbers: std::ops::Range<u64>) {
    let recorder = history.recorder(run).unwrap();
    for n in numbers {
        recorder.record(numbered(n));
        if n.is_multiple_of(17) {
            recorder.flush().unwrap();
        }
    }
    recorder.flush().unwrap();
}

fn all(numbers: u64) -> Vec<Stamped> {
    (0..numbers).map(numbered).collect()
}

fn spool_files(server: &MariaDb) -> usize {
    fs::read_dir(server.spool()).map_or(0, |files| files.count())
}

#[test]
fn a_history_is_there_when_it_is_opened_again() {
    let Some(server) = MariaDb::shared() else { return };
    let url = server.fresh();
    let location: Location = url.parse().unwrap();
    let history = History::connect(&location).unwrap();
    let run = history.begin_run(&run_info("first")).unwrap();
    record(&history, run, 0..100);
    history.end_run(run, Timestamp::from_nanos(9)).unwrap();
    drop(history);
    let receipts: Option<i64> = client(&url).query_first("SELECT count(*) FROM spool").unwrap();
    assert_eq!(receipts, Some(0), "who closes in order leaves nothing behind");

    // Through the Unix socket as well.
    let by_socket = url.replace('?', &format!("?socket={}&", server.socket().display()));
    let history = History::connect(&by_socket.parse().unwrap()).unwrap();
    assert_eq!(history.run(run).unwrap().ended, Some(Timestamp::from_nanos(9)));
    assert_eq!(history.run(run).unwrap().info, run_info("first"));
    record(&history, run, 100..120);
    assert_eq!(everything(&history, run), all(120));
    assert_ne!(history.begin_run(&run_info("second")).unwrap(), run);
}

#[test]
fn processes_may_open_a_new_database_at_once_and_share_it() {
    let Some(server) = MariaDb::shared() else { return };
    let place = place(&server.fresh());
    let together = Barrier::new(4);
    thread::scope(|scope| {
        for node in ["fog", "edge", "cloud", "fog"] {
            scope.spawn(|| {
                together.wait();
                let history = History::of(Arc::new(Remote::open(&place).unwrap())).unwrap();
                let run = history.begin_run(&run_info("shared")).unwrap();
                let recorder = history.recorder(run).unwrap();
                for t in 0..50 {
                    recorder.record(placement(t, "brain", node));
                    recorder.flush().unwrap();
                }
                let wanted: Vec<_> = (0..50).map(|t| placement(t, "brain", node)).collect();
                assert_eq!(everything(&history, run), wanted);
            });
        }
    });
}

#[test]
fn other_databases_are_rejected_and_left_alone() {
    let Some(server) = MariaDb::shared() else { return };
    let alien = server.fresh();
    client(&server.url("mysql")).query_drop(format!("CREATE DATABASE {}", quoted_name(&alien))).unwrap();
    client(&alien).query_drop("CREATE TABLE songs (title TEXT)").unwrap();
    assert!(matches!(refusal(&alien), Error::NotAHistory { .. }));
    assert_eq!(client(&alien).query::<String, _>("SHOW TABLES").unwrap(), ["songs"]);
}

fn quoted_name(url: &str) -> String {
    place(url).database
}

fn set_version(url: &str, version: u32) {
    client(url).exec_drop("UPDATE cotorra_schema SET version = ?", (version,)).unwrap();
}

fn version_of(url: &str) -> Option<u32> {
    client(url).query_first("SELECT version FROM cotorra_schema").unwrap()
}

#[test]
fn a_server_that_is_down_is_named_without_types_of_the_driver() {
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let free = taken.local_addr().unwrap();
    drop(taken);
    let message = refusal(&format!("mysql://ana@{free}/cotorra")).to_string();
    assert!(
        message.contains(&free.to_string()) && message.contains("the server does not answer"),
        "{message}"
    );
    assert!(!message.contains(['{', '}']), "{message}");
}

/// Covers newer versions.
#[test]
fn unknown_schemas_are_rejected_and_left_alone() {
    let Some(server) = MariaDb::shared() else { return };
    let url = server.fresh();
    drop(Remote::open(&place(&url)).unwrap());
    let tables = || client(&url).query::<String, _>("SHOW TABLES").unwrap();
    let before = tables();
    for other in (MIGRATIONS.len() as u32 + 1..).take(5) {
        set_version(&url, other);
        let error = refusal(&url);
        let message = error.to_string();
        assert!(
            matches!(error, Error::UnknownSchema { found, known, .. } if (found, known) == (other, MIGRATIONS.len() as u32)),
            "{message}"
        );
        assert!(
            message.contains(&format!("version {other}")) && message.contains("history export"),
            "{message}"
        );
        assert_eq!((tables(), version_of(&url)), (before.clone(), Some(other)));
    }
}

#[test]
fn a_new_database_that_was_left_half_made_is_finished() {
    let Some(server) = MariaDb::shared() else { return };
    let url = server.fresh();
    drop(Remote::open(&place(&url)).unwrap());
    // As if its process had been killed half-way: some of its tables are there.
    set_version(&url, 0);
    client(&url).query_drop("DROP TABLE spool, notice").unwrap();
    let history = History::connect(&url.parse().unwrap()).unwrap();
    let run = history.begin_run(&run_info("finished")).unwrap();
    record(&history, run, 0..20);
    assert_eq!(everything(&history, run), all(20));
    assert_eq!(version_of(&url), Some(MIGRATIONS.len() as u32));
}

#[test]
fn brings_an_older_schema_up_to_date() {
    let Some(server) = MariaDb::shared() else { return };
    let url = server.fresh();
    let history = History::connect(&url.parse().unwrap()).unwrap();
    let run = history.begin_run(&run_info("old")).unwrap();
    record(&history, run, 0..20);
    drop(history);
    let later = [MIGRATIONS, &["ALTER TABLE notice ADD COLUMN mood TEXT"]].concat();
    // The second time as if the first migration had been killed before it was noted.
    for _ in 0..2 {
        set_version(&url, MIGRATIONS.len() as u32);
        prepare(&mut client(&url), &place(&url), &later).unwrap();
        assert_eq!(version_of(&url), Some(later.len() as u32));
        let found: (u32, u32) =
            client(&url).query_first("SELECT count(*), count(mood) FROM notice").unwrap().unwrap();
        assert_eq!(found, (18, 0));
    }
}

/// Errors name the user but never the password.
#[test]
fn errors_name_the_user_but_not_the_password() {
    let Some(server) = MariaDb::shared() else { return };
    let wrong = server.fresh().replace("s3cret", "wr0ng");
    let error = refusal(&wrong);
    assert!(matches!(error, Error::Server { .. }), "{error}");
    let message = format!("{error} {error:?}");
    assert!(message.contains("cotorra") && !message.contains("wr0ng"), "{message}");
    let nobody = refusal("mysql://cotorra:wr0ng@127.0.0.1:1/cotorra");
    assert!(matches!(nobody, Error::Unreachable { .. }) && !format!("{nobody} {nobody:?}").contains("wr0ng"));
}

/// No question scans a whole table.
#[test]
fn questions_use_the_keys() {
    let Some(server) = MariaDb::shared() else { return };
    let url = server.fresh();
    let history = History::connect(&url.parse().unwrap()).unwrap();
    let run = history.begin_run(&run_info("plans")).unwrap();
    let recorder = history.recorder(run).unwrap();
    for t in 0..3000 {
        recorder.record(placement(t * 5_000_000_000, ["brain", "map"][t as usize % 2], "fog"));
    }
    recorder.flush().unwrap();
    let mut client = client(&url);
    client.query_drop("ANALYZE TABLE presence, placement").unwrap();
    let mut plan = |sql: &str, parameters: Vec<i64>| -> Vec<String> {
        let rows: Vec<Row> = client.exec(format!("EXPLAIN {sql}"), parameters).unwrap();
        rows.iter()
            .map(|row| format!("{:?} {:?}", row.get::<String, _>("type"), row.get::<String, _>("Extra")))
            .collect()
    };
    let found = plan(session::LAST_STRETCHES, vec![1, 3, 1000]);
    assert!(found[0].contains("range") && found[0].contains("Using index for group-by"), "{found:?}");
    for series in [None, Some([1, 0])] {
        let select = sql::Select { kind: Kind::Placement, series, until: 0, limit: 1 };
        let mut parameters = vec![run.0, 5_000_000_000, 5_000_000_000, 3, 50_000_000_000];
        parameters.extend(series.map(|ids| ids[0]));
        parameters.push(100);
        let found = plan(&select.sql(), parameters);
        assert!(found[0].contains("range") && !found[0].contains("filesort"), "{found:?}");
    }
}

#[test]
fn nothing_is_lost_when_the_server_is_stopped_and_started_again() {
    let Some(server) = MariaDb::start() else { return };
    let store = Arc::new(Remote::open(&place(&server.fresh())).unwrap());
    let history = History::of(store.clone()).unwrap();
    let run = history.begin_run(&run_info("stopped")).unwrap();
    record(&history, run, 0..100);
    let mut recorded = 100;
    for round in 0..3 {
        let recorder = history.recorder(run).unwrap();
        if round == 1 {
            server.kill()
        } else {
            server.stop()
        }
        // Flushed events are durable, though no question can be answered.
        for n in recorded..recorded + 500 {
            recorder.record(numbered(n));
            if n.is_multiple_of(50) {
                recorder.flush().unwrap();
            }
        }
        recorder.flush().unwrap();
        assert!(store.spools());
        assert!(matches!(
            history.events(run, &[], .., PageRequest::default()),
            Err(Error::Unreachable { .. })
        ));
        assert!(matches!(history.begin_run(&run_info("no")), Err(Error::Unreachable { .. })));
        recorded += 500;
        server.resume();
        // Recorded while the spool is emptied: after the events in it.
        for n in recorded..recorded + 100 {
            recorder.record(numbered(n));
        }
        recorder.flush().unwrap();
        recorded += 100;
        store.wait_until_caught_up();
        assert_eq!(everything(&history, run), all(recorded));
    }
    assert_eq!(history.recorder(run).unwrap().stats().dropped, 0);
    assert!(history.gaps(run, .., PageRequest::default()).unwrap().items.is_empty());
    assert_eq!(history.state_at(run, Timestamp::MAX).unwrap().placements.len(), 1);
}

#[test]
fn a_spool_left_behind_is_taken_in_when_the_history_is_opened_again() {
    let Some(server) = MariaDb::start() else { return };
    let location: Location = server.fresh().parse().unwrap();
    let history = History::connect(&location).unwrap();
    let run = history.begin_run(&run_info("left behind")).unwrap();
    record(&history, run, 0..50);
    let recorder = history.recorder(run).unwrap();
    server.kill();
    for n in 50..300 {
        recorder.record(numbered(n));
    }
    history.end_run(run, Timestamp::from_nanos(300)).unwrap();
    drop((history, recorder));
    assert_eq!(spool_files(&server), 1);

    assert!(matches!(History::connect(&location), Err(Error::Unreachable { .. })));
    server.resume();
    let history = History::connect(&location).unwrap();
    assert_eq!(everything(&history, run), all(300));
    assert_eq!(history.run(run).unwrap().ended, Some(Timestamp::from_nanos(300)));
    drop(history);
    assert_eq!(spool_files(&server), 0);
}

/// A hanging server counts as gone after a while. The fate of the last batch is found out when it is back.
#[test]
fn a_server_that_hangs_is_one_that_is_gone() {
    let Some(server) = MariaDb::start() else { return };
    let limits = Limits { patience: Duration::from_secs(2), ..Limits::USUAL };
    let store = Arc::new(Remote::within(&place(&server.fresh()), limits).unwrap());
    let history = History::of(store.clone()).unwrap();
    let run = history.begin_run(&run_info("hangs")).unwrap();
    record(&history, run, 0..100);
    let recorder = history.recorder(run).unwrap();
    server.hang();
    for n in 100..200 {
        recorder.record(numbered(n));
    }
    recorder.flush().unwrap();
    assert!(store.spools());
    server.go_on();
    store.wait_until_caught_up();
    assert_eq!(everything(&history, run), all(200));
}

/// A batch whose acknowledgement was lost is spooled, and not taken in again.
#[test]
fn a_batch_with_unknown_outcome_is_stored_once() {
    let Some(server) = MariaDb::shared() else { return };
    let url = server.fresh();
    let store = Remote::open(&place(&url)).unwrap();
    let run = store.begin_run(&run_info("unknown")).unwrap();
    let entries = |numbers: std::ops::Range<u64>| -> Vec<Entry> {
        numbers.map(|n| Entry { run, stamped: numbered(n) }).collect()
    };
    store.append(&entries(0..10), &[]).unwrap();
    store.append(&entries(10..20), &[]).unwrap();
    {
        let mut state = store.shared.state.lock();
        // As if the answer to the last one had been lost.
        let number = state.batch - 1;
        state.spool.push_batch(number, &entries(10..20), &[]).unwrap();
        let error = Error::Stopped;
        store.shared.lose(&mut state, &error);
    }
    store.append(&entries(20..30), &[]).unwrap();
    store.wait_until_caught_up();
    drop(store);
    let history = History::connect(&url.parse().unwrap()).unwrap();
    assert_eq!(everything(&history, run), all(30));
}

/// When the spool is full, the queue fills, and events that do not fit become a gap.
#[test]
fn a_full_spool_makes_gaps_in_the_end() {
    let Some(server) = MariaDb::start() else { return };
    let store = Arc::new(Remote::within(&place(&server.fresh()), SMALL).unwrap());
    let history = History::of(store.clone()).unwrap();
    let run = history.begin_run(&run_info("full")).unwrap();
    let recorder = history.recorder(run).unwrap();
    server.stop();
    let mut recorded = 0;
    let error = loop {
        for _ in 0..50 {
            recorder.record(numbered(recorded));
            recorded += 1;
        }
        if let Err(error) = recorder.flush() {
            break error;
        }
    };
    assert!(matches!(error, Error::SpoolFull { .. }), "{error}");
    while recorder.stats().dropped == 0 {
        recorder.record(numbered(recorded));
        recorded += 1;
    }
    let stats = recorder.stats();
    server.resume();
    store.wait_until_caught_up();
    recorder.flush().unwrap();
    let found = everything(&history, run);
    assert_eq!(found.len() as u64, stats.recorded);
    assert!(found == all(recorded)[..found.len()]);
    let gaps = history.gaps(run, .., PageRequest::default()).unwrap().items;
    assert_eq!(gaps.iter().map(|gap| gap.events).sum::<u64>(), stats.dropped);
}

/// Events without room at the end of a process become a gap.
#[test]
fn an_abandoned_full_spool_reports_its_gap() {
    let Some(server) = MariaDb::start() else { return };
    let place = place(&server.fresh());
    let history = History::of(Arc::new(Remote::within(&place, SMALL).unwrap())).unwrap();
    let run = history.begin_run(&run_info("left full")).unwrap();
    let recorder = history.recorder(run).unwrap();
    server.stop();
    let mut recorded = 0;
    while recorder.flush().is_ok() {
        for _ in 0..50 {
            recorder.record(numbered(recorded));
            recorded += 1;
        }
    }
    drop((history, recorder));
    server.resume();
    let history = History::of(Arc::new(Remote::open(&place).unwrap())).unwrap();
    let found = everything(&history, run);
    assert!(!found.is_empty() && found == all(recorded)[..found.len()]);
    let gaps = history.gaps(run, .., PageRequest::default()).unwrap().items;
    assert_eq!(found.len() as u64 + gaps.iter().map(|gap| gap.events).sum::<u64>(), recorded);
}

/// NaN and infinite figures come back, though a server has no infinity.
#[test]
fn odd_figures_come_back() {
    let Some(server) = MariaDb::shared() else { return };
    let history = History::connect(&server.fresh().parse().unwrap()).unwrap();
    let run = history.begin_run(&run_info("odd")).unwrap();
    let lateness = |x: f64| {
        let lateness =
            cotorra_graph::Lateness { frames: u64::MAX, p50_us: x, p99_us: -x, max_us: f64::MIN_POSITIVE };
        Stamped { at: Timestamp::ZERO, event: cotorra_graph::Event::Lateness(lateness) }
    };
    let recorder = history.recorder(run).unwrap();
    let odd = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 0.1 + 0.2, 5e-324, f64::MAX / 2.0].map(lateness);
    odd.iter().for_each(|stamped| recorder.record(stamped.clone()));
    recorder.flush().unwrap();
    let found = everything(&history, run);
    assert_eq!(format!("{found:?}").replace("-NaN", "NaN"), format!("{odd:?}").replace("-NaN", "NaN"));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    /// Any text parses or fails without a panic.
    #[test]
    fn any_text_is_a_location_or_not(text in "(mysql://)?[a-z:@/?=%\\[\\]]{0,30}") {
        if let Ok(location) = text.parse::<Location>() {
            let _ = location.to_string();
        }
    }
}
