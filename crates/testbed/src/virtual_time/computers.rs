//! Computers in virtual time: the CPUs of nodes, and the requests of VNFs with demands that are served there.

use std::{collections::BTreeMap, time::Duration};

use cotorra_computing::{Demands, Finished, Limits, Server};
use cotorra_engine::InstanceId;
use cotorra_graph::{
    Computing, CpuContext, Event, HardwareGraph, MachineContext, NodeId, NodeKind, Probability, ReadingTime,
    Stamped, Testbed, Timestamp, Vnf, VnfId, millis,
};

use super::interference::Held;
use crate::computed::{Computed, ComputedSoFar, UsedComputer};

/// Interval of the contexts of servers that VNFs with demands can use, as agents of real servers report theirs.
const CONTEXT_INTERVAL: Duration = Duration::from_secs(1);

/// An answer that is sent once it is computed.
pub(super) struct Answer {
    pub(super) held: Held,
    /// Delay after that.
    pub(super) later: Duration,
}

/// A node's CPUs.
struct Computer {
    server: Server<Answer>,
    cpus: f64,
    speed: f64,
    is_server: bool,
    /// CPU time up to the last context.
    told: Duration,
    /// CPU time of instances that stopped.
    stopped: Duration,
}

impl Computer {
    fn cpu_time(&self) -> Duration {
        let loads = self.server.instances().filter_map(|instance| self.server.load(instance));
        self.stopped + loads.map(|load| load.cpu_time()).sum::<Duration>()
    }
}

struct Instance {
    node: NodeId,
    vnf: VnfId,
    demands: Demands,
    /// Most CPUs that it uses.
    limit: f64,
    since: Timestamp,
}

/// The CPUs of all nodes, if any VNF has a demand.
#[derive(Default)]
pub(super) struct Computers {
    by_node: BTreeMap<NodeId, Computer>,
    computing: BTreeMap<VnfId, Box<Computing>>,
    seed: u64,
    instances: BTreeMap<InstanceId, Instance>,
    /// Instances that are off their CPUs.
    paused: BTreeMap<InstanceId, Instance>,
    /// Number of starts of each replica of a VNF.
    starts: BTreeMap<(VnfId, u32), u32>,
    computed: BTreeMap<(VnfId, NodeId), Computed>,
    /// Time of the next contexts.
    context_at: Timestamp,
}

impl Computers {
    pub(super) fn new(testbed: &Testbed, seed: u64) -> Self {
        let computing: BTreeMap<_, _> =
            testbed.vnfs().filter_map(|vnf| Some((vnf.id.clone(), vnf.computing.clone()?))).collect();
        let by_node = if computing.is_empty() { BTreeMap::new() } else { computers(&testbed.graph) };
        let context_at = Timestamp::ZERO + CONTEXT_INTERVAL;
        Self { by_node, computing, seed, context_at, ..Self::default() }
    }

    /// Whether a VNF's instances are started here.
    pub(super) fn compute(&self, vnf: &VnfId) -> bool {
        self.computing.contains_key(vnf)
    }

    pub(super) fn start(
        &mut self,
        now: Timestamp,
        id: InstanceId,
        vnf: &Vnf,
        replica: u32,
        node: &NodeId,
    ) -> Result<(), String> {
        let Some(computing) = self.computing.get(&vnf.id) else { return Ok(()) };
        let computer = self.by_node.get_mut(node).ok_or("its node has no CPUs")?;
        let starts = self.starts.entry((vnf.id.clone(), replica)).or_default();
        *starts += 1;
        let label = format!("{} {replica} {starts}", vnf.id);
        let demands =
            Demands::new(computing, self.seed, &label).ok_or("its demand has no such distribution")?;
        let limit = vnf.most_cpus();
        computer.server.start(now, id.0, Limits::new(computing, limit));
        let instance = Instance { node: node.clone(), vnf: vnf.id.clone(), demands, limit, since: now };
        self.instances.insert(id, instance);
        self.computed
            .entry((vnf.id.clone(), node.clone()))
            .or_insert_with(|| Computed::nothing(vnf.id.clone(), node.clone(), limit));
        Ok(())
    }

    /// Stops an instance. Its requests are lost.
    pub(super) fn stop(&mut self, now: Timestamp, id: InstanceId) {
        self.pause(now, id);
        self.paused.remove(&id);
    }

    /// Takes an instance off its CPUs. Its requests are lost.
    pub(super) fn pause(&mut self, now: Timestamp, id: InstanceId) {
        let Some(instance) = self.instances.remove(&id) else { return };
        let Instance { node, vnf, since, .. } = &instance;
        let Some(computer) = self.by_node.get_mut(node) else { return };
        let Some((load, lost)) = computer.server.stop(now, id.0) else { return };
        computer.stopped += load.cpu_time();
        if let Some(computed) = self.computed.get_mut(&(vnf.clone(), node.clone())) {
            computed.ran += now.since(*since);
            computed.load.add(&load);
            computed.lost += lost.len() as u64;
        }
        self.paused.insert(id, instance);
    }

    /// Lets a paused instance go on.
    pub(super) fn resume(&mut self, now: Timestamp, id: InstanceId) {
        let Some(instance) = self.paused.remove(&id) else { return };
        let Instance { node, vnf, .. } = &instance;
        let (Some(computing), Some(computer)) = (self.computing.get(vnf), self.by_node.get_mut(node)) else {
            return;
        };
        computer.server.start(now, id.0, Limits::new(computing, instance.limit));
        self.instances.insert(id, Instance { since: now, ..instance });
    }

    /// Takes a request of so many bytes, whose answer leaves once it is computed.
    pub(super) fn arrive(&mut self, now: Timestamp, id: InstanceId, bytes: usize, answer: Answer) {
        let Some(instance) = self.instances.get_mut(&id) else { return };
        let Some(computer) = self.by_node.get_mut(&instance.node) else { return };
        // One that is refused is counted there.
        let _ = computer.server.arrive(now, id.0, instance.demands.next(bytes), answer);
    }

    /// Returns the next answer that is computed.
    pub(super) fn poll(&mut self, now: Timestamp) -> Option<Answer> {
        let (node, finished) =
            self.by_node.iter_mut().find_map(|(node, computer)| Some((node, computer.server.poll(now)?)))?;
        let waiting = finished.waiting();
        let Finished { instance, computing, token, .. } = finished;
        if let Some(Instance { vnf, .. }) = self.instances.get(&InstanceId(instance))
            && let Some(computed) = self.computed.get_mut(&(vnf.clone(), node.clone()))
        {
            computed.computing_ms += millis::of(computing);
            computed.waited_ms += millis::of(waiting);
            computed.waiting_ms.add(millis::of(waiting));
        }
        Some(token)
    }

    pub(super) fn next_deadline(&self) -> Option<Timestamp> {
        let context = (!self.by_node.is_empty()).then_some(self.context_at);
        self.by_node.values().filter_map(|computer| computer.server.deadline()).chain(context).min()
    }

    /// Returns the contexts of servers, if they are due.
    pub(super) fn contexts(&mut self, now: Timestamp) -> Vec<Stamped> {
        if self.by_node.is_empty() || now < self.context_at {
            return Vec::new();
        }
        self.context_at = now + CONTEXT_INTERVAL;
        let servers = self.by_node.iter_mut().filter(|(_, computer)| computer.is_server);
        servers
            .map(|(node, computer)| Stamped { at: now, event: Event::Machine(context(now, node, computer)) })
            .collect()
    }

    /// Returns what VNFs computed so far.
    pub(super) fn computed(&self, now: Timestamp) -> ComputedSoFar {
        let mut all = self.computed.clone();
        for (id, Instance { node, vnf, since, .. }) in &self.instances {
            let load = self.by_node.get(node).and_then(|computer| computer.server.load(id.0));
            if let (Some(computed), Some(load)) = (all.get_mut(&(vnf.clone(), node.clone())), load) {
                computed.ran += now.since(*since);
                computed.load.add(&load);
            }
        }
        let used = |(node, computer): (&NodeId, &Computer)| {
            let cpu_time = computer.cpu_time();
            let Computer { cpus, speed, .. } = *computer;
            let is_shown = computer.is_server || !cpu_time.is_zero();
            is_shown.then(|| UsedComputer { node: node.clone(), cpus, speed, cpu_time })
        };
        let nodes = self.by_node.iter().filter_map(used).collect();
        ComputedSoFar { nodes, vnfs: all.into_values().collect() }
    }
}

fn computers(graph: &HardwareGraph) -> BTreeMap<NodeId, Computer> {
    let computer = |node: &cotorra_graph::Node| {
        let cpus = node.capacity()?.cpus;
        let (speed, is_server) = match &node.kind {
            NodeKind::Server(server) => (server.speed, true),
            _ => (1.0, false),
        };
        let server = Server::new(cpus, speed);
        let nothing = Duration::ZERO;
        Some((node.id.clone(), Computer { server, cpus, speed, is_server, told: nothing, stopped: nothing }))
    };
    graph.nodes.iter().filter_map(computer).collect()
}

fn context(now: Timestamp, node: &NodeId, computer: &mut Computer) -> MachineContext {
    let used = computer.cpu_time();
    let busy = (used - computer.told).as_secs_f64() / (CONTEXT_INTERVAL.as_secs_f64() * computer.cpus);
    computer.told = used;
    MachineContext {
        node: node.clone(),
        reading: Some(ReadingTime { measured: now, error: Duration::ZERO }),
        cpu: Some(CpuContext {
            cpus: computer.cpus.ceil() as u32,
            busy: Probability::new(busy.clamp(0.0, 1.0)),
        }),
        load_average: None,
        memory: None,
        interfaces: Vec::new(),
        interfaces_left_out: 0,
        wifi: Vec::new(),
        wifi_left_out: 0,
    }
}
