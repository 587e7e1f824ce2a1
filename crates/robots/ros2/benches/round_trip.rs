//! Measures the round trip of a 360-beam scan over loopback, 100 times a second, with the quality of service of sensors:
//! to a node of this crate, to Cyclone DDS, and from Cyclone DDS to itself.
//!
//! `cargo bench -p cotorra-ros2 --bench round_trip`
#![allow(clippy::disallowed_types, clippy::disallowed_methods, reason = "measures real time")]
#![allow(clippy::unwrap_used, reason = "a failed benchmark ends")]

use std::{
    thread,
    time::{Duration, Instant},
};

use cotorra_ros2::{
    Qos,
    messages::{Header, LaserScan, Time},
};
use cotorra_testing::{
    process::{PATIENCE, until},
    ros2::Meeting,
};
use hdrhistogram::Histogram;

const INTERVAL: Duration = Duration::from_millis(10);
const WARM_UP: u32 = 100;
const SAMPLES: u32 = 2000;
/// Deadline of a scan. Best effort: a later one is lost.
const LOST: Duration = Duration::from_secs(1);

fn scan() -> LaserScan {
    LaserScan {
        header: Header { frame_id: "laser".to_owned(), ..Header::default() },
        ranges: (0..360).map(|beam| 1.0 + beam as f32 / 100.0).collect(),
        ..LaserScan::default()
    }
}

/// Measures scans to a peer that returns them on `scan_back`, and prints percentiles.
fn measure(peer: &str, meeting: &Meeting) {
    let node = meeting.node("pitcher");
    let there = node.publish::<LaserScan>("scan", Qos::SENSORS).unwrap();
    let back = node.subscribe::<LaserScan>("scan_back", Qos::SENSORS).unwrap();
    until("the peer is connected", || there.subscribers() == 1 && back.publishers() == 1);
    let mut scan = scan();
    until("scans come back", || {
        there.publish(&scan);
        back.try_recv().is_some()
    });
    thread::sleep(LOST);
    while back.try_recv().is_some() {}
    let (mut took, mut lost) = (Histogram::<u64>::new(3).unwrap(), 0);
    let mut due = Instant::now();
    for number in 0..WARM_UP + SAMPLES {
        due += INTERVAL;
        thread::sleep(due.saturating_duration_since(Instant::now()));
        let began = Instant::now();
        scan.header.stamp = Time { sec: i32::try_from(number).unwrap(), nanosec: 0 };
        there.publish(&scan);
        // A scan may arrive after its deadline.
        let came = loop {
            match back.recv_timeout(LOST) {
                Ok(came) if came.header.stamp == scan.header.stamp => break true,
                Ok(_) => {}
                Err(_) => break false,
            }
        };
        match (number >= WARM_UP, came) {
            (true, true) => took.record(u64::try_from(began.elapsed().as_nanos()).unwrap()).unwrap(),
            (true, false) => lost += 1,
            _ => {}
        }
    }
    let at = |percentile| took.value_at_quantile(percentile) as f64 / 1e6;
    println!("| {peer} | {:.3} ms | {:.3} ms | {:.3} ms | {lost} |", at(0.5), at(0.99), at(1.0));
}

fn main() {
    println!("| to | p50 | p99 | max | lost |\n|---|---|---|---|---|");
    let meeting = Meeting::new();
    let echo = meeting.node("echo");
    let back = echo.publish::<LaserScan>("scan_back", Qos::SENSORS).unwrap();
    let there = echo.subscribe::<LaserScan>("scan", Qos::SENSORS).unwrap();
    let catcher = thread::spawn(move || {
        while let Some(scan) = there.recv() {
            back.publish(&scan);
        }
    });
    measure("a node of this crate", &meeting);
    echo.shut_down();
    catcher.join().unwrap();

    let meeting = Meeting::new();
    let Some(echo) = meeting.cyclone("echo", "LaserScan", "scan", "sensors") else { return };
    measure("Cyclone DDS, in Python", &meeting);
    let pitcher = meeting.cyclone("pitch", "LaserScan", "scan", "sensors").unwrap();
    until("Cyclone DDS is done", || {
        thread::sleep(PATIENCE / 600);
        pitcher.output().contains('|')
    });
    println!("{}", pitcher.output().lines().last().unwrap());
    drop(echo);
}
