//! What VNFs with demands computed in a run, in virtual time and with real packets.

use std::{collections::BTreeMap, time::Duration};

use cotorra_computing::Load;
use cotorra_engine::{Requests, VnfComputed};
use cotorra_graph::{NodeId, NodeKind, Testbed, VnfId, millis};
use cotorra_numbers::Gathered;

/// What a VNF computed on a node in a run.
#[derive(Debug, Clone)]
pub(crate) struct Computed {
    pub(crate) vnf: VnfId,
    pub(crate) node: NodeId,
    /// Most CPUs that an instance uses.
    pub(crate) limit: f64,
    /// Time for which instances ran there.
    pub(crate) ran: Duration,
    pub(crate) load: Load,
    /// Requests that an instance had when it stopped.
    pub(crate) lost: u64,
    /// CPU times of the answers on a CPU of the node alone, milliseconds in all.
    pub(crate) computing_ms: f64,
    /// Waits of the answers, milliseconds in all.
    pub(crate) waited_ms: f64,
    /// Each of these.
    pub(crate) waiting_ms: Gathered,
}

impl Computed {
    /// Returns that it computed nothing so far.
    pub(crate) fn nothing(vnf: VnfId, node: NodeId, limit: f64) -> Self {
        Self {
            vnf,
            node,
            limit,
            ran: Duration::ZERO,
            load: Load::default(),
            lost: 0,
            computing_ms: 0.0,
            waited_ms: 0.0,
            waiting_ms: Gathered::default(),
        }
    }

    /// Returns what a VNF computed on a node, as its programs report it.
    fn measured(computed: VnfComputed) -> Self {
        let VnfComputed { vnf, node, limit, ran, requests } = computed;
        let Requests { arrived, served, dropped, lost, most, cpu_time, waited, waiting_ms } = requests;
        let mut load = Load::of_cpu_time(cpu_time);
        (load.arrived, load.served, load.dropped) = (arrived, served, dropped);
        (load.in_system, load.most_requests) = (cpu_time + waited, most);
        Self {
            ran,
            load,
            lost,
            computing_ms: millis::of(cpu_time),
            waited_ms: millis::of(waited),
            waiting_ms,
            ..Self::nothing(vnf, node, limit)
        }
    }
}

/// What VNFs with demands computed in a run. Empty without any.
#[derive(Debug, Clone, Default)]
pub(crate) struct ComputedSoFar {
    /// All servers, and other nodes that VNFs used, by name.
    pub(crate) nodes: Vec<UsedComputer>,
    /// By VNF and node.
    pub(crate) vnfs: Vec<Computed>,
}

/// How much VNFs used of a node's CPUs.
#[derive(Debug, Clone)]
pub(crate) struct UsedComputer {
    pub(crate) node: NodeId,
    pub(crate) cpus: f64,
    pub(crate) speed: f64,
    pub(crate) cpu_time: Duration,
}

impl ComputedSoFar {
    /// Returns what VNFs on emulated nodes computed, as their programs report it. Empty if no VNF has a demand.
    pub(crate) fn measured(testbed: &Testbed, vnfs: Vec<VnfComputed>) -> Self {
        if testbed.vnfs().all(|vnf| vnf.computing.is_none()) {
            return Self::default();
        }
        let mut cpu_times: BTreeMap<NodeId, Duration> = BTreeMap::new();
        for its in &vnfs {
            *cpu_times.entry(its.node.clone()).or_default() += its.requests.cpu_time;
        }
        let used = |node: &cotorra_graph::Node| {
            let cpu_time = cpu_times.get(&node.id).copied().unwrap_or_default();
            let cpus = node.capacity()?.cpus;
            let (speed, is_server) = match &node.kind {
                NodeKind::Server(server) => (server.speed, node.real_server().is_none()),
                _ => (1.0, false),
            };
            let is_shown = is_server || !cpu_time.is_zero();
            is_shown.then(|| UsedComputer { node: node.id.clone(), cpus, speed, cpu_time })
        };
        let mut nodes: Vec<_> = testbed.graph.nodes.iter().filter_map(used).collect();
        nodes.sort_by(|a, b| a.node.cmp(&b.node));
        Self { nodes, vnfs: vnfs.into_iter().map(Computed::measured).collect() }
    }
}
