//! Results of searches.

use cotorra_graph::{NodeId, ServiceId};
use cotorra_testbed::Void;
use serde::Serialize;

use crate::batch::Again;

/// The result of a search.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Margins {
    /// Share of a service's samples that must keep its target.
    pub keep: f64,
    /// Number of seeds.
    pub seeds: u32,
    /// The services' shares of samples within their targets before anything changes.
    pub unchanged: Vec<ServiceKept>,
    /// One for each search.
    pub findings: Vec<Finding>,
    /// Whether all searches ended; false after a stop.
    pub complete: bool,
    /// Number of runs that the result is based on.
    pub runs: usize,
    /// Number of these that the journal already had.
    #[serde(skip)]
    pub resumed: usize,
    /// Runs that the journal had, but not as they are now.
    #[serde(skip)]
    pub again: Again,
    /// Number of void runs.
    #[serde(rename = "void_runs")]
    pub void: usize,
}

/// The share of a service's samples within its target, over all seeds.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ServiceKept {
    pub service: ServiceId,
    /// Target, milliseconds.
    pub service_time_target_ms: f64,
    /// Number of samples.
    pub samples: usize,
    /// Share of samples within the target; `None` without samples.
    pub kept: Option<f64>,
    /// The first of its further KPIs that failed with any seed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub failed: Option<String>,
}

/// The result of one search.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Finding {
    /// Name of the kind of change.
    pub change: &'static str,
    /// The link, wireless network or server that gets worse.
    pub on: Option<String>,
    /// The radio unit that is down.
    pub down: Option<NodeId>,
    /// Whether an amount broke the target, or the radio unit that is down did.
    pub breaks: bool,
    /// Longest extra delay that was tested and survived; 0 if none was. `None` for other kinds of changes, as below.
    pub survives_ms: Option<f64>,
    /// Shortest extra delay that was tested and broke the target.
    pub breaks_ms: Option<f64>,
    /// Largest extra loss that was tested and survived, as a share.
    pub survives_loss: Option<f64>,
    /// Smallest extra loss that was tested and broke the target, as a share.
    pub breaks_loss: Option<f64>,
    /// The first service whose target broke there; `None` if only a walk did not end.
    pub service: Option<ServiceId>,
    /// Its share of samples within the target.
    pub kept: Option<f64>,
    /// The first of its further KPIs that failed there.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub failed: Option<String>,
    /// Whether the search ended.
    pub complete: bool,
    /// The reason for which a run was void. The search then ended without a result.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub void: Option<Void>,
}
