//! Speed of virtual time on one core: seconds of a testbed's time per second. Run with `cargo bench -p cotorra-testbed
//! --bench virtual_time`.
#![allow(
    clippy::disallowed_types,
    clippy::disallowed_methods,
    clippy::unwrap_used,
    reason = "a benchmark reads the clock, and panics on failures"
)]

use std::{
    path::{Path, PathBuf},
    sync::Arc,
    time::{Duration, Instant},
};

use cotorra_graph::{Testbed, Timestamp};
use cotorra_recording::{RecordingPlace, Wanted};
use cotorra_testbed::{Options, Place, Simulation, simulate};

fn main() {
    let load = |name: &str, plugin: &str| {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../testbeds").join(name);
        cotorra_testbed_file::load_with(file, &[format!("plugin={plugin}").parse().unwrap()]).unwrap()
    };
    println!("{:<58} {:>10} {:>10}", "virtual seconds in a second", "median", "slowest");
    for plugin in ["probing", "okpi"] {
        let testbed = load("corridor.yaml", plugin);
        row(&format!("corridor, {plugin}"), 15, || bare(&testbed, None));
        row(&format!("corridor, {plugin}, with history and figure"), 15, || whole(&testbed, None, None));
        row(&format!("corridor, {plugin}, … and recorded as MCAP"), 15, || {
            whole(&testbed, None, recorded())
        });
    }
    for plugin in ["probing", "okpi"] {
        let testbed = load("corridor-wifi.yaml", plugin);
        row(&format!("corridor with real Wi-Fi, {plugin}"), 15, || bare(&testbed, None));
        row(&format!("… {plugin}, with history and figure"), 15, || whole(&testbed, None, None));
    }
    let minute = Duration::from_secs(60);
    let hundred = hundred_robots();
    row("100 robots, 20 radio units, 3 servers, a minute", 5, || bare(&hundred, Some(minute)));
    row("… with history and figure", 5, || whole(&hundred, Some(minute), None));
    row("… and recorded as MCAP", 5, || whole(&hundred, Some(minute), recorded()));
}

/// Prints the median and the slowest of some runs; each returns its virtual seconds.
fn row(name: &str, runs: usize, mut run: impl FnMut() -> Timestamp) {
    let speed = |_| {
        let began = Instant::now();
        let virtual_s = run().as_secs_f64();
        virtual_s / began.elapsed().as_secs_f64()
    };
    let mut speeds: Vec<f64> = (0..runs).map(speed).collect();
    speeds.sort_by(f64::total_cmp);
    println!("{name:<58} {:>9.0}× {:>9.0}×", speeds[runs / 2], speeds[0]);
}

/// Simulates without writing results.
fn bare(testbed: &Testbed, until: Option<Duration>) -> Timestamp {
    let end = until.map_or(Timestamp::MAX, |until| Timestamp::ZERO + until);
    let mut simulation = Simulation::new(Arc::new(testbed.clone()), 1).unwrap();
    loop {
        let now = simulation.step();
        while simulation.poll_event().is_some() {}
        if simulation.is_finished() || now >= end {
            return now;
        }
    }
}

/// The recording's place with `--record`.
fn recorded() -> Option<RecordingPlace> {
    Some(RecordingPlace::Folder)
}

/// Simulates as `cotorra run --simulate` does.
fn whole(testbed: &Testbed, until: Option<Duration>, file: Option<RecordingPlace>) -> Timestamp {
    let out = tempfile::tempdir().unwrap();
    let folder = Place::In(PathBuf::from(out.path()));
    let recording = Wanted { file, foxglove: None };
    let options = Options { until, folder, recording, ..Options::default() };
    let mut end = Timestamp::ZERO;
    let finished = simulate(testbed.clone(), "", &options, |_| true).unwrap();
    for sample in finished.report.samples().iter() {
        end = end.max(sample.emitted);
    }
    end
}

/// A hall of 100 m × 80 m with a radio unit every 20 m. Robots walk to and fro, each with its navigation on one of three
/// servers. They roam by periodic probing.
fn hundred_robots() -> Testbed {
    let mut nodes = String::from("  lan: { kind: switch }\n");
    let (mut links, mut services, mut walks) = (String::new(), String::new(), String::new());
    for (server, delay_ms) in [("fog", 1.0), ("edge", 2.0), ("cloud", 8.0)] {
        nodes += &format!("  {server}: {{ kind: server, tier: {server}, cpus: 64, memory: 64 GB }}\n");
        links += &format!("  - {{ ends: [lan, {server}], delay: {delay_ms} ms, rate: 1 Gbit/s }}\n");
    }
    for unit in 0..20 {
        let (x, y, channel) = (10 + unit % 5 * 20, 10 + unit / 5 * 20, [1, 6, 11][unit % 3]);
        nodes += &format!("  R{unit}: {{ kind: radio_unit, position: [{x}, {y}], channel: {channel} }}\n");
        links += &format!("  - {{ ends: [R{unit}, lan], delay: 0.2 ms, rate: 100 Mbit/s }}\n");
    }
    for robot in 0..100 {
        let (x, y, server) = (robot % 10 * 10 + 2, robot / 10 * 8 + 2, ["fog", "edge", "cloud"][robot % 3]);
        nodes += &format!("  robot{robot}: {{ kind: robot, cpus: 2, memory: 8 GB, roaming: instructed }}\n");
        services += &format!(
            "  s{robot}:\n    robot: robot{robot}\n    kpis: {{ service_time: 50 ms }}\n    vnfs:\n      \
             d{robot}: {{ program: robot_driver, pinned_to: robot{robot} }}\n      \
             n{robot}: {{ program: navigation, node: {server}, cpus: 1, memory: 1 GB }}\n    \
             virtual_links: [{{ from: d{robot}, to: n{robot}, rate: 1 Mbit/s }}]\n"
        );
        walks += &format!(
            "  robot{robot}: {{ waypoints: [[{x}, {y}], [{}, {}]], and_back: true, speed_limit: 0.3 m/s, \
             position_interval: 100 ms }}\n",
            98 - x,
            78 - y
        );
    }
    let text = format!(
        "name: hundred\nwireless:\n  hall:\n    standard: n\n    delay: 1 ms\n    \
         path_loss: {{ model: log_distance, exponent: 3.0 }}\n\
         nodes:\n{nodes}links:\n{links}services:\n{services}walks:\n{walks}plugins: [probing]\n"
    );
    cotorra_testbed_file::parse("hundred.yaml", &text, Path::new("."))
        .unwrap_or_else(|error| panic!("{error}"))
}
