//! Decisions of a run, and the alternatives that each one had.

use std::{collections::BTreeMap, time::Duration};

use cotorra_graph::{
    Attachment, Decision, Event, Instruction, NodeId, NodeKind, Nodes, PluginId, Program, ServiceId, Stamped,
    Testbed, Timestamp, VnfId,
};
use cotorra_testbed::is_same_subject;
use serde::Serialize;

/// An applied decision of a plug-in: a radio unit for a robot, or nodes for a VNF.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Decided {
    /// Number of the decision, from 1.
    pub number: usize,
    /// Number of times that the plug-in had decided the same about the same robot or VNF, this decision included.
    #[serde(skip)]
    pub time: usize,
    /// Time of the decision.
    #[serde(rename = "at_ns")]
    pub at: Timestamp,
    pub plugin: PluginId,
    pub instruction: Instruction,
    /// The plug-in's reason.
    pub reason: Option<String>,
    /// Its alternatives.
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

    /// Whether it is the same decision as one with another seed.
    pub fn is_like(&self, other: &Self) -> bool {
        self.plugin == other.plugin && self.instruction == other.instruction && self.time == other.time
    }

    /// Returns the radio unit or the nodes.
    pub fn chosen(&self) -> String {
        target(&self.instruction)
    }
}

/// An alternative to a decision.
#[derive(Debug, Clone, PartialEq)]
pub struct Alternative {
    /// The instruction; `None` to leave everything as it is.
    pub instead: Option<Instruction>,
    /// The radio unit or the node.
    pub target: String,
}

pub(super) fn target(instruction: &Instruction) -> String {
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

/// The state of a run beside its samples, moment by moment.
#[derive(Debug, Clone, Default)]
pub(super) struct Taken {
    /// Price of all placed CPUs from each moment on, by the prices of servers.
    pub(super) costs: Vec<(Timestamp, f64)>,
    /// Changes of VNFs' nodes.
    pub(super) migrations: Vec<Timestamp>,
    /// Changes of radio unit.
    pub(super) handovers: Vec<Timestamp>,
}

impl Taken {
    /// Returns the mean price of the placed CPUs from one moment to another; `None` if no time passes.
    pub(super) fn cost(&self, from: Timestamp, until: Timestamp) -> Option<f64> {
        let ends = self.costs.iter().skip(1).map(|(at, _)| *at).chain([until]);
        let spent = |((at, cost), end): (&(Timestamp, f64), Timestamp)| {
            cost * end.min(until).since((*at).max(from)).as_secs_f64()
        };
        let time = until.since(from).as_secs_f64();
        (time > 0.0).then(|| self.costs.iter().zip(ends).map(spent).sum::<f64>() / time)
    }
}

/// Collects service times, and decisions with their alternatives, from the events of a run.
pub(super) struct Observer<'a> {
    testbed: &'a Testbed,
    pub(super) samples: Vec<Sample>,
    pub(super) decided: Vec<Decided>,
    pub(super) taken: Taken,
    attachments: BTreeMap<NodeId, Vec<Attachment>>,
    placements: BTreeMap<VnfId, Nodes>,
}

impl<'a> Observer<'a> {
    pub(super) fn new(testbed: &'a Testbed) -> Self {
        let vnfs = testbed.services.iter().flat_map(|service| &service.vnfs);
        let mut new = Self {
            testbed,
            samples: Vec::new(),
            decided: Vec::new(),
            taken: Taken::default(),
            attachments: BTreeMap::new(),
            placements: vnfs.map(|vnf| (vnf.id.clone(), vnf.node.clone())).collect(),
        };
        new.taken.costs.push((Timestamp::ZERO, new.cost()));
        new
    }

    /// Returns the present price of all placed CPUs of the file's VNFs. CPUs of robots have none.
    fn cost(&self) -> f64 {
        let price = |node: &NodeId| match self.testbed.graph.node(node).map(|node| &node.kind) {
            Some(NodeKind::Server(server)) => server.cost,
            _ => 0.0,
        };
        let vnfs = self.testbed.services.iter().flat_map(|service| &service.vnfs);
        let placed = vnfs.filter_map(|vnf| Some((vnf.cpus, self.placements.get(&vnf.id)?)));
        placed.map(|(cpus, nodes)| cpus * nodes.all().iter().map(price).sum::<f64>()).sum()
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
                let before = self.placements.insert(placement.vnf.clone(), placement.node.clone());
                if *at > Timestamp::ZERO && before.is_none_or(|before| before != placement.node) {
                    self.taken.migrations.push(*at);
                }
                self.taken.costs.push((*at, self.cost()));
            }
            Event::Handover(_) => self.taken.handovers.push(*at),
            Event::Decision(Decision { plugin, instruction, reason, refused: None }) => {
                let Some(alternatives) = self.alternatives(instruction) else { return };
                let earlier = self.decided.iter_mut().filter(|decided| decided.next.is_none());
                earlier
                    .filter(|decided| is_same_subject(&decided.instruction, instruction))
                    .for_each(|decided| decided.next = Some(*at));
                let same = |before: &&Decided| before.plugin == *plugin && before.instruction == *instruction;
                self.decided.push(Decided {
                    number: self.decided.len() + 1,
                    time: self.decided.iter().filter(same).count() + 1,
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
    fn the_cost_is_the_mean_over_the_time_from_a_decision_on() {
        let at = Timestamp::from_secs_f64;
        let costs = vec![(at(0.0), 1.0), (at(2.0), 4.0), (at(4.0), 2.0)];
        let taken = Taken { costs, ..Taken::default() };
        assert_eq!(taken.cost(at(0.0), at(4.0)), Some(2.5));
        assert_eq!(taken.cost(at(3.0), at(6.0)), Some(8.0 / 3.0));
        assert_eq!((taken.cost(at(5.0), at(9.0)), taken.cost(at(5.0), at(5.0))), (Some(2.0), None));
    }

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
        assert_eq!(observer.taken.migrations.len(), 2);
        let [first, second] = &observer.decided[..] else { panic!("{:?}", observer.decided) };
        assert_eq!((first.number, first.next), (1, Some(Timestamp::from_secs_f64(3.0))));
        assert_eq!(alternatives(first), [("a".to_owned(), true), ("c".to_owned(), false)]);
        assert_eq!((second.number, second.next), (2, None));
        assert_eq!(alternatives(second), [("b".to_owned(), true), ("a".to_owned(), false)]);
    }
}
