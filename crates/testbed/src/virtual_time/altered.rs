//! Differences of a run from its testbed file that no file can state: slow servers, and another outcome of one decision.

use std::{collections::BTreeMap, time::Duration};

use cotorra_graph::{Instruction, NodeId, PluginId, Stamped, Timestamp, VnfId};
use cotorra_network_control::InstructionError;

use super::{engine::VirtualEngine, network::VirtualNetwork};
use crate::{
    core::Core,
    given::Given,
    plugins::host::{Controlled, Fault},
};

/// Differences of a run in virtual time from its testbed file.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Altered {
    /// Nodes whose bundled VNFs answer so much later.
    pub slow: BTreeMap<NodeId, Duration>,
    /// A decision with another outcome.
    pub fork: Option<Fork>,
}

/// The replacement of one decision of a plug-in.
#[derive(Debug, Clone, PartialEq)]
pub struct Fork {
    /// Number of applied decisions before it. Like [`Report::decisions`](crate::Report::decisions), it counts attachments
    /// and placements.
    pub index: usize,
    /// Time of the decision.
    pub at: Timestamp,
    /// The decision, which is rejected.
    pub chosen: Instruction,
    /// The instruction that is applied in its place; `None` for none.
    pub instead: Option<Instruction>,
    /// Until then, further decisions about the same robot or VNF are rejected.
    pub hold: Timestamp,
}

/// The robot of an attachment, or the VNF of a placement.
#[derive(PartialEq)]
enum Subject<'a> {
    Robot(&'a NodeId),
    Vnf(&'a VnfId),
}

impl<'a> Subject<'a> {
    fn of(instruction: &'a Instruction) -> Option<Self> {
        match instruction {
            Instruction::Attach { robot, .. } => Some(Self::Robot(robot)),
            Instruction::Place { vnf, .. } => Some(Self::Vnf(vnf)),
            _ => None,
        }
    }
}

/// Whether two decisions are about the same robot or VNF.
pub fn is_same_subject(a: &Instruction, b: &Instruction) -> bool {
    Subject::of(a).is_some_and(|subject| Subject::of(b) == Some(subject))
}

/// The state of a fork.
pub(super) struct Forking {
    fork: Fork,
    /// Number of applied decisions so far.
    applied: usize,
    /// The outcome of the replacement, once it was made.
    outcome: Option<Result<(), InstructionError>>,
}

impl Forking {
    pub(super) fn new(fork: Fork) -> Self {
        Self { fork, applied: 0, outcome: None }
    }

    pub(super) fn outcome(&self) -> Option<&Result<(), InstructionError>> {
        self.outcome.as_ref()
    }

    fn is_here(&self, now: Timestamp, instruction: &Instruction) -> bool {
        self.outcome.is_none()
            && self.applied == self.fork.index
            && now == self.fork.at
            && *instruction == self.fork.chosen
    }

    fn holds(&self, now: Timestamp, instruction: &Instruction) -> bool {
        self.outcome.is_some() && now < self.fork.hold && is_same_subject(instruction, &self.fork.chosen)
    }
}

/// A core whose plug-ins' decisions pass a fork, if there is one.
pub(super) struct Forked<'a> {
    pub(super) core: &'a mut Core<VirtualNetwork, VirtualEngine>,
    pub(super) forking: &'a mut Option<Forking>,
}

/// Publishes that a decision was rejected.
fn reject(
    core: &mut Core<VirtualNetwork, VirtualEngine>,
    at: Timestamp,
    given: Given,
) -> Result<(), InstructionError> {
    let refused = InstructionError("a fork tries an alternative".to_owned());
    core.observe(Stamped { at, event: given.decided(Some(refused.to_string())) });
    Err(refused)
}

impl Controlled for Forked<'_> {
    fn instruct(&mut self, now: Timestamp, given: Given) -> Result<(), InstructionError> {
        let Self { core, forking: Some(forking) } = self else { return self.core.instruct(now, given) };
        if forking.is_here(now, &given.instruction) {
            let plugin = given.plugin.clone();
            let rejected = reject(core, now, given);
            let applied = forking.fork.instead.clone().map(|instruction| {
                let reason = Some("an alternative to the plug-in's decision".to_owned());
                core.instruct(now, Given { plugin, instruction, reason })
            });
            forking.outcome = Some(applied.unwrap_or(Ok(())));
            return rejected;
        }
        if forking.holds(now, &given.instruction) {
            return reject(core, now, given);
        }
        let is_decision = Subject::of(&given.instruction).is_some();
        let done = core.instruct(now, given);
        forking.applied += usize::from(is_decision && done.is_ok());
        done
    }

    fn cut_off(&mut self, now: Timestamp, plugin: PluginId, fault: &Fault, robots: &[NodeId]) {
        self.core.cut_off(now, plugin, fault, robots);
    }

    fn publish(&mut self, event: Stamped) {
        self.core.publish(event);
    }
}
