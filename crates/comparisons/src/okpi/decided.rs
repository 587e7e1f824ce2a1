//! OKpi's decisions over time, and the sum of the known link delays in each.

use std::{collections::BTreeMap, time::Duration};

use cotorra_graph::{HardwareGraph, Instruction, NodeId, Position, Program, ServiceTime, Testbed};
use cotorra_testbed::Report;

use super::{
    Change, compared,
    published::{Leg, PUBLISHED_CHANGES, Published, Segment},
    samples,
};

/// Instructions within this time are one decision, seconds: locations are not more frequent.
const ONE_DECISION_S: f64 = 0.2;

/// The time at which a walk turned: its first sample in segment C.
#[derive(Debug)]
pub(super) struct Legs {
    turned_s: f64,
}

impl Legs {
    pub fn of(testbed: &Testbed, report: &Report) -> Self {
        let in_c =
            |sample: &ServiceTime| sample.attachment.as_ref().and_then(Segment::of) == Some(Segment::C);
        let times = samples(testbed, report).filter(in_c).map(|sample| sample.emitted.as_secs_f64());
        Self { turned_s: times.fold(f64::INFINITY, f64::min) }
    }

    pub fn at(&self, seconds: f64) -> Leg {
        if seconds < self.turned_s { Leg::Out } else { Leg::Back }
    }

    pub fn is_in(&self, sample: &ServiceTime, part: &Published) -> bool {
        let segment = sample.attachment.as_ref().and_then(Segment::of);
        // Segment C is walked out and back in one part.
        let leg = part.segment == Segment::C || self.at(sample.emitted.as_secs_f64()) == part.leg;
        segment == Some(part.segment) && leg
    }
}

/// A radio unit and a server.
pub(super) type State = (NodeId, NodeId);

/// The decisions for the robot, over time.
#[derive(Debug)]
pub(super) struct Decided {
    robot: Option<NodeId>,
    /// The beginning of each state in seconds, the robot's position then, and the state.
    states: Vec<(f64, Option<Position>, State)>,
}

impl Decided {
    /// Follows the decisions for the compared service's robot, from its state at the first sample.
    pub fn by(testbed: &Testbed, report: &Report) -> Self {
        let service = compared(testbed);
        let navigation = service.and_then(|s| s.vnfs.iter().find(|vnf| vnf.program == Program::Navigation));
        let (Some(service), Some(navigation)) = (service, navigation) else {
            return Self { robot: None, states: Vec::new() };
        };
        let first = samples(testbed, report).find_map(|sample| sample.attachment.clone());
        let mut state = first.map(|unit| (unit, navigation.node.first().clone()));
        let mut states: Vec<_> = state.iter().map(|state| (0.0, None, state.clone())).collect();
        for decision in report.decisions() {
            let Some((unit, server)) = &mut state else { break };
            match &decision.instruction {
                Instruction::Attach { robot, radio_unit } if *robot == service.robot => {
                    *unit = radio_unit.clone()
                }
                Instruction::Place { vnf, node } if *vnf == navigation.id => *server = node.first().clone(),
                _ => continue,
            }
            let (at, state) = (decision.at.as_secs_f64(), (unit.clone(), server.clone()));
            match states.last_mut() {
                // One decision for a new radio unit and a new server has two instructions.
                Some(last) if at - last.0 <= ONE_DECISION_S => last.2 = state,
                Some(last) if last.2 == state => {}
                _ => states.push((at, decision.position, state)),
            }
        }
        Self { robot: Some(service.robot.clone()), states }
    }

    pub fn at(&self, seconds: f64) -> Option<&State> {
        let next = self.states.partition_point(|(from, ..)| *from <= seconds);
        self.states.get(next.checked_sub(1)?).map(|(.., state)| state)
    }

    /// Returns the sum of the known link delays in each state, there and back, ms.
    pub fn theory(&self, testbed: &Testbed) -> BTreeMap<State, f64> {
        let Some(robot) = &self.robot else { return BTreeMap::new() };
        let with_theory = |(.., state): &(f64, Option<Position>, State)| {
            let taken = round_trip(&testbed.graph, robot, state)?;
            Some((state.clone(), taken.as_secs_f64() * 1e3))
        };
        self.states.iter().filter_map(with_theory).collect()
    }

    pub fn changes(&self, legs: &Legs) -> Vec<Change> {
        let change = |(at_s, position, (unit, server)): &(f64, Option<Position>, State)| {
            let published = PUBLISHED_CHANGES.iter().find(|published| {
                published.radio_unit == unit.as_str()
                    && published.server == server.as_str()
                    && (published.leg == legs.at(*at_s) || published.radio_unit == "R5")
            });
            let off = published.zip(*position);
            Change {
                at_s: *at_s,
                position: *position,
                radio_unit: unit.clone(),
                server: server.clone(),
                off_published_m: off.map(|(published, at)| (published.axis.of(at) - published.metres).abs()),
            }
        };
        self.states.iter().skip(1).map(change).collect()
    }
}

fn round_trip(graph: &HardwareGraph, robot: &NodeId, (unit, server): &State) -> Option<Duration> {
    let attached = |of: &NodeId| (of == robot).then_some(unit);
    let there = graph.route(robot, server, attached)?;
    let back = graph.route(server, robot, attached)?;
    Some(there.delay + back.delay)
}
