//! Plug-ins that are away from the core.

use cotorra_graph::{ContextKind, Staleness};
use cotorra_testbed_file::Setting;

use super::*;

/// Two radio units that a robot walks past. `CLOUD` are conditions of the way to the cloud, and `PLUGIN` keys of the plug-in.
const PASSAGE: &str = "
name: passage
wireless: { lab: { shadowing: { deviation: 0 dB } } }
nodes:
  robot: { kind: robot, roaming: instructed }
  A: { kind: radio_unit, position: [0, 3], channel: 1 }
  B: { kind: radio_unit, position: [20, 3], channel: 6 }
  lan: { kind: switch }
  edge: { kind: server, tier: edge, cpus: 4, memory: 8 GB }
  cloud: { kind: server, tier: cloud, cpus: 4, memory: 8 GB }
links:
  - { ends: [lan, [A, B]], delay: 1 ms, rate: 100 Mbit/s }
  - { ends: [lan, edge], delay: 1 ms, rate: 100 Mbit/s }
  - { ends: [lan, cloud], CLOUD, rate: 20 Mbit/s }
services:
  navigation:
    robot: robot
    kpis: { service_time: 15 ms }
    vnfs:
      robot-driver: { program: robot_driver, pinned_to: robot }
      navigation: { program: navigation, node: edge, cpus: 2 }
    virtual_links: [{ from: robot-driver, to: navigation, rate: 0.5 Mbit/s }]
walks:
  robot: { waypoints: [[1, 0], [19, 0]], and_back: true }
core: { node: edge }
plugins:
  - { bundled: probing, settings: { interval: [1 s, 2 s] }PLUGIN }
";

fn passage(cloud: &str, plugin: &str) -> Vec<Stamped> {
    let text = PASSAGE.replace("CLOUD", cloud).replace("PLUGIN", plugin);
    let testbed = cotorra_testbed_file::parse("passage.yaml", &text, Path::new(""));
    events_of(&Arc::new(testbed.unwrap_or_else(|error| panic!("{error:?}"))), 1, 60.0)
}

/// The corridor with OKpi and these settings of it.
fn corridor_with(settings: &[&str]) -> Arc<Testbed> {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../testbeds/corridor.yaml");
    let settings = ["plugin=okpi"].iter().chain(settings).map(|setting| setting.parse::<Setting>().unwrap());
    Arc::new(cotorra_testbed_file::load_with(file, &settings.collect::<Vec<_>>()).unwrap())
}

/// Returns the decisions that were applied, with their times.
fn decisions(events: &[Stamped]) -> Vec<(Timestamp, &Instruction)> {
    let decision = |stamped| match stamped {
        &Stamped { at, event: Event::Decision(Decision { ref instruction, refused: None, .. }) } => {
            Some((at, instruction))
        }
        _ => None,
    };
    events.iter().filter_map(decision).collect()
}

fn staleness(events: &[Stamped], of: ContextKind) -> Vec<&Staleness> {
    let its = events.iter().filter_map(|stamped| match &stamped.event {
        Event::Staleness(its) => Some(its),
        _ => None,
    });
    its.filter(|its| its.kind == of).collect()
}

fn millis_of(duration: Duration) -> f64 {
    duration.as_secs_f64() * 1e3
}

#[test]
fn no_distance_and_no_time_of_decisions_change_no_event() {
    let beside = events_of(&corridor_with(&[]), 3, 60.0);
    assert!(!decisions(&beside).is_empty());
    for settings in [
        &["plugins.okpi.control_delay=0 ms", "plugins.okpi.decides_in=0 ms"][..],
        &["core.node=edge", "plugins.okpi.node=edge"],
        &["core.node=edge"],
    ] {
        assert!(events_of(&corridor_with(settings), 3, 60.0) == beside, "{settings:?}");
    }
}

#[test]
fn decisions_come_later_and_say_how_old_their_contexts_are() {
    let beside = events_of(&corridor_with(&[]), 3, 60.0);
    let far = events_of(&corridor_with(&["plugins.okpi.control_delay=200 ms"]), 3, 60.0);
    let (beside, all) = (decisions(&beside), decisions(&far));
    assert!(all[0].0 >= beside[0].0 + Duration::from_millis(400), "{:?} {:?}", all[0], beside[0]);
    let ages = staleness(&far, ContextKind::Robot);
    assert!(ages.len() >= all.len());
    for its in ages {
        assert!(its.youngest >= Duration::from_millis(400) && its.youngest <= its.oldest, "{its:?}");
        assert!(its.oldest < Duration::from_millis(700), "one robot, ten contexts a second: {its:?}");
    }
    let links = staleness(&far, ContextKind::Link);
    assert!(links.iter().all(|its| its.contexts > 40), "both directions of all links");
}

#[test]
fn the_time_of_decisions_is_added() {
    let slow = passage("delay: 1 ms", ", control_delay: 10 ms, decides_in: 300 ms");
    for its in staleness(&slow, ContextKind::Robot) {
        assert!(its.youngest >= Duration::from_millis(320), "{its:?}");
    }
    let fast = passage("delay: 1 ms", ", control_delay: 10 ms");
    let youngest = staleness(&fast, ContextKind::Robot).iter().map(|its| its.youngest).min();
    assert!(youngest.unwrap() < Duration::from_millis(130));
}

/// The way is edge, switch, cloud.
#[test]
fn contexts_and_instructions_cross_the_network_between_nodes() {
    let far = passage("delay: 30 ms", ", node: cloud");
    let ages = staleness(&far, ContextKind::Robot);
    assert!(ages.len() > 20, "{}", ages.len());
    for its in &ages {
        let youngest = millis_of(its.youngest);
        assert!((62.0..250.0).contains(&youngest), "{youngest}");
    }
    let near = passage("delay: 1 ms", ", node: cloud");
    let least = |ages: Vec<&Staleness>| ages.iter().map(|its| millis_of(its.youngest)).fold(1e9, f64::min);
    let (near, far) = (least(staleness(&near, ContextKind::Robot)), least(ages));
    assert!((50.0..70.0).contains(&(far - near)), "2 * 29 ms more: {near} {far}");
}

#[test]
fn the_network_is_loaded_by_what_travels() {
    let carried = |events: &[Stamped]| {
        let rates = events.iter().filter_map(|stamped| match &stamped.event {
            Event::Link(context) if context.link == "lan-cloud" => Some(context.throughput_bps),
            _ => None,
        });
        rates.fold(0.0, f64::max)
    };
    let (beside, far) = (passage("delay: 1 ms", ""), passage("delay: 1 ms", ", node: cloud"));
    assert!(carried(&far) > carried(&beside) + 1e5, "{} {}", carried(&far), carried(&beside));
}

#[test]
fn lost_contexts_are_not_seen_and_no_instruction_is_lost() {
    let scans = |events: &[Stamped]| {
        let all = decisions(events);
        all.iter().filter(|(_, instruction)| matches!(instruction, Instruction::Scan { .. })).count()
    };
    let (perfect, lossy) =
        (passage("delay: 1 ms", ", node: cloud"), passage("delay: 1 ms, loss: 30 %", ", node: cloud"));
    // Scans need no context. The last ones may still be under way.
    assert!(
        scans(&perfect) > 20 && scans(&lossy) + 2 >= scans(&perfect),
        "{} {}",
        scans(&lossy),
        scans(&perfect)
    );
    let mean = |events: &[Stamped]| {
        let ages: Vec<_> =
            staleness(events, ContextKind::Robot).iter().map(|its| millis_of(its.youngest)).collect();
        ages.iter().sum::<f64>() / ages.len() as f64
    };
    assert!(mean(&lossy) > mean(&perfect) + 20.0, "{} {}", mean(&lossy), mean(&perfect));
}

#[test]
fn a_plugin_behind_a_dead_link_decides_nothing() {
    let dead = passage("delay: 1 ms, loss: 100 %", ", node: cloud");
    assert_eq!(decisions(&dead), []);
    assert!(!decisions(&passage("delay: 1 ms, loss: 100 %", "")).is_empty());
}

#[test]
fn a_run_with_distances_repeats() {
    let run = || passage("delay: 5 ms, jitter: 2 ms, loss: 5 %", ", node: cloud, decides_in: 5 ms");
    assert!(run() == run());
}
