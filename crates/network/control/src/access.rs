//! Virtual access points: the VNF `vAP`, which makes a radio unit serve its network. Deployment takes some time, removal
//! none.

use std::{collections::BTreeMap, time::Duration};

use cotorra_engine::Engine;
use cotorra_graph::{AccessPoint, Event, HardwareGraph, NodeId, Timestamp, VnfEvent, VnfState};

use crate::{
    network::{InstructionError, Network, NetworkGone, rejected},
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
        let (unit, wanted) = (radio_unit.clone(), access_point.clone());
        let check = move |fabric: &mut cotorra_fabric::Fabric, _| fabric.check_switch_on(&unit, &wanted);
        network.with(check).map_err(rejected)?.map_err(rejected)?;
        vim.reserve(AccessPoint::vnf(radio_unit), CPUS, MEMORY, radio_unit).map_err(rejected)?;
        let time = self.times.get(radio_unit).copied().unwrap_or_default();
        self.deploying.insert(radio_unit.clone(), (now + time, access_point));
        Ok(())
    }

    /// Removes a vAP, or cancels its deployment.
    pub(crate) fn remove<E: Engine>(
        &mut self,
        radio_unit: &NodeId,
        network: &impl Network,
        vim: &mut Vim<E>,
    ) -> Result<Vec<Event>, InstructionError> {
        if self.deploying.remove(radio_unit).is_none() {
            let unit = radio_unit.clone();
            let off = move |fabric: &mut cotorra_fabric::Fabric, now| fabric.switch_off(now, &unit);
            network.with(off).map_err(rejected)?.map_err(rejected)?;
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
            let unit = radio_unit.clone();
            let on =
                move |fabric: &mut cotorra_fabric::Fabric, now| fabric.switch_on(now, &unit, access_point);
            events.push(match network.with(on)? {
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
