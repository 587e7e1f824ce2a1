//! Who triggers a federation: the plug-in's own prediction, or the word of the robot's brain.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::time::Duration;

use cotorra_federation::{Federation, Ledgers};
use cotorra_graph::{DomainId, Event, Instruction, Pose, PoseSource, Testbed, Timestamp};
use cotorra_plugin::{Actions, Plugin};
use cotorra_testing::{project_file, robot};

/// Where coverage ends on the way, metres.
const EDGE_M: f64 = 23.7;

/// Places of the robot at the first announcement, and at its halt, metres.
#[derive(Debug, PartialEq)]
struct Walked {
    announced: Option<f64>,
    halted: Option<f64>,
}

/// Returns the part of `testbeds/federation.yaml` that domain 1 sees.
fn domain(name: &DomainId) -> Testbed {
    let mut testbed = cotorra_testbed_file::load(project_file("testbeds/federation.yaml")).unwrap();
    testbed.graph.nodes.retain(|node| node.domain == *name);
    testbed
}

/// Walks the robot from x = 6 m to 23.5 m at 0.3 m/s, past a request of its brain at `requested` metres. The ledger is always
/// current.
fn walk(trigger: &str, requested: Option<f64>) -> Walked {
    let name: DomainId = "domain-1".parse().unwrap();
    let settings = serde_json::json!({
        "ledger": { "kind": "modelled", "block_period": "1 s" }, "highest_price": 150, "edge": "-65 dBm", "trigger": trigger,
    });
    let mut ledgers = Ledgers::default();
    let mut plugin = Federation::open(settings.as_object().unwrap(), Some(&name), 1, &mut ledgers).unwrap();
    let (mut actions, mut walked) = (Actions::default(), Walked { announced: None, halted: None });
    plugin.start(Timestamp::ZERO, &domain(&name), &mut actions);
    let mut asked = false;
    for step in 0..583 {
        let (now, x) =
            (Timestamp::ZERO + Duration::from_millis(100 * step), 6.0 + 0.03 * f64::from(step as u32));
        while plugin.next_deadline().is_some_and(|deadline| deadline <= now) {
            plugin.expire(now, &mut actions);
        }
        if requested.is_some_and(|place| place <= x) && !asked {
            asked = true;
            let robot = robot::robot();
            plugin.handle(now, &Event::FederationRequested { robot }, &mut actions);
        }
        let pose = Pose::planar(x, 0.0, 0.0, [0.0; 9], PoseSource::Localization);
        plugin.handle(now, &robot::context(pose, 1), &mut actions);
        for (instruction, _) in actions.drain() {
            match instruction {
                Instruction::Note { step, .. } if step == "announced" => {
                    walked.announced.get_or_insert(x);
                }
                Instruction::Halt { .. } => {
                    walked.halted.get_or_insert(x);
                }
                _ => {}
            }
        }
    }
    walked
}

fn near(place: Option<f64>, expected: f64) -> bool {
    place.is_some_and(|place| (place - expected).abs() < 0.2)
}

#[test]
fn at_the_brains_word_it_announces_then_and_only_then() {
    let silent = walk("brain", None);
    assert_eq!(silent.announced, None, "nobody asked for it");
    assert!(
        near(silent.halted, EDGE_M - 0.6),
        "a robot that nobody serves stops 2 s before the edge: {silent:?}"
    );
    for place in [8.0, 20.0] {
        let asked = walk("brain", Some(place));
        assert!(near(asked.announced, place), "{asked:?}");
    }
}

#[test]
fn by_itself_it_announces_when_it_foresees_the_edge() {
    let alone = walk("coverage", None);
    assert!(near(alone.announced, EDGE_M - 9.0), "30 s before the edge: {alone:?}");
    assert_eq!(walk("coverage", Some(8.0)), alone, "it does not listen to the brain");
}
