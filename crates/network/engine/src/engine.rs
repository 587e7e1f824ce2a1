//! The interface to the engine that runs VNFs: processes in namespaces by default.

use cotorra_graph::{NodeId, Vnf};

use crate::{computed::VnfComputed, processor_waits::InstanceWaits};

/// The number of a VNF's instance, unique in a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct InstanceId(pub u64);

/// An event of an instance.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct EngineEvent {
    pub instance: InstanceId,
    pub outcome: Outcome,
}

/// The outcome of starting or running an instance.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Outcome {
    /// It serves.
    Ready,
    /// It ended without being stopped; with the reason, for people.
    Died(String),
    /// It could not be started; with the reason, for people.
    Failed(String),
}

/// Runs instances of VNFs on nodes.
///
/// `start` and `stop` return at once. `poll` reports the outcome of a start: exactly one `Ready` and then at most one
/// `Died`, or one `Failed`. A stopped instance may still report one last event.
///
/// The module `contract`, with the feature of that name, checks these and all other promises of an engine.
pub trait Engine {
    /// Begins to start an instance. `replica` is its number, from 0, among the VNF's instances.
    ///
    /// # Errors
    /// The reason for which a start is impossible, for people.
    fn start(&mut self, instance: InstanceId, vnf: &Vnf, replica: u32, node: &NodeId) -> Result<(), String>;

    /// Begins to start an instance that takes over the state of another one of its VNF, as [`Vnf::state`] says. By default, it
    /// starts without.
    ///
    /// # Errors
    /// As of [`Engine::start`].
    fn migrate(
        &mut self,
        instance: InstanceId,
        _from: InstanceId,
        vnf: &Vnf,
        replica: u32,
        node: &NodeId,
    ) -> Result<(), String> {
        self.start(instance, vnf, replica, node)
    }

    /// Begins to stop an instance. Ignores unknown ones.
    fn stop(&mut self, instance: InstanceId);

    /// Returns the next event, oldest first.
    fn poll(&mut self) -> Option<EngineEvent>;

    /// Stops all instances, and waits until they have ended and are cleaned up.
    fn shut_down(&mut self);

    /// Returns for how long instances have waited for a processor so far, also those that have ended. Leaves out those of
    /// which it cannot know.
    fn processor_waits(&self) -> Vec<InstanceWaits> {
        Vec::new()
    }

    /// Returns what instances of bundled VNFs with a demand have computed so far, also those that have ended. Leaves out
    /// those of which it cannot know.
    fn computed(&self) -> Vec<VnfComputed> {
        Vec::new()
    }
}
