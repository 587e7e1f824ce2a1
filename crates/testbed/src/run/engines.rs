//! The engines of a run: VNFs on emulated nodes are processes of this machine, and those on real servers run at their agents.

use cotorra_engine::{Engine, EngineEvent, InstanceId, ProcessEngine};
use cotorra_graph::{NodeId, Vnf};

use super::launcher::NodeLauncher;
#[cfg(feature = "agents")]
use crate::agents::AgentEngine;

/// The engines of a run.
pub(super) struct Engines {
    pub(super) local: ProcessEngine<NodeLauncher>,
    #[cfg(feature = "agents")]
    pub(super) agents: Option<AgentEngine>,
}

impl Engines {
    /// Returns the engine of a node.
    fn of(&mut self, node: &NodeId) -> &mut dyn Engine {
        #[cfg(feature = "agents")]
        if let Some(agents) = self.agents.as_mut().filter(|agents| agents.carries(node)) {
            return agents;
        }
        let _ = node;
        &mut self.local
    }

    /// Returns all engines.
    fn all(&mut self) -> impl Iterator<Item = &mut dyn Engine> {
        let local: &mut dyn Engine = &mut self.local;
        let all = std::iter::once(local);
        #[cfg(feature = "agents")]
        let all = all.chain(self.agents.as_mut().map(|agents| agents as &mut dyn Engine));
        all
    }
}

impl Engine for Engines {
    fn start(&mut self, instance: InstanceId, vnf: &Vnf, replica: u32, node: &NodeId) -> Result<(), String> {
        self.of(node).start(instance, vnf, replica, node)
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
