//! State of a domain that both roles use, as creator and as provider.

use std::{
    collections::{BTreeMap, BTreeSet},
    net::SocketAddr,
};

use cotorra_graph::{Instruction, NodeId, Timestamp};
use cotorra_ledger::{Secret, ServiceId, negotiation::Creator};
use cotorra_plugin::{Actions, Noted, coverage::Coverage};

use crate::{
    settings::Settings,
    steps::{Step, process},
};

/// A radio unit of the domain.
#[derive(Debug)]
pub(crate) struct Unit {
    pub(crate) ssid: String,
    pub(crate) mobility_domain: u16,
    pub(crate) frequency_mhz: u16,
    /// Whether it is serving.
    pub(crate) on: bool,
}

/// The domain's state, passed to both roles while they decide.
pub(crate) struct DomainContext<'a> {
    pub(crate) now: Timestamp,
    pub(crate) settings: &'a Settings,
    pub(crate) secret: &'a Secret,
    pub(crate) coverage: &'a Coverage,
    /// Address at which this core takes the robots of others.
    pub(crate) core: Option<SocketAddr>,
    pub(crate) units: &'a mut BTreeMap<NodeId, Unit>,
    /// Services to be ended.
    pub(crate) closing: &'a mut Vec<Creator>,
    /// Notes from before this orchestrator was restarted.
    pub(crate) noted: &'a BTreeSet<Noted>,
    pub(crate) actions: &'a mut Actions,
}

impl DomainContext<'_> {
    /// Notes a step in the history, unless an earlier run of this orchestrator did. Events received again from the
    /// chain, or repeated to a restarted network, are not new steps.
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
