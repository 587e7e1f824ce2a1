//! Queues whose times are known: means and 95th percentiles over seeds contain the known value in their 99 % interval.
//!
//! `cargo nextest run -p cotorra-computing --test queues --no-capture` prints the distances.
#![allow(clippy::unwrap_used, reason = "tests may panic")]

use std::time::Duration;

use cotorra_computing::{Finished, Limits, Server};
use cotorra_graph::{Scheduling, Timestamp};
use cotorra_numbers::{Distribution, Draws, quantile};

const SEEDS: u64 = 20;
/// Student's t at 99 % with 19 degrees of freedom.
const T: f64 = 2.861;

/// A queue whose mean service time is 1 ms on one CPU.
struct Queue {
    cpus: f64,
    scheduling: Scheduling,
    /// Arrivals per millisecond.
    rate: f64,
    /// Milliseconds.
    demand: Distribution,
}

/// Number of requests, of which the first are left out.
#[derive(Clone, Copy)]
struct Length {
    left_out: usize,
    measured: usize,
}

/// The relaxation time of these queues is below 40 service times up to a load of 0.7.
const USUAL: Length = Length { left_out: 2000, measured: 30_000 };
/// That of a load of 0.95 is 1560 service times.
const LONG: Length = Length { left_out: 40_000, measured: 400_000 };

fn nanos(ms: f64) -> Duration {
    Duration::from_nanos((ms * 1e6).round() as u64)
}

fn limits(cpus: f64, scheduling: Scheduling) -> Limits {
    Limits { cpus, scheduling, backlog: u32::MAX }
}

/// Returns the requests that finished, in the order of their arrivals.
fn served(queue: &Queue, arrivals: impl Iterator<Item = Timestamp>, seed: u64) -> Vec<Finished<usize>> {
    let mut draws = Draws::new(seed, "demands");
    let arrivals = arrivals.map(|at| (at, queue.demand.sample(&mut draws)));
    finished(queue.cpus, queue.scheduling, arrivals)
}

/// Returns the requests of these demands, milliseconds, in the order of their arrivals.
fn finished(
    cpus: f64,
    scheduling: Scheduling,
    arrivals: impl Iterator<Item = (Timestamp, f64)>,
) -> Vec<Finished<usize>> {
    let mut server = Server::new(cpus, 1.0);
    server.start(Timestamp::ZERO, 1, limits(cpus, scheduling));
    let mut finished = Vec::new();
    for (number, (at, demand_ms)) in arrivals.enumerate() {
        while let Some(next) = server.poll(at) {
            finished.push(next);
        }
        server.arrive(at, 1, nanos(demand_ms), number).unwrap();
    }
    while let Some(deadline) = server.deadline() {
        finished.extend(server.poll(deadline));
    }
    finished.sort_by_key(|finished| finished.token);
    finished
}

fn poisson(rate: f64, seed: u64) -> impl Iterator<Item = Timestamp> {
    let times = Distribution::exponential(1.0 / rate).unwrap();
    let mut draws = Draws::new(seed, "arrivals");
    let mut at_ms = 0.0;
    std::iter::repeat_with(move || {
        at_ms += times.sample(&mut draws);
        Timestamp::ZERO + nanos(at_ms)
    })
}

/// Returns the times in the system, milliseconds.
fn times(queue: &Queue, length: Length, seed: u64) -> Vec<f64> {
    let arrivals = poisson(queue.rate, seed).take(length.left_out + length.measured);
    let finished = served(queue, arrivals, seed);
    let time = |its: &Finished<usize>| its.at.since(its.arrived).as_secs_f64() * 1e3;
    finished[length.left_out..].iter().map(time).collect()
}

/// Whether the interval of a figure over seeds contains the known value. Prints both.
fn holds(name: &str, known: f64, figure: impl Fn(u64) -> f64) -> bool {
    let all: Vec<f64> = (1..=SEEDS).map(figure).collect();
    let mean = all.iter().sum::<f64>() / SEEDS as f64;
    let deviation = (all.iter().map(|of| (of - mean).powi(2)).sum::<f64>() / (SEEDS - 1) as f64).sqrt();
    let half = T * deviation / (SEEDS as f64).sqrt();
    let off = 100.0 * (mean / known - 1.0);
    println!("{name}: {mean:.4} ms ± {half:.4}, known {known:.4}, off by {off:+.2} %");
    (mean - known).abs() <= half
}

fn mean(times: &[f64]) -> f64 {
    times.iter().sum::<f64>() / times.len() as f64
}

fn p95(mut times: Vec<f64>) -> f64 {
    times.sort_by(f64::total_cmp);
    quantile(&times, 0.95).unwrap()
}

/// Asserts the mean and the 95th percentile of a queue.
fn assert_times(name: &str, queue: &Queue, length: Length, known: [f64; 2]) {
    let runs: Vec<_> = (1..=SEEDS).map(|seed| times(queue, length, seed)).collect();
    let run = |seed: u64| &runs[seed as usize - 1];
    let means = holds(&format!("{name}, mean"), known[0], |seed| mean(run(seed)));
    let p95s = holds(&format!("{name}, p95"), known[1], |seed| p95(run(seed).clone()));
    assert!(means && p95s, "{name}");
}

/// Returns the value at which a falling tail is 5 %.
fn at_5_percent(tail: impl Fn(f64) -> f64) -> f64 {
    let (mut low, mut high) = (0.0, 1000.0);
    for _ in 0..100 {
        let middle = 0.5 * (low + high);
        if tail(middle) > 0.05 { low = middle } else { high = middle }
    }
    low
}

fn exponential() -> Distribution {
    Distribution::exponential(1.0).unwrap()
}

const ONE_WORKER: Scheduling = Scheduling::Fifo { workers: 1 };

#[test]
fn one_worker_with_exponential_demands_is_an_m_m_1_queue() {
    let queue = Queue { cpus: 1.0, scheduling: ONE_WORKER, rate: 0.7, demand: exponential() };
    // The time in the system is exponential.
    assert_times("M/M/1 at 0.7", &queue, USUAL, [1.0 / 0.3, 20_f64.ln() / 0.3]);
}

#[test]
fn a_load_of_95_percent_has_its_long_times() {
    let queue = Queue { cpus: 1.0, scheduling: ONE_WORKER, rate: 0.95, demand: exponential() };
    assert_times("M/M/1 at 0.95", &queue, LONG, [20.0, 20_f64.ln() / 0.05]);
}

#[test]
fn constant_demands_make_an_m_d_1_queue() {
    let (rate, demand) = (0.7, Distribution::constant(1.0).unwrap());
    let queue = Queue { cpus: 1.0, scheduling: ONE_WORKER, rate, demand };
    // Erlang's distribution of the wait (Tijms, A First Course in Stochastic Models, 2003, section 9.6.2).
    let waits_up_to = |x: f64| {
        let term = |k: usize| {
            let y = rate * (x - k as f64);
            (1..=k).fold(1.0, |product, i| product * -y / i as f64) * y.exp()
        };
        (1.0 - rate) * (0..=x.floor() as usize).map(term).sum::<f64>()
    };
    let known_p95 = 1.0 + at_5_percent(|x| 1.0 - waits_up_to(x.min(20.0)));
    assert_times("M/D/1 at 0.7", &queue, USUAL, [1.0 + rate / (2.0 * (1.0 - rate)), known_p95]);
}

#[test]
fn several_workers_make_an_m_m_k_queue() {
    let (workers, rate) = (3_u32, 2.1);
    let scheduling = Scheduling::Fifo { workers };
    let queue = Queue { cpus: f64::from(workers), scheduling, rate, demand: exponential() };
    // Erlang's C, from his B.
    let k = f64::from(workers);
    let blocked = (1..=workers).fold(1.0, |b, n| rate * b / (f64::from(n) + rate * b));
    let waits = k * blocked / (k - rate * (1.0 - blocked));
    let left = k - rate;
    let tail = |t: f64| {
        let both = (left * (-t).exp() - (-left * t).exp()) / (left - 1.0);
        (1.0 - waits) * (-t).exp() + waits * both
    };
    assert_times("M/M/3 at 0.7", &queue, USUAL, [1.0 + waits / left, at_5_percent(tail)]);
}

/// Returns the probability that the time in an M/M/1 queue with shared service is above t. It is the time until a marked
/// request ends that finds n others: a Markov chain, by uniformization. Arrivals find a geometric number of others.
fn shared_tail(rate: f64, t: f64) -> f64 {
    const MOST: usize = 200;
    let jumps = rate + 1.0;
    let mut others: Vec<f64> = (0..MOST).map(|n| (1.0 - rate) * rate.powi(n as i32)).collect();
    let (mut weight, mut tail) = ((-jumps * t).exp(), 0.0);
    let steps = (jumps * t + 12.0 * (jumps * t).sqrt() + 40.0) as usize;
    for step in 0..steps {
        tail += weight * others.iter().sum::<f64>();
        let mut next = vec![0.0; MOST];
        for (n, share) in others.iter().enumerate() {
            next[(n + 1).min(MOST - 1)] += share * rate / jumps;
            if n > 0 {
                next[n - 1] += share * n as f64 / (n + 1) as f64 / jumps;
            }
        }
        others = next;
        weight *= jumps * t / (step + 1) as f64;
    }
    tail
}

#[test]
fn shared_service_makes_an_m_m_1_ps_queue() {
    let queue = Queue { cpus: 1.0, scheduling: Scheduling::Shared, rate: 0.7, demand: exponential() };
    assert_times(
        "M/M/1-PS at 0.7",
        &queue,
        USUAL,
        [1.0 / 0.3, at_5_percent(|t| shared_tail(0.7, t.min(200.0)))],
    );
}

#[test]
fn shared_service_takes_in_proportion_to_demands_of_any_distribution() {
    let demand = Distribution::lognormal(1.0, 1.0).unwrap();
    let queue = Queue { cpus: 1.0, scheduling: Scheduling::Shared, rate: 0.7, demand };
    let runs: Vec<_> = (1..=SEEDS)
        .map(|seed| {
            let all = served(&queue, poisson(queue.rate, seed).take(USUAL.left_out + USUAL.measured), seed);
            all[USUAL.left_out..].to_vec()
        })
        .collect();
    let mean_of = |seed: u64, is_in: &dyn Fn(f64) -> bool| {
        let of = runs[seed as usize - 1].iter().filter(|its| is_in(its.computing.as_secs_f64() * 1e3));
        let (mut took, mut demand) = (0.0, 0.0);
        of.for_each(|its| {
            took += its.at.since(its.arrived).as_secs_f64();
            demand += its.computing.as_secs_f64();
        });
        took / demand
    };
    // The mean time of requests of any demand is the demand by 1 - load, whatever the distribution.
    let all = holds("M/G/1-PS at 0.7, time by demand", 1.0 / 0.3, |seed| mean_of(seed, &|_| true));
    let small = holds("… of demands below 0.5 ms", 1.0 / 0.3, |seed| mean_of(seed, &|ms| ms < 0.5));
    let large = holds("… of demands above 2 ms", 1.0 / 0.3, |seed| mean_of(seed, &|ms| ms > 2.0));
    assert!(all && small && large);
}

/// Shares of two classes of requests, and the rates at which a CPU of its own serves them, 1/ms. Their mean is 1 ms, and the
/// variance of all demands 2.5 ms².
const CLASSES: [(f64, f64); 2] = [(0.75, 2.0), (0.25, 0.4)];

/// Returns the probability that a request of a queue with shared service and demands of two exponential classes is still
/// there after so many jumps of the uniformized Markov chain of the others of both classes, and the rate of jumps. Arrivals
/// find a multinomial share of a geometric number of others, whatever the demands.
fn shared_survivals(rate: f64) -> (Vec<f64>, f64) {
    const MOST: usize = 60;
    let loads = CLASSES.map(|(share, served)| rate * share / served);
    let jumps = rate + CLASSES.map(|(_, served)| served).into_iter().fold(0.0, f64::max);
    let mut survivals = vec![0.0; 1000];
    for (own_share, own_served) in CLASSES {
        let mut others = vec![[0.0; MOST]; MOST];
        for (a, row) in others.iter_mut().enumerate() {
            let mut found = (1.0 - rate) * loads[0].powi(a as i32);
            for (b, here) in row.iter_mut().enumerate() {
                *here = own_share * found;
                found *= loads[1] * (a + b + 1) as f64 / (b + 1) as f64;
            }
        }
        for survival in &mut survivals {
            *survival += others.iter().flatten().sum::<f64>();
            let mut next = vec![[0.0; MOST]; MOST];
            for a in 0..MOST {
                for b in 0..MOST {
                    let (here, all) = (others[a][b] / jumps, (a + b + 1) as f64);
                    let leave = [a, b].map(|n| n as f64 / all);
                    let rates = [leave[0] * CLASSES[0].1, leave[1] * CLASSES[1].1];
                    next[(a + 1).min(MOST - 1)][b] += here * rate * CLASSES[0].0;
                    next[a][(b + 1).min(MOST - 1)] += here * rate * CLASSES[1].0;
                    next[a.saturating_sub(1)][b] += here * rates[0];
                    next[a][b.saturating_sub(1)] += here * rates[1];
                    next[a][b] += here * (jumps - rate - rates[0] - rates[1] - own_served / all);
                }
            }
            others = next;
        }
    }
    (survivals, jumps)
}

#[test]
fn shared_service_has_the_long_times_of_two_classes_of_demands() {
    let (survivals, jumps) = shared_survivals(0.7);
    let tail = |t: f64| {
        let mean = jumps * t.min(200.0);
        let mut weight = (-mean).exp();
        let weighted = survivals.iter().zip(1..).map(|(survival, next)| {
            let its = weight * survival;
            weight *= mean / f64::from(next);
            its
        });
        weighted.sum::<f64>()
    };
    let run = |seed: u64| {
        let mut draws = Draws::new(seed, "demands");
        let of = CLASSES.map(|(_, served)| Distribution::exponential(1.0 / served).unwrap());
        let arrivals = poisson(0.7, seed).take(USUAL.left_out + USUAL.measured);
        let arrivals = arrivals.map(|at| {
            let class = usize::from(draws.unit() >= CLASSES[0].0);
            (at, of[class].sample(&mut draws))
        });
        let finished = finished(1.0, Scheduling::Shared, arrivals.collect::<Vec<_>>().into_iter());
        let time = |its: &Finished<usize>| its.at.since(its.arrived).as_secs_f64() * 1e3;
        finished[USUAL.left_out..].iter().map(time).collect::<Vec<_>>()
    };
    let runs: Vec<_> = (1..=SEEDS).map(run).collect();
    let means = holds("M/H2/1-PS at 0.7, mean", 1.0 / 0.3, |seed| mean(&runs[seed as usize - 1]));
    let p95s =
        holds("M/H2/1-PS at 0.7, p95", at_5_percent(tail), |seed| p95(runs[seed as usize - 1].clone()));
    assert!(means && p95s);
}

#[test]
fn queues_in_a_row_have_independent_times() {
    let first = Queue { cpus: 1.0, scheduling: ONE_WORKER, rate: 0.7, demand: exponential() };
    let second = Queue { demand: Distribution::exponential(0.8).unwrap(), ..first };
    let run = |seed: u64| {
        let arrivals = poisson(0.7, seed).take(USUAL.left_out + USUAL.measured);
        let from = served(&first, arrivals, seed);
        let to = served(&second, from.iter().map(|its| its.at), seed + 1000);
        let both = from.iter().zip(&to).map(|(from, to)| to.at.since(from.arrived).as_secs_f64() * 1e3);
        both.skip(USUAL.left_out).collect::<Vec<_>>()
    };
    let runs: Vec<_> = (1..=SEEDS).map(run).collect();
    // What leaves the first is Poisson (Burke 1956), and the times of a request in both are independent (Reich 1963).
    let [a, b] = [0.3, 1.25 - 0.7];
    let tail = |t: f64| (b * (-a * t).exp() - a * (-b * t).exp()) / (b - a);
    let means = holds("two queues, mean", 1.0 / a + 1.0 / b, |seed| mean(&runs[seed as usize - 1]));
    let p95s = holds("two queues, p95", at_5_percent(tail), |seed| p95(runs[seed as usize - 1].clone()));
    assert!(means && p95s);
}
