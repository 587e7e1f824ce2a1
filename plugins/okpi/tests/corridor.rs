//! The published corridor: what is decided where, on the way out and back.
#![allow(clippy::unwrap_used, reason = "a test stops where its world is not as it says")]

mod common;

use std::sync::LazyLock;

use common::{context, corridor, survey};
use cotorra_graph::{
    Decision, Event, Handover, Instruction, LinkId, NodeId, Placement, PluginId, Position, Testbed,
    Timestamp, VirtualLinkMapping,
};
use cotorra_okpi::Okpi;
use cotorra_plugin::{Actions, Plugin};
use proptest::prelude::*;
use serde_json::{Map, Value, json};

/// A change of decision on the walk.
#[derive(Debug, Clone, PartialEq)]
struct Change {
    at: (f64, f64),
    unit: String,
    server: String,
    reason: String,
}

/// Walks the corridor out and back, a location each 5 cm, and does at once what is asked for.
fn walk(settings: &Map<String, Value>) -> Vec<Change> {
    let testbed = corridor();
    let mut okpi = Okpi::from_settings(settings).expect("the settings are right");
    let mut actions = Actions::default();
    okpi.start(Timestamp::ZERO, &testbed, &mut actions);
    let (mut unit, mut server) = ("R1".to_owned(), "cloud".to_owned());
    let mut changes = Vec::new();
    for leg in testbed.walks[0].waypoints.windows(2) {
        let steps = (leg[0].distance(leg[1]) * 20.0).ceil();
        for step in 0..steps as u32 {
            let share = f64::from(step) / steps;
            let at = Position::new(
                leg[0].x + (leg[1].x - leg[0].x) * share,
                leg[0].y + (leg[1].y - leg[0].y) * share,
            );
            okpi.handle(Timestamp::ZERO, &context((at.x, at.y), &unit), &mut actions);
            let before = (unit.clone(), server.clone());
            let mut said = String::new();
            let mut attached = false;
            let mut done = Vec::new();
            for (instruction, reason) in actions.drain() {
                said = reason.expect("each instruction has its reason");
                match instruction {
                    Instruction::Place { vnf, node } => {
                        assert!(vnf == "navigation" && !attached, "the new VNF is started first");
                        server = node.to_string();
                        done.push(Event::Placement(Placement { vnf, node }));
                    }
                    Instruction::Attach { radio_unit, .. } => {
                        attached = true;
                        done.push(handover(&unit, radio_unit.as_str()));
                        unit = radio_unit.to_string();
                    }
                    other => panic!("{other:?}"),
                }
            }
            for event in done {
                assert_eq!(told(&mut okpi, &event), []);
            }
            if (&unit, &server) != (&before.0, &before.1) {
                changes.push(Change {
                    at: (at.x, at.y),
                    unit: unit.clone(),
                    server: server.clone(),
                    reason: said,
                });
            }
        }
    }
    changes
}

fn pairs(changes: &[Change]) -> Vec<(&str, &str)> {
    changes.iter().map(|change| (change.unit.as_str(), change.server.as_str())).collect()
}

fn with(name: &str, value: Value) -> Map<String, Value> {
    let mut settings = survey();
    settings.insert(name.to_owned(), value);
    settings
}

#[test]
fn decides_as_published_where_it_was_published() {
    let changes = walk(&survey());
    // From (x or y), unit and server, as the authors' system decided.
    let published = [
        ('y', -24.6, "R3", "cloud"),
        ('y', -10.9, "R2", "edge"),
        ('x', 15.8, "R5", "fog"),
        ('x', 17.8, "R2", "edge"),
        ('y', -12.5, "R3", "cloud"),
        ('y', -26.1, "R1", "cloud"),
    ];
    assert_eq!(changes.len(), published.len(), "{changes:#?}");
    for (change, (axis, from, unit, server)) in changes.iter().zip(published) {
        assert_eq!((change.unit.as_str(), change.server.as_str()), (unit, server));
        let at = if axis == 'x' { change.at.0 } else { change.at.1 };
        // Two new locations.
        assert!((at - from).abs() <= 0.5, "{change:?}, not from {axis} = {from}");
    }
}

#[test]
fn says_what_it_costs_and_what_is_to_spare() {
    let changes = walk(&survey());
    assert!(changes[1].reason.starts_with("R2 + edge at ("), "{}", changes[1].reason);
    assert!(
        changes[1].reason.ends_with("for a cost of 8: 10.0 ms, 5.0 ms to spare"),
        "{}",
        changes[1].reason
    );
}

#[test]
fn resolution_decides_between_edge_and_fog() {
    let last = |settings: &Map<String, Value>| walk(settings)[2].server.clone();
    for gamma in [3, 4, 8] {
        assert_eq!(last(&with("gamma", json!(gamma))), "fog", "gamma = {gamma}");
    }
    // Exactly, 2 ms and 12 ms are within 15 ms.
    for gamma in [10, 15, 100] {
        assert_eq!(last(&with("gamma", json!(gamma))), "edge", "gamma = {gamma}");
    }
    // 1 / (1000 - 500) s more are not.
    let mut processed = with("gamma", json!(15));
    let queue = json!({ "navigation": { "service_rate": "1000 /s", "arrival_rate": "500 /s" } });
    processed.insert("processing".to_owned(), queue);
    assert_eq!(last(&processed), "fog");
}

#[test]
fn by_signal_alone_the_nearest_of_each_segment_is_taken() {
    let changes = walk(&Map::new());
    let out = [("R3", "cloud"), ("R2", "edge"), ("R4", "edge"), ("R5", "fog")];
    let back = [("R4", "edge"), ("R2", "edge"), ("R3", "cloud"), ("R1", "cloud")];
    assert_eq!(pairs(&changes), [out, back].concat(), "{changes:#?}");
}

#[test]
fn the_same_walk_gives_the_same_decisions() {
    assert_eq!(walk(&survey()), walk(&survey()));
}

#[test]
fn what_cannot_be_kept_changes_nothing_unless_relaxed() {
    let mut testbed = corridor();
    testbed.services[0].kpis.service_time = std::time::Duration::from_millis(9);
    let asked = |settings: &Map<String, Value>| {
        let mut okpi = Okpi::from_settings(settings).expect("the settings are right");
        let mut actions = Actions::default();
        okpi.start(Timestamp::ZERO, &testbed, &mut actions);
        okpi.handle(Timestamp::ZERO, &context((9.8, -0.7), "R2"), &mut actions);
        actions.drain().collect::<Vec<_>>()
    };
    assert!(asked(&survey()).is_empty());
    let relaxed = asked(&with("relax", json!(true)));
    assert_eq!(relaxed.len(), 2);
    let reason = relaxed[0].1.as_ref().unwrap();
    assert!(reason.ends_with("11.0 ms, 2.0 ms too much"), "{reason}");
}

/// A plug-in that was told of a location just beyond R3's area, and the two instructions with which it answered.
fn instructed() -> (Okpi, [Instruction; 2]) {
    let mut okpi = Okpi::from_settings(&survey()).unwrap();
    let mut actions = Actions::default();
    okpi.start(Timestamp::ZERO, &corridor(), &mut actions);
    let asked = told(&mut okpi, &context((27.2, -10.0), "R3"));
    (okpi, asked.try_into().unwrap())
}

/// What an event makes it ask for.
fn told(okpi: &mut Okpi, event: &Event) -> Vec<Instruction> {
    let mut actions = Actions::default();
    okpi.handle(Timestamp::ZERO, event, &mut actions);
    actions.drain().map(|(instruction, _)| instruction).collect()
}

fn handover(from: &str, to: &str) -> Event {
    let [robot, from, to] = ["robot", from, to].map(|name| NodeId::new(name).unwrap());
    let gap = std::time::Duration::from_millis(30);
    Event::Handover(Handover { robot, from: Some(from), to, fast: true, gap })
}

#[test]
fn a_handover_under_way_is_not_asked_for_again() {
    let (mut okpi, [place, attach]) = instructed();
    let Instruction::Place { vnf, node } = place else { panic!("{place:?}") };
    assert!(matches!(&attach, Instruction::Attach { radio_unit, .. } if radio_unit == "R2"), "{attach:?}");
    // Its own doing comes back as events, κ tells φ of before, and the robot goes on.
    let mapping = VirtualLinkMapping {
        from: "robot-driver".parse().unwrap(),
        to: vnf.clone(),
        links: vec![LinkId::new("R3-edge").unwrap()],
    };
    for event in [
        Event::Placement(Placement { vnf, node }),
        context((27.2, -10.0), "R3"),
        Event::VirtualLink(mapping),
        context((27.2, -9.9), "R3"),
        context((27.2, -9.5), "R3"),
        handover("R3", "R2"),
        context((27.2, -9.4), "R2"),
        context((27.2, -9.0), "R2"),
    ] {
        assert_eq!(told(&mut okpi, &event), [], "{event:?}");
    }
}

#[test]
fn what_was_refused_is_asked_for_again_at_the_next_location() {
    let (mut okpi, asked) = instructed();
    for instruction in &asked {
        let plugin = PluginId::new("okpi").unwrap();
        let (instruction, refused) = (instruction.clone(), Some("not now".to_owned()));
        let decision = Decision { plugin, instruction, reason: None, refused };
        assert_eq!(told(&mut okpi, &Event::Decision(decision)), []);
    }
    assert_eq!(told(&mut okpi, &context((27.2, -9.9), "R3")), [], "that is no new location");
    assert_eq!(told(&mut okpi, &context((27.2, -9.5), "R3")), asked);
}

#[test]
fn a_robot_that_roams_by_itself_is_brought_back_at_once() {
    let (mut okpi, [_, attach]) = instructed();
    told(&mut okpi, &handover("R3", "R2"));
    assert_eq!(told(&mut okpi, &context((27.2, -9.6), "R2")), []);
    told(&mut okpi, &handover("R2", "R4"));
    assert_eq!(told(&mut okpi, &context((27.2, -9.6), "R4")), [attach]);
}

#[test]
fn generated_graphs_are_placed_the_same_each_time() {
    let (service, infrastructure) = common::generated(100, 4, Some(0.9), 3);
    let search = cotorra_okpi::Search::at(10);
    let place = || cotorra_okpi::place(&service, &infrastructure, search).unwrap();
    assert_eq!(place(), place());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]
    #[test]
    fn wherever_the_robot_is_nothing_is_asked_for_twice(x in -30.0f64..60.0, y in -60.0f64..30.0) {
        static TESTBED: LazyLock<Testbed> = LazyLock::new(corridor);
        let mut okpi = Okpi::from_settings(&survey()).unwrap();
        let mut actions = Actions::default();
        okpi.start(Timestamp::ZERO, &TESTBED, &mut actions);
        okpi.handle(Timestamp::ZERO, &context((x, y), "R4"), &mut actions);
        prop_assert!(actions.len() <= 2);
        actions.drain().for_each(drop);
        okpi.handle(Timestamp::ZERO, &context((x, y), "R4"), &mut actions);
        prop_assert!(actions.is_empty());
    }
}
