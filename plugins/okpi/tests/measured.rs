//! Decisions by measurements: when they are made again, and that they do not go back and forth.
#![allow(clippy::unwrap_used, reason = "a test stops where its world is not as it says")]

use std::{path::Path, time::Duration};

use cotorra_graph::{
    Conditions, Direction, Event, Instruction, LinkContext, LinkId, PathKind, Placement, Probed,
    RobotContext, Testbed, Timestamp, VirtualLinkMapping,
};
use cotorra_graph_testing as base;
use cotorra_okpi::Okpi;
use cotorra_plugin::{Actions, Plugin, links::LinkHistory};
use serde_json::{Value, json};

const TEXT: &str = "
name: room
wireless: { lab: { delay: 1 ms } }
nodes:
  robot: { kind: robot, position: [1, 0], roaming: instructed }
  unit: { kind: radio_unit, position: [5, 3], channel: 1 }
  edge: { kind: server, tier: edge, cpus: 4, memory: 8 GB, cost: 2 }
  cloud: { kind: server, tier: cloud, cpus: 4, memory: 8 GB, cost: 1 }
links:
  - { ends: [unit, edge], delay: 4 ms, rate: 100 Mbit/s }
  - { ends: [unit, cloud], delay: 4.5 ms, rate: 10 Mbit/s }
services:
  navigation:
    robot: robot
    kpis: { service_time: 15 ms }
    vnfs:
      robot-driver: { program: robot_driver, pinned_to: robot }
      navigation: { program: navigation, node: cloud, cpus: 2 }
    virtual_links: [{ from: robot-driver, to: navigation, rate: 1 Mbit/s }]
walks: { robot: { waypoints: [[1, 0], [9, 0]] } }
";

/// A plug-in and a network that does at once what it is instructed.
struct World {
    testbed: Testbed,
    okpi: Okpi,
    server: String,
    /// Delay by probes up to the radio unit, ms.
    air_ms: f64,
    /// Moves with their times and reasons.
    moves: Vec<(f64, String, String)>,
}

fn world(settings: Value) -> World {
    let testbed = cotorra_testbed_file::parse("room.yaml", TEXT, Path::new("")).unwrap();
    world_of(testbed, Okpi::from_settings(settings.as_object().unwrap()).unwrap())
}

fn world_of(testbed: Testbed, mut okpi: Okpi) -> World {
    let mut actions = Actions::default();
    okpi.start(Timestamp::ZERO, &testbed, &mut actions);
    assert!(actions.is_empty());
    let mut world = World { testbed, okpi, server: "cloud".to_owned(), air_ms: 1.0, moves: Vec::new() };
    world.tell(0.0, mapping("cloud"));
    world
}

/// The links that carry packets to the server.
fn mapping(server: &str) -> Event {
    let links = ["robot~unit".to_owned(), format!("unit-{server}")];
    Event::VirtualLink(VirtualLinkMapping {
        from: "robot-driver".parse().unwrap(),
        to: "navigation".parse().unwrap(),
        links: links.iter().map(|link| link.parse().unwrap()).collect(),
        path: PathKind::Shortest,
        others: Vec::new(),
    })
}

/// Contexts of both directions of the link to the cloud, whose probes take so long there.
fn probed(testbed: &Testbed, delay_ms: f64) -> [LinkContext; 2] {
    let link = testbed.graph.link(&LinkId::new("unit-cloud").unwrap()).unwrap();
    [
        probes_of("unit-cloud", Direction::Forward, &link.forward, delay_ms),
        probes_of("unit-cloud", Direction::Backward, &link.backward, 4.5),
    ]
}

/// Contexts of both directions of the air, whose probes take so long up to the radio unit.
fn air(delay_ms: f64) -> [LinkContext; 2] {
    let configured = Conditions { delay: Duration::from_millis(1), ..Conditions::default() };
    [
        probes_of("robot~unit", Direction::Forward, &configured, delay_ms),
        probes_of("robot~unit", Direction::Backward, &configured, 1.0),
    ]
}

fn probes_of(link: &str, direction: Direction, conditions: &Conditions, delay_ms: f64) -> LinkContext {
    let age = Duration::from_millis(100);
    let probed = Probed {
        delay: Some(Duration::from_secs_f64(delay_ms / 1e3)),
        jitter: None,
        delay_age: Some(age),
        loss: Some(0.0),
        loss_age: age,
    };
    let effective = conditions.clone();
    LinkContext { direction, effective, probed: Some(probed), ..base::link_context(link) }
}

impl World {
    fn tell(&mut self, seconds: f64, event: Event) {
        let mut actions = Actions::default();
        self.okpi.handle(Timestamp::from_secs_f64(seconds), &event, &mut actions);
        let asked: Vec<_> = actions.drain().collect();
        for (instruction, reason) in asked {
            if let Instruction::Place { vnf, node } = instruction {
                self.server = node.first().to_string();
                self.moves.push((seconds, self.server.clone(), reason.unwrap()));
                self.tell(seconds, Event::Placement(Placement { vnf, node }));
                self.tell(seconds, mapping(&self.server.clone()));
            }
        }
    }

    /// The robot stands at a place for that time. Contexts come ten times a second.
    fn stand(&mut self, from: f64, to: f64, delay_ms: impl Fn(&str) -> f64) {
        for step in 0..((to - from) * 10.0).round() as u32 {
            let now = from + f64::from(step) / 10.0;
            let contexts = probed(&self.testbed, delay_ms(&self.server));
            let contexts = contexts.into_iter().chain(air(self.air_ms));
            contexts.for_each(|context| self.tell(now, Event::Link(context)));
            let pose = base::pose(1.0, 0.0, 0.0);
            let attachments = vec![base::attachment("unit", true, None)];
            let context = RobotContext { attachments, ..base::robot_context("robot", pose) };
            self.tell(now, Event::Robot(context));
        }
    }
}

#[test]
fn a_standing_robots_service_leaves_a_link_that_becomes_slow() {
    let mut world = world(json!({}));
    world.stand(0.0, 20.0, |_| 5.4);
    assert_eq!(world.moves, [], "that is within the tolerance");
    world.stand(20.0, 40.0, |_| 29.0);
    let [(at, server, reason)] = &world.moves[..] else { panic!("{:#?}", world.moves) };
    assert_eq!((server.as_str(), *at < 21.1), ("edge", true), "{at}");
    assert!(reason.ends_with("5.0 ms to spare; `unit-cloud` is 24.5 ms slower than configured"), "{reason}");
    let mut by_configuration = self::world(json!({ "delays": "asked" }));
    by_configuration.stand(0.0, 40.0, |_| 29.0);
    assert_eq!(by_configuration.moves, []);
}

#[test]
fn a_service_moves_nearer_if_the_air_is_slow_all_the_time() {
    let mut world = world(json!({ "gamma": 100 }));
    world.air_ms = 5.4;
    world.stand(0.0, 19.0, |_| 4.5);
    assert_eq!(world.moves, [], "that can be a scan");
    world.stand(19.0, 60.0, |_| 4.5);
    let [(at, server, reason)] = &world.moves[..] else { panic!("{:#?}", world.moves) };
    assert_eq!((server.as_str(), *at < 23.0), ("edge", true), "{at}");
    assert!(reason.contains("14.4 ms, 0.6 ms to spare"), "{reason}");
}

#[test]
fn servers_count_with_the_configured_air_if_the_measured_one_leaves_none() {
    let mut world = world(json!({}));
    world.air_ms = 30.0;
    world.stand(0.0, 30.0, |_| 4.5);
    assert_eq!(world.moves, [], "each server is as late");
    world.stand(30.0, 40.0, |_| 29.0);
    let [(_, server, reason)] = &world.moves[..] else { panic!("{:#?}", world.moves) };
    assert_eq!(server, "edge");
    assert!(reason.contains("slower than configured; with the air as configured"), "{reason}");
}

#[test]
fn it_comes_back_once_the_link_was_fast_for_the_hold() {
    let mut world = world(json!({ "measurements": { "hold": "30 s" } }));
    world.stand(0.0, 10.0, |_| 29.0);
    world.stand(10.0, 60.0, |_| 4.5);
    let places: Vec<_> =
        world.moves.iter().map(|(at, server, _)| (at.round() as u32, server.as_str())).collect();
    let [(_, "edge"), (back, "cloud")] = places[..] else { panic!("{places:?}") };
    assert!((30..=36).contains(&back), "{places:?}");
}

#[test]
fn a_load_of_its_own_does_not_make_it_go_back_and_forth() {
    let hour = |hold: &str| {
        let mut world = world(json!({ "measurements": { "hold": hold } }));
        world.stand(0.0, 3600.0, |server| if server == "cloud" { 29.0 } else { 4.5 });
        world.moves.len()
    };
    // 60 s, 120 s, 240 s, 480 s, and then 600 s each.
    let (held, forgotten) = (hour("60 s"), hour("1 ms"));
    assert!(held <= 19, "{held}");
    assert!(forgotten > 200, "without a hold, the link idles into favour: {forgotten}");
}

/// A history that has the same link in it, always.
#[derive(Debug)]
struct Slow([LinkContext; 2]);

impl LinkHistory for Slow {
    fn latest(&mut self, now: Timestamp) -> Result<Vec<(Timestamp, LinkContext)>, String> {
        Ok(self.0.iter().map(|context| (now, context.clone())).collect())
    }
}

#[test]
fn a_history_is_read_in_place_of_events() {
    let testbed = cotorra_testbed_file::parse("room.yaml", TEXT, Path::new("")).unwrap();
    let settings = json!({ "delays": "history" });
    let okpi = || Okpi::from_settings(settings.as_object().unwrap()).unwrap();
    let error = okpi().for_testbed(&testbed).unwrap_err().to_string();
    assert_eq!(
        error,
        "delays: `history` needs a history, which is not kept here; write `measured` for the same figures"
    );
    let okpi = okpi().reading(Slow(probed(&testbed, 29.0))).for_testbed(&testbed).unwrap();
    let mut world = world_of(testbed, okpi);
    world.stand(0.0, 1.0, |_| 4.5);
    assert_eq!(world.server, "edge");
}
