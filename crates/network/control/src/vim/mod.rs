//! The virtual infrastructure manager: places VNFs on nodes, a(n), and moves them without a gap. A move starts the new
//! instance first, sends packets to it once it is ready, and stops the old one when packets in flight to it have arrived. A
//! VNF can have several instances, each on a node of its own.

use std::{collections::BTreeMap, time::Duration};

use cotorra_engine::{Backoff, Engine, EngineEvent, InstanceId, InstanceWaits, Outcome, VnfComputed};
use cotorra_graph::{
    Event, HardwareGraph, NodeId, Nodes, Placement, Program, Timestamp, Vnf, VnfEvent, VnfId, VnfState,
};

/// Time from the last packets sent to an instance until it stops. It exceeds any robot's timeout for answers, 0.6 s for a
/// TurtleBot 2.
const LAST_PACKETS: Duration = Duration::from_secs(1);

mod added;

pub use added::{AddedVnfError, MOST_ADDED, check_added};

/// An error in placing a VNF.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum VimError {
    /// An unknown VNF.
    #[error("there is no VNF `{0}`")]
    UnknownVnf(VnfId),
    /// An unknown node.
    #[error("there is no node `{0}`")]
    UnknownNode(NodeId),
    /// A switch or a real machine.
    #[error("`{0}` is a switch, a gateway or a real machine, which runs no VNFs")]
    NotAHost(NodeId),
    /// A VNF that is pinned to a node.
    #[error("VNF `{vnf}` is pinned to `{node}`")]
    Pinned { vnf: VnfId, node: NodeId },
    /// A node without the room that the VNF needs.
    #[error("VNF `{vnf}` needs {needed} of `{node}`, which has {free} left")]
    NoRoom { vnf: VnfId, node: NodeId, needed: String, free: String },
    /// A VNF that cannot be added.
    #[error("VNF `{vnf}` cannot be added: {reason}")]
    NotAddable { vnf: VnfId, reason: AddedVnfError },
    /// A name in use, also if its case differs.
    #[error("there is a VNF `{0}` already")]
    Taken(VnfId),
    /// The name of a removed VNF whose last instance has not stopped.
    #[error("VNF `{0}` was removed, and its last instances still stop: try again in a second")]
    StillStopping(VnfId),
    /// Too many VNFs.
    #[error("no more than {MOST_ADDED} VNFs can be added at a time: remove one")]
    TooMany,
    /// A VNF of the testbed file.
    #[error("VNF `{0}` is of the testbed file: only VNFs that were added can be removed")]
    NotAdded(VnfId),
}

/// A running or starting instance of a VNF.
#[derive(Debug, Clone)]
struct Instance {
    id: InstanceId,
    node: NodeId,
    /// Number of the replica that it was started as.
    replica: u32,
    since: Timestamp,
    ready: bool,
}

/// The stage of an instance's life.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stage {
    /// It is not ready yet.
    Starting,
    /// Packets go to it.
    Serving,
    /// It answers packets in flight to it until this time.
    Draining(Timestamp),
}

/// A replica of a VNF and its instances, for checks.
#[derive(Debug, Clone, PartialEq)]
pub struct Managed<'a> {
    pub vnf: &'a Vnf,
    /// Node of the replica, also while no instance runs; `None` if the VNF was removed, and its instances only drain.
    pub node: Option<&'a NodeId>,
    /// Its instances. All draining ones of the VNF are with the first replica.
    pub instances: Vec<(InstanceId, &'a NodeId, Stage)>,
    /// Time of its next start.
    pub restart_at: Option<Timestamp>,
}

/// A replica of a VNF, on a node of its own.
#[derive(Debug)]
struct Slot {
    /// Its number, from 0: the lowest free one when it was added.
    replica: u32,
    /// The serving instance.
    current: Option<Instance>,
    /// The instance that will serve once it is ready.
    next: Option<Instance>,
    /// Its node, also while no instance runs.
    node: NodeId,
    /// Whether an instance has served there. Only then a(n) has the node.
    is_placed: bool,
    /// Whether it serves only until all others do.
    is_leaving: bool,
    /// Time of its restart, after it died.
    restart_at: Option<Timestamp>,
    backoff: Backoff,
}

impl Slot {
    fn new(replica: u32, node: NodeId) -> Self {
        Self {
            replica,
            current: None,
            next: None,
            node,
            is_placed: false,
            is_leaving: false,
            restart_at: None,
            backoff: Backoff::default(),
        }
    }

    /// Whether it runs on a node, or is moving there.
    fn is_on(&self, node: &NodeId) -> bool {
        self.node == *node || self.next.as_ref().is_some_and(|next| next.node == *node)
    }

    /// Whether it serves on its final node.
    fn has_arrived(&self) -> bool {
        self.current.is_some() && self.next.is_none()
    }

    /// Makes an instance the serving one. Returns the one before.
    fn switch(&mut self, to: Instance) -> Option<Instance> {
        self.node = to.node.clone();
        (self.restart_at, self.is_placed) = (None, true);
        self.current.replace(to)
    }

    fn restart(&mut self, now: Timestamp) {
        self.restart_at = Some(now + self.backoff.delay());
    }
}

/// A VNF and its replicas.
#[derive(Debug)]
struct Group {
    vnf: Vnf,
    /// Replicas, preferred ones first and leaving ones last. There is at least one.
    slots: Vec<Slot>,
    /// Former serving instances, and until when they answer packets in flight to them.
    draining: Vec<(Timestamp, Instance)>,
    /// The last reported a(n).
    reported: Vec<NodeId>,
    /// Whether it was added during the run.
    is_added: bool,
}

impl Group {
    fn new(vnf: &Vnf) -> Self {
        let slots = vnf.node.all().iter().zip(0..).map(|(node, replica)| Slot::new(replica, node.clone()));
        Self {
            vnf: vnf.clone(),
            slots: slots.collect(),
            draining: Vec::new(),
            reported: Vec::new(),
            is_added: false,
        }
    }

    /// Whether an instance runs on a node, or is moving there.
    fn is_on(&self, node: &NodeId) -> bool {
        self.slots.iter().any(|slot| slot.is_on(node))
    }

    /// Returns a(n).
    fn placement(&self) -> Placement {
        let placed = self.slots.iter().filter(|slot| slot.is_placed).map(|slot| slot.node.clone());
        // Before any instance serves, the first replica's node.
        let node = Nodes::new(placed.collect()).unwrap_or_else(|_| self.slots[0].node.clone().into());
        Placement { vnf: self.vnf.id.clone(), node }
    }

    /// Whether no slot except the one at `place` has a number.
    fn is_free(&self, replica: u32, place: usize) -> bool {
        self.slots.iter().enumerate().all(|(other, slot)| other == place || slot.replica != replica)
    }

    /// Makes an instance the serving one of a slot.
    fn switch(&mut self, now: Timestamp, place: usize, to: Instance) {
        let node = to.node.clone();
        let old = self.slots[place].switch(to);
        if old.as_ref().is_none_or(|old| old.node != node) {
            self.reported.clear();
        }
        self.draining.extend(old.map(|old| (now + LAST_PACKETS, old)));
    }

    /// Removes leaving slots once all others serve, and reports a(n) if it changed.
    fn settle(&mut self, now: Timestamp, events: &mut Vec<Event>) {
        let arrived = self.slots.iter().filter(|slot| !slot.is_leaving).all(Slot::has_arrived);
        let may_go = |slot: &mut Slot| slot.is_leaving && (arrived || slot.current.is_none());
        let gone: Vec<_> = self.slots.extract_if(.., may_go).filter_map(|slot| slot.current).collect();
        self.draining.extend(gone.into_iter().map(|instance| (now + LAST_PACKETS, instance)));
        let placement = self.placement();
        if self.slots.iter().any(|slot| slot.is_placed) && placement.node.all() != self.reported {
            self.reported = placement.node.all().to_vec();
            events.push(Event::Placement(placement));
        }
    }

    /// Assigns a slot to each of these nodes, in their order: one that is there, else one that is moving there, else one
    /// that can move, else a new one. All other slots leave. Returns the cancelled instances, and the
    /// indices of the slots to start, with their nodes.
    fn assign(&mut self, nodes: &[NodeId]) -> (Vec<Instance>, Vec<(usize, NodeId)>) {
        let mut assigned: Vec<Option<Slot>> = nodes.iter().map(|_| None).collect();
        let mut take = |is_fit: &dyn Fn(&Slot, &NodeId) -> bool| {
            for (slot, node) in assigned.iter_mut().zip(nodes).filter(|(slot, _)| slot.is_none()) {
                let found = self.slots.iter().position(|slot| is_fit(slot, node));
                *slot = found.map(|place| self.slots.remove(place));
            }
        };
        take(&|slot, node| slot.node == *node);
        take(&Slot::is_on);
        take(&|_, _| true);
        let mut leaving = std::mem::take(&mut self.slots);
        let mut numbers: Vec<_> =
            assigned.iter().flatten().chain(&leaving).map(|slot| slot.replica).collect();
        let (mut given_up, mut starts) = (Vec::new(), Vec::new());
        for (place, (slot, node)) in assigned.into_iter().zip(nodes).enumerate() {
            let mut slot = slot.unwrap_or_else(|| {
                let free = (0..).find(|number| !numbers.contains(number)).unwrap_or(u32::MAX);
                numbers.push(free);
                Slot::new(free, node.clone())
            });
            slot.is_leaving = false;
            if !slot.is_placed {
                slot.node = node.clone();
            }
            given_up.extend(slot.next.take_if(|next| next.node != *node));
            let is_there = slot.node == *node && (slot.current.is_some() || slot.restart_at.is_some());
            if slot.next.is_none() && !is_there {
                starts.push((place, node.clone()));
            }
            self.slots.push(slot);
        }
        for slot in &mut leaving {
            given_up.extend(slot.next.take());
            (slot.is_leaving, slot.restart_at) = (true, None);
        }
        self.slots.append(&mut leaving);
        (given_up, starts)
    }
}

fn life(vnf: &VnfId, node: &NodeId, state: VnfState, detail: Option<String>) -> Event {
    Event::Vnf(VnfEvent { vnf: vnf.clone(), node: node.clone(), state, detail })
}

/// Keeps every VNF running on its nodes.
#[derive(Debug)]
pub struct Vim<E> {
    engine: E,
    graph: HardwareGraph,
    /// VNFs, sorted by name. A map would be slower to iterate in each step of virtual time.
    groups: Vec<Group>,
    /// Removed VNFs, without replicas, whose last instances drain. Each has at least one.
    removed: Vec<Group>,
    /// Room that VNFs outside of this manager take on nodes: CPUs and bytes.
    reserved: BTreeMap<VnfId, (NodeId, f64, u64)>,
    instances: u64,
}

impl<E: Engine> Vim<E> {
    /// Creates the manager of these VNFs. None runs before [`Vim::start`].
    pub fn new<'a>(graph: HardwareGraph, vnfs: impl IntoIterator<Item = &'a Vnf>, engine: E) -> Self {
        let mut groups: Vec<_> = vnfs.into_iter().map(Group::new).collect();
        groups.sort_by(|a, b| a.vnf.id.cmp(&b.vnf.id));
        Self { engine, graph, groups, removed: Vec::new(), reserved: BTreeMap::new(), instances: 0 }
    }

    /// Starts every VNF on its nodes of the testbed file.
    pub fn start(&mut self, now: Timestamp) -> Vec<Event> {
        let mut events = Vec::new();
        for index in 0..self.groups.len() {
            for place in 0..self.groups[index].slots.len() {
                let node = self.groups[index].slots[place].node.clone();
                self.launch(now, (index, place), node, &mut events);
            }
            self.groups[index].settle(now, &mut events);
        }
        events
    }

    /// Returns the preferred node of a VNF.
    pub fn node(&self, vnf: &VnfId) -> Option<&NodeId> {
        self.group(vnf).map(|group| &group.slots[0].node)
    }

    /// Returns the nodes of a VNF, preferred ones first.
    pub fn nodes(&self, vnf: &VnfId) -> impl Iterator<Item = &NodeId> {
        self.group(vnf).into_iter().flat_map(|group| group.slots.iter().map(|slot| &slot.node))
    }

    /// Returns the nodes of a VNF's serving instances, preferred ones first and leaving ones last.
    pub fn serving(&self, vnf: &VnfId) -> Vec<&NodeId> {
        let slots = self.group(vnf).into_iter().flat_map(|group| &group.slots);
        let mut serving: Vec<_> = slots.filter(|slot| slot.current.is_some()).collect();
        serving.sort_by_key(|slot| (slot.is_leaving, slot.next.is_some()));
        serving.into_iter().map(|slot| &slot.node).collect()
    }

    /// Whether an instance of a VNF runs on a node, or is moving there.
    pub fn is_on(&self, vnf: &VnfId, node: &NodeId) -> bool {
        self.group(vnf).is_some_and(|group| group.is_on(node))
    }

    /// Returns the placement of every VNF.
    pub fn placements(&self) -> Vec<Placement> {
        self.groups.iter().map(Group::placement).collect()
    }

    /// Returns every replica of every VNF with its instances, by the VNF's name, and then removed VNFs whose instances drain.
    pub fn managed(&self) -> impl Iterator<Item = Managed<'_>> {
        let drained = self.removed.iter().map(|group| {
            let draining = group.draining.iter();
            let instances = draining.map(|(until, i)| (i.id, &i.node, Stage::Draining(*until))).collect();
            Managed { vnf: &group.vnf, node: None, instances, restart_at: None }
        });
        let replicas = self.groups.iter().flat_map(|group| {
            group.slots.iter().enumerate().map(|(place, slot)| {
                let starting = slot.next.iter().map(|i| (i.id, &i.node, Stage::Starting));
                let serving = slot.current.iter().map(|i| (i.id, &i.node, Stage::Serving));
                let last = if place == 0 { &group.draining[..] } else { &[] };
                let draining = last.iter().map(|(until, i)| (i.id, &i.node, Stage::Draining(*until)));
                Managed {
                    vnf: &group.vnf,
                    node: Some(&slot.node),
                    instances: starting.chain(serving).chain(draining).collect(),
                    restart_at: slot.restart_at,
                }
            })
        });
        replicas.chain(drained)
    }

    /// Whether all instances of every VNF of the testbed file are ready.
    pub fn all_ready(&self) -> bool {
        let mut slots = self.groups.iter().filter(|group| !group.is_added).flat_map(|group| &group.slots);
        slots.all(|slot| slot.current.as_ref().is_some_and(|i| i.ready))
    }

    /// Begins to move a VNF, or to change the number of its instances: one on each of these nodes, in this order.
    /// [`Event::Placement`] reports when packets go to other nodes. Instances on these nodes stay. Others stop once all
    /// instances on these nodes serve. An unfinished move to another node is cancelled.
    ///
    /// # Errors
    /// [`VimError`]. Nothing has changed then.
    pub fn place(&mut self, now: Timestamp, vnf: &VnfId, nodes: &Nodes) -> Result<Vec<Event>, VimError> {
        let index = self.index(vnf).ok_or_else(|| VimError::UnknownVnf(vnf.clone()))?;
        let group = &self.groups[index];
        if let Some(pinned) = group.vnf.pinned_to.as_ref().filter(|pinned| nodes.only() != Some(pinned)) {
            return Err(VimError::Pinned { vnf: vnf.clone(), node: pinned.clone() });
        }
        for node in nodes.all().iter().filter(|node| !group.is_on(node)) {
            self.check_room(vnf, group.vnf.cpus, group.vnf.memory_bytes, node)?;
            self.check_accelerator(&group.vnf, node)?;
        }
        let mut events = Vec::new();
        let (given_up, starts) = self.groups[index].assign(nodes.all());
        given_up.into_iter().for_each(|instance| self.engine.stop(instance.id));
        for (place, node) in starts {
            let group = &mut self.groups[index];
            let there = group.draining.iter().position(|(_, instance)| instance.node == node);
            match there.map(|there| group.draining.swap_remove(there).1) {
                // An instance there is still draining: it serves again, unless its state has moved on.
                Some(instance) if group.vnf.state.is_none() && group.is_free(instance.replica, place) => {
                    group.slots[place].replica = instance.replica;
                    group.switch(now, place, instance);
                }
                // Another instance has its state, or another replica its number now.
                Some(instance) => {
                    events.push(life(vnf, &node, VnfState::Stopped, None));
                    self.engine.stop(instance.id);
                    self.launch(now, (index, place), node, &mut events);
                }
                None => self.launch(now, (index, place), node, &mut events),
            }
        }
        self.groups[index].settle(now, &mut events);
        Ok(events)
    }

    /// Returns the events since the last call: VNFs that became ready, died, or were started again.
    pub fn poll(&mut self, now: Timestamp) -> Vec<Event> {
        let mut events = Vec::new();
        while let Some(event) = self.engine.poll() {
            if let Some(index) = self.absorb(now, event, &mut events) {
                self.groups[index].settle(now, &mut events);
            }
        }
        for group in self.groups.iter_mut().chain(&mut self.removed) {
            for (_, old) in group.draining.extract_if(.., |(until, _)| *until <= now) {
                events.push(life(&group.vnf.id, &old.node, VnfState::Stopped, None));
                self.engine.stop(old.id);
            }
        }
        self.removed.retain(|group| !group.draining.is_empty());
        for index in 0..self.groups.len() {
            for place in 0..self.groups[index].slots.len() {
                let slot = &mut self.groups[index].slots[place];
                if slot.restart_at.take_if(|at| *at <= now).is_some() {
                    let node = slot.node.clone();
                    self.launch(now, (index, place), node, &mut events);
                }
            }
        }
        events
    }

    /// Returns when [`Vim::poll`] is due without an event of the engine.
    pub fn next_deadline(&self) -> Option<Timestamp> {
        let of_group = |group: &Group| {
            let restarts = group.slots.iter().filter_map(|slot| slot.restart_at);
            restarts.chain(group.draining.iter().map(|(until, _)| *until)).min()
        };
        self.groups.iter().chain(&self.removed).filter_map(of_group).min()
    }

    /// Returns for how long instances have waited for a processor so far.
    pub fn processor_waits(&self) -> Vec<InstanceWaits> {
        self.engine.processor_waits()
    }

    /// Returns what instances with demands have computed so far.
    pub fn computed(&self) -> Vec<VnfComputed> {
        self.engine.computed()
    }

    /// Stops all instances and waits for their ends.
    pub fn shut_down(&mut self) {
        for group in self.groups.iter_mut().chain(&mut self.removed) {
            for slot in &mut group.slots {
                slot.restart_at = None;
                for instance in slot.current.take().into_iter().chain(slot.next.take()) {
                    self.engine.stop(instance.id);
                }
            }
            group.draining.drain(..).for_each(|(_, instance)| self.engine.stop(instance.id));
        }
        self.engine.shut_down();
    }

    /// Reserves room on a node for a VNF outside of this manager.
    ///
    /// # Errors
    /// [`VimError`] if the node has too little room.
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

    /// Releases reserved room, if any.
    pub(crate) fn release(&mut self, vnf: &VnfId) {
        self.reserved.remove(vnf);
    }

    /// Checks whether a VNF fits on a node, besides all others that are there or moving there.
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
            let takes_room = |group: &&Group| !matches!(group.vnf.program, Program::Host(_));
            let groups = self.groups.iter().filter(takes_room);
            let groups = groups.filter(|group| group.vnf.id != *vnf && group.is_on(id));
            let reserved = self.reserved.iter().filter(|(other, (node, ..))| *other != vnf && node == id);
            groups
                .map(|group| (group.vnf.cpus, group.vnf.memory_bytes))
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

    /// Checks whether an accelerator of a node has room for a VNF, besides all others that are there or moving there.
    fn check_accelerator(&self, vnf: &Vnf, id: &NodeId) -> Result<(), VimError> {
        let needed = vnf.accelerator_bytes();
        if needed == 0 {
            return Ok(());
        }
        let no_room = |free: String| {
            let needed = format!("{} MB of an accelerator", needed / 1_000_000);
            Err(VimError::NoRoom { vnf: vnf.id.clone(), node: id.clone(), needed, free })
        };
        let accelerators = self.graph.node(id).and_then(|node| node.capacity()?.accelerators);
        let Some(accelerators) = accelerators else { return no_room("no accelerator".to_owned()) };
        let others = self.groups.iter().filter(|group| group.vnf.id != vnf.id && group.is_on(id));
        let taken = accelerators.taken(others.map(|group| group.vnf.accelerator_bytes()));
        let most_free = accelerators.memory_bytes - taken.iter().min().copied().unwrap_or_default();
        match accelerators.place(&taken, needed) {
            Some(_) => Ok(()),
            None => no_room(format!("{} MB", most_free / 1_000_000)),
        }
    }

    fn index(&self, vnf: &VnfId) -> Option<usize> {
        self.groups.binary_search_by(|group| group.vnf.id.cmp(vnf)).ok()
    }

    fn group(&self, vnf: &VnfId) -> Option<&Group> {
        self.index(vnf).map(|index| &self.groups[index])
    }

    /// Starts an instance of a VNF on a node, for one of its slots. It serves once it is ready.
    fn launch(
        &mut self,
        now: Timestamp,
        (index, place): (usize, usize),
        node: NodeId,
        events: &mut Vec<Event>,
    ) {
        let Group { vnf, slots, .. } = &mut self.groups[index];
        let slot = &mut slots[place];
        self.instances += 1;
        let (id, replica) = (InstanceId(self.instances), slot.replica);
        slot.next = Some(Instance { id, node: node.clone(), replica, since: now, ready: false });
        slot.restart_at = None;
        if vnf.program == Program::RobotDriver {
            // The robot's own driver runs in the Robot Middleware, so there is nothing to start.
            self.absorb(now, EngineEvent { instance: id, outcome: Outcome::Ready }, events);
            return;
        }
        let from = slot.current.as_ref().filter(|_| vnf.state.is_some());
        let started = match from {
            Some(Instance { id: from, .. }) => self.engine.migrate(id, *from, vnf, replica, &node),
            None => self.engine.start(id, vnf, replica, &node),
        };
        if let Err(error) = started {
            self.absorb(now, EngineEvent { instance: id, outcome: Outcome::Failed(error) }, events);
        }
    }

    /// Handles an event of the engine. Returns the index of its VNF, whose slots must settle.
    fn absorb(&mut self, now: Timestamp, event: EngineEvent, events: &mut Vec<Event>) -> Option<usize> {
        if let Outcome::Died(_) = event.outcome {
            // A draining instance that died needs no stop.
            let is_other = |(_, i): &(_, Instance)| i.id != event.instance;
            self.groups.iter_mut().chain(&mut self.removed).for_each(|group| group.draining.retain(is_other));
        }
        let is = |i: &Option<Instance>| i.as_ref().is_some_and(|i| i.id == event.instance);
        let in_group =
            |group: &Group| group.slots.iter().position(|slot| is(&slot.current) || is(&slot.next));
        // Ignores the last event of a stopped instance.
        let mut groups = self.groups.iter().enumerate();
        let (index, place) = groups.find_map(|(index, group)| Some((index, in_group(group)?)))?;
        let group = &mut self.groups[index];
        let (vnf, slot) = (group.vnf.id.clone(), &mut group.slots[place]);
        let life = |node: &NodeId, state, detail| life(&vnf, node, state, detail);
        match event.outcome {
            Outcome::Ready => {
                let mut ready = slot.next.take()?;
                ready.ready = true;
                events.push(life(&ready.node, VnfState::Started, None));
                group.switch(now, place, ready);
            }
            Outcome::Died(detail) | Outcome::Failed(detail) if is(&slot.current) => {
                let died = slot.current.take()?;
                slot.backoff.ran(now.since(died.since));
                events.push(life(&died.node, VnfState::Died, Some(detail)));
                // Restarts it unless a starting instance replaces it.
                if slot.next.is_none() && !slot.is_leaving {
                    slot.restart(now);
                }
            }
            Outcome::Died(detail) | Outcome::Failed(detail) => {
                let failed = slot.next.take()?;
                if slot.backoff.is_first() {
                    tracing::warn!("VNF `{vnf}` does not start on `{}`: {detail}", failed.node);
                }
                events.push(life(&failed.node, VnfState::Failed, Some(detail)));
                // A failed move leaves the old instance in service. A failed start is retried.
                if slot.current.is_none() {
                    slot.restart(now);
                }
            }
        }
        Some(index)
    }
}

#[cfg(test)]
mod tests;
