//! How busy computers were, and for how long requests waited there, in a run's summary.

use std::time::Duration;

use cotorra_graph::{NodeId, VnfId, millis};
use serde::Serialize;

use super::times::Quantiles;
use crate::computed::{Computed, ComputedSoFar, UsedComputer};

/// What VNFs with demands computed in a run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ComputingSummary {
    /// All servers, and other nodes on which such VNFs computed, by name.
    pub nodes: Vec<ComputerSummary>,
    /// Each VNF on each node that it ran on.
    pub vnfs: Vec<VnfComputing>,
}

/// How busy a node's CPUs were.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ComputerSummary {
    pub node: NodeId,
    pub cpus: f64,
    /// Speed of a CPU.
    pub cpu_speed: f64,
    /// CPU time that VNFs used.
    pub cpu_time_ms: f64,
    /// Share of the CPUs' time that VNFs used.
    pub busy: f64,
}

/// What a VNF computed on a node.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct VnfComputing {
    pub vnf: VnfId,
    pub node: NodeId,
    /// Most CPUs that an instance uses.
    pub cpu_limit: f64,
    /// CPU time that it used.
    pub cpu_time_ms: f64,
    /// Share of the time of its CPUs that it used, while it ran there.
    pub busy: f64,
    /// Requests that arrived.
    pub requests: u64,
    /// Requests that were answered.
    pub requests_served: u64,
    /// Requests that were dropped, because the backlog was full.
    pub requests_dropped: u64,
    /// Requests that an instance had when it stopped.
    pub requests_lost: u64,
    /// Mean number of requests that were with it at a time, waiting or served.
    pub requests_present_mean: f64,
    /// Most of them.
    pub requests_present_max: u32,
    /// Mean time of an answer on a CPU of its own; `None` without an answer.
    pub computing_mean_ms: Option<f64>,
    /// Waits of answers: for a worker, and while others used the CPU.
    pub waiting_ms: Option<Quantiles>,
}

impl ComputingSummary {
    /// Summarizes a run of that duration; `None` if no VNF has a demand.
    pub(super) fn of(so_far: &ComputedSoFar, duration: Duration) -> Option<Self> {
        let ComputedSoFar { nodes, vnfs } = so_far;
        let node = |UsedComputer { node, cpus, speed, cpu_time }: &UsedComputer| ComputerSummary {
            node: node.clone(),
            cpus: *cpus,
            cpu_speed: *speed,
            cpu_time_ms: millis::of(*cpu_time),
            busy: share(*cpu_time, duration.as_secs_f64() * cpus),
        };
        (!nodes.is_empty()).then(|| Self {
            nodes: nodes.iter().map(node).collect(),
            vnfs: vnfs.iter().map(VnfComputing::of).collect(),
        })
    }
}

impl ComputerSummary {
    /// Describes it for people.
    pub fn sentence(&self) -> String {
        let s = if self.cpus == 1.0 { "" } else { "s" };
        format!("{:.1} % of {} CPU{s} busy", 100.0 * self.busy, self.cpus)
    }
}

impl VnfComputing {
    fn of(computed: &Computed) -> Self {
        let Computed { vnf, node, limit, ran, load, lost, computing_ms, waited_ms: _, waiting_ms } = computed;
        let answers = waiting_ms.count();
        Self {
            vnf: vnf.clone(),
            node: node.clone(),
            cpu_limit: *limit,
            cpu_time_ms: millis::of(load.cpu_time()),
            busy: share(load.cpu_time(), ran.as_secs_f64() * limit),
            requests: load.arrived,
            requests_served: load.served,
            requests_dropped: load.dropped,
            requests_lost: *lost,
            requests_present_mean: share(load.in_system, ran.as_secs_f64()),
            requests_present_max: load.most_requests,
            computing_mean_ms: (answers > 0).then(|| computing_ms / answers as f64),
            waiting_ms: Quantiles::gathered(waiting_ms),
        }
    }

    /// Describes it for people.
    pub fn sentence(&self) -> String {
        let Self { node, requests_served: served, requests_dropped: dropped, requests_lost: lost, .. } = self;
        let busy = 100.0 * self.busy;
        let waits = self.waiting_ms.map(|its| format!(", waited {:.2} ms (p95 {:.2} ms)", its.p50, its.p95));
        let waits = waits.unwrap_or_default();
        let bad = [(*dropped, "dropped"), (*lost, "lost")];
        let bad: String = bad
            .iter()
            .filter(|(count, _)| *count > 0)
            .map(|(count, what)| format!(", {count} {what}"))
            .collect();
        let requests = if *served == 1 { "request" } else { "requests" };
        format!("{busy:.1} % busy on {node}, {served} {requests}{waits}{bad}")
    }
}

/// Returns the ratio of a time to seconds; zero of none.
fn share(time: Duration, of_s: f64) -> f64 {
    if of_s > 0.0 { time.as_secs_f64() / of_s } else { 0.0 }
}
