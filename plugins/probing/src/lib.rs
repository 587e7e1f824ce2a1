//! The state of the art to compare with: a robot roams by periodic probing, and its navigation stays where it was put.
//!
//! About every 20 to 25 s the robot's radio leaves its channel to scan all others, which holds up its packets
//! meanwhile; then it attaches to the strongest radio unit. That is what the robot of the published corridor testbed
//! did by itself (arXiv 2101.07676).
#![forbid(unsafe_code)]

mod settings;

use std::{collections::BTreeMap, time::Duration};

use cotorra_graph::{Attachment, Event, Instruction, NodeId, Roaming, RobotContext, Testbed, Timestamp};
use cotorra_numbers::Draws;
use cotorra_plugin::{Actions, Plugin, settings::InvalidSettings};

use crate::settings::Settings;

/// Lets robots roam by periodic probing: all whose roaming is instructed.
#[derive(Debug)]
pub struct Probing {
    settings: Settings,
    seed: u64,
    radios: BTreeMap<NodeId, Radio>,
}

/// One robot's radio.
#[derive(Debug)]
struct Radio {
    random: Draws,
    next_scan: Timestamp,
    /// Whether it has scanned since its last context, so that the next one's signals are fresh.
    scanned: bool,
    /// When it goes to another radio unit, if it always does.
    leaves: Option<(Timestamp, NodeId)>,
}

/// Longest wait after a scan of a robot that always goes on. Without it, contexts would give handovers the rhythm of clocks.
const LONGEST_WAIT: Duration = Duration::from_millis(100);

impl Probing {
    /// Reads the settings of a testbed file:
    ///
    /// - `interval`: the time from one scan to the next, `20 s`, or bounds between which each is drawn, by default
    ///   `[20 s, 25 s]`; the first scan comes so long after the start;
    /// - `margin`: a robot leaves its radio unit for one that is stronger by more than this, by default `0 dB`, the
    ///   published behaviour: the time between scans already keeps it from going back and forth;
    /// - `always`: whether a robot goes to the strongest other radio unit after each scan, even if its own is stronger, by
    ///   default `false`, and at a random time within 100 ms. It makes many handovers, to measure them.
    ///
    /// # Errors
    /// [`InvalidSettings`] for a setting that does not exist, or that has no such value.
    pub fn from_settings(
        settings: &serde_json::Map<String, serde_json::Value>,
        seed: u64,
    ) -> Result<Self, InvalidSettings> {
        Ok(Self { settings: Settings::decode(settings)?, seed, radios: BTreeMap::new() })
    }
}

impl Plugin for Probing {
    fn start(&mut self, now: Timestamp, testbed: &Testbed, _actions: &mut Actions) {
        let radio = |id: &NodeId| {
            let mut random = Draws::new(self.seed, id.as_str());
            let next_scan = now + draw(&mut random, &self.settings);
            (id.clone(), Radio { random, next_scan, scanned: false, leaves: None })
        };
        let robots = testbed.graph.robots().filter(|(_, robot)| robot.roaming == Roaming::Instructed);
        self.radios = robots.map(|(node, _)| radio(&node.id)).collect();
    }

    fn handle(&mut self, now: Timestamp, event: &Event, actions: &mut Actions) {
        match event {
            Event::Scanned { robot } => {
                if let Some(radio) = self.radios.get_mut(robot) {
                    radio.scanned = true;
                }
            }
            Event::Robot(context) => {
                let Some(radio) = self.radios.get_mut(&context.robot) else { return };
                if !std::mem::take(&mut radio.scanned) {
                    return;
                }
                let Some((radio_unit, reason)) = choose(context, &self.settings) else { return };
                if self.settings.always {
                    radio.leaves = Some((now + LONGEST_WAIT.mul_f64(radio.random.unit()), radio_unit));
                } else {
                    let robot = context.robot.clone();
                    actions.instruct_because(Instruction::Attach { robot, radio_unit }, reason);
                }
            }
            _ => {}
        }
    }

    fn next_deadline(&self) -> Option<Timestamp> {
        let leaves = |radio: &Radio| radio.leaves.as_ref().map(|(at, _)| *at);
        self.radios.values().flat_map(|radio| leaves(radio).into_iter().chain([radio.next_scan])).min()
    }

    fn expire(&mut self, now: Timestamp, actions: &mut Actions) {
        for (robot, radio) in &mut self.radios {
            if let Some((_, radio_unit)) = radio.leaves.take_if(|(at, _)| *at <= now) {
                actions.instruct(Instruction::Attach { robot: robot.clone(), radio_unit });
            }
            if radio.next_scan <= now {
                radio.next_scan = now + draw(&mut radio.random, &self.settings);
                actions.instruct(Instruction::Scan { robot: robot.clone() });
            }
        }
    }
}

/// Returns the strongest radio unit, and the reason to go there, if it is not the present one or hardly stronger.
fn choose(context: &RobotContext, settings: &Settings) -> Option<(NodeId, String)> {
    let heard = |a: &&Attachment| {
        a.signal.is_some_and(|signal| signal.0.is_finite()) && !(settings.always && a.attached)
    };
    let strength = |a: &Attachment| a.signal.map_or(f64::NEG_INFINITY, |signal| signal.0);
    let strongest =
        context.attachments.iter().filter(heard).max_by(|a, b| strength(a).total_cmp(&strength(b)))?;
    if strongest.attached {
        return None;
    }
    let better = format!("`{}` is received with {:.1} dBm", strongest.radio_unit, strength(strongest));
    let reason = match context.attachments.iter().find(|a| a.attached) {
        None => better,
        Some(present) if settings.always || strength(strongest) - strength(present) > settings.margin_db => {
            format!("{better}, `{}` with {:.1} dBm", present.radio_unit, strength(present))
        }
        Some(_) => return None,
    };
    Some((strongest.radio_unit.clone(), reason))
}

/// A time from one scan to the next.
fn draw(random: &mut Draws, settings: &Settings) -> Duration {
    let (shortest, longest) = (*settings.interval.start(), *settings.interval.end());
    shortest + (longest - shortest).mul_f64(random.unit())
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use cotorra_graph::{Dbm, Pose, PoseSource};
    use cotorra_graph_testing as base;
    use proptest::prelude::*;
    use serde_json::{Map, json};

    use super::*;

    const TESTBED: &str = "
name: two-robots
wireless:
  lab: { standard: n, delay: 1 ms, path_loss: { model: free_space } }
nodes:
  r1: { kind: robot, cpus: 1, memory: 1 GB, position: [0, 0], roaming: instructed }
  r2: { kind: robot, cpus: 1, memory: 1 GB, position: [1, 0], roaming: instructed }
  r3: { kind: robot, cpus: 1, memory: 1 GB, position: [2, 0], roaming: signal }
  r4: { kind: robot, cpus: 1, memory: 1 GB, position: [3, 0], roaming: supplicant }
  A: { kind: radio_unit, position: [0, 1], channel: 1 }
  B: { kind: radio_unit, position: [9, 1], channel: 6 }
links:
  - { ends: [A, B] }
";

    fn id(name: &str) -> NodeId {
        NodeId::new(name).unwrap()
    }

    fn started(settings: serde_json::Value, seed: u64) -> Probing {
        let testbed =
            cotorra_testbed_file::parse("test", TESTBED, Path::new("")).unwrap_or_else(|e| panic!("{e:?}"));
        let mut probing = Probing::from_settings(settings.as_object().unwrap(), seed).unwrap();
        probing.start(Timestamp::ZERO, &testbed, &mut Actions::default());
        probing
    }

    /// Runs for `seconds` of virtual time, and returns the scans of each robot.
    fn scans(probing: &mut Probing, seconds: f64) -> Vec<(Timestamp, NodeId)> {
        let mut scans = Vec::new();
        let mut actions = Actions::default();
        while let Some(now) = probing.next_deadline().filter(|t| t.as_secs_f64() < seconds) {
            probing.expire(now, &mut actions);
            for (instruction, _) in actions.drain() {
                let Instruction::Scan { robot } = instruction else { panic!("not a scan: {instruction:?}") };
                scans.push((now, robot));
            }
        }
        scans
    }

    /// κ with these radio units: name, whether attached, signal.
    fn context(robot: &str, attachments: &[(&str, bool, Option<f64>)]) -> Event {
        let pose = Pose::planar(0.0, 0.0, 0.0, [0.0; 9], PoseSource::Simulator);
        Event::Robot(RobotContext {
            robot: id(robot),
            attachments: attachments
                .iter()
                .map(|&(name, attached, signal)| Attachment {
                    radio_unit: id(name),
                    attached,
                    signal: signal.map(Dbm),
                    age: None,
                })
                .collect(),
            ..base::robot_context("robot", pose)
        })
    }

    /// Returns the instruction after a scan, and its reason.
    fn roams(margin: &str, attachments: &[(&str, bool, Option<f64>)]) -> Option<(NodeId, String)> {
        let mut probing = started(json!({ "margin": margin }), 1);
        let mut actions = Actions::default();
        probing.handle(Timestamp::ZERO, &Event::Scanned { robot: id("r1") }, &mut actions);
        probing.handle(Timestamp::ZERO, &context("r1", attachments), &mut actions);
        assert!(actions.len() < 2);
        actions.drain().next().map(|(instruction, reason)| match instruction {
            Instruction::Attach { robot, radio_unit } if robot == "r1" => (radio_unit, reason.unwrap()),
            other => panic!("not an attachment of r1: {other:?}"),
        })
    }

    #[test]
    fn every_instructed_robot_scans_about_every_20_to_25_seconds() {
        let mut probing = started(json!({}), 7);
        let scans = scans(&mut probing, 3600.0);
        for robot in ["r1", "r2"] {
            let times: Vec<_> =
                scans.iter().filter(|(_, r)| *r == robot).map(|(t, _)| t.as_secs_f64()).collect();
            let gaps: Vec<_> = std::iter::once(&0.0).chain(&times).zip(&times).map(|(a, b)| b - a).collect();
            assert!(gaps.iter().all(|gap| (20.0..=25.0).contains(gap)), "{gaps:?}");
            let mean = gaps.iter().sum::<f64>() / gaps.len() as f64;
            assert!((22.0..23.0).contains(&mean), "{mean}");
        }
        assert!(scans.iter().all(|(_, robot)| *robot != "r3" && *robot != "r4"), "they roam by themselves");
    }

    #[test]
    fn scans_repeat_with_the_seed_and_differ_by_robot() {
        let run = |seed| scans(&mut started(json!({}), seed), 100.0);
        assert_eq!(run(1), run(1));
        assert_ne!(run(1), run(2));
        assert_ne!(run(1)[0].0, run(1)[1].0);
    }

    #[test]
    fn attaches_to_the_strongest_and_says_why() {
        let (radio_unit, reason) =
            roams("0 dB", &[("A", true, Some(-71.25)), ("B", false, Some(-60.0)), ("C", false, None)])
                .unwrap();
        assert_eq!(radio_unit, id("B"));
        assert_eq!(reason, "`B` is received with -60.0 dBm, `A` with -71.2 dBm");
    }

    #[test]
    fn always_goes_to_the_strongest_other_soon_after_each_scan() {
        let after = |attachments: &[(&str, bool, Option<f64>)]| {
            let mut probing = started(json!({ "always": true, "interval": "10 s" }), 1);
            let mut actions = Actions::default();
            let scanned = Timestamp::from_secs_f64(5.0);
            probing.handle(scanned, &Event::Scanned { robot: id("r1") }, &mut actions);
            probing.handle(scanned, &context("r1", attachments), &mut actions);
            assert_eq!(actions.len(), 0);
            let due = probing.next_deadline().unwrap();
            probing.expire(due, &mut actions);
            (due, actions.drain().next().unwrap().0)
        };
        let heard = [("A", true, Some(-50.0)), ("B", false, Some(-80.0)), ("C", false, Some(-70.0))];
        let (due, instruction) = after(&heard);
        assert_eq!(instruction, Instruction::Attach { robot: id("r1"), radio_unit: id("C") });
        assert!((5.0..5.1).contains(&due.as_secs_f64()), "{due:?}");
        // There is no other: the next scan follows.
        let (due, instruction) = after(&heard[..1]);
        assert!(matches!(instruction, Instruction::Scan { .. }) && due.as_secs_f64() == 10.0);
    }

    #[test]
    fn stays_where_nothing_is_stronger_by_the_margin() {
        assert_eq!(roams("0 dB", &[("A", true, Some(-60.0)), ("B", false, Some(-60.0))]), None);
        assert_eq!(roams("3 dB", &[("A", true, Some(-60.0)), ("B", false, Some(-57.5))]), None);
        assert!(roams("2 dB", &[("A", true, Some(-60.0)), ("B", false, Some(-57.5))]).is_some());
        assert_eq!(roams("0 dB", &[("A", true, Some(-60.0)), ("B", false, None)]), None);
        assert_eq!(roams("0 dB", &[]), None);
    }

    #[test]
    fn a_robot_without_a_radio_unit_takes_the_strongest() {
        let (radio_unit, _) =
            roams("10 dB", &[("A", false, Some(-90.0)), ("B", false, Some(-88.0))]).unwrap();
        assert_eq!(radio_unit, id("B"));
        let (radio_unit, _) = roams("0 dB", &[("A", true, None), ("B", false, Some(-88.0))]).unwrap();
        assert_eq!(radio_unit, id("B"), "the present one is not heard any more");
    }

    #[test]
    fn roams_only_after_a_scan_and_once() {
        let mut probing = started(json!({}), 1);
        let mut actions = Actions::default();
        let weak = context("r1", &[("A", true, Some(-80.0)), ("B", false, Some(-50.0))]);
        probing.handle(Timestamp::ZERO, &weak, &mut actions);
        probing.handle(Timestamp::ZERO, &Event::Scanned { robot: id("r2") }, &mut actions);
        probing.handle(Timestamp::ZERO, &weak, &mut actions);
        assert!(actions.is_empty());
        probing.handle(Timestamp::ZERO, &Event::Scanned { robot: id("r1") }, &mut actions);
        probing.handle(Timestamp::ZERO, &weak, &mut actions);
        probing.handle(Timestamp::ZERO, &weak, &mut actions);
        assert_eq!(actions.len(), 1);
    }

    proptest! {
        #[test]
        fn never_leaves_for_a_weaker_one(
            signals in prop::collection::vec(prop::option::of(-100.0f64..-20.0), 1..8),
            attached in 0usize..9,
        ) {
            let names: Vec<String> = (0..signals.len()).map(|i| format!("R{i}")).collect();
            let attachments: Vec<_> =
                signals.iter().enumerate().map(|(i, &signal)| (names[i].as_str(), i == attached, signal)).collect();
            let strength = |i: usize| signals.get(i).copied().flatten().unwrap_or(f64::NEG_INFINITY);
            if let Some((to, _)) = roams("0 dB", &attachments) {
                let to = names.iter().position(|name| to == name.as_str()).unwrap();
                prop_assert!(to != attached && strength(to) > strength(attached));
                prop_assert!((0..signals.len()).all(|i| strength(i) <= strength(to)));
            }
        }

        #[test]
        fn any_interval_is_kept(shortest in 1u32..3600, longer in 0u32..100, seed: u64) {
            let longest = (shortest + longer).min(3600);
            let settings = json!({ "interval": [format!("{shortest} s"), format!("{longest} s")] });
            let probing = started(settings, seed);
            let first = probing.next_deadline().unwrap().as_secs_f64();
            prop_assert!((f64::from(shortest)..=f64::from(longest)).contains(&first));
        }
    }

    #[test]
    fn without_robots_it_sleeps() {
        let probing = Probing::from_settings(&Map::new(), 1).unwrap();
        assert_eq!(probing.next_deadline(), None);
    }
}
