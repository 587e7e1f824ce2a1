//! The parts of service times in a run of a sweep, and where samples without an answer ended.

use cotorra_graph::{LostAt, ServiceId};
use cotorra_testbed::{LostSummary, PartSummary, Summary};
use serde::{Deserialize, Serialize};

use super::column::{Column, other};

/// A link or host, and what it added to the samples above the target.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MeasuredPart {
    pub service: ServiceId,
    /// Name of the link, or `sender`, `vnf`, `receiver` or `unknown`.
    pub part: String,
    /// Median time of samples within the target, ms.
    pub within_p50_ms: Option<f64>,
    /// 95th percentile of samples above the target, ms.
    pub above_p95_ms: Option<f64>,
    /// 95th percentile of the time that it added to samples above the target, ms.
    pub added_p95_ms: Option<f64>,
    /// Share of the answered samples above the target to which it added most.
    pub explains: Option<f64>,
}

/// A place where samples without an answer ended.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MeasuredLoss {
    pub service: ServiceId,
    /// The place; `None` if it is unknown.
    pub at: Option<LostAt>,
    /// Number of samples.
    pub samples: usize,
}

impl MeasuredLoss {
    /// Returns the places of all services of a run.
    pub(super) fn of(summary: &Summary) -> Vec<Self> {
        let lost =
            summary.time_parts.iter().flat_map(|its| its.lost_at.iter().map(|lost| (&its.service, lost)));
        let measured = |(service, LostSummary { at, samples }): (&ServiceId, &LostSummary)| Self {
            service: service.clone(),
            at: at.clone(),
            samples: *samples,
        };
        lost.map(measured).collect()
    }

    /// Returns the place: the link, the way and the cause.
    pub(super) fn place(&self) -> [String; 3] {
        match &self.at {
            None => ["", "", "unknown"].map(str::to_owned),
            Some(LostAt { link, back, cause }) => [
                link.as_ref().map(ToString::to_string).unwrap_or_default(),
                if *back { "answer" } else { "request" }.to_owned(),
                cause.as_str().to_owned(),
            ],
        }
    }
}

impl MeasuredPart {
    /// Returns the parts of all services of a run.
    pub(super) fn of(summary: &Summary) -> Vec<Self> {
        let parts =
            summary.time_parts.iter().flat_map(|its| its.parts.iter().map(|part| (&its.service, part)));
        let measured = |(service, part): (&ServiceId, &PartSummary)| Self {
            service: service.clone(),
            part: part.part.clone(),
            within_p50_ms: part.within_p50_ms,
            above_p95_ms: part.above_p95_ms,
            added_p95_ms: part.added_p95_ms,
            explains: part.explains,
        };
        parts.map(measured).collect()
    }

    /// Returns the figures with their names.
    pub(super) fn figures(&self) -> [Column<Option<f64>>; 4] {
        [
            other("within_p50_ms", self.within_p50_ms),
            other("above_p95_ms", self.above_p95_ms),
            other("added_p95_ms", self.added_p95_ms),
            other("explains", self.explains),
        ]
    }
}
