//! Virtual access points: the VNF `vAP`, which makes a radio unit serve its network. Deployment takes some time, removal
//! none.

use std::{collections::BTreeMap, time::Duration};

use cotorra_engine::Engine;
use cotorra_graph::{AccessPoint, Event, HardwareGraph, NodeId, Timestamp, VnfEvent, VnfState};

use crate::{
    network::{Deployment, InstructionError, Network, NetworkGone, rejected},
    vim::Vim,
};

/// CPUs of a vAP.
const CPUS: f64 = 0.5;
/// Memory of a vAP, bytes.
const MEMORY: u64 = 128_000_000;

/// Current deployments of vAPs.
#[derive(Debug, Default)]
pub(crate) struct AccessPoints {
    times: BTreeMap<NodeId, Duration>,
    deploying: BTreeMap<NodeId, (Timestamp, AccessPoint)>,
}

impl AccessPoints {
    pub(crate) fn new(graph: &HardwareGraph) -> Self {
        let time = |(node, unit): (&cotorra_graph::Node, &cotorra_graph::RadioUnit)| {
            (node.id.clone(), unit.deployment)
        };
        Self { times: graph.radio_units().map(time).collect(), deploying: BTreeMap::new() }
    }

    /// Starts to deploy a vAP.
    pub(crate) fn deploy<E: Engine>(
        &mut self,
        now: Timestamp,
        radio_unit: &NodeId,
        access_point: AccessPoint,
        network: &impl Network,
        vim: &mut Vim<E>,
    ) -> Result<(), InstructionError> {
        if self.deploying.contains_key(radio_unit) {
            return Err(InstructionError(format!("a vAP is being deployed on `{radio_unit}` already")));
        }
        let deployment = network.check_switch_on(radio_unit, &access_point)?;
        let vnf = AccessPoint::vnf(radio_unit);
        vim.reserve(vnf.clone(), CPUS, MEMORY, radio_unit).map_err(rejected)?;
        match deployment {
            Deployment::Emulated => {
                let time = self.times.get(radio_unit).copied().unwrap_or_default();
                self.deploying.insert(radio_unit.clone(), (now + time, access_point));
                Ok(())
            }
            Deployment::Real => {
                let done = network.switch_on(radio_unit, access_point).map_err(rejected).flatten();
                done.inspect_err(|_| vim.release(&vnf))
            }
        }
    }

    /// Removes a vAP, or cancels its deployment.
    pub(crate) fn remove<E: Engine>(
        &mut self,
        radio_unit: &NodeId,
        network: &impl Network,
        vim: &mut Vim<E>,
    ) -> Result<Vec<Event>, InstructionError> {
        if self.deploying.remove(radio_unit).is_none() {
            network.switch_off(radio_unit)?;
        }
        vim.release(&AccessPoint::vnf(radio_unit));
        Ok(vec![life(radio_unit, VnfState::Stopped, None)])
    }

    /// Switches on the vAPs whose deployment is done.
    pub(crate) fn poll<E: Engine>(
        &mut self,
        now: Timestamp,
        network: &impl Network,
        vim: &mut Vim<E>,
    ) -> Result<Vec<Event>, NetworkGone> {
        let mut events = Vec::new();
        for (radio_unit, (_, access_point)) in self.deploying.extract_if(.., |_, (at, _)| *at <= now) {
            events.push(match network.switch_on(&radio_unit, access_point)? {
                Ok(()) => life(&radio_unit, VnfState::Started, None),
                Err(reason) => {
                    vim.release(&AccessPoint::vnf(&radio_unit));
                    life(&radio_unit, VnfState::Failed, Some(reason.to_string()))
                }
            });
        }
        Ok(events)
    }

    /// Returns when [`Self::poll`] is due.
    pub(crate) fn next_deadline(&self) -> Option<Timestamp> {
        self.deploying.values().map(|(at, _)| *at).min()
    }
}

fn life(radio_unit: &NodeId, state: VnfState, detail: Option<String>) -> Event {
    Event::Vnf(VnfEvent { vnf: AccessPoint::vnf(radio_unit), node: radio_unit.clone(), state, detail })
}

#[cfg(test)]
mod tests;
