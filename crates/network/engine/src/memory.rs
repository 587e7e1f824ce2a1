//! An engine that runs nothing, for virtual time, in which VNFs are part of the simulation, and for tests.

use std::collections::{BTreeMap, VecDeque};

use cotorra_graph::{NodeId, Vnf, VnfId};

use crate::engine::{Engine, EngineEvent, InstanceId, Outcome};

/// Keeps a list of instances. Each one is ready at once, unless starts on its node fail or stall.
#[derive(Debug, Default)]
pub struct InMemoryEngine {
    running: BTreeMap<InstanceId, (VnfId, NodeId)>,
    failing: Vec<NodeId>,
    stalled: Vec<NodeId>,
    events: VecDeque<EngineEvent>,
}

impl InMemoryEngine {
    /// Makes all later starts on a node fail.
    pub fn fail_on(&mut self, node: NodeId) {
        self.failing.push(node);
    }

    /// Makes all later starts on a node stall: the instance never becomes ready.
    pub fn stall_on(&mut self, node: NodeId) {
        self.stalled.push(node);
    }

    /// Makes an instance die.
    pub fn kill(&mut self, instance: InstanceId, detail: &str) {
        if self.running.remove(&instance).is_some() {
            self.events.push_back(EngineEvent { instance, outcome: Outcome::Died(detail.to_owned()) });
        }
    }

    /// Returns the running instances with their VNFs and nodes.
    pub fn running(&self) -> impl Iterator<Item = (InstanceId, &VnfId, &NodeId)> {
        self.running.iter().map(|(id, (vnf, node))| (*id, vnf, node))
    }
}

impl Engine for InMemoryEngine {
    fn start(&mut self, instance: InstanceId, vnf: &Vnf, _replica: u32, node: &NodeId) -> Result<(), String> {
        if self.failing.contains(node) {
            return Err(format!("`{node}` starts nothing"));
        }
        self.running.insert(instance, (vnf.id.clone(), node.clone()));
        if !self.stalled.contains(node) {
            self.events.push_back(EngineEvent { instance, outcome: Outcome::Ready });
        }
        Ok(())
    }

    fn stop(&mut self, instance: InstanceId) {
        self.running.remove(&instance);
    }

    fn poll(&mut self) -> Option<EngineEvent> {
        self.events.pop_front()
    }

    fn shut_down(&mut self) {
        self.running.clear();
    }
}
