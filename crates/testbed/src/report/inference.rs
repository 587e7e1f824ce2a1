//! What models inferred in virtual time, and how robots followed their actions, in a run's summary.

use std::time::Duration;

use cotorra_graph::{NodeId, ServiceId, VnfId, millis};
use serde::Serialize;

use super::times::Quantiles;
use crate::{
    followed::PolicyFollowed,
    virtual_time::{AcceleratorsUse, InferredSoFar, ModelUse},
};

/// What models inferred in a run, and how robots followed their actions.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct InferenceSummary {
    /// All nodes with accelerators, by name.
    pub nodes: Vec<AcceleratorsSummary>,
    /// Each model on each node that it ran on.
    pub models: Vec<ModelSummary>,
    /// Each service whose robot follows a model, in the file's order.
    pub policies: Vec<PolicySummary>,
}

/// How busy a node's accelerators were.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AcceleratorsSummary {
    pub node: NodeId,
    /// Their number.
    pub accelerators: u32,
    /// Speed of each.
    pub accelerator_speed: f64,
    /// Share of their time that batches took.
    pub busy: f64,
}

/// What a model did on a node.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ModelSummary {
    pub vnf: VnfId,
    pub node: NodeId,
    /// Requests that arrived.
    pub requests: u64,
    /// Requests that were answered.
    pub requests_served: u64,
    /// Requests that were dropped, because the backlog was full.
    pub requests_dropped: u64,
    /// Requests that an instance had when it stopped.
    pub requests_lost: u64,
    /// Batches that began.
    pub batches: u64,
    /// Mean number of requests of a batch; `None` without one.
    pub batch_size_mean: Option<f64>,
    /// Waits of answered requests until their batches began.
    pub waiting_ms: Option<Quantiles>,
}

/// How a robot followed the actions of a model.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PolicySummary {
    pub service: ServiceId,
    pub robot: NodeId,
    /// Steps of its control.
    pub steps: u64,
    /// Share of the steps without an action to follow; `None` without a step.
    pub starved: Option<f64>,
    /// Stretches of such steps.
    pub stalls: u64,
    /// Longest of them.
    pub longest_stall_ms: f64,
    /// Ages of the actions that it followed: the time since the observation that they answer.
    pub action_age_ms: Option<Quantiles>,
}

impl InferenceSummary {
    /// Summarizes a run of that duration; `None` without a model.
    pub(super) fn of(so_far: &InferredSoFar, duration: Duration) -> Option<Self> {
        let InferredSoFar { nodes, models, policies } = so_far;
        let node = |AcceleratorsUse { node, accelerators, used }: &AcceleratorsUse| {
            let all = duration.as_secs_f64() * f64::from(accelerators.count);
            AcceleratorsSummary {
                node: node.clone(),
                accelerators: accelerators.count,
                accelerator_speed: accelerators.speed,
                busy: if all > 0.0 { used.as_secs_f64() / all } else { 0.0 },
            }
        };
        (!nodes.is_empty()).then(|| Self {
            nodes: nodes.iter().map(node).collect(),
            models: models.iter().map(ModelSummary::of).collect(),
            policies: policies.iter().map(PolicySummary::of).collect(),
        })
    }

    /// Returns how the robot of a service followed its model.
    pub fn policy(&self, service: &ServiceId) -> Option<&PolicySummary> {
        self.policies.iter().find(|policy| policy.service == *service)
    }
}

impl AcceleratorsSummary {
    /// Describes it for people.
    pub fn sentence(&self) -> String {
        let s = if self.accelerators == 1 { "" } else { "s" };
        format!("{:.1} % of {} accelerator{s} busy", 100.0 * self.busy, self.accelerators)
    }
}

impl ModelSummary {
    fn of(used: &ModelUse) -> Self {
        let ModelUse { vnf, node, load, lost, waiting_ms } = used;
        Self {
            vnf: vnf.clone(),
            node: node.clone(),
            requests: load.arrived,
            requests_served: load.served,
            requests_dropped: load.dropped,
            requests_lost: *lost,
            batches: load.batches,
            batch_size_mean: (load.batches > 0).then(|| load.batched as f64 / load.batches as f64),
            waiting_ms: Quantiles::gathered(waiting_ms),
        }
    }

    /// Describes it for people.
    pub fn sentence(&self) -> String {
        let Self { node, requests_served: served, batches, .. } = self;
        let size = self.batch_size_mean.map(|size| format!(" of {size:.1} requests")).unwrap_or_default();
        let waits = self.waiting_ms.map(|its| format!(", waited {:.1} ms (p95 {:.1} ms)", its.p50, its.p95));
        let bad = [(self.requests_dropped, "dropped"), (self.requests_lost, "lost")];
        let bad = bad.iter().filter(|(count, _)| *count > 0);
        let bad: String = bad.map(|(count, what)| format!(", {count} {what}")).collect();
        format!("{batches} batches{size} on {node}, {served} answered{}{bad}", waits.unwrap_or_default())
    }
}

impl PolicySummary {
    fn of(PolicyFollowed { service, robot, followed }: &PolicyFollowed) -> Self {
        Self {
            service: service.clone(),
            robot: robot.clone(),
            steps: followed.steps,
            starved: (followed.steps > 0).then(|| followed.starved as f64 / followed.steps as f64),
            stalls: followed.stalls,
            longest_stall_ms: millis::of(followed.longest_stall),
            action_age_ms: Quantiles::gathered(&followed.age_ms),
        }
    }

    /// Describes it for people.
    pub fn sentence(&self) -> String {
        let ages = self.action_age_ms.map_or_else(
            || "no action".to_owned(),
            |its| format!("actions {:.0} ms old (p95 {:.0} ms)", its.p50, its.p95),
        );
        let starved = 100.0 * self.starved.unwrap_or_default();
        let (stalls, s) = (self.stalls, if self.stalls == 1 { "" } else { "s" });
        let longest = self.longest_stall_ms;
        format!("{ages}, starved {starved:.1} % in {stalls} stall{s} of up to {longest:.0} ms")
    }
}
