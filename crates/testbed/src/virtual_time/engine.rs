//! VNFs in virtual time. Bundled ones are parts of the simulation. Others do not run: datagrams to them are lost, and
//! nothing answers. An instance is ready some time after its start. A bundled one answers at once, after the delay of its
//! image, or once its node's CPUs computed the answer. One that takes over a state is ready once that has come, too.

use std::{
    collections::{BTreeMap, VecDeque},
    sync::Arc,
    time::Duration,
};

use cotorra_brain::NavigationVnf;
use cotorra_engine::{Engine, EngineEvent, InstanceId, Outcome};
use cotorra_graph::{NodeId, Program, Stamped, StateTransfer, Testbed, Timestamp, Vnf, VnfId};
use cotorra_plugin::wire;
use cotorra_vnfs::{LocalizationVnf, NotLocalized};
use parking_lot::Mutex;

use super::{
    accelerators::{AllAccelerators, InferredSoFar},
    computers::{Answer, Computers},
    interference::Held,
    migrations::{Change, Migrated, Migrations, Placed},
};
use crate::{computed::ComputedSoFar, followed::PolicyFollowed, parcel::Parcels};

/// The state of a bundled VNF.
#[derive(Clone)]
enum Bundled {
    Navigation(NavigationVnf),
    Localization(Box<LocalizationVnf>),
    /// Parts of observations. Its answers come from an accelerator.
    PolicyServer(Parcels),
}

impl Bundled {
    /// Writes the answer to a datagram; returns false if there is none.
    fn answer(&mut self, datagram: &[u8], answer: &mut Vec<u8>) -> bool {
        match self {
            Self::Navigation(vnf) => vnf.answer(datagram, answer).is_ok(),
            Self::Localization(vnf) => vnf.answer(datagram, answer).is_ok(),
            Self::PolicyServer(parcels) => {
                answer.extend(datagram);
                parcels.receive(datagram).is_some()
            }
        }
    }
}

/// The way in which an instance answers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Mood {
    /// Answers at once.
    #[default]
    Prompt,
    /// Answers after this delay.
    Slow(Duration),
    /// Never answers.
    Hung,
}

/// What the answers of an instance take time of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Takes {
    Nothing,
    Cpus,
    Accelerator,
}

struct Instance {
    id: InstanceId,
    vnf: VnfId,
    /// Its port and its program; `None` for a program of others, which does not run.
    bundled: Option<(u16, Bundled)>,
    /// Time from a request to its answer.
    processing: Duration,
    /// What its answers take time of.
    takes: Takes,
    mood: Mood,
    /// Time from which it can serve.
    serves_at: Timestamp,
    is_ready: bool,
    /// Whether its state is leaving, so that it does not answer.
    is_paused: bool,
}

#[derive(Default)]
struct Instances {
    /// By node, in the order of their start.
    by_node: BTreeMap<NodeId, Vec<Instance>>,
    happened: VecDeque<EngineEvent>,
    /// Time of the present step.
    now: Timestamp,
    /// Nodes whose instances answer so much later.
    slow: BTreeMap<NodeId, Duration>,
    /// Whether started instances stay unready until this ends.
    starts_held: bool,
    computers: Computers,
    accelerators: AllAccelerators,
    migrations: Migrations,
}

impl Instances {
    fn all(&mut self) -> impl Iterator<Item = &mut Instance> {
        self.by_node.values_mut().flatten()
    }

    /// Removes all instances that `is_removed` selects, and returns them. Requests that they compute are lost.
    fn remove(&mut self, mut is_removed: impl FnMut(&NodeId, &Instance) -> bool) -> Vec<InstanceId> {
        let mut removed = Vec::new();
        for (node, here) in &mut self.by_node {
            removed.extend(here.extract_if(.., |instance| is_removed(node, instance)).map(|its| its.id));
        }
        for id in &removed {
            self.computers.stop(self.now, *id);
            self.accelerators.stop(self.now, *id);
            if let Some(former) = self.migrations.ended(self.now, *id) {
                self.set_paused(former, false);
            }
        }
        removed
    }

    fn tell(&mut self, instance: InstanceId, outcome: Outcome) {
        self.happened.push_back(EngineEvent { instance, outcome });
    }

    /// Makes the instances ready that can serve by now, in the order of their times and then of their starts.
    fn make_ready(&mut self) {
        if self.starts_held {
            return;
        }
        let now = self.now;
        let is_due = |instance: &Instance| !instance.is_ready && instance.serves_at <= now;
        for started in self.by_node.values().flatten().filter(|instance| is_due(instance)) {
            self.migrations.started(now, started.id);
        }
        self.follow_migrations();
        let mut ready = Vec::new();
        let due = self.by_node.values_mut().flatten().filter(|instance| is_due(instance));
        for due in due.filter(|instance| !self.migrations.holds(instance.id)) {
            due.is_ready = true;
            ready.push((due.serves_at, due.id));
        }
        ready.sort_unstable();
        ready.into_iter().for_each(|(_, instance)| self.tell(instance, Outcome::Ready));
    }

    fn find(&mut self, id: InstanceId) -> Option<&mut Instance> {
        self.all().find(|instance| instance.id == id)
    }

    /// Begins to copy a state from a former instance, if that runs, to a new one.
    fn migrate(&mut self, vnf: &Vnf, state: StateTransfer, former: InstanceId, new: Placed<'_>) {
        let is_there = |(_, here): &(&NodeId, &Vec<Instance>)| here.iter().any(|its| its.id == former);
        if let Some((node, _)) = self.by_node.iter().find(is_there) {
            self.migrations.begin(self.now, &vnf.id, state, Placed { id: former, node }, new);
            self.follow_migrations();
        }
    }

    /// Sets whether an instance is paused. One that is loses its requests.
    fn set_paused(&mut self, id: InstanceId, paused: bool) {
        let Some(instance) = self.find(id) else { return };
        instance.is_paused = paused;
        if paused {
            self.computers.pause(self.now, id);
        } else {
            self.computers.resume(self.now, id);
        }
    }

    /// Does what migrations bring.
    fn follow_migrations(&mut self) {
        while let Some(change) = self.migrations.poll(self.now) {
            match change {
                Change::Stop(former) => self.set_paused(former, true),
                Change::HandOver(former, new) => {
                    let state = self.find(former).and_then(|former| former.bundled.clone());
                    if let (Some(new), Some(state)) = (self.find(new), state) {
                        new.bundled = Some(state);
                    }
                }
            }
        }
    }
}

/// The VNFs that serve on each node.
#[derive(Clone, Default)]
pub struct Serving(Arc<Mutex<Instances>>);

impl Serving {
    /// Writes the answer of a node's VNFs to a datagram into the payload, which the port `from` sends. Returns it with its
    /// delay, unless it has to be computed or inferred, or there is none.
    pub(super) fn answer(&self, node: &NodeId, datagram: &[u8], mut held: Held) -> Option<Answer> {
        let mut all = self.0.lock();
        let all = &mut *all;
        let slow = all.slow.get(node).copied().unwrap_or_default();
        let here = all.by_node.get_mut(node).into_iter().flatten();
        let mut here = here.filter(|instance| instance.is_ready && !instance.is_paused);
        let (takes, id, later) = here.find_map(|instance| {
            let (_, program) = instance.bundled.as_mut().filter(|(its, _)| *its == held.from.1)?;
            let later = match instance.mood {
                Mood::Prompt => Duration::ZERO,
                Mood::Slow(later) => later,
                Mood::Hung => return None,
            };
            let answers = program.answer(datagram, &mut held.payload);
            answers.then_some((instance.takes, instance.id, later + instance.processing + slow))
        })?;
        let answer = Answer { held, later };
        match takes {
            Takes::Nothing => return Some(answer),
            Takes::Cpus => all.computers.arrive(all.now, id, datagram.len(), answer),
            Takes::Accelerator => all.accelerators.arrive(all.now, id, answer),
        }
        None
    }

    /// Returns the next answer that is computed or inferred.
    pub(super) fn poll(&self) -> Option<Answer> {
        let mut all = self.0.lock();
        let now = all.now;
        all.computers.poll(now).or_else(|| all.accelerators.poll(now))
    }

    /// Returns the contexts of servers, if they are due.
    pub(super) fn contexts(&self) -> Vec<Stamped> {
        let mut all = self.0.lock();
        let now = all.now;
        all.computers.contexts(now)
    }

    /// Returns what VNFs with demands computed so far.
    pub(super) fn computed(&self) -> ComputedSoFar {
        let all = self.0.lock();
        all.computers.computed(all.now)
    }

    /// Returns what models did so far, beside what robots followed.
    pub(super) fn inferred(&self, policies: Vec<PolicyFollowed>) -> InferredSoFar {
        self.0.lock().accelerators.inferred(policies)
    }

    /// Replaces `frame` by the next frame of a state that moves, and returns the place of the host that sends it.
    pub(super) fn poll_frame(&self, now: Timestamp, frame: &mut Vec<u8>) -> Option<usize> {
        self.0.lock().migrations.poll_frame(now, frame)
    }

    /// Takes a frame that arrives at a host. Returns whether it is one of a state that moves.
    pub(super) fn handle(&self, now: Timestamp, host: usize, frame: &[u8]) -> bool {
        let mut all = self.0.lock();
        let is_its = all.migrations.handle(now, host, frame);
        if is_its {
            all.follow_migrations();
        }
        is_its
    }

    /// Returns all migrations until now.
    pub(super) fn migrated(&self) -> Vec<Migrated> {
        let all = self.0.lock();
        all.migrations.migrated(all.now)
    }
}

impl Serving {
    /// Goes on to the time of the next step, and makes the instances ready that can serve by then.
    pub(super) fn advance(&self, now: Timestamp) {
        let mut all = self.0.lock();
        all.now = now;
        all.make_ready();
    }

    /// Returns when the next instance can serve, the next answer is computed, or a state that moves has a frame to send.
    pub(super) fn next_deadline(&self) -> Option<Timestamp> {
        let all = self.0.lock();
        let computed = [all.computers.next_deadline(), all.accelerators.next_deadline()];
        let others = computed.into_iter().flatten().chain(all.migrations.next_deadline(all.now));
        if all.starts_held {
            return others.min();
        }
        let instances = all.by_node.values().flatten();
        let starting = instances.filter(|instance| !instance.is_ready && !all.migrations.awaits(instance.id));
        starting.map(|instance| instance.serves_at).chain(others).min()
    }

    /// Lets the instances on these nodes answer later.
    pub(super) fn slow_down(&self, slow: BTreeMap<NodeId, Duration>) {
        self.0.lock().slow = slow;
    }
}

/// Faults of instances.
impl Serving {
    /// Kills all instances of a VNF.
    pub fn kill(&self, vnf: &VnfId) {
        let mut all = self.0.lock();
        let killed = all.remove(|_, instance| instance.vnf == *vnf);
        killed.into_iter().for_each(|instance| all.tell(instance, Outcome::Died("killed".to_owned())));
    }

    /// Kills the instance of a VNF on a node.
    #[cfg(test)]
    pub(crate) fn kill_on(&self, vnf: &VnfId, node: &NodeId) {
        let mut all = self.0.lock();
        let killed = all.remove(|its, instance| its == node && instance.vnf == *vnf);
        killed.into_iter().for_each(|instance| all.tell(instance, Outcome::Died("killed".to_owned())));
    }

    /// Sets how all instances of a VNF answer from now on.
    pub fn set_mood(&self, vnf: &VnfId, mood: Mood) {
        self.0.lock().all().filter(|i| i.vnf == *vnf).for_each(|instance| instance.mood = mood);
    }

    /// Keeps instances that are started unready, until this is called with `false`.
    pub fn hold_starts(&self, held: bool) {
        let mut all = self.0.lock();
        all.starts_held = held;
        all.make_ready();
    }

    /// Returns the running instances, ready or not.
    pub fn running(&self) -> Vec<InstanceId> {
        let mut running: Vec<_> = self.0.lock().all().map(|instance| instance.id).collect();
        running.sort_unstable();
        running
    }
}

/// Runs bundled VNFs as parts of the simulation. An instance is ready at once, or after the start of its image.
pub(crate) struct VirtualEngine {
    /// The port of an instance, and its initial state, by VNF.
    planned: BTreeMap<VnfId, (u16, Bundled)>,
    serving: Serving,
}

impl VirtualEngine {
    /// Plans all walks, and prepares the map.
    pub(crate) fn new(testbed: &Testbed, seed: u64, serving: Serving) -> Result<Self, NotLocalized> {
        let mut all = serving.0.lock();
        (all.computers, all.migrations) = (Computers::new(testbed, seed), Migrations::new(testbed));
        all.accelerators = AllAccelerators::new(testbed);
        drop(all);
        let navigations = NavigationVnf::of_all(testbed);
        let localizations = LocalizationVnf::of_all(testbed, seed)?;
        let planned = testbed.services.iter().flat_map(|service| {
            let (navigations, localizations) = (&navigations, &localizations);
            service.vnfs.iter().filter_map(move |vnf| {
                let bundled = match vnf.program {
                    Program::Navigation => Bundled::Navigation(navigations.get(&service.robot)?.clone()),
                    Program::Localization => {
                        Bundled::Localization(Box::new(localizations.get(&service.robot)?.clone()))
                    }
                    Program::PolicyServer(_) => Bundled::PolicyServer(Parcels::default()),
                    // A robot in ROS is rejected before.
                    Program::Command(_)
                    | Program::Host(_)
                    | Program::RobotDriver
                    | Program::RosNavigation => return None,
                };
                Some((vnf.id.clone(), (wire::port(testbed, &vnf.id)?, bundled)))
            })
        });
        Ok(Self { planned: planned.collect(), serving })
    }
}

impl VirtualEngine {
    /// Starts an instance, which takes over the state of a former one if it has one.
    fn launch(
        &mut self,
        id: InstanceId,
        former: Option<InstanceId>,
        vnf: &Vnf,
        replica: u32,
        node: &NodeId,
    ) -> Result<(), String> {
        let bundled = match vnf.program {
            Program::Command(_) | Program::Host(_) => None,
            _ => Some(self.planned.get(&vnf.id).ok_or("its robot has no walk, or no map")?.clone()),
        };
        let processing = vnf.image.as_ref().map_or(Duration::ZERO, |image| image.processing);
        let mut all = self.serving.0.lock();
        let now = all.now;
        let serves_at = now + vnf.start_time();
        all.computers.start(now, id, vnf, replica, node)?;
        all.accelerators.start(now, id, vnf, node)?;
        let takes = match vnf.policy_server() {
            Some(_) => Takes::Accelerator,
            None if all.computers.compute(&vnf.id) => Takes::Cpus,
            None => Takes::Nothing,
        };
        all.by_node.entry(node.clone()).or_default().push(Instance {
            id,
            vnf: vnf.id.clone(),
            bundled,
            processing,
            takes,
            mood: Mood::default(),
            serves_at,
            is_ready: false,
            is_paused: false,
        });
        if let Some((former, state)) = former.zip(vnf.state.as_deref()) {
            all.migrate(vnf, *state, former, Placed { id, node });
        }
        all.make_ready();
        Ok(())
    }
}

impl Engine for VirtualEngine {
    fn start(&mut self, id: InstanceId, vnf: &Vnf, replica: u32, node: &NodeId) -> Result<(), String> {
        self.launch(id, None, vnf, replica, node)
    }

    fn migrate(
        &mut self,
        id: InstanceId,
        from: InstanceId,
        vnf: &Vnf,
        replica: u32,
        node: &NodeId,
    ) -> Result<(), String> {
        self.launch(id, Some(from), vnf, replica, node)
    }

    fn stop(&mut self, id: InstanceId) {
        self.serving.0.lock().remove(|_, instance| instance.id == id);
    }

    fn poll(&mut self) -> Option<EngineEvent> {
        self.serving.0.lock().happened.pop_front()
    }

    fn shut_down(&mut self) {
        self.serving.0.lock().remove(|_, _| true);
    }
}
