//! Servers here and in SimPy: the same requests end at the same times.
//!
//! `cargo nextest run -p cotorra-computing --test simpy --no-capture` prints the distances.
#![allow(clippy::unwrap_used, reason = "tests may panic")]

use std::{
    io::Write,
    path::Path,
    process::{Command, Stdio},
    time::Duration,
};

use cotorra_computing::{Limits, Server};
use cotorra_graph::{Scheduling, Timestamp};
use cotorra_numbers::{Distribution, Draws};
use serde_json::{Value, json};

/// Number of requests to each VNF.
const REQUESTS: usize = 2000;
/// Farthest that two times may be apart: rounding to nanoseconds adds up over a busy time, here and in floating point.
const MOST_APART_US: f64 = 5.0;

/// A VNF with a load of its own: requests come at random, and have exponential demands.
struct Vnf {
    limit: f64,
    scheduling: Scheduling,
    /// Seconds between requests, and of a demand, on average.
    times: [f64; 2],
}

struct Scene {
    name: &'static str,
    cpus: f64,
    speed: f64,
    vnfs: Vec<Vnf>,
}

fn scenes() -> Vec<Scene> {
    let fifo = |workers| Scheduling::Fifo { workers };
    let vnf = |limit, scheduling, times| Vnf { limit, scheduling, times };
    vec![
        Scene {
            name: "FIFO with one worker",
            cpus: 1.0,
            speed: 1.0,
            vnfs: vec![vnf(1.0, fifo(1), [0.010, 0.008])],
        },
        Scene {
            name: "FIFO with three workers, limited to 2.5 CPUs",
            cpus: 4.0,
            speed: 1.5,
            vnfs: vec![vnf(2.5, fifo(3), [0.010, 0.028])],
        },
        Scene {
            name: "shared",
            cpus: 1.0,
            speed: 1.0,
            vnfs: vec![vnf(1.0, Scheduling::Shared, [0.010, 0.008])],
        },
        Scene {
            name: "two VNFs, FIFO and shared, over-committed",
            cpus: 1.0,
            speed: 0.8,
            vnfs: vec![vnf(0.6, fifo(1), [0.020, 0.006]), vnf(1.0, Scheduling::Shared, [0.012, 0.005])],
        },
    ]
}

/// Returns the times of arrivals and the demands of a VNF's requests, nanoseconds.
fn requests(vnf: &Vnf, label: &str) -> Vec<[u64; 2]> {
    let mut draws = Draws::new(1, label);
    let [between, demand] = vnf.times.map(|mean| Distribution::exponential(mean).unwrap());
    let mut at = 0;
    let mut next = || {
        at += (between.sample(&mut draws) * 1e9) as u64;
        [at, 1 + (demand.sample(&mut draws) * 1e9) as u64]
    };
    (0..REQUESTS).map(|_| next()).collect()
}

/// Returns when the requests of each VNF end here, nanoseconds.
fn ours(scene: &Scene, all: &[Vec<[u64; 2]>]) -> Vec<Vec<u64>> {
    let mut server = Server::new(scene.cpus, scene.speed);
    for (key, vnf) in scene.vnfs.iter().enumerate() {
        let limits = Limits { cpus: vnf.limit, scheduling: vnf.scheduling, backlog: u32::MAX };
        server.start(Timestamp::ZERO, key as u64, limits);
    }
    let numbered =
        all.iter().enumerate().flat_map(|(key, its)| its.iter().enumerate().map(move |its| (key, its)));
    let mut arrivals: Vec<_> =
        numbered.map(|(key, (number, [at, demand]))| (*at, key, number, *demand)).collect();
    arrivals.sort_unstable();
    let mut ends: Vec<_> = all.iter().map(|its| vec![0; its.len()]).collect();
    for (at, key, number, demand) in arrivals {
        server.arrive(Timestamp::from_nanos(at), key as u64, Duration::from_nanos(demand), number).unwrap();
    }
    while let Some(deadline) = server.deadline() {
        let finished = server.poll(deadline).unwrap();
        ends[finished.instance as usize][finished.token] = finished.at.as_nanos();
    }
    ends
}

/// Returns when they end in SimPy, seconds.
fn theirs(scenes: &Value) -> Option<Value> {
    let python = cotorra_testing::python("simpy", "SimPy")?;
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/servers.py");
    let mut simpy =
        Command::new(python).arg(script).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
    simpy.stdin.take().unwrap().write_all(scenes.to_string().as_bytes()).unwrap();
    let output = simpy.wait_with_output().unwrap();
    assert!(output.status.success());
    Some(serde_json::from_slice(&output.stdout).unwrap())
}

#[test]
fn requests_end_when_they_end_in_simpy() {
    let scenes = scenes();
    let all: Vec<Vec<_>> = scenes
        .iter()
        .map(|scene| {
            scene
                .vnfs
                .iter()
                .enumerate()
                .map(|(key, vnf)| requests(vnf, &format!("{}{key}", scene.name)))
                .collect()
        })
        .collect();
    let described: Vec<_> = scenes
        .iter()
        .zip(&all)
        .map(|(scene, requests)| {
            let vnfs = scene.vnfs.iter().zip(requests).map(|(vnf, its)| {
                let workers = match vnf.scheduling {
                    Scheduling::Fifo { workers } => workers,
                    Scheduling::Shared => 0,
                };
                let requests: Vec<_> = its.iter().map(|times| times.map(|ns| ns as f64 / 1e9)).collect();
                json!({ "limit": vnf.limit, "workers": workers, "requests": requests })
            });
            json!({ "cpus": scene.cpus, "speed": scene.speed, "vnfs": vnfs.collect::<Vec<_>>() })
        })
        .collect();
    let Some(theirs) = theirs(&json!(described)) else { return };
    for ((scene, requests), theirs) in scenes.iter().zip(&all).zip(theirs["ends"].as_array().unwrap()) {
        let ours = ours(scene, requests);
        let mut apart = Vec::new();
        let mut waited = 0.0;
        for (key, ends) in ours.iter().enumerate() {
            for (number, end) in ends.iter().enumerate() {
                let [at, _] = requests[key][number];
                waited += (end - at) as f64 / 1e6;
                apart.push((*end as f64 / 1e3 - theirs[key][number].as_f64().unwrap() * 1e6).abs());
            }
        }
        let (count, most) = (apart.len(), apart.iter().fold(0.0, |a: f64, b| a.max(*b)));
        println!(
            "{}: {count} requests took {:.3} ms on average; SimPy is at most {most:.3} µs away",
            scene.name,
            waited / count as f64
        );
        assert_eq!(count, scene.vnfs.len() * REQUESTS);
        assert!(most < MOST_APART_US, "{}: {most} µs", scene.name);
    }
}
