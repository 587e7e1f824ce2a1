//! The engines of a run: VNFs on emulated nodes are processes or containers of this machine, and those on real servers run at
//! their agents.

use std::collections::BTreeMap;

use cotorra_engine::{Engine, EngineEvent, InstanceId, InstanceWaits, ProcessEngine, VnfComputed};
use cotorra_graph::{AgentId, HardwareGraph, NodeId, Vnf};

use super::{containers::Containers, launcher::NodeLauncher};

/// The engines of a run.
pub(super) struct Engines {
    local: ProcessEngine<NodeLauncher>,
    containers: Containers,
    /// The engine of real servers; `None` if no agent can connect.
    agents: Option<Box<dyn Engine + Send>>,
    real_servers: BTreeMap<NodeId, AgentId>,
}

impl Engines {
    pub(super) fn new(
        graph: &HardwareGraph,
        local: ProcessEngine<NodeLauncher>,
        containers: Containers,
        agents: Option<Box<dyn Engine + Send>>,
    ) -> Self {
        let real_servers = graph.real_servers().map(|(node, real)| (node.id.clone(), real.agent.clone()));
        Self { local, containers, agents, real_servers: real_servers.collect() }
    }

    fn all(&mut self) -> impl Iterator<Item = &mut dyn Engine> {
        let here: [&mut dyn Engine; 2] = [&mut self.local, &mut self.containers];
        let agents = self.agents.as_deref_mut().map(|agents| -> &mut dyn Engine { agents });
        here.into_iter().chain(agents)
    }
}

impl Engine for Engines {
    fn start(&mut self, instance: InstanceId, vnf: &Vnf, replica: u32, node: &NodeId) -> Result<(), String> {
        match (self.real_servers.get(node), &mut self.agents) {
            (Some(_), Some(agents)) => agents.start(instance, vnf, replica, node),
            (Some(agent), None) => Err(format!("its agent `{agent}` cannot connect: no agent is enrolled")),
            (None, _) if vnf.image.is_some() => self.containers.start(instance, vnf, replica, node),
            (None, _) => self.local.start(instance, vnf, replica, node),
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

    fn processor_waits(&self) -> Vec<InstanceWaits> {
        // Processes in containers are their engine's, and real servers wait as their machines do.
        self.local.processor_waits()
    }

    fn computed(&self) -> Vec<VnfComputed> {
        self.local.computed()
    }
}
