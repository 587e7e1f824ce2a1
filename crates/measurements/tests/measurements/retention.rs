//! Rolled-up samples are counted once: in a file and in a server, by a process that is killed, and with samples that come
//! late.
#![allow(clippy::unwrap_used, reason = "a test says so by failing")]

use std::{
    io::{BufRead, BufReader, Write},
    process::{Command, Stdio},
    sync::Arc,
    time::Duration,
};

use cotorra_graph::{
    Attachment, CpuContext, DataFormat, Dbm, Direction, Event, LargeData, LinkContext, LinkId,
    MachineContext, MemoryContext, NodeId, Pose, PoseSource, Probability, Retention, RobotContext,
    SensorReading, Stamped, Timestamp,
};
use cotorra_graph_testing as base;
use cotorra_measurements::{
    CurveRequest, Figure, History, Kind, Location, PageRequest, Pruned, RunId, RunInfo, Values,
};
use cotorra_testing::mariadb::MariaDb;

const PATH: &str = "COTORRA_TEST_HISTORY";
const RUN: &str = "COTORRA_TEST_RUN";

/// Ten samples a second.
const TICK: u64 = 100_000_000;
const SECONDS: u64 = 120;
const SAMPLES: u64 = SECONDS * 10;

const RETENTION: Retention =
    Retention { raw: Duration::from_secs(30), step: Duration::from_secs(1), keep: None };

fn at(n: u64) -> Timestamp {
    Timestamp::from_nanos(n * TICK)
}

fn link(name: &str, n: u64) -> Stamped {
    let context = LinkContext {
        link: LinkId::new(name).unwrap(), // Some samples have no delay.
        delay: (!n.is_multiple_of(7)).then(|| Duration::from_micros(1000 + n * 37 % 501)),
        throughput_bps: n as f64,
        queued_packets: Some(n % 11),
        ..base::link_context("link")
    };
    Stamped { at: at(n), event: Event::Link(context) }
}

fn robot(n: u64) -> Stamped {
    let pose = Pose::planar(n as f64, 0.5, 0.0, [0.0; 9], PoseSource::Simulator);
    let heard = |(name, signal): (&str, f64)| Attachment {
        radio_unit: NodeId::new(name).unwrap(),
        attached: name == "R1",
        signal: (!n.is_multiple_of(3)).then_some(Dbm(signal)),
        age: None,
    };
    let context = RobotContext {
        attachments: [("R1", -50.0 - n as f64 * 0.01), ("R2", -70.0)].map(heard).into(), // Some samples have none.
        localization_error_m: (!n.is_multiple_of(5)).then_some(n as f64 * 0.25),
        ..base::robot_context("robot", pose)
    };
    Stamped { at: at(n), event: Event::Robot(context) }
}

fn charge(n: u64) -> f64 {
    1.0 - n as f64 * 1e-4
}

fn reading(n: u64) -> Stamped {
    let values = [("charge", charge(n)), ("voltage_v", 16.0)];
    let reading = SensorReading {
        robot: NodeId::new("robot").unwrap(),
        sensor: "pack".parse().unwrap(),
        measured: at(n),
        values: values.map(|(name, value)| (name.parse().unwrap(), value)).into(),
        data: Some(LargeData { sequence: n, format: DataFormat::Scan, width: 360, height: 1, bytes: 1500 }),
    };
    Stamped { at: at(n), event: Event::Sensor(reading) }
}

fn machine(n: u64) -> Stamped {
    let context = MachineContext {
        cpu: Some(CpuContext { cpus: 4, busy: Probability::new(n as f64 / SAMPLES as f64) }),
        memory: Some(MemoryContext { memory_bytes: 1 << 33, available_bytes: (1 << 32) + n }),
        ..base::machine_context("edge")
    };
    Stamped { at: at(n), event: Event::Machine(context) }
}

/// Records a run of two links, a robot and its sensor, and a machine.
fn recorded(history: &History, ended: bool) -> RunId {
    let info = RunInfo { name: "old".into(), seed: 1, started_at_unix_ns: 0, testbed: String::new() };
    let run = history.begin_run(&info).unwrap();
    let recorder = history.recorder(run).unwrap();
    for n in 0..SAMPLES {
        let all = [link("a-b", n), link("b-c", n), robot(n), reading(n), machine(n)];
        all.into_iter().for_each(|s| recorder.record(s));
    }
    recorder.flush().unwrap();
    if ended {
        history.end_run(run, at(SAMPLES)).unwrap();
    }
    run
}

/// Returns all available engines.
fn engines() -> Vec<(History, String, Option<Arc<MariaDb>>, tempfile::TempDir)> {
    let mut all = Vec::new();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("history.sqlite").display().to_string();
    all.push((History::open(&path).unwrap(), path, None, folder));
    if let Some(server) = MariaDb::shared() {
        let url = server.fresh();
        let history = History::connect(&url.parse::<Location>().unwrap()).unwrap();
        all.push((history, url, Some(server), tempfile::tempdir().unwrap()));
    }
    all
}

const FIGURES: [&str; 10] = [
    "delay:a-b",
    "throughput:b-c",
    "x:robot",
    "signal:robot:R1",
    "signal:robot:R2",
    "sensor:robot:pack:charge",
    "cpu:edge",
    "available_memory:edge",
    "queue:a-b",
    "localization_error:robot",
];

fn curve(history: &History, run: RunId, figure: &str, points: usize) -> Vec<Values> {
    let figure: Figure = figure.parse().unwrap();
    let request = CurveRequest { points, quantiles: vec![0.5] };
    let curve = history.curve(run, &figure, at(0)..at(SAMPLES), &request).unwrap();
    curve.points.into_iter().filter_map(|point| point.values).collect()
}

fn prune(history: &History, run: RunId, retention: &Retention, dry: bool) -> Pruned {
    let mut all = Pruned::default();
    for kind in Kind::SAMPLED {
        let pruned = history.retain(run, kind, retention, at(SAMPLES), dry, || true).unwrap();
        all.rolled_up += pruned.rolled_up;
        all.points += pruned.points;
        all.dropped += pruned.dropped;
    }
    all
}

/// Returns the values that rolling up must not change. Sums may differ in the last bits.
fn exact(values: &Values) -> (u64, f64, f64, i64, f64) {
    (values.count, values.min, values.max, (values.mean * 1e6).round() as i64, values.last)
}

#[test]
fn figures_are_the_same_before_and_after() {
    let mut results = Vec::new();
    for (history, ..) in engines() {
        let run = recorded(&history, true);
        let other = recorded(&history, true);
        let before = FIGURES.map(|figure| [12, 1].map(|points| curve(&history, run, figure, points)));
        let of_sensor = &before[5][1][0];
        let least = charge(SAMPLES - 1);
        let told_of = (of_sensor.count, of_sensor.min, of_sensor.max, of_sensor.last);
        assert_eq!(told_of, (SAMPLES, least, charge(0), least));
        let state = |seconds: u64| history.state_at(run, at(seconds * 10 - 1)).unwrap();
        let states = [1, 60, 120].map(state);

        let would = prune(&history, run, &RETENTION, true);
        assert!(history.retained(run).unwrap().is_empty(), "a dry run changes nothing");
        let did = prune(&history, run, &RETENTION, false);
        assert_eq!(would, did);
        assert_eq!((did.rolled_up, did.points, did.dropped), (5 * 900, 5 * 90, 0));
        assert_eq!(prune(&history, run, &RETENTION, false), Pruned::default(), "once is enough");

        let after = FIGURES.map(|figure| [12, 1].map(|points| curve(&history, run, figure, points)));
        for (before, after) in before.iter().flatten().flatten().zip(after.iter().flatten().flatten()) {
            assert_eq!(exact(before), exact(after));
            assert_eq!(before.rolled_up, 0);
        }
        let delays = &after[0][0];
        assert_eq!((delays[0].rolled_up, delays[11].rolled_up), (delays[0].count, 0));
        assert_eq!([1, 60, 120].map(state), states, "at the end of a step, the state is what it was");
        let kept = history.events(run, &[Kind::Link], .., PageRequest::first(10_000)).unwrap().items;
        assert_eq!(kept.len(), 2 * (90 + 300));
        let retained = history.retained(run).unwrap();
        let told_of: Vec<_> = retained.iter().map(|r| (r.kind, r.rolled_up_to, r.step)).collect();
        assert_eq!(
            told_of,
            [Kind::Robot, Kind::Link, Kind::Sensor, Kind::Machine].map(|kind| (
                kind,
                at(900),
                Duration::from_secs(1)
            ))
        );
        let difference = history.difference(run, other, Default::default()).unwrap();
        for entry in &difference.links {
            let [a, b] = entry.runs.each_ref().map(|its| its.as_ref().unwrap().delay_ms.as_ref().unwrap());
            assert_eq!(exact(a), exact(b));
        }

        // The rest of the past is dropped.
        let short = Retention { keep: Some(Duration::from_secs(60)), ..RETENTION };
        let dropped = prune(&history, run, &short, false);
        assert_eq!((dropped.rolled_up, dropped.dropped), (0, 5 * 60));
        let rest = curve(&history, run, "x:robot", 1);
        assert_eq!((rest[0].count, rest[0].min), (600, 600.0));
        assert_eq!(history.retained(run).unwrap()[0].dropped_to, at(600));
        assert_eq!(exact(&curve(&history, other, "x:robot", 1)[0]), exact(&before[2][1][0]));
        results.push((format!("{after:?}"), kept));
    }
    assert!(results.windows(2).all(|two| two[0] == two[1]), "every engine gives the same answers");
}

#[test]
fn late_samples_are_counted_once() {
    for (history, ..) in engines() {
        let run = recorded(&history, false);
        prune(&history, run, &RETENTION, false);
        // The clock steps back to times that were rolled up.
        let recorder = history.recorder(run).unwrap();
        for n in [55, 57, 305] {
            recorder.record(link("b-c", n));
        }
        recorder.flush().unwrap();
        let values = &curve(&history, run, "throughput:b-c", 1)[0];
        assert_eq!((values.count, values.rolled_up), (SAMPLES + 3, 900));
        let sum: u64 = (0..SAMPLES).sum::<u64>() + 55 + 57 + 305;
        assert!((values.mean * values.count as f64 - sum as f64).abs() < 1e-3);
        let series = history
            .link_series(run, &LinkId::new("b-c").unwrap(), Direction::Forward, .., PageRequest::first(5000))
            .unwrap();
        assert!(series.items.iter().any(|sample| sample.at == at(57)));
    }
}

#[test]
fn a_run_that_goes_on_keeps_its_last_seconds() {
    let engines = engines();
    let history = &engines[0].0;
    let run = recorded(history, false);
    let now_only = Retention { raw: Duration::ZERO, ..RETENTION };
    history.retain(run, Kind::Robot, &now_only, at(SAMPLES), false, || true).unwrap();
    assert!(history.retained(run).unwrap()[0].rolled_up_to <= at(SAMPLES - 100));
}

/// Runs in the process that is killed.
#[test]
#[ignore = "is started and killed by the test below"]
fn prunes_until_it_is_killed() {
    let Ok(location) = std::env::var(PATH) else { return };
    let run: RunId = std::env::var(RUN).unwrap().parse().unwrap();
    let history = History::connect(&location.parse().unwrap()).unwrap();
    let mut out = std::io::stdout();
    for kind in Kind::SAMPLED {
        let go_on = || writeln!(out, "\nslice").is_ok();
        history.retain(run, kind, &RETENTION, at(SAMPLES), false, go_on).unwrap();
    }
    writeln!(out, "\ndone").unwrap();
}

#[test]
fn kill_9_leaves_either_samples_or_points() {
    for (history, location, ..) in engines() {
        let run = recorded(&history, true);
        let before = FIGURES.map(|figure| exact(&curve(&history, run, figure, 1)[0]));
        for round in 0..100_u64 {
            let mut child = Command::new(std::env::current_exe().unwrap())
                .args(["retention::prunes_until_it_is_killed", "--exact", "--ignored", "--nocapture"])
                .env(PATH, &location)
                .env(RUN, run.to_string())
                .stdout(Stdio::piped())
                .stderr(Stdio::null())
                .spawn()
                .unwrap();
            let mut lines = BufReader::new(child.stdout.take().unwrap()).lines().map_while(Result::ok);
            let slices = lines.by_ref().filter(|line| line == "slice" || line == "done");
            // A little later each time.
            let last = slices.take(2 + round as usize % 3).last();
            child.kill().unwrap();
            child.wait().unwrap();
            assert_eq!(FIGURES.map(|figure| exact(&curve(&history, run, figure, 1)[0])), before);
            let done = last.as_deref() == Some("done") || lines.any(|line| line == "done");
            if done {
                break;
            }
            assert!(round < 99, "it never comes to an end");
        }
        prune(&history, run, &RETENTION, false);
        assert_eq!(FIGURES.map(|figure| exact(&curve(&history, run, figure, 1)[0])), before);
        let all = history.events(run, &[], .., PageRequest::first(10_000)).unwrap().items;
        assert_eq!(all.len(), 5 * (90 + 300));
    }
}
