use std::{path::Path, time::Duration};

use cotorra_graph::{
    Decision, Event, Handover, Instruction, MachineContext, NodeId, Pose, PoseSource, RealRadio, Stamped,
    Timestamp, WifiContext, WifiRole, WifiStation,
};
use cotorra_graph_testing as base;

use super::*;

const TESTBED: &str = "
name: small
wireless: { lab: { path_loss: { model: free_space } } }
nodes:
  robot: { kind: robot, roaming: instructed, tx_power: 12 dBm }
  A: { kind: radio_unit, position: [0, 1], channel: 1 }
  B: { kind: radio_unit, position: [9, 1], channel: 6 }
  edge: { kind: server, tier: edge, cpus: 4, memory: 4 GB }
links:
  - { ends: [edge, [A, B]] }
services:
  navigation:
    robot: robot
    kpis: { service_time: 15 ms }
    vnfs:
      driver: { program: robot_driver, pinned_to: robot }
      navigation: { program: navigation, node: edge, cpus: 1 }
walks:
  robot: { waypoints: [[0, 0], [9, 0]], speed_limit: 0.3 m/s }
";

fn testbed() -> Testbed {
    cotorra_testbed_file::parse("test.yaml", TESTBED, Path::new("")).unwrap()
}

fn id(name: &str) -> NodeId {
    NodeId::new(name).unwrap()
}

fn at(ms: f64) -> Timestamp {
    Timestamp::from_secs_f64(ms / 1e3)
}

fn stamped(ms: f64, event: Event) -> Stamped {
    Stamped { at: at(ms), event }
}

fn answer(emitted_ms: f64, took_ms: Option<f64>) -> Stamped {
    let event = Event::ServiceTime(base::service_time(
        "edge",
        at(emitted_ms),
        took_ms.map(|ms| Duration::from_secs_f64(ms / 1e3)),
    ));
    stamped(emitted_ms + took_ms.unwrap_or(1000.0), event)
}

fn place(ms: f64, x: f64) -> Stamped {
    let pose = Pose::planar(x, 0.0, 0.0, [0.0; 9], PoseSource::Simulator);
    let context = base::robot_context("robot", pose);
    stamped(ms, Event::Robot(context))
}

fn handover(ms: f64, from: Option<&str>, to: &str, gap_ms: f64) -> Stamped {
    let event = Event::Handover(Handover {
        robot: id("robot"),
        from: from.map(id),
        to: id(to),
        fast: true,
        gap: Duration::from_secs_f64(gap_ms / 1e3),
    });
    stamped(ms, event)
}

fn decided(ms: f64, instruction: Instruction) -> Stamped {
    let plugin = "probing".parse().unwrap();
    stamped(ms, Event::Decision(Decision { plugin, instruction, reason: None, refused: None }))
}

fn scan() -> Instruction {
    Instruction::Scan { robot: id("robot") }
}

fn attach(to: &str) -> Instruction {
    Instruction::Attach { robot: id("robot"), radio_unit: id(to) }
}

fn walked(kind: &str, walk: Walk, events: &[Stamped]) -> Walked {
    let of_events = Walked::empty().with(&testbed(), events);
    Walked { kind: kind.to_owned(), walk, ..of_events }
}

fn sent(kind: &str, gaps_ms: &[f64]) -> Walked {
    let roams = gaps_ms.iter().enumerate();
    let roams: Vec<_> =
        roams.map(|(i, gap)| handover(1000.0 * (i + 1) as f64, Some("A"), "B", *gap)).collect();
    walked(kind, Walk::Sent, &roams)
}

#[test]
fn gaps_scans_and_places_are_read_from_events() {
    let events = [
        // The first association is no handover.
        handover(10.0, None, "A", 5.0),
        place(100.0, 0.0),
        place(200.0, 3.0),
        decided(300.0, scan()),
        answer(295.0, Some(4.0)),
        answer(310.0, Some(70.0)),
        answer(390.0, Some(5.0)),
        stamped(390.0, Event::Scanned { robot: id("robot") }),
        // Packets that still wait for the end of the scan count for 200 ms.
        answer(440.0, Some(5.0)),
        answer(515.0, Some(5.0)),
        answer(590.0, Some(5.0)),
        place(800.0, 2.0),
        decided(900.0, attach("B")),
        decided(950.0, attach("B")),
        answer(985.0, Some(4.0)),
        answer(990.0, None),
        answer(995.0, Some(34.0)),
        answer(1000.0, Some(30.0)),
        handover(1015.0, Some("A"), "B", 20.0),
    ];
    let walked = walked("model", Walk::Sent, &events);
    let [roam] = &walked.roams[..] else { panic!("{:?}", walked.roams) };
    assert_eq!((&roam.from, &roam.to, roam.fast), (&id("A"), &id("B"), true));
    let near = |a: f64, b: f64| assert!((a - b).abs() < 1e-6, "{a} {b}");
    near(roam.gap_ms, 20.0);
    // From the answer at 989 ms to that at 1029 ms.
    near(roam.packet_gap_ms.unwrap(), 40.0);
    assert_eq!((roam.position, roam.walked_m), (Some([2.0, 0.0]), Some(4.0)));
    let [scan] = &walked.scans[..] else { panic!("{:?}", walked.scans) };
    near(scan.took_ms, 90.0);
    near(scan.packet_gap_ms.unwrap(), 81.0);
    assert_eq!((walked.asked, walked.retries, walked.packets, walked.unanswered), (2, 1, 10, 1));
}

#[test]
fn the_model_is_inside_where_its_quantile_is_in_the_others_interval() {
    let real: Vec<f64> = (0..60).map(|i| 14.0 + f64::from(i % 20) / 5.0).collect();
    let inside = |model: &[f64]| {
        let comparison = Comparison::of(vec![sent("model", model), sent("hwsim", &real)], 1);
        let by_events = comparison.verdicts.iter().filter(|verdict| verdict.figure.starts_with("gap p"));
        by_events.map(|verdict| (verdict.figure.clone(), verdict.is_inside)).collect::<Vec<_>>()
    };
    let verdicts = |p50, p95| vec![("gap p50".to_owned(), p50), ("gap p95".to_owned(), p95)];
    assert_eq!(inside(&real), verdicts(true, true));
    assert_eq!(inside(&[30.0; 40]), verdicts(false, false));
    // The right median without any spread.
    assert_eq!(inside(&[15.9; 40]), verdicts(true, false));
    assert_eq!(Comparison::of(vec![sent("model", &real)], 1).verdicts, []);
}

#[test]
fn roams_of_all_kinds_are_matched_in_their_order() {
    let model = walked(
        "model",
        Walk::Alone,
        &[
            place(0.0, 0.0),
            place(900.0, 4.0),
            handover(1000.0, Some("A"), "B", 9.0),
            place(1900.0, 1.0),
            handover(2000.0, Some("B"), "A", 9.0),
        ],
    );
    let hwsim = walked(
        "hwsim",
        Walk::Alone,
        &[place(0.0, 0.0), place(900.0, 4.5), handover(1000.0, Some("A"), "B", 9.0)],
    );
    let comparison = Comparison::of(vec![model, hwsim], 1);
    let found: Vec<_> =
        comparison.places.iter().map(|place| (place.from.as_str(), place.walked_m.clone())).collect();
    let expected = [
        ("A", vec![("model", Some(4.0)), ("hwsim", Some(4.5))]),
        ("B", vec![("model", Some(7.0)), ("hwsim", None)]),
    ];
    assert_eq!(found, expected);
    assert!(comparison.to_markdown().contains("| B to A | 0 | 7.0 | – |"));
}

/// Returns a reading of the robot's machine, with the counters of its radio.
fn counted(ms: f64, access_point: &str, retransmissions: u32) -> Stamped {
    let station = WifiStation {
        mac: access_point.to_owned(),
        signal: None,
        transmit_rate: None,
        receive_rate: None,
        retransmissions: Some(retransmissions),
        transmissions_failed: None,
        transmit_airtime: None,
        receive_airtime: None,
        inactive: None,
    };
    let wifi = WifiContext {
        interface: "wlan0".to_owned(),
        role: WifiRole::Client,
        ssid: None,
        stations: vec![station],
        stations_left_out: 0,
        channels: Vec::new(),
        channels_left_out: 0,
    };
    let machine = MachineContext { wifi: vec![wifi], ..base::machine_context("robot") };
    stamped(ms, Event::Machine(machine))
}

#[test]
fn real_radios_have_gaps_and_counters_but_neither_packets_nor_places() {
    let mut testbed = testbed();
    let robot = testbed.graph.nodes.iter_mut().find(|node| node.id == "robot").unwrap();
    let NodeKind::Robot(robot) = &mut robot.kind else { panic!() };
    robot.radio =
        Some(RealRadio { agent: "turtle1".parse().unwrap(), interface: "wlan0".to_owned(), bridge: None });
    testbed.services.clear();
    let events = [
        // Counted for the owner.
        counted(10.0, "a", 40),
        place(100.0, 0.0),
        counted(200.0, "a", 43),
        handover(1000.0, Some("A"), "B", 9.0),
        counted(1100.0, "b", 2),
        // The same access point, joined again.
        counted(2100.0, "b", 1),
    ];
    let real = Walked { kind: "hardware".to_owned(), ..Walked::empty() }.with(&testbed, &events);
    assert_eq!((real.frames_again, real.packets), (Some(6), 0));
    let [roam] = &real.roams[..] else { panic!("{:?}", real.roams) };
    assert_eq!((roam.gap_ms, roam.packet_gap_ms, roam.position, roam.walked_m), (9.0, None, None, None));

    let alone = walked("model", Walk::Alone, &[place(0.0, 0.0), handover(1000.0, Some("A"), "B", 9.0)]);
    let comparison = Comparison::of(vec![sent("model", &[9.5]), alone, real], 1);
    let text = comparison.to_markdown();
    let row = "| sent | hardware | 1 | 1 | 9.00 | 9.00 | not measured | not measured | 0 | – | – | not measured | 0 | 0 | 6 |";
    assert!(text.contains(row), "{text}");
    assert!(text.contains("| A to B | 0 | 0.0 | not measured |"), "{text}");
    assert!(text.contains("Packets and places are not measured on real radios"), "{text}");
    let figures: Vec<_> = comparison.verdicts.iter().map(|verdict| verdict.figure.as_str()).collect();
    assert_eq!(figures, ["gap p50", "gap p95"]);
}

#[test]
fn only_emulated_robots_roam_by_themselves() {
    assert_eq!(KINDS.map(|kind| kind.walks().len()), [2, 2, 1]);
    assert_eq!(HARDWARE.walks(), [Walk::Sent]);
}

#[test]
fn written_walks_are_read_again() {
    let folder = tempfile::tempdir().unwrap();
    let comparison = Comparison::of(vec![sent("model", &[20.0, 22.5]), sent("hwsim", &[15.0])], 1);
    comparison.write(folder.path()).unwrap();
    assert_eq!(read(folder.path()).unwrap(), comparison.walks);
    for file in FILES {
        assert!(folder.path().join(file).exists(), "{file}");
    }
    let csv = fs::read_to_string(folder.path().join("roams.csv")).unwrap();
    assert!(csv.lines().nth(2).unwrap().starts_with("model,sent,0,2,A,B,true,22.5,"), "{csv}");
    assert!(read(Path::new("/nowhere")).unwrap_err().to_string().contains("handover.json"));
}

#[test]
fn each_walk_has_its_settings() {
    let testbed = testbed();
    let of = |kind, walk| settings(&testbed, kind, walk);
    let has = |settings: &[(String, String)], path: &str, value: &str| {
        settings.iter().any(|(p, v)| p == path && v == value)
    };
    let sent = of(HWSIM, Walk::Sent);
    assert!(has(&sent, "wireless.*.wifi", "hwsim") && has(&sent, "nodes.robot.roaming", "instructed"));
    assert!(!sent.iter().any(|(path, _)| path.ends_with("tx_power")));
    let alone = of(MODEL, Walk::Alone);
    assert!(has(&alone, "wireless.*.wifi", "model") && has(&alone, "nodes.robot.roaming", "supplicant"));
    assert!(has(&alone, "nodes.robot.tx_power", "-3 dBm") && has(&alone, "nodes.A.tx_power", "0 dBm"));
}

#[test]
fn a_testbed_needs_a_walk_a_choice_and_packets() {
    assert_eq!(check(&testbed()), Ok(()));
    let mut without = testbed();
    without.graph.nodes.retain(|node| node.id != "B");
    assert_eq!(check(&without), Err(Unfit::NoChoice(id("robot"))));
    let mut without = testbed();
    without.services.clear();
    assert_eq!(check(&without), Err(Unfit::NoService));
    let mut without = testbed();
    without.walks.clear();
    assert_eq!(check(&without), Err(Unfit::NoWalk));
}
