//! Accelerators in virtual time, and the models on them.

use std::{
    collections::{BTreeMap, VecDeque},
    time::Duration,
};

use cotorra_computing::{Accelerator, BatchLoad, Inferred};
use cotorra_engine::InstanceId;
use cotorra_graph::{Accelerators, NodeId, PolicyServer, Testbed, Timestamp, Vnf, VnfId, millis};
use cotorra_numbers::Gathered;

use super::{computers::Answer, interference::Held};
use crate::{followed::PolicyFollowed, parcel::Parcel};

/// What a model did on a node in a run.
#[derive(Debug, Clone)]
pub(crate) struct ModelUse {
    pub(crate) vnf: VnfId,
    pub(crate) node: NodeId,
    pub(crate) load: BatchLoad,
    /// Requests that an instance had when it stopped.
    pub(crate) lost: u64,
    /// Waits of answered requests until their batches began, milliseconds.
    pub(crate) waiting_ms: Gathered,
}

/// How much models used of a node's accelerators.
#[derive(Debug, Clone)]
pub(crate) struct AcceleratorsUse {
    pub(crate) node: NodeId,
    pub(crate) accelerators: Accelerators,
    /// Time for which they served, in all.
    pub(crate) used: Duration,
}

/// What models did in a run. Empty without any.
#[derive(Debug, Clone, Default)]
pub(crate) struct InferredSoFar {
    /// By node.
    pub(crate) nodes: Vec<AcceleratorsUse>,
    /// By VNF and node.
    pub(crate) models: Vec<ModelUse>,
    /// What robots followed, by service.
    pub(crate) policies: Vec<PolicyFollowed>,
}

/// The accelerators of a node.
struct Here {
    declared: Accelerators,
    /// Each, with the memory that models take of it.
    all: Vec<(Accelerator<Answer>, u64)>,
}

impl Here {
    fn new(declared: Accelerators) -> Self {
        let one = |_| (Accelerator::new(declared.speed), 0);
        Self { declared, all: (0..declared.count).map(one).collect() }
    }
}

struct Instance {
    node: NodeId,
    /// Place of its accelerator on the node.
    place: usize,
    vnf: VnfId,
    server: PolicyServer,
}

/// The accelerators of all nodes, if there is a model.
#[derive(Default)]
pub(super) struct AllAccelerators {
    by_node: BTreeMap<NodeId, Here>,
    instances: BTreeMap<InstanceId, Instance>,
    used: BTreeMap<(VnfId, NodeId), ModelUse>,
    /// Datagrams of answers that are sent next.
    answers: VecDeque<Answer>,
}

impl AllAccelerators {
    pub(super) fn new(testbed: &Testbed) -> Self {
        let here =
            |node: &cotorra_graph::Node| Some((node.id.clone(), Here::new(node.capacity()?.accelerators?)));
        let has_model = testbed.vnfs().any(|vnf| vnf.policy_server().is_some());
        let by_node =
            if has_model { testbed.graph.nodes.iter().filter_map(here).collect() } else { BTreeMap::new() };
        Self { by_node, ..Self::default() }
    }

    /// Starts an instance of a VNF on an accelerator of the node, if it has a model.
    pub(super) fn start(
        &mut self,
        now: Timestamp,
        id: InstanceId,
        vnf: &Vnf,
        node: &NodeId,
    ) -> Result<(), String> {
        let Some(server) = vnf.policy_server() else { return Ok(()) };
        let Here { declared, all } = self.by_node.get_mut(node).ok_or("its node has no accelerator")?;
        let taken: Vec<_> = all.iter().map(|(_, taken)| *taken).collect();
        let place = declared.place(&taken, server.accelerator_bytes);
        let place = place.ok_or("no accelerator of its node has enough free memory")?;
        let (accelerator, taken) = &mut all[place];
        *taken += server.accelerator_bytes;
        accelerator.start(now, id.0, server.batching, server.batch_times);
        let (vnf, node) = (vnf.id.clone(), node.clone());
        self.used.entry((vnf.clone(), node.clone())).or_insert_with(|| ModelUse {
            vnf: vnf.clone(),
            node: node.clone(),
            load: BatchLoad::default(),
            lost: 0,
            waiting_ms: Gathered::default(),
        });
        self.instances.insert(id, Instance { node, place, vnf, server: *server });
        Ok(())
    }

    /// Stops an instance. Its requests are lost.
    pub(super) fn stop(&mut self, now: Timestamp, id: InstanceId) {
        let Some(Instance { node, place, vnf, server }) = self.instances.remove(&id) else { return };
        let Some(here) = self.by_node.get_mut(&node) else { return };
        let (accelerator, taken) = &mut here.all[place];
        *taken -= server.accelerator_bytes;
        if let Some((load, lost)) = accelerator.stop(now, id.0)
            && let Some(used) = self.used.get_mut(&(vnf, node))
        {
            used.load.add(&load);
            used.lost += lost.len() as u64;
        }
    }

    /// Takes a request, whose answer leaves once its batch is finished.
    pub(super) fn arrive(&mut self, now: Timestamp, id: InstanceId, answer: Answer) {
        let Some(Instance { node, place, .. }) = self.instances.get(&id) else { return };
        let Some(here) = self.by_node.get_mut(node) else { return };
        // One that is refused is counted there.
        let _ = here.all[*place].0.arrive(now, id.0, answer);
    }

    /// Returns the next datagram of an answer.
    pub(super) fn poll(&mut self, now: Timestamp) -> Option<Answer> {
        while self.answers.is_empty() {
            let mut all = self.by_node.values_mut().flat_map(|here| &mut here.all);
            let inferred = all.find_map(|(accelerator, _)| accelerator.poll(now))?;
            self.answer(inferred);
        }
        self.answers.pop_front()
    }

    fn answer(&mut self, inferred: Inferred<Answer>) {
        let Inferred { model, arrived, began, token: Answer { held, later }, .. } = inferred;
        let Some(Instance { node, vnf, server, .. }) = self.instances.get(&InstanceId(model)) else { return };
        if let Some(used) = self.used.get_mut(&(vnf.clone(), node.clone())) {
            used.waiting_ms.add(millis::of(began.since(arrived)));
        }
        let Some((parcel, _)) = Parcel::of(&held.payload) else { return };
        let datagram = |payload| Answer { held: Held { from: held.from, to: held.to, payload }, later };
        self.answers.extend(parcel.datagrams(server.chunk.bytes).map(datagram));
    }

    pub(super) fn next_deadline(&self) -> Option<Timestamp> {
        let all = self.by_node.values().flat_map(|here| &here.all);
        all.filter_map(|(accelerator, _)| accelerator.deadline()).min()
    }

    /// Returns what models did so far, beside what robots followed.
    pub(super) fn inferred(&self, policies: Vec<PolicyFollowed>) -> InferredSoFar {
        let mut models = self.used.clone();
        for (id, Instance { node, place, vnf, .. }) in &self.instances {
            let load = self.by_node.get(node).and_then(|here| here.all[*place].0.load(id.0));
            if let (Some(used), Some(load)) = (models.get_mut(&(vnf.clone(), node.clone())), load) {
                used.load.add(&load);
            }
        }
        let used = |(node, here): (&NodeId, &Here)| AcceleratorsUse {
            node: node.clone(),
            accelerators: here.declared,
            used: models.values().filter(|its| its.node == *node).map(|its| its.load.used).sum(),
        };
        InferredSoFar {
            nodes: self.by_node.iter().map(used).collect(),
            models: models.into_values().collect(),
            policies,
        }
    }
}
