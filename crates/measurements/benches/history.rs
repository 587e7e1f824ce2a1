//! Measures the cost of `record`, the writing rate beside the engines' own limits, the time of answers in a long history,
//! and its size. Run `cargo bench -p cotorra-measurements`, and after `--` name the wanted parts: record, sqlite, mariadb,
//! sizes, long. `COTORRA_BENCH_MILLIONS` sets the millions of samples of the long history, 10 by default;
//! `COTORRA_BENCH_FOLDER` the folder where it is made.
#![allow(clippy::unwrap_used, reason = "a benchmark that cannot run says so by failing")]
#![allow(
    clippy::disallowed_types,
    clippy::disallowed_methods,
    reason = "a benchmark reads the clock and waits"
)]

use std::{
    path::Path,
    sync::LazyLock,
    time::{Duration, Instant},
};

use cotorra_graph::{
    Attachment, Dbm, Direction, Event, LinkContext, LinkCounters, LinkId, NodeId, Pose, PoseSource, Probed,
    RobotContext, SensorData, Stamped, Timestamp, Velocity,
};
use cotorra_graph_testing as base;
use cotorra_measurements::{
    CurveRequest, Figure, History, LinkQuantity, PageRequest, RobotQuantity, RunInfo, export::Format,
};
use cotorra_testing::mariadb::MariaDb;
use mysql::prelude::Queryable;
use rusqlite::{Connection, params};

fn main() {
    let words: Vec<String> = std::env::args().skip(1).filter(|word| !word.starts_with("--")).collect();
    let parts: [(&str, fn()); 5] =
        [("record", recording), ("sqlite", sqlite), ("mariadb", mariadb), ("sizes", sizes), ("long", long)];
    for (name, part) in parts {
        if words.is_empty() || words.iter().any(|word| name.contains(word.as_str())) {
            part();
        }
    }
}

const LINKS: u64 = 100;
const ROBOTS: u64 = 10;
/// Time between samples of one series, ns.
const TICK: u64 = 100_000_000;

fn info() -> RunInfo {
    RunInfo { name: "bench".into(), seed: 1, started_at_unix_ns: 0, testbed: String::new() }
}

static LINK_IDS: LazyLock<Vec<LinkId>> =
    LazyLock::new(|| (0..LINKS).map(|n| LinkId::new(&format!("link-{n}")).unwrap()).collect());
static NODE_IDS: LazyLock<Vec<NodeId>> =
    LazyLock::new(|| (0..ROBOTS).map(|n| NodeId::new(&format!("node-{n}")).unwrap()).collect());

/// Returns the `n`th sample of a testbed that observes all links, in both directions, every tick.
fn link(n: u64) -> Stamped {
    let (tick, place) = (n / (2 * LINKS), n % (2 * LINKS));
    let context = LinkContext {
        link: LINK_IDS[(place / 2) as usize].clone(),
        direction: if place % 2 == 0 { Direction::Forward } else { Direction::Backward },
        delay: Some(Duration::from_nanos(1_000_000 + n % 1000)),
        throughput_bps: n as f64 * 1.1,
        queued_packets: Some(n % 7),
        probed: Some(Probed {
            delay: Some(Duration::from_nanos(10_000_000 + n % 977)),
            jitter: Some(Duration::from_nanos(n % 977)),
            delay_age: Some(Duration::from_millis(230)),
            loss: Some(0.0),
            loss_age: Duration::from_millis(240),
        }),
        counters: LinkCounters { packets: n, bytes: n * 100, ..LinkCounters::default() },
        ..base::link_context("link")
    };
    Stamped { at: Timestamp::from_nanos(tick * TICK), event: Event::Link(context) }
}

/// Returns the `n`th sample of robots that hear four radio units.
fn robot(n: u64) -> Stamped {
    let (tick, place) = (n / ROBOTS, n % ROBOTS);
    let pose = Pose::planar(n as f64 * 0.01, 1.5, 0.1, [0.0; 9], PoseSource::Simulator);
    let attachment = |(i, unit): (usize, &NodeId)| Attachment {
        radio_unit: unit.clone(),
        attached: i == 0,
        signal: Some(Dbm(-50.5 - i as f64)),
        age: Some(Duration::from_secs(i as u64)),
    };
    let context = RobotContext {
        robot: NODE_IDS[place as usize].clone(),
        attachments: NODE_IDS.iter().take(4).enumerate().map(attachment).collect(),
        sensors: SensorData {
            pose,
            odometry: pose,
            velocity: Velocity::planar(0.3, 0.0),
            bumper: false,
            nearest_obstacle_m: Some(1.25),
        },
        waypoint: 3,
        ..base::robot_context("robot", pose)
    };
    Stamped { at: Timestamp::from_nanos(tick * TICK), event: Event::Robot(context) }
}

/// Measures quantiles of the cost of `record` at a steady rate, because a mean hides the tail.
fn recording() {
    const RATE: u64 = 100_000;
    const SAMPLES: u64 = 500_000;
    println!("record() at {RATE} samples/s, {SAMPLES} samples a round, SQLite behind it");
    for round in 1..=5 {
        let folder = tempfile::tempdir().unwrap();
        let history = History::open(folder.path().join("history.sqlite")).unwrap();
        let recorder = history.recorder(history.begin_run(&info()).unwrap()).unwrap();
        let began = Instant::now();
        let mut took = Vec::with_capacity(SAMPLES as usize);
        for n in 0..SAMPLES {
            let stamped = link(n);
            while began.elapsed().as_nanos() < u128::from(n * 1_000_000_000 / RATE) {
                std::hint::spin_loop();
            }
            let before = Instant::now();
            recorder.record(stamped);
            took.push(before.elapsed().as_nanos());
        }
        recorder.flush().unwrap();
        took.sort_unstable();
        let at = |share: f64| took[((SAMPLES - 1) as f64 * share) as usize];
        println!(
            "  round {round}: p50 {} ns, p99 {} ns, p99.9 {} ns, max {} µs; dropped {}",
            at(0.5),
            at(0.99),
            at(0.999),
            at(1.0) / 1000,
            recorder.stats().dropped
        );
    }
}

/// Samples of a transaction, in both contenders.
const BATCH: u64 = 20_000;
const BATCHES: u64 = 10;
const ROUNDS: usize = 7;

/// Runs both by turns, so that other load of the machine affects both, and prints their rates.
fn side_by_side(what: &str, bare: impl Fn() -> Duration, ours: impl Fn() -> Duration) {
    let (mut bares, mut its) = (Vec::new(), Vec::new());
    for _ in 0..ROUNDS {
        bares.push(bare());
        its.push(ours());
    }
    let rate = |took: Duration| (BATCH * BATCHES) as f64 / took.as_secs_f64() / 1e6;
    let [bare, its] = [bares, its].map(|mut took: Vec<Duration>| {
        took.sort();
        (rate(took[ROUNDS / 2]), rate(took[ROUNDS - 1]))
    });
    println!("{what}, {ROUNDS} rounds of {} samples by turns, million samples/s", BATCH * BATCHES);
    println!("  bare inserts  median {:.3}, slowest {:.3}", bare.0, bare.1);
    println!(
        "  recorder      median {:.3}, slowest {:.3}: {:.0} % of bare",
        its.0,
        its.1,
        its.0 / bare.0 * 100.0
    );
}

/// Times a recorder from the first sample until the last one is on the disk. Samples come as fast as they are accepted, so
/// that the writer is never idle.
fn through_a_recorder(history: &History, sample: impl Fn(u64) -> Stamped) -> Duration {
    through_a_recorder_of(history, BATCH * BATCHES, sample)
}

fn through_a_recorder_of(history: &History, samples: u64, sample: impl Fn(u64) -> Stamped) -> Duration {
    let recorder = history.recorder(history.begin_run(&info()).unwrap()).unwrap();
    let samples: Vec<Stamped> = (0..samples).map(sample).collect();
    let began = Instant::now();
    for (n, stamped) in (0_u64..).zip(samples) {
        // The queue holds 32,768.
        while n.is_multiple_of(1000) && n - recorder.stats().written > 30_000 {
            std::thread::sleep(Duration::from_micros(200));
        }
        recorder.record(stamped);
    }
    recorder.flush().unwrap();
    let took = began.elapsed();
    assert_eq!(recorder.stats().dropped, 0);
    took
}

const COLUMNS: &str = "run, at_ns, seq, link, direction, delay_ms, throughput_bps, delay_scale, drop_scale, asked, \
     effective, packets, bytes, lost, overflowed, duplicated, corrupted, probed_delay_ms, probed_jitter_ms, \
     probed_delay_age_ms, probed_loss, probed_loss_age_ms, tested_throughput_bps, tested_offered_bps, tested_age_ms, \
     queued_packets";
const WIDTH: usize = 26;

fn sqlite() {
    // The engine's limit: the same columns of the same table, bound by hand, in equally large transactions.
    let bare = || {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("history.sqlite");
        History::open(&path).unwrap().begin_run(&info()).unwrap();
        let mut connection = Connection::open(path).unwrap();
        connection.pragma_update(None, "synchronous", "FULL").unwrap();
        let began = Instant::now();
        for batch in 0..BATCHES {
            let transaction = connection.transaction().unwrap();
            let places = vec!["?"; WIDTH].join(", ");
            let mut insert =
                transaction.prepare(&format!("INSERT INTO link ({COLUMNS}) VALUES ({places})")).unwrap();
            for n in (batch * BATCH..(batch + 1) * BATCH).map(u64::cast_signed) {
                let (tick, place) = (n / (2 * LINKS as i64), n % (2 * LINKS as i64));
                insert
                    .execute(params![
                        1,
                        tick * TICK as i64,
                        n,
                        place / 2,
                        place % 2,
                        1_000_000 + n % 1000,
                        n as f64 * 1.1,
                        1.0,
                        1.0,
                        1,
                        2,
                        n,
                        n * 100,
                        0,
                        0,
                        0,
                        0,
                        10_000_000 + n % 977,
                        n % 977,
                        230_000_000,
                        0.0,
                        240_000_000,
                        rusqlite::types::Null,
                        rusqlite::types::Null,
                        rusqlite::types::Null,
                        n % 7
                    ])
                    .unwrap();
            }
            drop(insert);
            transaction.commit().unwrap();
        }
        began.elapsed()
    };
    let ours = || {
        let folder = tempfile::tempdir().unwrap();
        through_a_recorder(&History::open(folder.path().join("history.sqlite")).unwrap(), link)
    };
    side_by_side("SQLite: links", bare, ours);
    let mut took: Vec<Duration> = (0..ROUNDS)
        .map(|_| {
            let folder = tempfile::tempdir().unwrap();
            through_a_recorder(&History::open(folder.path().join("history.sqlite")).unwrap(), robot)
        })
        .collect();
    took.sort();
    let rate = |took: Duration| (BATCH * BATCHES) as f64 / took.as_secs_f64() / 1e6;
    println!(
        "  recorder, robots with four attachments (five rows each)  median {:.3}, slowest {:.3}",
        rate(took[ROUNDS / 2]),
        rate(took[ROUNDS - 1])
    );
}

fn mariadb() {
    let Some(server) = MariaDb::start() else { return };
    let bare = || {
        let url = server.fresh();
        let history = History::connect(&url.parse().unwrap()).unwrap();
        history.begin_run(&info()).unwrap();
        let options = mysql::Opts::from_url(url.split('?').next().unwrap()).unwrap();
        let mut connection = mysql::Conn::new(options).unwrap();
        // Of the sizes tried, none was faster.
        const ROWS: u64 = 500;
        let row = format!("({})", vec!["?"; WIDTH].join(", "));
        let sql = format!("INSERT INTO link ({COLUMNS}) VALUES {}", vec![row; ROWS as usize].join(", "));
        let statement = connection.prep(sql).unwrap();
        let began = Instant::now();
        for batch in 0..BATCHES {
            let mut transaction = connection.start_transaction(mysql::TxOpts::default()).unwrap();
            for first in (batch * BATCH..(batch + 1) * BATCH).step_by(ROWS as usize) {
                let mut values = Vec::with_capacity(WIDTH * ROWS as usize);
                for n in (first..first + ROWS).map(u64::cast_signed) {
                    let (tick, place) = (n / (2 * LINKS as i64), n % (2 * LINKS as i64));
                    use mysql::Value::{Double, Int, NULL};
                    values.extend([
                        Int(1),
                        Int(tick * TICK as i64),
                        Int(n),
                        Int(place / 2),
                        Int(place % 2),
                        Int(1_000_000 + n % 1000),
                        Double(n as f64 * 1.1),
                        Double(1.0),
                        Double(1.0),
                        Int(1),
                        Int(2),
                        Int(n),
                        Int(n * 100),
                        Int(0),
                        Int(0),
                        Int(0),
                        Int(0),
                        Int(10_000_000 + n % 977),
                        Int(n % 977),
                        Int(230_000_000),
                        Double(0.0),
                        Int(240_000_000),
                        NULL,
                        NULL,
                        NULL,
                        Int(n % 7),
                    ]);
                }
                transaction.exec_drop(&statement, mysql::Params::Positional(values)).unwrap();
            }
            transaction.commit().unwrap();
        }
        began.elapsed()
    };
    let ours = || through_a_recorder(&History::connect(&server.fresh().parse().unwrap()).unwrap(), link);
    side_by_side("MariaDB: links", bare, ours);
}

/// Times questions to a long run of 200 link directions and 10 robots, with ten samples of each a second, and prints its
/// size.
fn long() {
    let millions = std::env::var("COTORRA_BENCH_MILLIONS").map_or(10, |text| text.parse().unwrap());
    let folder = match std::env::var_os("COTORRA_BENCH_FOLDER") {
        Some(folder) => tempfile::tempdir_in(folder).unwrap(),
        None => tempfile::tempdir().unwrap(),
    };
    let path = folder.path().join("history.sqlite");
    let history = History::open(&path).unwrap();
    let run = history.begin_run(&info()).unwrap();
    let recorder = history.recorder(run).unwrap();
    let ticks = millions * 1_000_000 / (2 * LINKS + ROBOTS);
    let began = Instant::now();
    for tick in 0..ticks {
        (tick * 2 * LINKS..(tick + 1) * 2 * LINKS).for_each(|n| recorder.record(link(n)));
        (tick * ROBOTS..(tick + 1) * ROBOTS).for_each(|n| recorder.record(robot(n)));
        if tick % 100 == 99 {
            recorder.flush().unwrap();
        }
    }
    recorder.flush().unwrap();
    assert_eq!(recorder.stats().dropped, 0);
    let written = recorder.stats().written;
    let end = (ticks * TICK) as f64 / 1e9;
    println!(
        "a run of {end:.0} s with {written} samples, written in {:.0} s; million samples/s: {:.3}",
        began.elapsed().as_secs_f64(),
        written as f64 / began.elapsed().as_secs_f64() / 1e6
    );
    drop(recorder);
    // Closed, so that the log is in the file.
    history.end_run(run, Timestamp::from_secs_f64(end)).unwrap();
    drop(history);
    file_size(&path, written);

    let history = History::open(&path).unwrap();
    let time = |what: &str, ask: &dyn Fn(f64)| {
        let mut took: Vec<Duration> = (0..21)
            .map(|n| {
                let began = Instant::now();
                ask(f64::from(n) / 20.0);
                began.elapsed()
            })
            .collect();
        took.sort();
        let ms = |took: Duration| took.as_secs_f64() * 1e3;
        println!("  {what:<58} median {:.2} ms, slowest {:.2} ms", ms(took[10]), ms(took[20]));
    };
    time("state_at, early to late", &|share| {
        let state = history.state_at(run, Timestamp::from_secs_f64(share * end)).unwrap();
        assert_eq!((state.links.len(), state.robots.len()), (2 * LINKS as usize, ROBOTS as usize));
    });
    let hour = |figure: Figure| {
        let history = &history;
        move |share: f64| {
            let from = Timestamp::from_secs_f64(share * (end - 3600.0).max(0.0));
            let until = from + Duration::from_secs(3600);
            let curve = history.curve(run, &figure, from..until, &CurveRequest::default()).unwrap();
            assert!(curve.points.len() > 900 || end < 3600.0);
        }
    };
    let delay = Figure::Link(LINK_IDS[7].clone(), Direction::Backward, LinkQuantity::Delay);
    time("an hour's delay of one link, 1000 points", &hour(delay));
    let x = Figure::Robot(NODE_IDS[3].clone(), RobotQuantity::X);
    time("an hour's position of one robot, 1000 points", &hour(x));
    let signal = Figure::Signal { robot: NODE_IDS[3].clone(), radio_unit: NODE_IDS[1].clone() };
    time("an hour's signal of one robot, 1000 points", &hour(signal));
    time("1000 samples of one link, as recorded", &|share| {
        let from = Timestamp::from_secs_f64(share * (end - 100.0));
        let page = PageRequest::first(1000);
        let page = history.link_series(run, &LINK_IDS[7], Direction::Forward, from.., page).unwrap();
        assert_eq!(page.items.len(), 1000);
    });
    time("1000 events of all kinds", &|share| {
        let from = Timestamp::from_secs_f64(share * (end - 100.0));
        history.events(run, &[], from.., PageRequest::first(1000)).unwrap();
    });
}

/// Prints the size of the file, and of the links' tables in it.
fn file_size(path: &Path, written: u64) {
    let bytes = std::fs::metadata(path).unwrap().len();
    let connection = Connection::open(path).unwrap();
    println!("  file: {} MB, {:.1} bytes a sample", bytes / 1_000_000, bytes as f64 / written as f64);
    if written > 20_000_000 {
        // Counting the pages takes as long as reading them.
        return;
    }
    let of = |table: &str| -> f64 {
        let sql = "SELECT sum(pgsize) FROM dbstat WHERE name = ?1";
        connection.query_row(sql, [table], |row| row.get::<_, i64>(0)).unwrap_or(0) as f64
    };
    let links: i64 = connection.query_row("SELECT count(*) FROM link", [], |row| row.get(0)).unwrap();
    let each = |table| of(table) / links as f64;
    println!("  bytes a link's sample: rows {:.1}, chunks (with robots') {:.1}", each("link"), each("chunk"));
}

/// Prints the bytes of a link's sample in a history and in exported tables.
fn sizes() {
    const SAMPLES: u64 = 1_000_000;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("history.sqlite");
    let history = History::open(&path).unwrap();
    through_a_recorder_of(&history, SAMPLES, link);
    let run = history.runs(None, 1).unwrap()[0].id;
    for format in Format::ALL {
        let tables = folder.path().join(format.as_str());
        match history.export(run, format, &tables, |_| true) {
            Ok(_) => {
                let bytes = std::fs::metadata(tables.join(format!("link.{format}"))).unwrap().len();
                println!("  exported as {format}: {:.1} bytes a sample", bytes as f64 / SAMPLES as f64);
            }
            Err(error) => println!("  {error}"),
        }
    }
    drop(history);
    file_size(&path, SAMPLES);
}
