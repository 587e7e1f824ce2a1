//! Results of one run of a search.

use cotorra_graph::ServiceId;
use cotorra_testbed::{ServiceSummary, Summary, Verdict};
use serde::{Deserialize, Serialize};

/// The results of a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Measured {
    /// Duration in virtual time, ms.
    pub(super) duration_ms: f64,
    /// Whether every walk was done.
    pub(super) walked: bool,
    /// Services with samples.
    pub(super) services: Vec<Counted>,
}

/// The samples of a service.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Counted {
    pub(super) service: ServiceId,
    /// Number of samples, unanswered ones included.
    pub(super) samples: usize,
    /// Number of samples within the target.
    pub(super) within: usize,
    /// Further KPIs of the service that failed; none in journals of earlier versions.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(super) failed: Vec<String>,
}

impl Measured {
    pub(super) fn of(summary: &Summary) -> Self {
        let counted = |its: &ServiceSummary| {
            // A share of whole numbers below 2^53 leads back to them.
            let above = (its.above_target? * its.samples as f64).round() as usize;
            let failed = its.further_kpis().filter(|judged| judged.verdict == Some(Verdict::Fail));
            Some(Counted {
                service: its.service.clone(),
                samples: its.samples,
                within: its.samples - above,
                failed: failed.map(|judged| judged.kpi.clone()).collect(),
            })
        };
        Self {
            duration_ms: summary.duration_ms,
            walked: summary.is_walked(),
            services: summary.services.iter().filter_map(counted).collect(),
        }
    }
}
