//! The engines of a run: VNFs on emulated nodes are processes of this machine, and those on real servers run at their agents.

use std::collections::BTreeMap;

use cotorra_engine::{Engine, EngineEvent, InstanceId, ProcessEngine};
use cotorra_graph::{AgentId, HardwareGraph, NodeId, Vnf};

use super::launcher::NodeLauncher;

/// The engines of a run.
pub(super) struct Engines {
    local: ProcessEngine<NodeLauncher>,
    /// The engine of real servers; `None` if no agent can connect.
    agents: Option<Box<dyn Engine + Send>>,
    real_servers: BTreeMap<NodeId, AgentId>,
}

impl Engines {
    pub(super) fn new(
        graph: &HardwareGraph,
        local: ProcessEngine<NodeLauncher>,
        agents: Option<Box<dyn Engine + Send>>,
    ) -> Self {
        let real_servers = graph.real_servers().map(|(node, real)| (node.id.clone(), real.agent.clone()));
        Self { local, agents, real_servers: real_servers.collect() }
    }

    fn all(&mut self) -> impl Iterator<Item = &mut dyn Engine> {
        let local: &mut dyn Engine = &mut self.local;
        let agents = self.agents.as_mut().map(|agents| {
            let agents: &mut dyn Engine = &mut **agents;
            agents
        });
        std::iter::once(local).chain(agents)
    }
}

impl Engine for Engines {
    fn start(&mut self, instance: InstanceId, vnf: &Vnf, replica: u32, node: &NodeId) -> Result<(), String> {
        match (self.real_servers.get(node), &mut self.agents) {
            (None, _) => self.local.start(instance, vnf, replica, node),
            (Some(_), Some(agents)) => agents.start(instance, vnf, replica, node),
            (Some(agent), None) => Err(format!("its agent `{agent}` cannot connect: no agent is enrolled")),
        }
    }

    fn stop(&mut self, instance: InstanceId) {
        self.all().for_each(|engine| engine.stop(instance));
    }

    fn poll(&mut self) -> Option<EngineEvent> {
        self.all().find_map(Engine::poll)
    }

    fn shut_down(&mut self) {
        self.all().for_each(Engine::shut_down);
    }
}
