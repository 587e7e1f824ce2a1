//! Energy of a server whose load is known: that of M/M/1 at a load of 0.7 is idle + (full - idle) · 0.7.
#![allow(clippy::unwrap_used, reason = "tests may panic")]

use std::time::Duration;

use cotorra_computing::{Limits, Server};
use cotorra_graph::{Scheduling, ServerPower, Timestamp};
use cotorra_numbers::{Distribution, Draws};

const SEEDS: u64 = 20;
/// Student's t at 99 % with 19 degrees of freedom.
const T: f64 = 2.861;
const LOAD: f64 = 0.7;
const POWER: ServerPower = ServerPower { idle_w: 100.0, full_w: 250.0, energy_cost: 0.0 };

/// Returns the mean power over ten minutes of exponential demands of 1 ms that arrive at random, watts.
fn mean_power(seed: u64) -> f64 {
    let run = Duration::from_secs(600);
    let end = Timestamp::ZERO + run;
    let exponential = |mean_ms: f64| Distribution::exponential(mean_ms).unwrap();
    let (between, demand) = (exponential(1.0 / LOAD), exponential(1.0));
    let (mut arrivals, mut demands) = (Draws::new(seed, "arrivals"), Draws::new(seed, "demands"));
    let ms = |ms: f64| Duration::from_nanos((ms * 1e6).round() as u64);
    let mut server = Server::new(1.0, 1.0);
    let scheduling = Scheduling::Fifo { workers: 1 };
    server.start(Timestamp::ZERO, 1, Limits { cpus: 1.0, scheduling, backlog: u32::MAX });
    let mut at = Timestamp::ZERO;
    loop {
        at = at + ms(between.sample(&mut arrivals));
        while server.poll(at.min(end)).is_some() {}
        if at >= end {
            break;
        }
        server.arrive(at, 1, ms(demand.sample(&mut demands)), ()).unwrap();
    }
    let cpu_time = server.load(1).unwrap().cpu_time();
    (POWER.idle_wh(run) + POWER.load_wh(cpu_time, 1.0)) / (run.as_secs_f64() / 3600.0)
}

#[test]
fn power_of_an_m_m_1_queue_follows_its_load() {
    let all: Vec<_> = (1..=SEEDS).map(mean_power).collect();
    let mean = all.iter().sum::<f64>() / SEEDS as f64;
    let deviation = (all.iter().map(|of| (of - mean).powi(2)).sum::<f64>() / (SEEDS - 1) as f64).sqrt();
    let half = T * deviation / (SEEDS as f64).sqrt();
    let known = POWER.idle_w + (POWER.full_w - POWER.idle_w) * LOAD;
    println!("{mean:.4} W ± {half:.4}, known {known:.4}");
    assert!((mean - known).abs() <= half, "{mean} W ± {half}, known {known}");
    assert!(all.iter().all(|watts| (POWER.idle_w..=POWER.full_w).contains(watts)));
}
