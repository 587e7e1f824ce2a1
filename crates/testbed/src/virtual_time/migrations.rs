//! Moves of VNFs with their state in virtual time: the state crosses the emulated network.

use std::{collections::BTreeMap, time::Duration};

use cotorra_computing::{Migration, MigrationFigures};
use cotorra_engine::InstanceId;
use cotorra_graph::{NodeId, StateTransfer, Testbed, Timestamp, VnfId};
use cotorra_traffic::{Copies, CopyId};

/// The end of a migration.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum MigrationOutcome {
    /// The new instance serves with the state.
    Done,
    /// An instance ended, or the VNF moved elsewhere.
    Abandoned,
    /// None until now.
    Running,
}

/// A migration of a run.
#[derive(Debug, Clone)]
pub(crate) struct Migrated {
    pub(crate) vnf: VnfId,
    pub(crate) from: NodeId,
    pub(crate) to: NodeId,
    pub(crate) at: Timestamp,
    pub(crate) outcome: MigrationOutcome,
    /// Bytes of its state that have arrived.
    pub(crate) bytes: u64,
    pub(crate) rounds: u32,
    pub(crate) duration: Duration,
    pub(crate) downtime: Duration,
}

/// An instance of a VNF on a node.
pub(super) struct Placed<'a> {
    pub(super) id: InstanceId,
    pub(super) node: &'a NodeId,
}

/// A change that a migration brings.
pub(super) enum Change {
    /// This instance stops serving.
    Stop(InstanceId),
    /// The first instance's state is at the second, which serves from now on.
    HandOver(InstanceId, InstanceId),
}

struct Running {
    vnf: VnfId,
    former: InstanceId,
    from: NodeId,
    to: NodeId,
    at: Timestamp,
    migration: Migration,
    copy: CopyId,
    /// Whether it was said that the former instance stops.
    stop_told: bool,
}

/// All migrations of a run.
#[derive(Default)]
pub(super) struct Migrations {
    /// Places of hosts in the network.
    places: BTreeMap<NodeId, usize>,
    copies: Copies,
    /// By the new instance.
    running: BTreeMap<InstanceId, Running>,
    ended: Vec<Migrated>,
}

impl Running {
    fn migrated(&self, now: Timestamp, outcome: MigrationOutcome, bytes: u64) -> Migrated {
        let MigrationFigures { rounds, duration, downtime } = self.migration.figures(now);
        let (vnf, from, to, at) = (self.vnf.clone(), self.from.clone(), self.to.clone(), self.at);
        Migrated { vnf, from, to, at, outcome, bytes, rounds, duration, downtime }
    }
}

impl Migrations {
    pub(super) fn new(testbed: &Testbed) -> Self {
        let places = testbed.graph.hosts().enumerate().map(|(place, node)| (node.id.clone(), place));
        Self { places: places.collect(), ..Self::default() }
    }

    /// Begins to copy the state of an instance to a new one. That one starts without if thousands of others are copied.
    pub(super) fn begin(
        &mut self,
        now: Timestamp,
        vnf: &VnfId,
        state: StateTransfer,
        former: Placed<'_>,
        new: Placed<'_>,
    ) {
        let places = self.places.get(former.node).zip(self.places.get(new.node));
        let Some((&from, &to)) = places else { return };
        let Some(copy) = self.copies.begin(from, to) else { return };
        let (from, to) = (former.node.clone(), new.node.clone());
        let migration = Migration::new(now, state);
        let running = Running {
            vnf: vnf.clone(),
            former: former.id,
            from,
            to,
            at: now,
            migration,
            copy,
            stop_told: false,
        };
        self.running.insert(new.id, running);
        self.go_on(new.id);
    }

    /// Whether a new instance waits for its state, and nothing else.
    pub(super) fn awaits(&self, new: InstanceId) -> bool {
        self.running.get(&new).is_some_and(|its| its.migration.has_started())
    }

    /// Whether a new instance must not serve yet.
    pub(super) fn holds(&self, new: InstanceId) -> bool {
        self.running.contains_key(&new)
    }

    /// Takes that a new instance has started, if it is one of a migration.
    pub(super) fn started(&mut self, now: Timestamp, new: InstanceId) {
        let running = self.running.get_mut(&new).filter(|its| !its.migration.has_started());
        if let Some(running) = running {
            running.migration.started(now);
            self.go_on(new);
        }
    }

    /// Abandons the migrations of an instance that ended. Returns the former instance that goes on, if it had stopped.
    pub(super) fn ended(&mut self, now: Timestamp, instance: InstanceId) -> Option<InstanceId> {
        let is_its = |new: &InstanceId, its: &mut Running| *new == instance || its.former == instance;
        let mut goes_on = None;
        for (new, running) in self.running.extract_if(.., is_its) {
            let bytes = self.copies.arrived(running.copy);
            self.copies.end(running.copy);
            goes_on = (new == instance && running.stop_told).then_some(running.former);
            self.ended.push(running.migrated(now, MigrationOutcome::Abandoned, bytes));
        }
        goes_on
    }

    /// Returns the next change.
    pub(super) fn poll(&mut self, now: Timestamp) -> Option<Change> {
        let stops = |its: &&mut Running| its.migration.has_stopped() && !its.stop_told;
        if let Some(running) = self.running.values_mut().find(stops) {
            running.stop_told = true;
            return Some(Change::Stop(running.former));
        }
        let (new, running) = self.running.extract_if(.., |_, its| its.migration.is_done()).next()?;
        let bytes = self.copies.arrived(running.copy);
        self.copies.end(running.copy);
        self.ended.push(running.migrated(now, MigrationOutcome::Done, bytes));
        Some(Change::HandOver(running.former, new))
    }

    /// Replaces `frame` by the next frame of a state, and returns the place of the host that sends it.
    pub(super) fn poll_frame(&mut self, now: Timestamp, frame: &mut Vec<u8>) -> Option<usize> {
        self.copies.poll(now, frame)
    }

    /// Takes a frame that arrives at a host. Returns whether it is one of a state.
    pub(super) fn handle(&mut self, now: Timestamp, host: usize, frame: &[u8]) -> bool {
        let Some(copy) = self.copies.handle(now, host, frame) else { return false };
        let found = self.running.iter_mut().find(|(_, its)| its.copy == copy);
        if let Some((new, running)) = found.filter(|_| self.copies.has_arrived(copy)) {
            let new = *new;
            running.migration.copied(now);
            self.go_on(new);
        }
        true
    }

    pub(super) fn next_deadline(&self, now: Timestamp) -> Option<Timestamp> {
        self.copies.deadline(now)
    }

    /// Returns all migrations until now, in the order of their begins.
    pub(super) fn migrated(&self, now: Timestamp) -> Vec<Migrated> {
        let running = self.running.values();
        let running =
            running.map(|its| its.migrated(now, MigrationOutcome::Running, self.copies.arrived(its.copy)));
        let mut all: Vec<_> = self.ended.iter().cloned().chain(running).collect();
        all.sort_by(|a, b| (a.at, &a.vnf).cmp(&(b.at, &b.vnf)));
        all
    }

    /// Begins the next copy of a migration, if there is one.
    fn go_on(&mut self, new: InstanceId) {
        if let Some(running) = self.running.get_mut(&new)
            && let Some(bytes) = running.migration.poll()
        {
            self.copies.add(running.copy, bytes);
        }
    }
}
