//! An engine that runs nothing: in virtual time VNFs are part of the simulation, and tests want to say what happens.

use std::collections::{BTreeMap, VecDeque};

use cotorra_graph::{NodeId, Vnf, VnfId};

use super::engine::{Engine, EngineEvent, InstanceId, Outcome};

/// Keeps a list of what would run; every instance is ready at once unless its node was told to fail or to take for ever.
#[derive(Debug, Default)]
pub struct InMemoryEngine {
    running: BTreeMap<InstanceId, (VnfId, NodeId)>,
    failing: Vec<NodeId>,
    stalled: Vec<NodeId>,
    happened: VecDeque<EngineEvent>,
}

impl InMemoryEngine {
    /// From now on no instance can be started on that node.
    pub fn fail_on(&mut self, node: NodeId) {
        self.failing.push(node);
    }

    /// From now on no instance that is started on that node becomes ready.
    pub fn stall_on(&mut self, node: NodeId) {
        self.stalled.push(node);
    }

    /// Lets an instance die.
    pub fn kill(&mut self, instance: InstanceId, detail: &str) {
        if self.running.remove(&instance).is_some() {
            self.happened.push_back(EngineEvent { instance, outcome: Outcome::Died(detail.to_owned()) });
        }
    }

    /// What runs, and where.
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
            self.happened.push_back(EngineEvent { instance, outcome: Outcome::Ready });
        }
        Ok(())
    }

    fn stop(&mut self, instance: InstanceId) {
        self.running.remove(&instance);
    }

    fn poll(&mut self) -> Option<EngineEvent> {
        self.happened.pop_front()
    }

    fn shut_down(&mut self) {
        self.running.clear();
    }
}
