//! What recording costs those who record, how fast it is written beside the engine's own limit, and how fast
//! questions are answered. `cargo bench -p cotorra-measurements`.
#![allow(clippy::unwrap_used, reason = "a benchmark that cannot run says so by failing")]
#![allow(clippy::disallowed_types, reason = "a benchmark reads the clock")]

use std::{hint::black_box, path::Path, sync::LazyLock, time::Instant};

use cotorra_graph::{
    Attachment, Conditions, Dbm, Direction, Event, LinkContext, LinkCounters, LinkId, NodeId, Pose,
    PoseSource, RobotContext, Scale, SensorData, Stamped, Timestamp, Velocity,
};
use cotorra_measurements::{History, PageRequest, RunId, RunInfo};
use divan::{Bencher, counter::ItemsCount};
use rusqlite::{Connection, params};
use tempfile::TempDir;

fn main() {
    // Without a filter: cargo's own argument only.
    if std::env::args().len() <= 2 {
        recording();
    }
    divan::main();
}

const LINKS: u64 = 100;
const ROBOTS: u64 = 10;
/// Time from sample to sample of one series, ns.
const TICK: u64 = 100_000_000;

fn info() -> RunInfo {
    RunInfo { name: "bench".into(), seed: 1, started_at_unix_ns: 0, testbed: String::new() }
}

static LINK_IDS: LazyLock<Vec<LinkId>> =
    LazyLock::new(|| (0..LINKS).map(|n| LinkId::new(&format!("link-{n}")).unwrap()).collect());
static NODE_IDS: LazyLock<Vec<NodeId>> =
    LazyLock::new(|| (0..ROBOTS).map(|n| NodeId::new(&format!("node-{n}")).unwrap()).collect());

/// The `n`th sample of a testbed that observes all links, in both directions, every tick.
fn link(n: u64) -> Stamped {
    let (tick, place) = (n / (2 * LINKS), n % (2 * LINKS));
    let context = LinkContext {
        link: LINK_IDS[(place / 2) as usize].clone(),
        direction: if place % 2 == 0 { Direction::Forward } else { Direction::Backward },
        delay: Some(std::time::Duration::from_nanos(1_000_000 + n % 1000)),
        throughput_bps: n as f64 * 1.1,
        asked: Conditions::default(),
        scale: Scale::default(),
        effective: Conditions::default(),
        counters: LinkCounters { packets: n, bytes: n * 100, ..LinkCounters::default() },
    };
    Stamped { at: Timestamp::from_nanos(tick * TICK), event: Event::Link(context) }
}

/// The `n`th sample of robots that hear four radio units.
fn robot(n: u64) -> Stamped {
    let (tick, place) = (n / ROBOTS, n % ROBOTS);
    let pose = Pose {
        x: n as f64 * 0.01,
        y: 1.5,
        heading: 0.1,
        covariance: [0.0; 9],
        source: PoseSource::Simulator,
    };
    let attachment = |(i, unit): (usize, &NodeId)| Attachment {
        radio_unit: unit.clone(),
        attached: i == 0,
        signal: Some(Dbm(-50.5 - i as f64)),
    };
    let context = RobotContext {
        robot: NODE_IDS[place as usize].clone(),
        attachments: NODE_IDS.iter().take(4).enumerate().map(attachment).collect(),
        sensors: SensorData {
            pose,
            odometry: pose,
            velocity: Velocity { linear: 0.3, angular: 0.0 },
            bumper: false,
            nearest_obstacle_m: Some(1.25),
        },
        waypoint: 3,
    };
    Stamped { at: Timestamp::from_nanos(tick * TICK), event: Event::Robot(context) }
}

/// The tail of what `record` costs, at a steady rate: a mean hides it.
fn recording() {
    const RATE: u64 = 100_000;
    const SAMPLES: u64 = 500_000;
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
    println!("record() at {RATE} samples/s, {SAMPLES} samples, SQLite behind it:");
    println!(
        "  p50 {} ns, p99 {} ns, p99.9 {} ns, max {} ns; dropped {}\n",
        at(0.5),
        at(0.99),
        at(0.999),
        at(1.0),
        recorder.stats().dropped
    );
}

/// Samples a transaction holds, here and there.
const BATCH: u64 = 20_000;
const BATCHES: u64 = 10;

/// What the engine can do: the same columns of the same table, bound by hand, in as big transactions.
#[divan::bench(sample_count = 5, sample_size = 1)]
fn write_links_bare_loop(bencher: Bencher) {
    bencher.counter(ItemsCount::new(BATCH * BATCHES)).with_inputs(prepared).bench_values(|folder| {
        let mut connection = Connection::open(folder.path().join("history.sqlite")).unwrap();
        connection.pragma_update(None, "synchronous", "FULL").unwrap();
        for batch in 0..BATCHES {
            let transaction = connection.transaction().unwrap();
            let mut insert = transaction
                .prepare(
                    "INSERT INTO link (run, t_ns, seq, link, direction, delay_ns, throughput_bps, delay_scale,
                     drop_scale, asked, effective, packets, bytes, lost, overflowed, duplicated, corrupted)
                     VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11, ?12, ?13, ?14, ?15, ?16, ?17)",
                )
                .unwrap();
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
                        0
                    ])
                    .unwrap();
            }
            drop(insert);
            transaction.commit().unwrap();
        }
        folder
    });
}

/// The same through a recorder, from its queue to the disk.
#[divan::bench(sample_count = 5, sample_size = 1)]
fn write_links_recorder(bencher: Bencher) {
    write(bencher, link);
}

/// κ with four attachments: five rows a sample.
#[divan::bench(sample_count = 5, sample_size = 1)]
fn write_robots_recorder(bencher: Bencher) {
    write(bencher, robot);
}

fn write(bencher: Bencher, sample: impl Fn(u64) -> Stamped + Sync) {
    let input = || {
        let folder = prepared();
        let history = History::open(folder.path().join("history.sqlite")).unwrap();
        let recorder = history.recorder(history.runs(None, 1).unwrap()[0].id).unwrap();
        (folder, history, recorder, (0..BATCH * BATCHES).map(&sample).collect::<Vec<_>>())
    };
    bencher.counter(ItemsCount::new(BATCH * BATCHES)).with_inputs(input).bench_values(
        |(folder, history, recorder, samples)| {
            for (n, stamped) in samples.into_iter().enumerate() {
                recorder.record(stamped);
                if (n + 1) % BATCH as usize == 0 {
                    recorder.flush().unwrap();
                }
            }
            assert_eq!(recorder.stats().dropped, 0);
            (folder, history, recorder)
        },
    );
}

/// An empty history with one run.
fn prepared() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    History::open(folder.path().join("history.sqlite")).unwrap().begin_run(&info()).unwrap();
    folder
}

/// A run of two million samples of links and a hundred thousand of robots: 1000 s.
struct Long {
    _folder: TempDir,
    history: History,
    run: RunId,
}

static LONG: LazyLock<Long> = LazyLock::new(|| {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("history.sqlite");
    let history = History::open(&path).unwrap();
    let run = history.begin_run(&info()).unwrap();
    let recorder = history.recorder(run).unwrap();
    for tick in 0..10_000 {
        (tick * 2 * LINKS..(tick + 1) * 2 * LINKS).for_each(|n| recorder.record(link(n)));
        (tick * ROBOTS..(tick + 1) * ROBOTS).for_each(|n| recorder.record(robot(n)));
        if tick % 100 == 99 {
            recorder.flush().unwrap();
        }
    }
    assert_eq!(recorder.stats().dropped, 0);
    let bytes = |path: &Path| std::fs::metadata(path).map_or(0, |file| file.len());
    println!("\nlong run: {} MB for {} samples", bytes(&path) / 1_000_000, recorder.stats().written);
    Long { _folder: folder, history, run }
});

/// The state of 200 link directions and 10 robots, early and late in a long run.
#[divan::bench(args = [1.0, 500.0, 999.0])]
fn state_at(bencher: Bencher, second: f64) {
    let Long { history, run, .. } = &*LONG;
    bencher.bench(|| {
        let state = history.state_at(*run, Timestamp::from_secs_f64(black_box(second))).unwrap();
        assert_eq!((state.links.len(), state.robots.len()), (2 * LINKS as usize, ROBOTS as usize));
        state
    });
}

/// A thousand samples of one link among two hundred.
#[divan::bench]
fn link_series_of_1000(bencher: Bencher) {
    let Long { history, run, .. } = &*LONG;
    bencher.counter(ItemsCount::new(1000_u64)).bench(|| {
        let from = Timestamp::from_secs_f64(700.0);
        let page = history
            .link_series(*run, &LINK_IDS[7], Direction::Forward, from.., PageRequest::first(1000))
            .unwrap();
        assert_eq!(page.items.len(), 1000);
        page
    });
}

/// A thousand events of all kinds.
#[divan::bench]
fn events_1000(bencher: Bencher) {
    let Long { history, run, .. } = &*LONG;
    bencher.counter(ItemsCount::new(1000_u64)).bench(|| {
        let from = Timestamp::from_secs_f64(700.0);
        history.events(*run, &[], from.., PageRequest::first(1000)).unwrap()
    });
}
