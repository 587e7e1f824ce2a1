//! Parameters of the search for a placement, and its outcomes.

use std::{num::NonZeroUsize, time::Duration};

use cotorra_graph::{LinkId, NodeId, Placement, VnfId};

/// Parameters of the search for a placement.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Search {
    /// γ: levels that each KPI's budget is divided into.
    pub gamma: u16,
    /// Paths that are tried between two hosts, as far as they differ: the fastest, the one that fails least often, the
    /// fastest with room beside what the service sends already. There are no more.
    pub k_paths: NonZeroUsize,
    /// Number of better labels of a VNF on a host, each with other resources taken, at which a label is dropped.
    pub rivals: NonZeroUsize,
    /// Whether to return the placement that exceeds the KPIs least, where none keeps them. Its slack says by how much.
    pub relax: bool,
}

impl Search {
    /// A search at this γ, with the number of paths and of labels that are worth their time, and nothing relaxed.
    pub const fn at(gamma: u16) -> Self {
        let [three, eight] = [NonZeroUsize::MIN.saturating_add(2), NonZeroUsize::MIN.saturating_add(7)];
        Self { gamma, k_paths: three, rivals: eight, relax: false }
    }
}

/// Placement of a service.
#[derive(Debug, Clone, PartialEq)]
pub struct Placed {
    /// a(n) for each VNF, in order: one node each.
    pub placement: Vec<Placement>,
    /// a(n1,n2): the links from each VNF to the next.
    pub paths: Vec<Vec<LinkId>>,
    /// The radio unit that the robot uses; `None` where nothing leaves it.
    pub attachment: Option<NodeId>,
    /// Price of the CPUs.
    pub cost: f64,
    /// Service time to expect.
    pub service_time: Duration,
    /// Probability that all that it uses works.
    pub reliability: f64,
    /// Margins of the KPIs.
    pub slack: Slack,
}

/// By how much KPIs are kept; negative where they are relaxed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Slack {
    /// Target less service time, milliseconds.
    pub service_time_ms: f64,
    /// Reliability less its target; `None` without one.
    pub reliability: Option<f64>,
}

/// Reason why a service cannot be placed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Infeasible {
    /// γ is none.
    #[error("γ = 0 leaves no level to count in; it is 1 or more")]
    NoLevels,
    /// More packets come than a VNF can process.
    #[error("`{vnf}` gets as many packets as it can process, or more; its queue grows forever")]
    Overloaded {
        /// The VNF.
        vnf: VnfId,
    },
    /// No host has what a VNF needs.
    #[error(
        "`{vnf}` needs {cpus} CPUs and {memory_bytes} B of memory, which none of its {hosts} hosts has free; the most free is {most_cpus} CPUs"
    )]
    Capacity {
        /// The VNF.
        vnf: VnfId,
        /// CPUs that it needs.
        cpus: f64,
        /// Memory that it needs.
        memory_bytes: u64,
        /// Number of nodes that could carry it.
        hosts: usize,
        /// CPUs of the one that has most free.
        most_cpus: f64,
    },
    /// No host of a VNF can be reached from where those before it can be.
    #[error("no host with {cpus} CPUs left for `{vnf}` can be reached with {mbps} Mbit/s free")]
    Unreachable {
        /// The VNF.
        vnf: VnfId,
        /// CPUs that it needs.
        cpus: f64,
        /// Rate between it and the one before it.
        mbps: f64,
    },
    /// Every placement takes too long.
    #[error("the service time is {least:?} at the least, {excess:?} above its target of {target:?}")]
    ServiceTime {
        /// Best reachable value.
        least: Duration,
        /// The KPI.
        target: Duration,
        /// The difference.
        excess: Duration,
    },
    /// Every placement fails too often.
    #[error("the reliability is {most:.6} at the most, {lack:.2e} below its target of {target}")]
    Reliability {
        /// Best reachable value.
        most: f64,
        /// The KPI.
        target: f64,
        /// The difference.
        lack: f64,
    },
    /// Each KPI can be kept, but not both by one placement.
    #[error(
        "{service_time:?} is the least service time with the reliability that is needed, {target:?} is its target; without it the target could be kept"
    )]
    Together {
        /// The least service time of those that are reliable enough.
        service_time: Duration,
        /// The KPI.
        target: Duration,
    },
    /// A placement keeps the KPIs, but not when its hops are rounded up.
    #[error(
        "a placement keeps the KPIs exactly, but none does with hops rounded up to levels of 1/{gamma}; a higher γ finds one"
    )]
    Resolution {
        /// γ.
        gamma: u16,
    },
}
