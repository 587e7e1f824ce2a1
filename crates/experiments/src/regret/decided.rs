//! Decisions of a run, and the alternatives that each one had.

use std::{collections::BTreeMap, time::Duration};

use cotorra_graph::{
    Attachment, Decision, Event, Instruction, NodeId, Nodes, PluginId, Program, ServiceId, Stamped, Testbed,
    Timestamp, VnfId,
};
use cotorra_testbed::is_same_subject;
use serde::Serialize;

/// An applied decision of a plug-in: a radio unit for a robot, or nodes for a VNF.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Decided {
    /// Number of the decision, from 1.
    pub number: usize,
    /// Time of the decision.
    #[serde(rename = "at_ns")]
    pub at: Timestamp,
    pub plugin: PluginId,
    pub instruction: Instruction,
    /// The plug-in's reason.
    pub reason: Option<String>,
    /// What could have been done in its place.
    #[serde(skip)]
    pub alternatives: Vec<Alternative>,
    /// Time of the next decision about the same robot or VNF.
    #[serde(skip)]
    pub next: Option<Timestamp>,
}

impl Decided {
    /// Returns the robot or the VNF.
    pub fn subject(&self) -> &str {
        match &self.instruction {
            Instruction::Attach { robot, .. } => robot.as_str(),
            Instruction::Place { vnf, .. } => vnf.as_str(),
            _ => "",
        }
    }

    /// Returns the radio unit or the nodes.
    pub fn chosen(&self) -> String {
        target(&self.instruction)
    }
}

/// What could have been done in place of a decision.
#[derive(Debug, Clone, PartialEq)]
pub struct Alternative {
    /// The instruction; `None` to leave everything as it is.
    pub instead: Option<Instruction>,
    /// The radio unit or the node.
    pub target: String,
}

fn target(instruction: &Instruction) -> String {
    match instruction {
        Instruction::Attach { radio_unit, .. } => radio_unit.to_string(),
        Instruction::Place { node, .. } => node.to_string(),
        _ => String::new(),
    }
}

/// A service time.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sample {
    /// Index of the service in the testbed.
    pub(super) service: usize,
    pub(super) emitted: Timestamp,
    pub(super) took: Option<Duration>,
}

/// Collects service times, and decisions with their alternatives, from the events of a run.
pub(super) struct Observer<'a> {
    testbed: &'a Testbed,
    pub(super) samples: Vec<Sample>,
    pub(super) decided: Vec<Decided>,
    attachments: BTreeMap<NodeId, Vec<Attachment>>,
    placements: BTreeMap<VnfId, Nodes>,
}

impl<'a> Observer<'a> {
    pub(super) fn new(testbed: &'a Testbed) -> Self {
        let vnfs = testbed.services.iter().flat_map(|service| &service.vnfs);
        Self {
            testbed,
            samples: Vec::new(),
            decided: Vec::new(),
            attachments: BTreeMap::new(),
            placements: vnfs.map(|vnf| (vnf.id.clone(), vnf.node.clone())).collect(),
        }
    }

    pub(super) fn see(&mut self, Stamped { at, event }: &Stamped) {
        match event {
            Event::ServiceTime(sample) => {
                let service = self.place(&sample.service);
                let (emitted, took) = (sample.emitted, sample.took);
                self.samples.extend(service.map(|service| Sample { service, emitted, took }));
            }
            Event::Robot(context) => {
                drop(self.attachments.insert(context.robot.clone(), context.attachments.clone()));
            }
            Event::Placement(placement) => {
                drop(self.placements.insert(placement.vnf.clone(), placement.node.clone()));
            }
            Event::Decision(Decision { plugin, instruction, reason, refused: None }) => {
                let Some(alternatives) = self.alternatives(instruction) else { return };
                let earlier = self.decided.iter_mut().filter(|decided| decided.next.is_none());
                earlier
                    .filter(|decided| is_same_subject(&decided.instruction, instruction))
                    .for_each(|decided| decided.next = Some(*at));
                self.decided.push(Decided {
                    number: self.decided.len() + 1,
                    at: *at,
                    plugin: plugin.clone(),
                    instruction: instruction.clone(),
                    reason: reason.clone(),
                    alternatives,
                    next: None,
                });
            }
            _ => {}
        }
    }

    fn place(&self, service: &ServiceId) -> Option<usize> {
        self.testbed.services.iter().position(|of| of.id == *service)
    }

    /// Returns the alternatives of a decision; `None` if the instruction is none.
    fn alternatives(&self, instruction: &Instruction) -> Option<Vec<Alternative>> {
        match instruction {
            Instruction::Attach { robot, radio_unit } => {
                let known = self.attachments.get(robot).into_iter().flatten();
                let others = known.filter(|known| known.radio_unit != *radio_unit);
                let heard =
                    |a: &&Attachment| a.attached || a.signal.is_some_and(|signal| signal.0.is_finite());
                let alternative = |known: &Attachment| {
                    let (robot, radio_unit) = (robot.clone(), known.radio_unit.clone());
                    let attach = Instruction::Attach { robot, radio_unit };
                    Alternative { target: target(&attach), instead: (!known.attached).then_some(attach) }
                };
                Some(others.filter(heard).map(alternative).collect())
            }
            Instruction::Place { vnf: id, node: chosen } => {
                let vnf = self
                    .testbed
                    .services
                    .iter()
                    .flat_map(|service| &service.vnfs)
                    .find(|vnf| vnf.id == *id)?;
                let present = self.placements.get(id);
                let stay = present.filter(|present| *present != chosen);
                let stay = stay.map(|stay| Alternative { instead: None, target: stay.to_string() });
                let can_carry = |node: &&cotorra_graph::Node| {
                    let fits = node.capacity().is_some_and(|capacity| {
                        capacity.cpus >= vnf.cpus && capacity.memory_bytes >= vnf.memory_bytes
                    });
                    fits && vnf.pinned_to.is_none() && vnf.program != Program::RobotDriver
                };
                let others = self.testbed.graph.nodes.iter().filter(can_carry);
                let others = others.map(|node| Nodes::from(node.id.clone()));
                let others = others.filter(|node| node != chosen && Some(node) != present);
                let others = others.map(|node| {
                    let place = Instruction::Place { vnf: id.clone(), node };
                    Alternative { target: target(&place), instead: Some(place) }
                });
                Some(stay.into_iter().chain(others).collect())
            }
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use cotorra_graph::Placement;

    use super::*;

    #[test]
    fn a_placement_can_stay_or_go_to_any_node_with_room() {
        let text = "name: x\nwireless: { w: {} }\nnodes:\n  r: { kind: robot, position: [0, 0], cpus: 1 }\n  \
                    U: { kind: radio_unit, position: [0, 0], channel: 1 }\n  \
                    a: { kind: server, tier: edge, cpus: 4, memory: 8 GB }\n  \
                    b: { kind: server, tier: edge, cpus: 4, memory: 8 GB }\n  \
                    c: { kind: server, tier: edge, cpus: 4, memory: 8 GB }\n  \
                    small: { kind: server, tier: edge, cpus: 1, memory: 8 GB }\n\
                    links: [{ ends: [U, [a, b, c, small]] }]\n\
                    services:\n  s:\n    robot: r\n    kpis: { service_time: 1 s }\n    vnfs:\n      \
                    d: { program: robot_driver, pinned_to: r }\n      n: { program: navigation, node: a, cpus: 2 }\n\
                    walks: { r: { waypoints: [[0, 0], [1, 0]] } }\n";
        let testbed = cotorra_testbed_file::parse("x.yaml", text, std::path::Path::new(""));
        let testbed = testbed.unwrap_or_else(|wrong| panic!("{wrong}"));
        let mut observer = Observer::new(&testbed);
        let node = |name: &str| Nodes::from(name.parse::<NodeId>().unwrap());
        let vnf: VnfId = "n".parse().unwrap();
        let mut place = |at, name: &str, refused: Option<String>| {
            let at = Timestamp::from_secs_f64(at);
            let instruction = Instruction::Place { vnf: vnf.clone(), node: node(name) };
            let is_applied = refused.is_none();
            let decision = Decision { plugin: "p".parse().unwrap(), instruction, reason: None, refused };
            observer.see(&Stamped { at, event: Event::Decision(decision) });
            if is_applied {
                let placement = Placement { vnf: vnf.clone(), node: node(name) };
                observer.see(&Stamped { at, event: Event::Placement(placement) });
            }
        };
        place(1.0, "b", None);
        place(2.0, "a", Some("no".to_owned()));
        place(3.0, "c", None);
        let alternatives = |decided: &Decided| -> Vec<_> {
            let all = decided.alternatives.iter();
            all.map(|alternative| (alternative.target.clone(), alternative.instead.is_none())).collect()
        };
        let [first, second] = &observer.decided[..] else { panic!("{:?}", observer.decided) };
        assert_eq!((first.number, first.next), (1, Some(Timestamp::from_secs_f64(3.0))));
        assert_eq!(alternatives(first), [("a".to_owned(), true), ("c".to_owned(), false)]);
        assert_eq!((second.number, second.next), (2, None));
        assert_eq!(alternatives(second), [("b".to_owned(), true), ("a".to_owned(), false)]);
    }
}
