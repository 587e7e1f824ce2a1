//! Every kind of event in a file, read by `rosbags`, and by `mcap` with `mcap-ros2-support`. They know the types from the
//! file alone.
#![allow(clippy::unwrap_used, reason = "a failure here fails the test")]

use std::{env, path::Path, process::Command, sync::Arc, time::Duration};

use cotorra_graph::{
    Attachment, Conditions, CpuContext, Dbm, Decision, Direction, Event, Handover, Instruction,
    InterfaceContext, InterfaceTraffic, Lateness, LinkContext, LinkCounters, LinkId, MachineContext, NodeId,
    PathKind, Placement, PluginId, Pose, PoseSource, Probability, RadioContext, ReadingTime, RobotContext,
    RobotFault, Scale, SensorData, ServiceTime, Stamped, StationContext, Testbed, Timestamp, Velocity,
    VirtualLinkMapping, VnfEvent, VnfId, VnfState,
};
use cotorra_graph_testing as base;
use cotorra_recording::{About, Pace, Recording, RecordingPlace, Wanted};
use cotorra_robot_middleware::{Scan, SensedScan};
use serde_json::{Value, json};

const TESTBED: &str = "
name: hall
map: map.yaml
wireless: { hall: { standard: n, delay: 1 ms } }
nodes:
  tb2: { kind: robot, cpus: 2, memory: 8 GB, position: [1, 2], network: hall }
  R-1: { kind: radio_unit, position: [3, 4], channel: 1, network: hall }
  edge: { kind: server, tier: edge, cpus: 4, memory: 8 GB, position: [5, 6] }
links:
  - { ends: [R-1, edge], delay: 4 ms }
";

fn testbed(place: &Path) -> Arc<Testbed> {
    let map = "image: map.pgm\nresolution: 10\norigin: [-1, -2, 0]\nnegate: 0\noccupied_thresh: 0.65\n\
               free_thresh: 0.196\n";
    std::fs::write(place.join("map.yaml"), map).unwrap();
    // Occupied, free, unknown, above free, free, free.
    std::fs::write(place.join("map.pgm"), b"P5 3 2 255 \x00\xfe\xcd\xfe\xfe\xfe").unwrap();
    let read = cotorra_testbed_file::parse("hall.yaml", TESTBED, place);
    Arc::new(read.unwrap_or_else(|error| panic!("{error}")))
}

fn node(name: &str) -> NodeId {
    NodeId::new(name).unwrap()
}

fn vnf(name: &str) -> VnfId {
    VnfId::new(name).unwrap()
}

fn pose(x: f64, y: f64, heading: f64) -> Pose {
    let mut covariance = [0.0; 9];
    (covariance[0], covariance[4], covariance[8]) = (0.25, 0.5, 0.125);
    Pose::planar(x, y, heading, covariance, PoseSource::Localization)
}

fn machine() -> MachineContext {
    let received = InterfaceTraffic { throughput_bps: Some(8e6), ..InterfaceTraffic::default() };
    let interface = InterfaceContext {
        name: "eth0".to_owned(),
        up: true,
        carrier: true,
        speed: None,
        mtu_bytes: 1500,
        received,
        sent: InterfaceTraffic::default(),
    };
    MachineContext {
        reading: Some(ReadingTime { measured: Timestamp::from_nanos(7), error: Duration::from_micros(250) }),
        cpu: Some(CpuContext { cpus: 4, busy: Probability::new(0.25) }),
        interfaces: vec![interface],
        ..base::machine_context("edge")
    }
}

fn events() -> Vec<Event> {
    let velocity = Velocity::planar(0.25, -0.5);
    vec![
        Event::Placement(Placement { vnf: vnf("navigation"), node: node("edge").into() }),
        Event::VirtualLink(VirtualLinkMapping {
            from: vnf("driver"),
            to: vnf("navigation"),
            links: vec![LinkId::new("tb2~R-1").unwrap(), LinkId::new("R-1-edge").unwrap()],
            path: PathKind::Mapped,
            others: Vec::new(),
        }),
        Event::Vnf(VnfEvent {
            vnf: vnf("navigation"),
            node: node("edge"),
            state: VnfState::Died,
            detail: Some("exit status 3".to_owned()),
        }),
        Event::Robot(RobotContext {
            attachments: vec![Attachment {
                radio_unit: node("R-1"),
                attached: true,
                signal: Some(Dbm(-61.5)),
                age: None,
            }],
            sensors: SensorData {
                pose: pose(1.5, 2.5, 0.0),
                odometry: pose(1.0, 2.0, 0.0),
                velocity,
                bumper: true,
                nearest_obstacle_m: None,
            },
            waypoint: 3,
            health: vec![RobotFault::TimeJump],
            speed_limit_mps: Some(0.25),
            localization_error_m: Some(0.125),
            ..base::robot_context("tb2", pose(0.0, 0.0, 0.0))
        }),
        Event::Radio(RadioContext {
            radio_unit: node("R-1"),
            channel: 11,
            load: Some(0.5),
            stations: vec![StationContext {
                robot: node("tb2"),
                signal: Dbm(-60.0),
                downlink_bps: 65e6,
                uplink_bps: 58.5e6,
                counted: Default::default(),
            }],
        }),
        Event::Link(LinkContext {
            direction: Direction::Backward,
            delay: Some(Duration::from_micros(4250)),
            throughput_bps: 1e6,
            queued_packets: Some(17),
            asked: Conditions { delay: Duration::from_millis(4), ..Conditions::default() },
            scale: Scale { delay_scale: 2.0, drop_scale: 1.5 },
            effective: Conditions { delay: Duration::from_millis(8), ..Conditions::default() },
            counters: LinkCounters {
                packets: 1 << 40,
                bytes: 2,
                lost: 3,
                overflowed: 4,
                duplicated: 5,
                corrupted: 6,
            },
            ..base::link_context("R-1-edge")
        }),
        Event::ServiceTime(ServiceTime {
            robot: node("tb2"),
            sequence: 42,
            attachment: Some(node("R-1")),
            ..base::service_time(
                "edge",
                Timestamp::from_nanos(2_500_000_001),
                Some(Duration::from_micros(11_250)),
            )
        }),
        Event::Handover(Handover {
            robot: node("tb2"),
            from: None,
            to: node("R-1"),
            fast: true,
            gap: Duration::from_millis(33),
        }),
        Event::Detached { robot: node("tb2"), from: node("R-1") },
        Event::Scanned { robot: node("tb2") },
        Event::Decision(Decision {
            plugin: PluginId::new("okpi").unwrap(),
            instruction: Instruction::Attach { robot: node("tb2"), radio_unit: node("R-1") },
            reason: Some("it is nearer".to_owned()),
            refused: Some("it is full".to_owned()),
        }),
        Event::PluginFault { plugin: PluginId::new("okpi").unwrap(), reason: "panicked".to_owned() },
        Event::Lateness(Lateness { frames: 9, p50_us: 1.5, p99_us: 20.0, max_us: 300.0 }),
        Event::Machine(machine()),
        Event::WalkFinished { robot: node("tb2") },
        Event::Notice { message: "ünïcode".to_owned() },
    ]
}

/// Records these events, and returns the readers' output.
fn read_by_peers() -> Option<Vec<Value>> {
    let python = cotorra_testing::peers("rosbags, mcap, mcap-ros2-support")?;
    let place = tempfile::tempdir().unwrap();
    let wanted = Wanted { file: Some(RecordingPlace::Folder), foxglove: None };
    let about = About { name: "hall", seed: 7, started_at_unix_ns: 0, testbed_file: TESTBED };
    let recording = Recording::begin(&wanted, place.path(), &testbed(place.path()), about, Pace::Waiting);
    let recording = recording.unwrap().unwrap();
    for (second, event) in (1..).zip(events()) {
        let at = Timestamp::from_nanos(second * 1_000_000_000 + 5);
        recording.tap().event(Arc::new(Stamped { at, event }));
    }
    let mut ranges = vec![2.0; 360];
    (ranges[0], ranges[1]) = (f32::INFINITY, f32::NEG_INFINITY);
    let scan = Scan {
        at: Timestamp::from_nanos(19_900_000_000),
        first_angle: -1.5,
        angle_step: 0.25,
        ray_interval: Duration::from_millis(1),
        turn: Duration::from_millis(100),
        range_min: 0.5,
        range_max: 9.0,
        ranges,
    };
    let at = Timestamp::from_nanos(20_000_000_000);
    recording.tap().scan(SensedScan { robot: node("tb2"), at, scan });
    let file = recording.finish().file.unwrap();
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/peers/read.py");
    let read = Command::new(python).arg(script).arg(file).output().unwrap();
    assert!(read.status.success(), "{}", String::from_utf8_lossy(&read.stderr));
    let lines = String::from_utf8(read.stdout).unwrap();
    Some(lines.lines().map(|line| serde_json::from_str(line).unwrap()).collect())
}

#[test]
fn two_independent_readers_agree_on_the_events() {
    let Some(read) = read_by_peers() else { return };
    let on = |topic: &str| -> Vec<&Value> { read.iter().filter(|told| told["topic"] == topic).collect() };
    let one = |topic: &str| match on(topic)[..] {
        [told] => &told["value"],
        ref several => panic!("{topic}: {several:?}"),
    };

    let map = one("/map");
    assert_eq!((&map["info"]["width"], &map["info"]["height"]), (&json!(3), &json!(2)));
    assert_eq!(map["info"]["origin"]["position"], json!({"x": -1.0, "y": -2.0, "z": 0.0}));
    // From the lower row.
    assert_eq!(map["data"], json!([0, 0, 0, 100, 0, -1]));

    let scan = on("/tb2/scan")[0];
    assert_eq!(scan["t"], 20_000_000_000u64);
    assert_eq!(scan["value"]["header"]["frame_id"], "tb2/laser");
    assert_eq!(scan["value"]["header"]["stamp"], json!({"sec": 19, "nanosec": 900_000_000}));
    let ranges = scan["value"]["ranges"].as_array().unwrap();
    assert_eq!((ranges.len(), &ranges[..3]), (360, &[json!("inf"), json!("-inf"), json!(2.0)][..]));

    let odometry = one("/tb2/odom");
    assert_eq!(odometry["header"], json!({"stamp": {"sec": 4, "nanosec": 5}, "frame_id": "tb2/odom"}));
    assert_eq!(odometry["child_frame_id"], "tb2/base_footprint");
    assert_eq!(odometry["pose"]["pose"]["position"], json!({"x": 1.0, "y": 2.0, "z": 0.0}));
    assert_eq!(odometry["twist"]["twist"]["linear"]["x"], 0.25);
    let pose = one("/tb2/amcl_pose");
    assert_eq!(pose["header"]["frame_id"], "map");
    assert_eq!(pose["pose"]["pose"]["position"], json!({"x": 1.5, "y": 2.5, "z": 0.0}));
    let covariance = &pose["pose"]["covariance"];
    assert_eq!((&covariance[0], &covariance[7], &covariance[35]), (&json!(0.25), &json!(0.5), &json!(0.125)));
    let moved = one("/tf")["transforms"].as_array().unwrap();
    assert_eq!(
        (&moved[0]["header"]["frame_id"], &moved[0]["child_frame_id"]),
        (&json!("map"), &json!("tb2/odom"))
    );
    assert_eq!(moved[0]["transform"]["translation"], json!({"x": 0.5, "y": 0.5, "z": 0.0}));
    assert_eq!(moved[1]["child_frame_id"], "tb2/base_footprint");
    assert_eq!(moved[2]["child_frame_id"], "tb2/laser");

    let context = one("/tb2/context");
    assert_eq!(context["attached_to"], "R-1");
    assert_eq!(context["attachments"], json!([{"radio_unit": "R-1", "attached": true, "signal_dbm": -61.5}]));
    assert_eq!(
        (&context["waypoint"], &context["bumper"], &context["nearest_obstacle_m"]),
        (&json!(3), &json!(true), &json!("nan"))
    );
    assert_eq!(context["health"], json!(["its time jumps"]));
    assert_eq!(context["localization_error_m"], 0.125);
    let service = one("/tb2/service_time");
    assert_eq!((&service["service_time_ms"], &service["sequence"]), (&json!(11.25), &json!(42)));
    assert_eq!(service["header"]["stamp"], json!({"sec": 2, "nanosec": 500_000_001}));
    assert_eq!((&service["attached_to"], &service["server"]), (&json!("R-1"), &json!("edge")));
    let handover = one("/tb2/handover");
    assert_eq!((&handover["from_radio_unit"], &handover["gap_ms"]), (&json!(""), &json!(33.0)));
    let radio = one("/radio_units/R_1");
    assert_eq!((&radio["channel"], &radio["stations"][0]["uplink_bps"]), (&json!(11), &json!(58.5e6)));
    let link = one("/network/R_1_edge/backward");
    assert_eq!((&link["delay_ms"], &link["effective_delay_ms"]), (&json!(4.25), &json!(8.0)));
    assert_eq!(link["queued_packets"], 17.0);
    assert_eq!((&link["packets"], &link["corrupted"]), (&json!(1u64 << 40), &json!(6)));
    assert_eq!((&link["delay_scale"], &link["drop_scale"]), (&json!(2.0), &json!(1.5)));
    assert_eq!(one("/placement")["node"], "edge");
    assert_eq!(one("/virtual_links")["links"], json!(["tb2~R-1", "R-1-edge"]));
    let decision = one("/decisions");
    let instruction: Value = serde_json::from_str(decision["instruction"].as_str().unwrap()).unwrap();
    assert_eq!(instruction, json!({"instruction": "attach", "robot": "tb2", "radio_unit": "R-1"}));
    assert_eq!((&decision["reason"], &decision["refused"]), (&json!("it is nearer"), &json!("it is full")));
    assert_eq!(one("/emulation/lateness")["max_us"], 300.0);

    let standing = one("/testbed")["markers"].as_array().unwrap();
    let texts: Vec<_> = standing.iter().map(|marker| marker["text"].as_str().unwrap()).collect();
    assert_eq!(texts, ["", "R-1", "", "edge"]);
    let markers = one("/markers")["markers"].as_array().unwrap();
    assert_eq!(markers[1]["text"], "tb2: R-1");
    let line = json!([{"x": 1.5, "y": 2.5, "z": 0.4}, {"x": 3.0, "y": 4.0, "z": 2.5}]);
    assert_eq!((&markers[2]["type"], &markers[2]["points"]), (&json!(4), &line));

    let log: Vec<_> = on("/rosout").iter().map(|line| line["value"]["msg"].as_str().unwrap()).collect();
    assert_eq!(
        log,
        [
            "runs on edge",
            "on edge: died: exit status 3",
            "from none to R-1, gap 33.0 ms",
            "lost R-1",
            "was refused: it is full",
            "cut off: panicked",
            "is at the end of its walk",
            "ünïcode"
        ]
    );
    let parts = on("/diagnostics");
    let parts: Vec<_> = parts.iter().map(|told| &told["value"]["status"][0]).collect();
    let names: Vec<_> = parts.iter().map(|part| part["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["VNF navigation", "radio unit R-1", "plug-in okpi", "emulation", "machine edge"]);
    assert_eq!(parts[1]["values"][2]["value"], "-60 dBm, 65 Mbit/s down, 58.5 Mbit/s up");
    assert_eq!(parts[4]["message"], "0.250 of CPU time busy");
    assert_eq!(
        parts[4]["values"][2],
        json!({"key": "eth0", "value": "8.000 Mbit/s received, - Mbit/s sent"})
    );
}
