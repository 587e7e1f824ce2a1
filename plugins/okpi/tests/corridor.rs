//! The published corridor: what is decided where, on the way out and back.
#![allow(clippy::unwrap_used, reason = "a test stops where its world is not as it says")]

use std::{sync::LazyLock, time::Duration};

use cotorra_graph::{
    Conditions, Decision, Event, Handover, Instruction, LinkId, NodeId, NodeKind, PathKind, Placement,
    PluginId, Position, Rate, Testbed, Timestamp, VirtualLinkMapping, VnfId,
};
use cotorra_okpi::{Chain, Infrastructure, Link, Node, Okpi, Search, Vnf};
use cotorra_plugin::{Actions, Plugin};
use cotorra_testing::{
    corridor,
    placement::{context, exact, generated, survey},
};
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
                    Instruction::Map { .. } => {
                        assert!(!attached, "paths are mapped before the robot takes them")
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

/// Without a survey.
fn by_signal() -> Map<String, Value> {
    Map::from_iter([("services".to_owned(), json!(["navigation"]))])
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
fn placements_report_cost_and_slack() {
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

/// The corridor as a decision sees it with some radio units in reach, put together from the testbed file alone.
fn seen(testbed: &Testbed, units: &[&str]) -> (Chain, Infrastructure) {
    let graph = &testbed.graph;
    let place = |id: &NodeId| graph.nodes.iter().position(|node| node.id == *id).unwrap();
    let nodes = graph.nodes.iter().map(|node| Node {
        id: node.id.clone(),
        cpus: node.capacity().map_or(0.0, |capacity| capacity.cpus),
        memory_bytes: node.capacity().map_or(0, |capacity| capacity.memory_bytes),
        cost: if let NodeKind::Server(server) = &node.kind { server.cost } else { 0.0 },
        reliability: 1.0,
        forwards: node.forwards(),
    });
    let link = |id: LinkId, ends: [&NodeId; 2], ms: [f64; 2], mbps: f64, wireless| Link {
        id,
        ends: ends.map(place),
        round_trip: Duration::from_secs_f64((ms[0] + ms[1]) / 1e3),
        free_bps: mbps * 1e6,
        reliability: 1.0,
        wireless,
    };
    let robot = NodeId::new("robot").unwrap();
    let air = units.iter().map(|unit| {
        let unit = NodeId::new(unit).unwrap();
        link(LinkId::wireless(&robot, &unit), [&robot, &unit], [1.0, 1.0], 8.0, true)
    });
    let ms = |conditions: &Conditions| conditions.delay.as_secs_f64() * 1e3;
    let wired = graph.links.iter().map(|wire| {
        let mbps = match wire.forward.rate {
            Rate::Fixed { bits_per_second } => bits_per_second.mbps(),
            _ => wire.medium.mbps(),
        };
        let delays = [ms(&wire.forward), ms(&wire.backward)];
        link(wire.id.clone(), wire.ends.each_ref(), delays, mbps, false)
    });
    let servers = ["fog", "edge", "cloud"].map(|name| place(&NodeId::new(name).unwrap()));
    let vnf = |name, cpus, hosts, rate_bps| Vnf {
        id: VnfId::new(name).unwrap(),
        cpus,
        memory_bytes: 1_000_000_000,
        hosts,
        rate_bps,
        processing: None,
    };
    let vnfs = vec![
        vnf("robot-driver", 0.0, vec![place(&robot)], 0.0),
        vnf("navigation", 4.0, servers.to_vec(), 6e6),
    ];
    let chain = Chain { vnfs, service_time: Duration::from_millis(15), reliability: None };
    (chain, Infrastructure { nodes: nodes.collect(), links: air.chain(wired).collect() })
}

#[test]
fn from_ten_levels_on_the_corridor_costs_the_optimum() {
    let testbed = corridor();
    let mut offered: Vec<Vec<&str>> =
        vec![vec!["R1"], vec!["R3"], vec!["R2"], vec!["R4"], vec!["R5"], vec!["R6"]];
    offered.extend([
        vec!["R1", "R3"],
        vec!["R3", "R2"],
        vec!["R4", "R2"],
        vec!["R5", "R4"],
        vec!["R6", "R5"],
    ]);
    for units in offered {
        let (chain, infrastructure) = seen(&testbed, &units);
        let optimum = exact::optimum(&chain, &infrastructure).unwrap();
        for gamma in 10..=100 {
            let placed = cotorra_okpi::place(&chain, &infrastructure, Search::at(gamma)).unwrap();
            assert_eq!(placed.cost, optimum, "{units:?}, gamma = {gamma}");
        }
    }
}

#[test]
fn every_decision_on_the_way_out_and_back_is_the_optimum() {
    let testbed = corridor();
    for gamma in [10, 15, 50, 100] {
        let mut unsurveyed = by_signal();
        unsurveyed.insert("gamma".to_owned(), json!(gamma));
        for settings in [with("gamma", json!(gamma)), unsurveyed] {
            for change in walk(&settings) {
                let (chain, infrastructure) = seen(&testbed, &[&change.unit]);
                let optimum = exact::optimum(&chain, &infrastructure).unwrap();
                let cost = format!("for a cost of {optimum}: ");
                assert!(change.reason.contains(&cost), "{change:?}, but the optimum is {optimum}");
            }
        }
    }
}

#[test]
fn by_signal_alone_the_nearest_of_each_segment_is_taken() {
    let changes = walk(&by_signal());
    let out = [("R3", "cloud"), ("R2", "edge"), ("R4", "edge"), ("R5", "fog")];
    let back = [("R4", "edge"), ("R2", "edge"), ("R3", "cloud"), ("R1", "cloud")];
    assert_eq!(pairs(&changes), [out, back].concat(), "{changes:#?}");
}

#[test]
fn all_services_are_orchestrated_unless_some_are_named() {
    let mut okpi = Okpi::from_settings(&Map::new()).unwrap();
    let mut actions = Actions::default();
    okpi.start(Timestamp::ZERO, &corridor(), &mut actions);
    let asked = told(&mut okpi, &context((25.5, -27.8), "R1"));
    let place = Instruction::Place {
        vnf: "localization".parse().unwrap(),
        node: NodeId::new("cloud").unwrap().into(),
    };
    assert_eq!(asked, [place], "it is cheapest there");
}

#[test]
fn the_same_walk_gives_the_same_decisions() {
    assert_eq!(walk(&survey()), walk(&survey()));
}

#[test]
fn infeasible_kpis_change_nothing_unless_relaxed() {
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
    assert_eq!(relaxed.len(), 4);
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

/// Returns the instructions that an event causes, without mappings.
fn told(okpi: &mut Okpi, event: &Event) -> Vec<Instruction> {
    let mut actions = Actions::default();
    okpi.handle(Timestamp::ZERO, event, &mut actions);
    let asked = actions.drain().map(|(instruction, _)| instruction);
    asked.filter(|instruction| !matches!(instruction, Instruction::Map { .. })).collect()
}

fn handover(from: &str, to: &str) -> Event {
    let [robot, from, to] = ["robot", from, to].map(|name| NodeId::new(name).unwrap());
    let gap = std::time::Duration::from_millis(30);
    Event::Handover(Handover { robot, from: Some(from), to, fast: true, gap })
}

#[test]
fn handovers_under_way_are_not_instructed_again() {
    let (mut okpi, [place, attach]) = instructed();
    let Instruction::Place { vnf, node } = place else { panic!("{place:?}") };
    assert!(matches!(&attach, Instruction::Attach { radio_unit, .. } if radio_unit == "R2"), "{attach:?}");
    // Its own doing comes back as events, κ has the φ of before, and the robot goes on.
    let mapping = VirtualLinkMapping {
        from: "robot-driver".parse().unwrap(),
        to: vnf.clone(),
        links: vec![LinkId::new("R3-edge").unwrap()],
        path: PathKind::Shortest,
        others: Vec::new(),
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
fn the_path_of_a_decision_is_mapped_there_and_back() {
    let mut okpi = Okpi::from_settings(&survey()).unwrap();
    let mut actions = Actions::default();
    okpi.start(Timestamp::ZERO, &corridor(), &mut actions);
    okpi.handle(Timestamp::ZERO, &context((27.2, -10.0), "R3"), &mut actions);
    let asked: Vec<_> = actions.drain().map(|(instruction, _)| instruction).collect();
    let map = |from: &str, to: &str, links: [&str; 2]| Instruction::Map {
        from: from.parse().unwrap(),
        to: to.parse().unwrap(),
        links: links.map(|link| link.parse().unwrap()).to_vec(),
        reservation: None,
    };
    let there = map("robot", "edge", ["robot~R2", "R2-edge"]);
    let back = map("edge", "robot", ["R2-edge", "robot~R2"]);
    assert_eq!(asked[1..3], [back, there]);
}

#[test]
fn rejected_instructions_are_repeated_at_the_next_location() {
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
fn robots_that_roam_by_themselves_are_brought_back() {
    let (mut okpi, [_, attach]) = instructed();
    told(&mut okpi, &handover("R3", "R2"));
    assert_eq!(told(&mut okpi, &context((27.2, -9.6), "R2")), []);
    told(&mut okpi, &handover("R2", "R4"));
    assert_eq!(told(&mut okpi, &context((27.2, -9.6), "R4")), [attach]);
}

#[test]
fn settings_name_only_parts_of_the_testbed() {
    let testbed = corridor();
    let said = |settings: &Map<String, Value>| {
        let okpi = Okpi::from_settings(settings).unwrap();
        okpi.for_testbed(&testbed).map_err(|error| error.to_string()).err()
    };
    assert_eq!(said(&Map::new()), None);
    assert_eq!(said(&survey()), None);
    let unit = with("coverage", json!({ "R2": [[0, 0], [1, 0], [0, 1]], "r44": [[0, 0], [1, 0], [0, 1]] }));
    let expected = "coverage: the testbed has no radio unit `r44`; did you mean `R4`?";
    assert_eq!(said(&unit).as_deref(), Some(expected));
    let queue = json!({ "navigaton": { "service_rate": "500 /s", "arrival_rate": "20 /s" } });
    let service = "services: the testbed has no service `navigaton`; did you mean `navigation`?";
    assert_eq!(said(&with("services", json!(["navigaton"]))).as_deref(), Some(service));
    let expected = "processing: the testbed has no VNF `navigaton`; did you mean `navigation`?";
    assert_eq!(said(&with("processing", queue)).as_deref(), Some(expected));
}

#[test]
fn generated_graphs_are_placed_the_same_each_time() {
    let (service, infrastructure) = generated(100, 4, Some(0.9), 3);
    let search = Search::at(10);
    let place = || cotorra_okpi::place(&service, &infrastructure, search).unwrap();
    assert_eq!(place(), place());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]
    #[test]
    fn nothing_is_instructed_twice_at_any_location(x in -30.0f64..60.0, y in -60.0f64..30.0) {
        static TESTBED: LazyLock<Testbed> = LazyLock::new(corridor);
        let mut okpi = Okpi::from_settings(&survey()).unwrap();
        let mut actions = Actions::default();
        okpi.start(Timestamp::ZERO, &TESTBED, &mut actions);
        okpi.handle(Timestamp::ZERO, &context((x, y), "R4"), &mut actions);
        // A place, a path there and one back, an attachment.
        prop_assert!(actions.len() <= 4);
        actions.drain().for_each(drop);
        okpi.handle(Timestamp::ZERO, &context((x, y), "R4"), &mut actions);
        prop_assert!(actions.is_empty());
    }
}
