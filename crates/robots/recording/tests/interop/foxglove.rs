//! A run watched by a viewer of Foxglove's WebSocket protocol: the Python package `websockets`, with `rosbags` as decoder.
#![allow(clippy::unwrap_used, reason = "a failure here fails the test")]

use std::{
    env,
    io::{BufRead, BufReader},
    net::SocketAddr,
    path::Path,
    process::{Command, Stdio},
    sync::Arc,
};

use cotorra_graph::{Event, NodeId, Pose, PoseSource, RobotContext, Stamped, Timestamp};
use cotorra_graph_testing as base;
use cotorra_recording::{About, Pace, Recording, RecordingError, Wanted};
use serde_json::{Value, json};

const TESTBED: &str = "
name: hall
wireless: { hall: { standard: n, delay: 1 ms } }
nodes:
  tb2: { kind: robot, cpus: 2, memory: 8 GB, position: [1, 2], network: hall }
  R1: { kind: radio_unit, position: [3, 4], channel: 1, network: hall }
links: []
";

/// The robot's context at a time: as many metres along x as seconds.
fn moved(second: u64) -> Arc<Stamped> {
    let (covariance, source) = ([0.0; 9], PoseSource::Odometry);
    let pose = Pose::planar(second as f64, 2.0, 0.0, covariance, source);
    let robot = NodeId::new("tb2").unwrap();
    let context = RobotContext { robot, ..base::robot_context("robot", pose) };
    Arc::new(Stamped { at: Timestamp::from_nanos(second * 1_000_000_000), event: Event::Robot(context) })
}

fn serve(address: SocketAddr) -> Result<Recording, RecordingError> {
    let testbed = cotorra_testbed_file::parse("hall.yaml", TESTBED, Path::new("."));
    let testbed = Arc::new(testbed.unwrap_or_else(|error| panic!("{error}")));
    let wanted = Wanted { file: None, foxglove: Some(address) };
    let about = About { name: "hall", seed: 1, started_at_unix_ns: 0, testbed_file: TESTBED };
    let begun = Recording::begin(&wanted, Path::new("."), &testbed, about, Pace::Live)?;
    Ok(begun.expect("something is wanted"))
}

#[test]
fn viewer_gets_fixed_parts_and_events() {
    let Some(python) = cotorra_testing::peers("websockets, rosbags") else { return };
    let recording = serve(([127, 0, 0, 1], 0).into()).unwrap();
    recording.tap().event(moved(1));

    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/peers/watch.py");
    let mut viewer = Command::new(python)
        .arg(script)
        .arg(recording.foxglove().unwrap().to_string())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(viewer.stdout.take().unwrap()).lines();
    let mut next = || -> Value { serde_json::from_str(&lines.next().expect("a line").unwrap()).unwrap() };
    assert_eq!(next(), json!("cotorra: hall"));
    // Sent before the viewer came: it is latched.
    assert_eq!(next(), json!({"t": 0, "names": ["R1"]}));
    recording.tap().event(moved(7));
    assert_eq!(next(), json!({"t": 7_000_000_000u64, "frame": "tb2/odom", "x": 7.0, "y": 2.0}));
    assert!(viewer.wait().unwrap().success());

    let summary = recording.finish();
    assert_eq!((summary.dropped, summary.failed, summary.file), (0, None, None));
}

#[test]
fn taken_port_is_an_error() {
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap();
    let refused = serve(address).unwrap_err();
    assert!(refused.to_string().starts_with(&format!("cannot serve Foxglove on {address}: ")), "{refused}");
}
