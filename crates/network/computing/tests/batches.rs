//! Batches on accelerators: schedules by hand, queues whose times are known, and the same requests in SimPy.
//!
//! `cargo nextest run -p cotorra-computing --test batches --no-capture` prints the distances.
#![allow(clippy::unwrap_used, reason = "tests may panic")]

use std::{
    io::Write,
    path::Path,
    process::{Command, Stdio},
    time::Duration,
};

use cotorra_computing::{Accelerator, Inferred, Refused};
use cotorra_graph::{BatchTimes, Batching, Timestamp};
use cotorra_numbers::{Distribution, Draws, quantile};
use proptest::prelude::*;
use serde_json::{Value, json};

const SEEDS: u64 = 20;
/// Student's t at 99 % with 19 degrees of freedom.
const T: f64 = 2.861;

fn ms(ms: f64) -> Duration {
    Duration::from_nanos((ms * 1e6).round() as u64)
}

fn at(time_ms: f64) -> Timestamp {
    Timestamp::ZERO + ms(time_ms)
}

fn batching(max_batch: u32, max_wait_ms: f64) -> Batching {
    Batching { max_batch, max_wait: ms(max_wait_ms), backlog: u32::MAX }
}

/// Times of a batch that takes `per_batch_ms`, and `per_request_ms` for each request.
fn times(per_batch_ms: f64, per_request_ms: f64) -> BatchTimes {
    let (per_batch, per_request) = (ms(per_batch_ms), ms(per_request_ms));
    BatchTimes { per_batch, per_request, tokens: 0, per_token: Duration::ZERO, first_batch: Duration::ZERO }
}

fn rest<T>(accelerator: &mut Accelerator<T>) -> Vec<Inferred<T>> {
    let mut all = Vec::new();
    while let Some(deadline) = accelerator.deadline() {
        all.extend(accelerator.poll(deadline));
    }
    all
}

/// Returns the milliseconds at which requests that arrive at these are finished, of one model.
fn ends_ms(batching: Batching, times: BatchTimes, speed: f64, arrivals_ms: &[f64]) -> Vec<f64> {
    let mut accelerator = Accelerator::new(speed);
    accelerator.start(Timestamp::ZERO, 1, batching, times);
    for (number, arrival) in arrivals_ms.iter().enumerate() {
        accelerator.arrive(at(*arrival), 1, number).unwrap();
    }
    let mut all = rest(&mut accelerator);
    all.sort_by_key(|its| its.token);
    all.iter().map(|its| its.at.since(Timestamp::ZERO).as_secs_f64() * 1e3).collect()
}

#[test]
fn a_batch_begins_when_it_is_full_or_its_oldest_request_has_waited() {
    let of = |batching, arrivals: &[f64]| ends_ms(batching, times(10.0, 1.0), 1.0, arrivals);
    // Alone at once; the others wait for the end, and are one batch.
    assert_eq!(of(batching(4, 0.0), &[0.0, 2.0, 5.0]), [11.0, 23.0, 23.0]);
    // At most two together.
    assert_eq!(of(batching(2, 0.0), &[0.0, 2.0, 5.0, 6.0]), [11.0, 23.0, 23.0, 34.0]);
    // Full after 3 ms, then after a wait of 5 ms.
    assert_eq!(of(batching(2, 5.0), &[0.0, 3.0, 20.0]), [15.0, 15.0, 36.0]);
    // A wait that ended during a batch.
    assert_eq!(of(batching(4, 5.0), &[0.0, 6.0, 7.0]), [16.0, 28.0, 28.0]);
}

#[test]
fn speed_tokens_and_the_first_batch_count() {
    let slow_start = BatchTimes { tokens: 7, per_token: ms(2.0), first_batch: ms(100.0), ..times(0.0, 6.0) };
    assert_eq!(ends_ms(batching(1, 0.0), slow_start, 1.0, &[0.0, 0.0]), [120.0, 140.0]);
    assert_eq!(ends_ms(batching(1, 0.0), slow_start, 2.0, &[0.0, 0.0]), [60.0, 70.0]);
}

#[test]
fn models_take_turns_by_when_their_batches_could_begin() {
    let mut accelerator = Accelerator::new(1.0);
    accelerator.start(at(0.0), 1, batching(8, 0.0), times(10.0, 0.0));
    accelerator.start(at(0.0), 2, batching(8, 0.0), times(20.0, 0.0));
    for (time, model) in [(0.0, 1), (1.0, 2), (2.0, 1), (3.0, 2)] {
        accelerator.arrive(at(time), model, ()).unwrap();
    }
    let ends: Vec<_> = rest(&mut accelerator).iter().map(|its| (its.model, its.at)).collect();
    assert_eq!(ends, [(1, at(10.0)), (2, at(30.0)), (2, at(30.0)), (1, at(40.0))]);
}

#[test]
fn a_model_that_stops_loses_its_batch_and_frees_the_accelerator() {
    let mut accelerator = Accelerator::new(1.0);
    let short = Batching { backlog: 1, ..batching(1, 0.0) };
    accelerator.start(at(0.0), 1, short, times(10.0, 0.0));
    accelerator.start(at(0.0), 2, short, times(5.0, 0.0));
    accelerator.arrive(at(0.0), 1, "served").unwrap();
    accelerator.arrive(at(1.0), 1, "waits").unwrap();
    assert_eq!(accelerator.arrive(at(1.0), 1, "too many"), Err(Refused::Full));
    accelerator.arrive(at(2.0), 2, "other").unwrap();
    let (load, lost) = accelerator.stop(at(4.0), 1).unwrap();
    assert_eq!((load.arrived, load.dropped, load.served, lost), (3, 1, 0, vec!["served", "waits"]));
    assert_eq!(rest(&mut accelerator).iter().map(|its| its.at).collect::<Vec<_>>(), [at(9.0)]);
    assert_eq!(accelerator.arrive(at(9.0), 1, "gone"), Err(Refused::NoInstance));
}

/// Returns the times from arrivals to ends, milliseconds, of Poisson arrivals. The first ones are left out.
fn poisson_times(batching: Batching, times: BatchTimes, rate: f64, seed: u64) -> Vec<f64> {
    let between = Distribution::exponential(1.0 / rate).unwrap();
    let mut draws = Draws::new(seed, "arrivals");
    let mut accelerator = Accelerator::new(1.0);
    accelerator.start(Timestamp::ZERO, 1, batching, times);
    let (mut time_ms, mut finished) = (0.0, Vec::new());
    for number in 0..32_000 {
        time_ms += between.sample(&mut draws);
        finished.extend(std::iter::from_fn(|| accelerator.poll(at(time_ms))));
        accelerator.arrive(at(time_ms), 1, number).unwrap();
    }
    finished.extend(rest(&mut accelerator));
    let measured = finished.iter().filter(|its| its.token >= 2000);
    measured.map(|its| its.at.since(its.arrived).as_secs_f64() * 1e3).collect()
}

/// Whether the interval of a figure over seeds contains the known value. Prints both.
fn holds(name: &str, known: f64, figure: impl Fn(u64) -> f64) -> bool {
    let all: Vec<f64> = (1..=SEEDS).map(figure).collect();
    let mean = all.iter().sum::<f64>() / SEEDS as f64;
    let deviation = (all.iter().map(|of| (of - mean).powi(2)).sum::<f64>() / (SEEDS - 1) as f64).sqrt();
    let half = T * deviation / (SEEDS as f64).sqrt();
    println!("{name}: {mean:.4} ms ± {half:.4}, known {known:.4}");
    (mean - known).abs() <= half
}

fn mean(times: &[f64]) -> f64 {
    times.iter().sum::<f64>() / times.len() as f64
}

#[test]
fn batches_of_one_are_an_m_d_1_queue() {
    let known = 1.0 + 0.7 / (2.0 * 0.3);
    assert!(holds("M/D/1 at 0.7, mean", known, |seed| {
        mean(&poisson_times(batching(1, 0.0), times(0.0, 1.0), 0.7, seed))
    }));
}

#[test]
fn unlimited_batches_of_one_length_have_known_times() {
    // All that arrive during a batch are the next one. The accelerator is idle between two batches only if none arrives, with
    // probability e^-rate, for 1/rate on average. By PASTA, a request finds it busy for its share of time, and then waits for
    // the rest of the batch, which is uniform.
    for rate in [0.5_f64, 2.0] {
        let busy = 1.0 / (1.0 + (-rate).exp() / rate);
        let runs: Vec<_> = (1..=SEEDS)
            .map(|seed| poisson_times(batching(u32::MAX, 0.0), times(1.0, 0.0), rate, seed))
            .collect();
        let run = |seed: u64| &runs[seed as usize - 1];
        let name = format!("unlimited batches, {rate} arrivals a batch");
        assert!(holds(&format!("{name}, mean"), 1.0 + busy / 2.0, |seed| mean(run(seed))));
        assert!(holds(&format!("{name}, p95"), 2.0 - 0.05 / busy, |seed| {
            let mut sorted = run(seed).clone();
            sorted.sort_by(f64::total_cmp);
            quantile(&sorted, 0.95).unwrap()
        }));
    }
}

#[test]
fn a_full_queue_is_served_at_the_rate_of_full_batches() {
    let mut accelerator = Accelerator::new(1.0);
    accelerator.start(Timestamp::ZERO, 1, batching(8, 100.0), times(27.0, 46.0));
    (0..800).for_each(|number| accelerator.arrive(Timestamp::ZERO, 1, number).unwrap());
    let last = rest(&mut accelerator).pop().unwrap();
    // Eight in 27 + 8 · 46 ms.
    assert_eq!(last.at, at(100.0 * (27.0 + 8.0 * 46.0)));
    let load = accelerator.load(1).unwrap();
    assert_eq!((load.served, load.batches, load.used), (800, 100, last.at.since(Timestamp::ZERO)));
}

proptest! {
    #[test]
    fn requests_of_a_model_stay_in_order_and_batches_do_not_overlap(
        gaps in prop::collection::vec((0_u64..40, 0_u64..3), 1..80),
        most in 1_u32..5,
        wait in 0_u64..30,
    ) {
        let mut accelerator = Accelerator::new(1.0);
        for model in 0..3 {
            accelerator.start(Timestamp::ZERO, model, batching(most, wait as f64), times(5.0, 3.0));
        }
        let mut time = 0;
        for (number, (gap, model)) in gaps.iter().enumerate() {
            time += gap;
            accelerator.arrive(at(time as f64), *model, number).unwrap();
        }
        let all = rest(&mut accelerator);
        prop_assert_eq!(all.len(), gaps.len());
        let mut batches: Vec<(Timestamp, Timestamp, u64, usize)> = Vec::new();
        for its in &all {
            prop_assert!(its.began >= its.arrived);
            match batches.last_mut() {
                Some(last) if last.0 == its.began => last.3 += 1,
                _ => batches.push((its.began, its.at, its.model, 1)),
            }
        }
        for (began, end, _, size) in &batches {
            prop_assert!(*size <= most as usize);
            prop_assert_eq!(end.since(*began), ms(5.0 + 3.0 * *size as f64));
        }
        prop_assert!(batches.windows(2).all(|pair| pair[0].1 <= pair[1].0));
        for model in 0..3 {
            let tokens: Vec<_> = all.iter().filter(|its| its.model == model).map(|its| its.token).collect();
            prop_assert!(tokens.is_sorted());
        }
    }
}

/// Number of requests to each model.
const REQUESTS: usize = 5000;

/// Returns the arrivals at a model, nanoseconds.
fn arrivals(mean_ms: f64, label: &str) -> Vec<u64> {
    let (between, mut draws) = (Distribution::exponential(mean_ms).unwrap(), Draws::new(1, label));
    let mut time = 0;
    let next = std::iter::repeat_with(|| {
        time += (between.sample(&mut draws) * 1e6) as u64;
        time
    });
    next.take(REQUESTS).collect()
}

#[test]
fn requests_end_when_they_end_in_simpy() {
    let tokens = BatchTimes { tokens: 7, per_token: ms(15.0), first_batch: ms(900.0), ..times(0.0, 61.0) };
    let scenes = [
        ("one by one", 1.0, vec![(20.0, batching(1, 0.0), times(0.0, 16.0))]),
        ("batches of 8 at most", 1.25, vec![(60.0, batching(8, 0.0), times(27.0, 46.0))]),
        ("batches that wait", 1.0, vec![(80.0, batching(4, 50.0), times(27.0, 46.0))]),
        (
            "three models",
            2.0,
            vec![
                (150.0, batching(8, 10.0), tokens),
                (120.0, batching(8, 0.0), times(27.0, 46.0)),
                (40.0, batching(2, 5.0), times(0.0, 10.0)),
            ],
        ),
    ];
    let mut described = Vec::new();
    let mut ours: Vec<Vec<Vec<u64>>> = Vec::new();
    for (name, speed, models) in &scenes {
        let mut accelerator = Accelerator::new(*speed);
        let (mut all, mut described_models) = (Vec::new(), Vec::new());
        for (key, (mean_ms, batching, times)) in models.iter().enumerate() {
            accelerator.start(Timestamp::ZERO, key as u64, *batching, *times);
            let arrivals = arrivals(*mean_ms, &format!("{name} {key}"));
            let ns = |time: Duration| time.as_nanos() as u64;
            described_models.push(json!({
                "requests": arrivals, "max_batch": batching.max_batch, "max_wait": ns(batching.max_wait),
                "times": {
                    "per_batch": ns(times.per_batch), "per_request": ns(times.per_request), "tokens": times.tokens,
                    "per_token": ns(times.per_token), "first_batch": ns(times.first_batch),
                },
            }));
            all.extend(arrivals.into_iter().enumerate().map(|(number, time)| (time, key as u64, number)));
        }
        all.sort_unstable();
        for (time, key, number) in all {
            accelerator.arrive(Timestamp::from_nanos(time), key, number).unwrap();
        }
        let mut ends = vec![vec![0; REQUESTS]; models.len()];
        let mut last = 0;
        for its in rest(&mut accelerator) {
            last = its.at.as_nanos();
            ends[its.model as usize][its.token] = last;
        }
        described.push(json!({ "speed": speed, "models": described_models, "until": last + 1_000_000_000 }));
        ours.push(ends);
    }
    let Some(python) = cotorra_testing::python("simpy", "SimPy") else { return };
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/batches.py");
    let mut simpy =
        Command::new(python).arg(script).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
    simpy.stdin.take().unwrap().write_all(json!(described).to_string().as_bytes()).unwrap();
    let output = simpy.wait_with_output().unwrap();
    assert!(output.status.success());
    let theirs: Value = serde_json::from_slice(&output.stdout).unwrap();
    for (((name, ..), ours), theirs) in scenes.iter().zip(&ours).zip(theirs["ends"].as_array().unwrap()) {
        for (ours, theirs) in ours.iter().zip(theirs.as_array().unwrap()) {
            let theirs: Vec<_> = theirs.as_array().unwrap().iter().map(|end| end.as_u64().unwrap()).collect();
            assert_eq!(theirs.len(), REQUESTS, "{name}");
            let most = ours.iter().zip(&theirs).map(|(ours, theirs)| ours.abs_diff(*theirs)).max().unwrap();
            println!("{name}: {REQUESTS} requests, SimPy is at most {most} ns away");
            assert!(most < 1000, "{name}: {most} ns");
        }
    }
}
