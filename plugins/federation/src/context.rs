//! The state of a domain that both roles read and change, as creator and as provider.

use std::collections::{BTreeMap, BTreeSet};

use cotorra_graph::{Instruction, NodeId, Timestamp};
use cotorra_ledger::{Secret, ServiceId, negotiation::Creator};
use cotorra_plugin::{Actions, Noted};

use crate::{
    coverage::Coverage,
    settings::Settings,
    steps::{Step, process},
};

/// A radio unit of the domain.
#[derive(Debug)]
pub(crate) struct Unit {
    pub(crate) ssid: String,
    pub(crate) mobility_domain: u16,
    pub(crate) frequency_mhz: u16,
    /// Whether it serves.
    pub(crate) on: bool,
}

/// What both roles have at hand while they decide.
pub(crate) struct DomainContext<'a> {
    pub(crate) now: Timestamp,
    pub(crate) settings: &'a Settings,
    pub(crate) secret: &'a Secret,
    pub(crate) coverage: &'a Coverage,
    pub(crate) units: &'a mut BTreeMap<NodeId, Unit>,
    /// Services that are to end.
    pub(crate) closing: &'a mut Vec<Creator>,
    /// What was noted before this orchestrator was started again.
    pub(crate) noted: &'a BTreeSet<Noted>,
    pub(crate) actions: &'a mut Actions,
}

impl DomainContext<'_> {
    /// Keeps in the history that a step was reached, unless a run before this one did: what is heard anew from the chain, or
    /// done again to a network that began anew, is no new step.
    pub(crate) fn note(&mut self, id: ServiceId, step: Step, detail: impl Into<String>) {
        let detail = detail.into();
        let reason = (!detail.is_empty()).then_some(detail);
        let noted = Noted { process: process(id), step: step.to_string(), reason };
        if step.is_reached_once() && self.noted.contains(&noted) {
            return;
        }
        let note = Instruction::Note { process: noted.process, step: noted.step, ago: None };
        match noted.reason {
            None => self.actions.instruct(note),
            Some(reason) => self.actions.instruct_because(note, reason),
        }
    }
}
