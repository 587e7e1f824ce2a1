//! The virtual infrastructure manager: where each VNF runs, a(n), and how it gets from one node to another without a
//! gap: the new instance first, packets over to it when it is ready, the old one down.

mod cgroup;
mod engine;
mod memory;
mod process;

use std::{collections::BTreeMap, time::Duration};

use cotorra_graph::{
    Event, HardwareGraph, NodeId, Placement, Program, Service, Timestamp, Vnf, VnfEvent, VnfId, VnfState,
};

pub use cgroup::{CgroupError, Cgroups};
pub use engine::{Engine, EngineEvent, InstanceId, Outcome};
pub use memory::InMemoryEngine;
pub use process::{Launcher, Process, ProcessEngine, READY};

/// After a VNF died it is started again after so long, twice as long each time …
const FIRST_BACKOFF: Duration = Duration::from_millis(100);
/// … but never longer than this.
const LONGEST_BACKOFF: Duration = Duration::from_secs(5);
/// A VNF that ran for so long starts again with the first backoff.
const HEALTHY_AFTER: Duration = Duration::from_secs(10);

/// Why a VNF cannot be placed there.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum VimError {
    /// No such VNF.
    #[error("there is no VNF `{0}`")]
    UnknownVnf(VnfId),
    /// No such node.
    #[error("there is no node `{0}`")]
    UnknownNode(NodeId),
    /// Switches run nothing.
    #[error("`{0}` is a switch, which runs no VNFs")]
    NotAHost(NodeId),
    /// It cannot move.
    #[error("VNF `{vnf}` is pinned to `{node}`")]
    Pinned {
        /// Which.
        vnf: VnfId,
        /// Where it stays.
        node: NodeId,
    },
    /// The node is full.
    #[error("VNF `{vnf}` needs {needed} of `{node}`, which has {free} left")]
    NoRoom {
        /// Which.
        vnf: VnfId,
        /// Where.
        node: NodeId,
        /// What it takes.
        needed: String,
        /// What is left.
        free: String,
    },
}

/// An instance of a VNF.
#[derive(Debug, Clone)]
struct Instance {
    id: InstanceId,
    node: NodeId,
    since: Timestamp,
    ready: bool,
}

/// A VNF and its instances.
#[derive(Debug)]
struct Slot {
    vnf: Vnf,
    /// The one that serves; its node is a(n).
    current: Option<Instance>,
    /// The one that will, once it is ready.
    next: Option<Instance>,
    /// Where the VNF belongs, also while nothing runs.
    node: NodeId,
    /// When to start it again, after it died.
    restart_at: Option<Timestamp>,
    backoff: Duration,
}

/// Keeps every VNF running where it was placed.
#[derive(Debug)]
pub struct Vim<E> {
    engine: E,
    graph: HardwareGraph,
    slots: BTreeMap<VnfId, Slot>,
    instances: u64,
}

impl<E: Engine> Vim<E> {
    /// Manages the VNFs of these services; nothing runs before [`Vim::start`].
    pub fn new(graph: HardwareGraph, services: &[Service], engine: E) -> Self {
        let slots = services
            .iter()
            .flat_map(|service| &service.vnfs)
            .map(|vnf| {
                let slot = Slot {
                    vnf: vnf.clone(),
                    current: None,
                    next: None,
                    node: vnf.node.clone(),
                    restart_at: None,
                    backoff: FIRST_BACKOFF,
                };
                (vnf.id.clone(), slot)
            })
            .collect();
        Self { engine, graph, slots, instances: 0 }
    }

    /// Starts every VNF where the testbed file puts it.
    pub fn start(&mut self, now: Timestamp) -> Vec<Event> {
        let vnfs: Vec<_> = self.slots.keys().cloned().collect();
        let mut events = Vec::new();
        for vnf in vnfs {
            let node = self.slots[&vnf].node.clone();
            self.launch(now, &vnf, node, &mut events);
        }
        events
    }

    /// Where a VNF runs, or is about to for the first time.
    pub fn node(&self, vnf: &VnfId) -> Option<&NodeId> {
        self.slots.get(vnf).map(|slot| &slot.node)
    }

    /// Where every VNF runs.
    pub fn placements(&self) -> Vec<Placement> {
        self.slots.values().map(|s| Placement { vnf: s.vnf.id.clone(), node: s.node.clone() }).collect()
    }

    /// Whether every VNF runs and is ready.
    pub fn all_ready(&self) -> bool {
        self.slots.values().all(|s| s.current.as_ref().is_some_and(|i| i.ready))
    }

    /// Begins to move a VNF; [`Event::Placement`] tells when packets go to the new node. Does nothing where it runs
    /// there already. A move to another node that was still under way is given up.
    ///
    /// # Errors
    /// [`VimError`]; then nothing changed.
    pub fn place(&mut self, now: Timestamp, vnf: &VnfId, node: &NodeId) -> Result<Vec<Event>, VimError> {
        let slot = self.slots.get(vnf).ok_or_else(|| VimError::UnknownVnf(vnf.clone()))?;
        if let Some(pinned) = slot.vnf.pinned_to.as_ref().filter(|pinned| *pinned != node) {
            return Err(VimError::Pinned { vnf: vnf.clone(), node: pinned.clone() });
        }
        if slot.next.as_ref().is_some_and(|next| next.node == *node) {
            return Ok(Vec::new());
        }
        if slot.node != *node {
            self.check_room(&slot.vnf, node)?;
        }
        let mut events = Vec::new();
        let slot = self.slots.get_mut(vnf).expect("it was found above");
        if let Some(given_up) = slot.next.take() {
            self.engine.stop(given_up.id);
        }
        if slot.node != *node {
            self.launch(now, vnf, node.clone(), &mut events);
        }
        Ok(events)
    }

    /// What happened since the last call: VNFs that became ready, died, or were started again.
    pub fn poll(&mut self, now: Timestamp) -> Vec<Event> {
        let mut events = Vec::new();
        while let Some(happened) = self.engine.poll() {
            self.absorb(now, happened, &mut events);
        }
        let due: Vec<_> = self
            .slots
            .values()
            .filter(|s| s.restart_at.is_some_and(|at| at <= now))
            .map(|s| (s.vnf.id.clone(), s.node.clone()))
            .collect();
        for (vnf, node) in due {
            self.slots.get_mut(&vnf).expect("it was listed above").restart_at = None;
            self.launch(now, &vnf, node, &mut events);
        }
        events
    }

    /// When [`Vim::poll`] has something to do by itself.
    pub fn next_deadline(&self) -> Option<Timestamp> {
        self.slots.values().filter_map(|s| s.restart_at).min()
    }

    /// Stops everything and waits for it.
    pub fn shut_down(&mut self) {
        for slot in self.slots.values_mut() {
            slot.restart_at = None;
            for instance in slot.current.take().into_iter().chain(slot.next.take()) {
                self.engine.stop(instance.id);
            }
        }
        self.engine.shut_down();
    }

    fn check_room(&self, vnf: &Vnf, id: &NodeId) -> Result<(), VimError> {
        let node = self.graph.node(id).ok_or_else(|| VimError::UnknownNode(id.clone()))?;
        let capacity = node.capacity().ok_or_else(|| VimError::NotAHost(id.clone()))?;
        let others = || {
            self.slots
                .values()
                .filter(|s| s.vnf.id != vnf.id && s.node == *id)
                .map(|s| (s.vnf.cpus, s.vnf.memory_bytes))
        };
        let cpus = capacity.cpus - others().map(|(cpus, _)| cpus).sum::<f64>();
        let memory = capacity.memory_bytes.saturating_sub(others().map(|(_, memory)| memory).sum());
        let no_room =
            |needed, free| Err(VimError::NoRoom { vnf: vnf.id.clone(), node: id.clone(), needed, free });
        if vnf.cpus > cpus + 1e-9 {
            return no_room(format!("{} CPUs", vnf.cpus), format!("{cpus}"));
        }
        if vnf.memory_bytes > memory {
            return no_room(
                format!("{} MB", vnf.memory_bytes / 1_000_000),
                format!("{} MB", memory / 1_000_000),
            );
        }
        Ok(())
    }

    /// Starts an instance of a VNF on a node; it becomes the current one when it is ready.
    fn launch(&mut self, now: Timestamp, vnf: &VnfId, node: NodeId, events: &mut Vec<Event>) {
        let Some(slot) = self.slots.get_mut(vnf) else { return };
        self.instances += 1;
        let id = InstanceId(self.instances);
        slot.next = Some(Instance { id, node: node.clone(), since: now, ready: false });
        if slot.vnf.program == Program::RobotDriver {
            // The robot's own driver runs in the Robot Middleware: nothing is to be started.
            self.absorb(now, EngineEvent { instance: id, outcome: Outcome::Ready }, events);
        } else if let Err(error) = self.engine.start(id, &slot.vnf, &node) {
            self.absorb(now, EngineEvent { instance: id, outcome: Outcome::Failed(error) }, events);
        }
    }

    fn absorb(&mut self, now: Timestamp, happened: EngineEvent, events: &mut Vec<Event>) {
        let is = |i: &Option<Instance>| i.as_ref().is_some_and(|i| i.id == happened.instance);
        let Some(slot) = self.slots.values_mut().find(|s| is(&s.current) || is(&s.next)) else {
            return; // A stopped instance has its last word; nobody waits for it.
        };
        let vnf = slot.vnf.id.clone();
        let life = |node: &NodeId, state, detail| {
            Event::Vnf(VnfEvent { vnf: vnf.clone(), node: node.clone(), state, detail })
        };
        match happened.outcome {
            Outcome::Ready => {
                let Some(mut ready) = slot.next.take() else { return };
                ready.ready = true;
                slot.node = ready.node.clone();
                events.push(life(&ready.node, VnfState::Started, None));
                let moved = slot.current.as_ref().is_none_or(|old| old.node != ready.node);
                if moved {
                    events.push(Event::Placement(Placement { vnf: vnf.clone(), node: ready.node.clone() }));
                }
                if let Some(old) = slot.current.replace(ready) {
                    events.push(life(&old.node, VnfState::Stopped, None));
                    self.engine.stop(old.id);
                }
            }
            Outcome::Died(detail) | Outcome::Failed(detail) if is(&slot.current) => {
                let Some(died) = slot.current.take() else { return };
                if now.since(died.since) >= HEALTHY_AFTER {
                    slot.backoff = FIRST_BACKOFF;
                }
                events.push(life(&died.node, VnfState::Died, Some(detail)));
                // One that was about to replace it will; else the same again.
                if slot.next.is_none() {
                    slot.restart_at = Some(now + slot.backoff);
                    slot.backoff = (slot.backoff * 2).min(LONGEST_BACKOFF);
                }
            }
            Outcome::Died(detail) | Outcome::Failed(detail) => {
                let Some(failed) = slot.next.take() else { return };
                events.push(life(&failed.node, VnfState::Failed, Some(detail)));
                // A move that failed leaves the old one in service; a start that failed is tried again.
                if slot.current.is_none() {
                    slot.restart_at = Some(now + slot.backoff);
                    slot.backoff = (slot.backoff * 2).min(LONGEST_BACKOFF);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests;
