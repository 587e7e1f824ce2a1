//! The catalog of descriptors and the instances of applications, as a state machine. It says which instruction adds, places or
//! removes a VNF, and gets the outcome.

use std::collections::{BTreeMap, BTreeSet};

use cotorra_graph::{DomainId, Instruction, NodeId, Nodes, Timestamp, VnfId};
use cotorra_mec::Epoch;

use crate::{
    application::{Application, Output, Seen, Stage, sees, share},
    descriptor::{Descriptor, variables},
    error::{LifecycleError, conflict},
    network::Network,
    operation::{Occurrence, Operation, OperationState, State},
    subscriptions::Subscriptions,
};

/// The most descriptors of the operator in the catalog.
const MOST_DESCRIPTORS: usize = 256;
/// The most instances of the operator, in all stages.
const MOST_INSTANCES: usize = 256;
/// The most occurrences of the operator's operations that are kept. The oldest are dropped.
const MOST_OCCURRENCES: usize = 1024;

#[derive(Debug)]
pub(crate) struct Known {
    pub(crate) owner: Option<DomainId>,
    pub(crate) descriptor: Descriptor,
    /// The VNF of a service that it describes; `None` for an application, each of whose instances is a VNF that is added.
    pub(crate) of_service: Option<VnfId>,
}

/// The catalog and the instances. A viewer is a domain, or `None` for the operator, who sees everything. Domains see their own.
#[derive(Debug, Default)]
pub struct Applications {
    pub(crate) catalog: BTreeMap<String, Known>,
    pub(crate) networks: BTreeMap<String, Network>,
    pub(crate) instances: BTreeMap<String, Application>,
    /// The last nodes that the VNFs of instances were placed on.
    pub(crate) wanted: BTreeMap<VnfId, Nodes>,
    occurrences: BTreeMap<u64, (Option<DomainId>, Occurrence)>,
    subscriptions: Subscriptions,
    epoch: Epoch,
    /// Number of identifiers made so far.
    made: u64,
    /// Number of instances of services' VNFs found so far.
    pub(crate) found: u64,
}

impl Applications {
    /// Creates an empty catalog in a run that began then.
    pub fn new(epoch: Epoch) -> Self {
        Self { epoch, ..Self::default() }
    }

    /// Makes an identifier. It has the form of a UUID, is unique in a run, and the same whenever the run is repeated.
    fn make_id(&mut self) -> String {
        self.made += 1;
        format!("c0704a00-0000-4000-8000-{:012x}", self.made)
    }

    /// Adds a descriptor to the catalog. Returns its identifier there.
    ///
    /// # Errors
    /// [`LifecycleError`] if the identifier is taken, or the catalog is full.
    pub fn onboard(
        &mut self,
        viewer: Option<&DomainId>,
        descriptor: Descriptor,
    ) -> Result<String, LifecycleError> {
        let is_own = |known: &&Known| known.owner.as_ref() == viewer && known.of_service.is_none();
        let (own, most) = (self.catalog.values().filter(is_own).count(), share(viewer, MOST_DESCRIPTORS));
        if own >= most {
            return conflict(format!("the catalog has {most} of your descriptors already: remove one"));
        }
        let id = match &descriptor.uuid {
            Some(id) if self.catalog.contains_key(id) => {
                return conflict(format!("there is a descriptor `{id}` already"));
            }
            Some(id) => id.clone(),
            None => self.make_id(),
        };
        let known = Known { owner: viewer.cloned(), descriptor, of_service: None };
        self.catalog.insert(id.clone(), known);
        Ok(id)
    }

    /// Adds the descriptor of a service's VNF to the catalog. It stays there.
    pub(crate) fn add_known(&mut self, owner: Option<DomainId>, descriptor: Descriptor, vnf: &VnfId) {
        let known = Known { owner, descriptor, of_service: Some(vnf.clone()) };
        self.catalog.insert(vnf.to_string(), known);
    }

    /// Returns the catalog: identifiers and descriptors.
    pub fn catalog(&self, viewer: Option<&DomainId>) -> impl Iterator<Item = (&str, &Descriptor)> {
        let seen = self.catalog.iter().filter(move |(_, known)| sees(viewer, known.owner.as_ref()));
        seen.map(|(id, known)| (id.as_str(), &known.descriptor))
    }

    /// Returns the identifier and the descriptor that are named by an identifier of the catalog, or by the descriptor's own
    /// name if only one has it.
    ///
    /// # Errors
    /// [`LifecycleError::Unknown`].
    pub fn descriptor(
        &self,
        viewer: Option<&DomainId>,
        name: &str,
    ) -> Result<(&str, &Descriptor), LifecycleError> {
        let by_id = self.catalog(viewer).find(|(id, _)| *id == name);
        let mut by_name = self.catalog(viewer).filter(|(_, descriptor)| descriptor.id == name);
        let only = || by_name.next().filter(|_| by_name.next().is_none());
        by_id.or_else(only).ok_or_else(|| LifecycleError::Unknown("descriptor", name.to_owned()))
    }

    /// Removes a descriptor without instances from the catalog.
    ///
    /// # Errors
    /// [`LifecycleError`].
    pub fn offload(&mut self, viewer: Option<&DomainId>, name: &str) -> Result<String, LifecycleError> {
        let id = self.descriptor(viewer, name)?.0.to_owned();
        if self.catalog[&id].of_service.is_some() {
            return conflict(format!("the descriptor `{id}` is of a VNF of the testbed file, and stays"));
        }
        if let Some(instance) = self.instances.values().find(|instance| instance.descriptor == id) {
            return conflict(format!(
                "the descriptor `{id}` has the instance `{}`: remove that first",
                instance.id
            ));
        }
        self.catalog.remove(&id);
        Ok(id)
    }

    /// Defines an instance of a descriptor, on a node or without one so far.
    ///
    /// # Errors
    /// [`LifecycleError`].
    pub fn define(
        &mut self,
        viewer: Option<&DomainId>,
        descriptor: &str,
        node: Option<NodeId>,
        [name, description]: [Option<String>; 2],
    ) -> Result<&Application, LifecycleError> {
        let (descriptor, of) = self.descriptor(viewer, descriptor)?;
        if let Some(network) = &of.network {
            self.network(viewer, network)?;
        }
        let descriptor = descriptor.to_owned();
        self.check_room(viewer)?;
        let (id, owner) = (self.make_id(), viewer.cloned());
        let stage = Stage::Defined;
        let instance = Application {
            id: id.clone(),
            descriptor,
            name,
            description,
            node,
            stage,
            owner,
            output: None,
            is_busy: false,
            is_found: false,
        };
        Ok(self.instances.entry(id).or_insert(instance))
    }

    /// Rejects a further instance if an owner has as many as they may have. Those that were found are not theirs.
    fn check_room(&self, owner: Option<&DomainId>) -> Result<(), LifecycleError> {
        let own = self.instances.values().filter(|one| one.owner.as_ref() == owner && !one.is_found).count();
        let most = share(owner, MOST_INSTANCES);
        if own >= most {
            return conflict(format!("there are {most} of your instances already: remove one"));
        }
        Ok(())
    }

    /// Returns the instances.
    pub fn instances(&self, viewer: Option<&DomainId>) -> impl Iterator<Item = &Application> {
        self.instances.values().filter(move |instance| sees(viewer, instance.owner.as_ref()))
    }

    /// Returns an instance.
    ///
    /// # Errors
    /// [`LifecycleError::Unknown`].
    pub fn instance(&self, viewer: Option<&DomainId>, id: &str) -> Result<&Application, LifecycleError> {
        let found = self.instances.get(id).filter(|instance| sees(viewer, instance.owner.as_ref()));
        found.ok_or_else(|| LifecycleError::Unknown("instance", id.to_owned()))
    }

    /// Returns an instance without an operation under way.
    fn idle(&mut self, viewer: Option<&DomainId>, id: &str) -> Result<&mut Application, LifecycleError> {
        if self.instance(viewer, id)?.is_busy {
            return conflict(format!("another operation of the instance `{id}` is under way"));
        }
        Ok(self.instances.get_mut(id).expect("it was just found"))
    }

    /// Makes a defined instance one that can be started.
    ///
    /// # Errors
    /// [`LifecycleError`].
    pub fn configure(
        &mut self,
        viewer: Option<&DomainId>,
        id: &str,
        now: Timestamp,
    ) -> Result<(), LifecycleError> {
        match self.idle(viewer, id)?.stage {
            Stage::Defined => {}
            Stage::Configured => return conflict(format!("the instance `{id}` is configured already")),
            Stage::Started(..) => return conflict(format!("the instance `{id}` runs already")),
        }
        self.change(id, now, |instance| instance.stage = Stage::Configured);
        Ok(())
    }

    /// Makes a configured instance a defined one again.
    ///
    /// # Errors
    /// [`LifecycleError`].
    pub fn clean(
        &mut self,
        viewer: Option<&DomainId>,
        id: &str,
        now: Timestamp,
    ) -> Result<(), LifecycleError> {
        match self.idle(viewer, id)?.stage {
            Stage::Configured => {}
            Stage::Defined => return conflict(format!("the instance `{id}` is not configured")),
            Stage::Started(..) => return conflict(format!("the instance `{id}` runs: stop it first")),
        }
        self.change(id, now, |instance| (instance.stage, instance.output) = (Stage::Defined, None));
        Ok(())
    }

    /// Removes a defined instance.
    ///
    /// # Errors
    /// [`LifecycleError`].
    pub fn undefine(&mut self, viewer: Option<&DomainId>, id: &str) -> Result<(), LifecycleError> {
        match self.idle(viewer, id)?.stage {
            Stage::Defined => {}
            Stage::Configured => {
                return conflict(format!("the instance `{id}` is configured: clean it first"));
            }
            Stage::Started(..) => {
                return conflict(format!("the instance `{id}` runs: stop and clean it first"));
            }
        }
        self.instances.remove(id);
        Ok(())
    }

    /// Begins to start a configured instance, with variables `NAME=VALUE,…`. Returns the instruction to give: add a VNF, or
    /// place a service's VNF on this node, too. Call [`Self::end_start`] with the outcome.
    ///
    /// # Errors
    /// [`LifecycleError`].
    pub fn begin_start(
        &mut self,
        viewer: Option<&DomainId>,
        id: &str,
        env: &str,
    ) -> Result<Instruction, LifecycleError> {
        let env = variables(env)
            .map_err(|part| LifecycleError::Invalid(format!("{part} is no variable: write NAME=VALUE,…")))?;
        let instance = self.idle(viewer, id)?;
        match &instance.stage {
            Stage::Configured => {}
            Stage::Defined => return conflict(format!("the instance `{id}` is not configured")),
            Stage::Started(..) => return conflict(format!("the instance `{id}` runs already")),
        }
        let node = instance.node.clone();
        let node =
            node.ok_or_else(|| LifecycleError::Conflict(format!("the instance `{id}` has no node")))?;
        let known = &self.catalog[&self.instances[id].descriptor];
        let instruction = match &known.of_service {
            Some(_) if !env.is_empty() => {
                let reason = "a VNF of the testbed file has its variables there: start it without any";
                return Err(LifecycleError::Invalid(reason.to_owned()));
            }
            Some(vnf) => self.place_also(vnf, node)?,
            None => {
                self.made += 1;
                let vnf = known.descriptor.vnf(known.descriptor.vnf_name(self.made), node, env);
                Instruction::AddVnf { vnf: Box::new(vnf) }
            }
        };
        self.idle(viewer, id)?.is_busy = true;
        Ok(instruction)
    }

    /// Ends a start, with the VNF if it was added or placed, whose log had so many bytes before.
    pub fn end_start(&mut self, id: &str, started: Option<(VnfId, u64)>, now: Timestamp) {
        let is_of_service = self.is_of_service(id);
        self.change(id, now, |instance| {
            instance.is_busy = false;
            if let Some((vnf, from)) = started {
                // All instances of a service's VNF go on with the logs that they have.
                instance.output = (!is_of_service).then(|| Output { vnf: vnf.clone(), from, to: None });
                instance.stage = Stage::Started(vnf, Seen::Starting);
            }
        });
    }

    /// Returns where the output of an instance's last start is.
    ///
    /// # Errors
    /// [`LifecycleError`] if there is none.
    pub fn output(&self, viewer: Option<&DomainId>, id: &str) -> Result<&Output, LifecycleError> {
        let output = &self.instance(viewer, id)?.output;
        output.as_ref().ok_or_else(|| {
            let reason = match self.is_of_service(id) {
                true => "is of a VNF of the testbed file, whose output is in the run's folder",
                false => "has no output: it was not started, or others removed its VNF",
            };
            LifecycleError::Conflict(format!("the instance `{id}` {reason}"))
        })
    }

    /// Whether an instance is of a service's VNF.
    fn is_of_service(&self, id: &str) -> bool {
        let descriptor = self.instances.get(id).map(|instance| &instance.descriptor);
        descriptor.is_some_and(|descriptor| self.catalog[descriptor].of_service.is_some())
    }

    /// Returns the VNFs of started instances and of services.
    pub fn vnfs(&self) -> BTreeSet<&VnfId> {
        let started = self.instances.values().filter_map(Application::vnf);
        started.chain(self.catalog.values().filter_map(|known| known.of_service.as_ref())).collect()
    }

    /// Returns the started instances of a VNF.
    pub(crate) fn started(&self, vnf: &VnfId) -> impl Iterator<Item = &Application> {
        self.instances.values().filter(move |instance| instance.vnf() == Some(vnf))
    }

    /// Records what is seen of a VNF, on one node or on all. Does nothing if no started instance is there.
    pub fn observe(&mut self, vnf: &VnfId, on: Option<&NodeId>, seen: &Seen, now: Timestamp) {
        let is_there = |instance: &&Application| on.is_none() || instance.node.as_ref() == on;
        let ids: Vec<_> = self.started(vnf).filter(is_there).map(|instance| instance.id.clone()).collect();
        for id in ids {
            self.change(&id, now, |instance| {
                if *seen == Seen::Gone && !instance.is_busy {
                    // Others removed it. Its name is free, and with it the log.
                    instance.output = None;
                }
                instance.stage = Stage::Started(vnf.clone(), seen.clone());
            });
        }
    }

    /// Changes an instance, and notifies those who subscribed to changes of its state.
    pub(crate) fn change(&mut self, id: &str, now: Timestamp, change: impl FnOnce(&mut Application)) {
        let Some(instance) = self.instances.get_mut(id) else { return };
        let before = State::of(instance);
        change(instance);
        if State::of(instance) != before {
            let of = &self.catalog[&instance.descriptor].descriptor;
            self.subscriptions.tell_instance(instance, of, self.epoch.at(now));
        }
    }

    /// Returns the subscriptions to changes.
    pub fn subscriptions(&mut self) -> &mut Subscriptions {
        &mut self.subscriptions
    }

    /// Begins to stop a started instance. Returns the instruction to give: place its VNF on the nodes of its other instances,
    /// or remove it with the last one. There is none if others removed it already. Call [`Self::end_stop`] with the outcome.
    ///
    /// # Errors
    /// [`LifecycleError`].
    pub fn begin_stop(
        &mut self,
        viewer: Option<&DomainId>,
        id: &str,
    ) -> Result<Option<Instruction>, LifecycleError> {
        let (vnf, seen) = self.running(viewer, id)?;
        if self.instances[id].is_found {
            // It is the owner's from now on.
            self.check_room(self.instances[id].owner.as_ref())?;
        }
        let instruction = (seen != Seen::Gone).then(|| self.place_elsewhere(&vnf, id, None)).transpose()?;
        self.idle(viewer, id)?.is_busy = true;
        Ok(instruction)
    }

    /// Ends a stop. If it was done, the VNF's log has so many bytes now.
    pub fn end_stop(&mut self, id: &str, removed: Option<u64>, now: Timestamp) {
        self.change(id, now, |instance| {
            instance.is_busy = false;
            if let Some(to) = removed {
                if let Some(output) = &mut instance.output {
                    output.to = Some(to);
                }
                (instance.stage, instance.is_found) = (Stage::Configured, false);
            }
        });
    }

    /// Begins to move a started instance. Returns the instruction to give: place its VNF on that node in place of the
    /// instance's. Call [`Self::end_move`] afterwards. The instance has the node as soon as it serves there.
    ///
    /// # Errors
    /// [`LifecycleError`].
    pub fn begin_move(
        &mut self,
        viewer: Option<&DomainId>,
        id: &str,
        to: NodeId,
    ) -> Result<Instruction, LifecycleError> {
        let (vnf, _) = self.running(viewer, id)?;
        let instruction = self.place_elsewhere(&vnf, id, Some(to))?;
        self.idle(viewer, id)?.is_busy = true;
        Ok(instruction)
    }

    /// Ends a move, whatever its outcome.
    pub fn end_move(&mut self, id: &str) {
        if let Some(instance) = self.instances.get_mut(id) {
            instance.is_busy = false;
        }
    }

    /// Returns the VNF of a started instance without an operation under way.
    fn running(&mut self, viewer: Option<&DomainId>, id: &str) -> Result<(VnfId, Seen), LifecycleError> {
        match &self.idle(viewer, id)?.stage {
            Stage::Started(vnf, seen) => Ok((vnf.clone(), seen.clone())),
            Stage::Defined | Stage::Configured => conflict(format!("the instance `{id}` does not run")),
        }
    }

    /// Gives a defined instance its node, and configures it, in the one step of MEC.
    ///
    /// # Errors
    /// [`LifecycleError`].
    pub(crate) fn settle(
        &mut self,
        viewer: Option<&DomainId>,
        id: &str,
        node: NodeId,
        now: Timestamp,
    ) -> Result<(), LifecycleError> {
        if self.idle(viewer, id)?.stage != Stage::Defined {
            return conflict(format!("the application instance `{id}` is instantiated already"));
        }
        self.change(id, now, |instance| (instance.node, instance.stage) = (Some(node), Stage::Configured));
        Ok(())
    }

    /// Takes an instance back to where it has no node, after a failed instantiation or a termination.
    pub(crate) fn unsettle(&mut self, id: &str, now: Timestamp) {
        self.change(id, now, |instance| {
            if !matches!(instance.stage, Stage::Started(..)) {
                (instance.node, instance.stage, instance.output) = (None, Stage::Defined, None);
            }
        });
    }

    /// Records the begin of an instance's operation. Returns its number.
    pub(crate) fn record(&mut self, id: &str, operation: Operation, now: Timestamp) -> u64 {
        self.made += 1;
        let owner = self.instances.get(id).and_then(|instance| instance.owner.clone());
        let of_owner = self.occurrences.iter().filter(|(_, (of, _))| *of == owner).map(|(number, _)| *number);
        let (mut oldest, own) = (of_owner.clone(), of_owner.count());
        if let Some(oldest) = oldest.next().filter(|_| own >= share(owner.as_ref(), MOST_OCCURRENCES)) {
            self.occurrences.remove(&oldest);
        }
        self.occurrences.insert(self.made, (owner, Occurrence::new(id, operation, self.epoch.at(now))));
        self.tell_operation(self.made, now);
        self.made
    }

    /// Records an operation's end.
    pub(crate) fn conclude(&mut self, number: u64, state: OperationState, now: Timestamp) {
        if let Some((_, occurrence)) = self.occurrences.get_mut(&number) {
            (occurrence.state, occurrence.entered) = (state, self.epoch.at(now));
            self.tell_operation(number, now);
        }
    }

    fn tell_operation(&mut self, number: u64, now: Timestamp) {
        if let Some((_, occurrence)) = self.occurrences.get(&number)
            && let Some(instance) = self.instances.get(&occurrence.instance)
        {
            let of = &self.catalog[&instance.descriptor].descriptor;
            self.subscriptions.tell_operation(number, occurrence, instance, of, self.epoch.at(now));
        }
    }

    /// Returns the occurrences of operations, the oldest first.
    pub(crate) fn occurrences(&self, viewer: Option<&DomainId>) -> impl Iterator<Item = (u64, &Occurrence)> {
        let seen = self.occurrences.iter().filter(move |(_, (owner, _))| sees(viewer, owner.as_ref()));
        seen.map(|(number, (_, occurrence))| (*number, occurrence))
    }
}

#[cfg(test)]
mod tests;
