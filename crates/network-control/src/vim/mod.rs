//! The virtual infrastructure manager: where each VNF runs, a(n), and how it gets from one node to another without a
//! gap: the new instance first, packets over to it when it is ready, the old one down when what is under way to it has
//! arrived.

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

/// An instance that packets do not go to any more stops so much later: longer than any robot waits for an answer to what
/// it sent there before, 0.6 s for a TurtleBot 2.
const LAST_PACKETS: Duration = Duration::from_secs(1);

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
    #[error("`{0}` is a switch or a real machine, which runs no VNFs")]
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

/// The stage of an instance's life.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stage {
    /// It will serve once it is ready.
    Starting,
    /// Packets go to it.
    Serving,
    /// It answers packets that are under way to it, until then.
    Draining(Timestamp),
}

/// A VNF and its instances, for checks.
#[derive(Debug, Clone, PartialEq)]
pub struct Managed<'a> {
    /// The VNF.
    pub vnf: &'a Vnf,
    /// a(n), also while nothing runs.
    pub node: &'a NodeId,
    /// Its instances.
    pub instances: Vec<(InstanceId, &'a NodeId, Stage)>,
    /// Time of its next start.
    pub restart_at: Option<Timestamp>,
}

/// A VNF and its instances.
#[derive(Debug)]
struct Slot {
    vnf: Vnf,
    /// The one that serves; its node is a(n).
    current: Option<Instance>,
    /// The one that will, once it is ready.
    next: Option<Instance>,
    /// Those that did, and answer what is under way to them, until then.
    last: Vec<(Timestamp, Instance)>,
    /// Where the VNF belongs, also while nothing runs.
    node: NodeId,
    /// When to start it again, after it died.
    restart_at: Option<Timestamp>,
    backoff: Duration,
}

impl Slot {
    /// Whether it runs on a node, or is on its way there.
    fn is_on(&self, node: &NodeId) -> bool {
        self.node == *node || self.next.as_ref().is_some_and(|next| next.node == *node)
    }

    /// From now on packets go to this instance.
    fn switch(&mut self, now: Timestamp, to: Instance, events: &mut Vec<Event>) {
        self.node = to.node.clone();
        self.restart_at = None;
        if self.current.as_ref().is_none_or(|old| old.node != to.node) {
            events.push(Event::Placement(Placement { vnf: self.vnf.id.clone(), node: to.node.clone() }));
        }
        let old = self.current.replace(to);
        self.last.extend(old.map(|old| (now + LAST_PACKETS, old)));
    }
}

fn life(vnf: &VnfId, node: &NodeId, state: VnfState, detail: Option<String>) -> Event {
    Event::Vnf(VnfEvent { vnf: vnf.clone(), node: node.clone(), state, detail })
}

/// Keeps every VNF running where it was placed.
#[derive(Debug)]
pub struct Vim<E> {
    engine: E,
    graph: HardwareGraph,
    /// By name. They are looked at in each step of virtual time: a map would take longer.
    slots: Vec<Slot>,
    /// Room that others take on nodes: CPUs and bytes.
    reserved: BTreeMap<VnfId, (NodeId, f64, u64)>,
    instances: u64,
}

impl<E: Engine> Vim<E> {
    /// Manages the VNFs of these services; nothing runs before [`Vim::start`].
    pub fn new(graph: HardwareGraph, services: &[Service], engine: E) -> Self {
        let slot = |vnf: &Vnf| Slot {
            vnf: vnf.clone(),
            current: None,
            next: None,
            last: Vec::new(),
            node: vnf.node.clone(),
            restart_at: None,
            backoff: FIRST_BACKOFF,
        };
        let mut slots: Vec<_> = services.iter().flat_map(|service| &service.vnfs).map(slot).collect();
        slots.sort_by(|a, b| a.vnf.id.cmp(&b.vnf.id));
        Self { engine, graph, slots, reserved: BTreeMap::new(), instances: 0 }
    }

    /// Starts every VNF where the testbed file puts it.
    pub fn start(&mut self, now: Timestamp) -> Vec<Event> {
        let mut events = Vec::new();
        for index in 0..self.slots.len() {
            let node = self.slots[index].node.clone();
            self.launch(now, index, node, &mut events);
        }
        events
    }

    /// Where a VNF runs, or is about to for the first time.
    pub fn node(&self, vnf: &VnfId) -> Option<&NodeId> {
        self.index(vnf).map(|index| &self.slots[index].node)
    }

    /// Whether a VNF runs on a node, or is on its way there.
    pub fn is_on(&self, vnf: &VnfId, node: &NodeId) -> bool {
        self.index(vnf).is_some_and(|index| self.slots[index].is_on(node))
    }

    /// Where every VNF runs.
    pub fn placements(&self) -> Vec<Placement> {
        self.slots.iter().map(|s| Placement { vnf: s.vnf.id.clone(), node: s.node.clone() }).collect()
    }

    /// Returns every VNF with its instances, by name.
    pub fn managed(&self) -> impl Iterator<Item = Managed<'_>> {
        self.slots.iter().map(|slot| {
            let starting = slot.next.iter().map(|i| (i.id, &i.node, Stage::Starting));
            let serving = slot.current.iter().map(|i| (i.id, &i.node, Stage::Serving));
            let draining = slot.last.iter().map(|(until, i)| (i.id, &i.node, Stage::Draining(*until)));
            Managed {
                vnf: &slot.vnf,
                node: &slot.node,
                instances: starting.chain(serving).chain(draining).collect(),
                restart_at: slot.restart_at,
            }
        })
    }

    /// Whether every VNF runs and is ready.
    pub fn all_ready(&self) -> bool {
        self.slots.iter().all(|s| s.current.as_ref().is_some_and(|i| i.ready))
    }

    /// Begins to move a VNF; [`Event::Placement`] tells when packets go to the new node. Does nothing where it runs
    /// there already. A move to another node that was still under way is given up.
    ///
    /// # Errors
    /// [`VimError`]; then nothing changed.
    pub fn place(&mut self, now: Timestamp, vnf: &VnfId, node: &NodeId) -> Result<Vec<Event>, VimError> {
        let index = self.index(vnf).ok_or_else(|| VimError::UnknownVnf(vnf.clone()))?;
        let slot = &self.slots[index];
        if let Some(pinned) = slot.vnf.pinned_to.as_ref().filter(|pinned| *pinned != node) {
            return Err(VimError::Pinned { vnf: vnf.clone(), node: pinned.clone() });
        }
        if slot.next.as_ref().is_some_and(|next| next.node == *node) {
            return Ok(Vec::new());
        }
        if slot.node != *node {
            self.check_room(vnf, slot.vnf.cpus, slot.vnf.memory_bytes, node)?;
        }
        let mut events = Vec::new();
        let slot = &mut self.slots[index];
        if let Some(given_up) = slot.next.take() {
            self.engine.stop(given_up.id);
        }
        if slot.node == *node {
            // The instance that served there died, and its successor is given up.
            if slot.current.is_none() && slot.restart_at.is_none() {
                self.launch(now, index, node.clone(), &mut events);
            }
            return Ok(events);
        }
        match slot.last.iter().position(|(_, instance)| instance.node == *node) {
            // It was there until a moment ago, and still is.
            Some(place) => {
                let (_, instance) = slot.last.swap_remove(place);
                slot.switch(now, instance, &mut events);
            }
            None => self.launch(now, index, node.clone(), &mut events),
        }
        Ok(events)
    }

    /// What happened since the last call: VNFs that became ready, died, or were started again.
    pub fn poll(&mut self, now: Timestamp) -> Vec<Event> {
        let mut events = Vec::new();
        while let Some(happened) = self.engine.poll() {
            self.absorb(now, happened, &mut events);
        }
        for slot in &mut self.slots {
            for (_, old) in slot.last.extract_if(.., |(until, _)| *until <= now) {
                events.push(life(&slot.vnf.id, &old.node, VnfState::Stopped, None));
                self.engine.stop(old.id);
            }
        }
        for index in 0..self.slots.len() {
            let slot = &mut self.slots[index];
            if slot.restart_at.take_if(|at| *at <= now).is_some() {
                let node = slot.node.clone();
                self.launch(now, index, node, &mut events);
            }
        }
        events
    }

    /// When [`Vim::poll`] has something to do by itself.
    pub fn next_deadline(&self) -> Option<Timestamp> {
        let of_slot =
            |slot: &Slot| slot.restart_at.into_iter().chain(slot.last.iter().map(|(until, _)| *until)).min();
        self.slots.iter().filter_map(of_slot).min()
    }

    /// Stops everything and waits for it.
    pub fn shut_down(&mut self) {
        for slot in &mut self.slots {
            slot.restart_at = None;
            let last = slot.last.drain(..).map(|(_, instance)| instance);
            for instance in slot.current.take().into_iter().chain(slot.next.take()).chain(last) {
                self.engine.stop(instance.id);
            }
        }
        self.engine.shut_down();
    }

    /// Takes room on a node for a VNF that something else runs.
    ///
    /// # Errors
    /// [`VimError`] when the node has no room.
    pub(crate) fn reserve(
        &mut self,
        vnf: VnfId,
        cpus: f64,
        memory: u64,
        node: &NodeId,
    ) -> Result<(), VimError> {
        self.check_room(&vnf, cpus, memory, node)?;
        self.reserved.insert(vnf, (node.clone(), cpus, memory));
        Ok(())
    }

    /// Gives that room back, if there is any.
    pub(crate) fn release(&mut self, vnf: &VnfId) {
        self.reserved.remove(vnf);
    }

    /// Whether a VNF that takes so much fits on a node, beside all others there and those on their way to it.
    fn check_room(
        &self,
        vnf: &VnfId,
        needed_cpus: f64,
        needed_memory: u64,
        id: &NodeId,
    ) -> Result<(), VimError> {
        let node = self.graph.node(id).ok_or_else(|| VimError::UnknownNode(id.clone()))?;
        let capacity = node.capacity().ok_or_else(|| VimError::NotAHost(id.clone()))?;
        let others = || {
            let slots = self.slots.iter().filter(|s| s.vnf.id != *vnf && s.is_on(id));
            let reserved = self.reserved.iter().filter(|(other, (node, ..))| *other != vnf && node == id);
            slots
                .map(|s| (s.vnf.cpus, s.vnf.memory_bytes))
                .chain(reserved.map(|(_, (_, cpus, memory))| (*cpus, *memory)))
        };
        let cpus = capacity.cpus - others().map(|(cpus, _)| cpus).sum::<f64>();
        let memory = capacity.memory_bytes.saturating_sub(others().map(|(_, memory)| memory).sum());
        let no_room =
            |needed, free| Err(VimError::NoRoom { vnf: vnf.clone(), node: id.clone(), needed, free });
        if needed_cpus > cpus + 1e-9 {
            return no_room(format!("{needed_cpus} CPUs"), format!("{cpus}"));
        }
        if needed_memory > memory {
            return no_room(
                format!("{} MB", needed_memory / 1_000_000),
                format!("{} MB", memory / 1_000_000),
            );
        }
        Ok(())
    }

    fn index(&self, vnf: &VnfId) -> Option<usize> {
        self.slots.binary_search_by(|slot| slot.vnf.id.cmp(vnf)).ok()
    }

    /// Starts an instance of a VNF on a node; it becomes the current one when it is ready.
    fn launch(&mut self, now: Timestamp, index: usize, node: NodeId, events: &mut Vec<Event>) {
        let slot = &mut self.slots[index];
        self.instances += 1;
        let id = InstanceId(self.instances);
        slot.next = Some(Instance { id, node: node.clone(), since: now, ready: false });
        slot.restart_at = None;
        if slot.vnf.program == Program::RobotDriver {
            // The robot's own driver runs in the Robot Middleware: nothing is to be started.
            self.absorb(now, EngineEvent { instance: id, outcome: Outcome::Ready }, events);
        } else if let Err(error) = self.engine.start(id, &slot.vnf, &node) {
            self.absorb(now, EngineEvent { instance: id, outcome: Outcome::Failed(error) }, events);
        }
    }

    fn absorb(&mut self, now: Timestamp, happened: EngineEvent, events: &mut Vec<Event>) {
        if let Outcome::Died(_) = happened.outcome {
            // One that was to stop soon anyway.
            self.slots.iter_mut().for_each(|slot| slot.last.retain(|(_, i)| i.id != happened.instance));
        }
        let is = |i: &Option<Instance>| i.as_ref().is_some_and(|i| i.id == happened.instance);
        let Some(slot) = self.slots.iter_mut().find(|s| is(&s.current) || is(&s.next)) else {
            return; // A stopped instance has its last word; nobody waits for it.
        };
        let vnf = slot.vnf.id.clone();
        let life = |node: &NodeId, state, detail| life(&vnf, node, state, detail);
        match happened.outcome {
            Outcome::Ready => {
                let Some(mut ready) = slot.next.take() else { return };
                ready.ready = true;
                events.push(life(&ready.node, VnfState::Started, None));
                slot.switch(now, ready, events);
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
