//! The seam to what runs VNFs: processes in namespaces by default, containers or a recorded list elsewhere.

use cotorra_graph::{NodeId, Vnf};

/// One instance of a VNF; never used twice in a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct InstanceId(pub u64);

/// What became of an instance.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct EngineEvent {
    /// Which.
    pub instance: InstanceId,
    /// What.
    pub outcome: Outcome,
}

/// What can become of an instance.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Outcome {
    /// It serves.
    Ready,
    /// It ended though nobody stopped it; how, for people.
    Died(String),
    /// It could not be started; why, for people.
    Failed(String),
}

/// Runs instances of VNFs on nodes.
///
/// `start` and `stop` return at once; what came of a start is told by `poll`: exactly one `Ready`, then at most one
/// `Died`; or one `Failed`. A stopped instance may still say one last thing, or nothing.
pub trait Engine {
    /// Begins to start an instance. `replica` is its number, from 0, among those that serve at once as the VNF.
    ///
    /// # Errors
    /// Why it cannot even be tried, for people.
    fn start(&mut self, instance: InstanceId, vnf: &Vnf, replica: u32, node: &NodeId) -> Result<(), String>;

    /// Begins to stop an instance; unknown ones are ignored.
    fn stop(&mut self, instance: InstanceId);

    /// What happened, oldest first; `None` when there is no more.
    fn poll(&mut self) -> Option<EngineEvent>;

    /// Waits until everything that was started has ended and left nothing behind. Stops what still runs.
    fn shut_down(&mut self);
}
