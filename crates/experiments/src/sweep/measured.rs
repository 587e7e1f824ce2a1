//! Results of one run of a sweep.

use cotorra_graph::{NodeId, PluginId, ServiceId, Statistic, Timestamp, Total, TrafficId};
use cotorra_testbed::{Judged, Kept, Quantiles, RegionSummary, ServiceSummary, Summary, Verdict};
use serde::{Deserialize, Serialize};

use super::{
    column::{Column, above_target, handover_gap, other, service_time, total},
    spent::Spent,
    time_parts::{MeasuredLoss, MeasuredPart},
};

/// The results of a run.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Measured {
    /// Duration in virtual time, ms.
    pub duration_ms: f64,
    /// Whether every walk was done.
    pub walked: bool,
    /// Number of service times, unanswered ones included.
    pub samples: usize,
    /// Number of unanswered ones.
    pub unanswered: usize,
    /// Share of samples above the target.
    pub above_target: Option<f64>,
    /// Median service time, ms.
    pub service_time_p50_ms: Option<f64>,
    /// 95th percentile of the service time, ms.
    pub service_time_p95_ms: Option<f64>,
    /// 99th percentile of the service time, ms.
    pub service_time_p99_ms: Option<f64>,
    /// Longest service time, ms.
    pub service_time_max_ms: Option<f64>,
    /// Number of changes of radio unit.
    pub handovers: usize,
    /// Median time without connection in a handover, ms.
    pub handover_gap_p50_ms: Option<f64>,
    /// Longest time without connection in a handover, ms.
    pub handover_gap_max_ms: Option<f64>,
    /// Number of changes of VNFs' nodes after the start.
    pub migrations: usize,
    /// Number of plug-ins that were cut off.
    pub plugin_faults: usize,
    /// Number of instructions of plug-ins that were applied.
    #[serde(default)]
    pub applied: usize,
    /// Number of instructions of plug-ins that were rejected.
    #[serde(default)]
    pub refused: usize,
    /// Plug-ins whose instructions were all rejected.
    #[serde(default)]
    pub ineffective: Vec<PluginId>,
    /// Distance that all robots drove, metres.
    pub driven_m: f64,
    /// Distance that robots drove blind, metres.
    pub blind_m: f64,
    /// Longest blind stretch of any robot, metres.
    pub longest_blind_m: f64,
    /// Service times of each service.
    pub services: Vec<MeasuredService>,
    /// Parts of the service times.
    #[serde(default)]
    pub time_parts: Vec<MeasuredPart>,
    /// Places where samples without an answer ended.
    #[serde(default)]
    pub losses: Vec<MeasuredLoss>,
    /// Goodput of each source of traffic, bit/s.
    #[serde(default)]
    pub goodput_bps: Vec<(TrafficId, f64)>,
    /// Prices, that of everything first; none if the testbed file has no currency.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub bill: Vec<Spent>,
    /// Energies, that of everything first; none if the testbed file has the power of no node.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub energy: Vec<Spent>,
    /// Stretches of services with one attachment and one server.
    pub regions: Vec<Region>,
}

/// The service times of a robot's service in a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MeasuredService {
    pub robot: NodeId,
    pub service: ServiceId,
    /// Whether it counts in the figures of the run.
    #[serde(default = "in_total")]
    pub in_total: bool,
    /// Target, ms.
    pub service_time_target_ms: f64,
    /// Number of service times, unanswered ones included.
    pub samples: usize,
    /// Number of unanswered ones.
    pub unanswered: usize,
    /// Share of samples above the target; `None` without samples.
    pub above_target: Option<f64>,
    /// Median service time, ms.
    pub service_time_p50_ms: Option<f64>,
    /// 95th percentile of the service time, ms.
    pub service_time_p95_ms: Option<f64>,
    /// 99th percentile of the service time, ms.
    pub service_time_p99_ms: Option<f64>,
    /// Longest service time, ms.
    pub service_time_max_ms: Option<f64>,
    /// Share of samples that must be within the target; `None` if any will do, and in journals of earlier versions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub keep: Option<f64>,
    /// Its KPIs beside the target; none in journals of earlier versions.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub kpis: Vec<Judged>,
}

/// In journals of earlier versions, all services do.
fn in_total() -> bool {
    true
}

/// A stretch of a service with one attachment and one server.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Region {
    pub robot: NodeId,
    pub service: ServiceId,
    /// Radio unit; `None` without attachment.
    pub attachment: Option<NodeId>,
    /// Node of the service's VNF that answered.
    pub server: NodeId,
    /// Emission of the first sample.
    #[serde(rename = "from_ns")]
    pub from: Timestamp,
    /// Emission of the last sample.
    #[serde(rename = "until_ns")]
    pub until: Timestamp,
    /// Number of samples.
    pub samples: usize,
    /// Median service time, ms; `None` without an answered sample.
    pub service_time_p50_ms: Option<f64>,
}

impl Measured {
    pub(crate) fn of(summary: &Summary) -> Self {
        let service_time = |of: fn(&Quantiles) -> f64| summary.service_time_ms.as_ref().map(of);
        let gaps = Quantiles::of(summary.handovers.iter().map(|handover| handover.gap_ms).collect());
        let region = |region: &RegionSummary| Region {
            robot: region.robot.clone(),
            service: region.service.clone(),
            attachment: region.attachment.clone(),
            server: region.server.clone(),
            from: region.from,
            until: region.until,
            samples: region.samples,
            service_time_p50_ms: region.service_time_p50_ms,
        };
        let ineffective = summary.plugins.iter().filter(|its| its.applied == 0 && its.refused > 0);
        Self {
            duration_ms: summary.duration_ms,
            walked: summary.is_walked(),
            samples: summary.samples,
            unanswered: summary.unanswered,
            above_target: summary.above_target,
            service_time_p50_ms: service_time(|q| q.p50),
            service_time_p95_ms: service_time(|q| q.p95),
            service_time_p99_ms: service_time(|q| q.p99),
            service_time_max_ms: service_time(|q| q.max),
            handovers: summary.handovers.len(),
            handover_gap_p50_ms: gaps.map(|q| q.p50),
            handover_gap_max_ms: gaps.map(|q| q.max),
            migrations: summary.placements.iter().filter(|placement| placement.at > Timestamp::ZERO).count(),
            plugin_faults: summary.plugin_faults.len(),
            applied: summary.plugins.iter().map(|its| its.applied).sum(),
            refused: summary.plugins.iter().map(|its| its.refused).sum(),
            ineffective: ineffective.map(|its| its.plugin.clone()).collect(),
            driven_m: summary.driving.iter().map(|driven| driven.driven_m).sum(),
            blind_m: summary.driving.iter().map(|driven| driven.blind_m).sum(),
            longest_blind_m: summary.driving.iter().map(|driven| driven.longest_blind_m).fold(0.0, f64::max),
            services: summary.services.iter().map(MeasuredService::of).collect(),
            time_parts: MeasuredPart::of(summary),
            losses: MeasuredLoss::of(summary),
            goodput_bps: summary.traffic.iter().map(|its| (its.source.clone(), its.goodput_bps)).collect(),
            bill: Spent::prices(summary),
            energy: Spent::energies(summary),
            regions: summary.regions.iter().map(region).collect(),
        }
    }

    /// Returns the verdict on all services of which the testbed file demands more than a target; `None` without any.
    pub fn verdict(&self) -> Option<Verdict> {
        Verdict::of_all(self.services.iter().map(MeasuredService::verdict))
    }

    /// Returns the figures by the names of the table's columns; `None` where a figure is missing.
    pub(crate) fn figures(&self) -> [Column<Option<f64>>; 20] {
        let count = |n: usize| Some(n as f64);
        [
            total(Total::Duration, Some(self.duration_ms)),
            other("walked", count(usize::from(self.walked))),
            total(Total::Samples, count(self.samples)),
            total(Total::Unanswered, count(self.unanswered)),
            above_target(self.above_target),
            service_time(Statistic::P50, self.service_time_p50_ms),
            service_time(Statistic::P95, self.service_time_p95_ms),
            service_time(Statistic::P99, self.service_time_p99_ms),
            service_time(Statistic::Max, self.service_time_max_ms),
            total(Total::Handovers, count(self.handovers)),
            handover_gap(Statistic::P50, self.handover_gap_p50_ms),
            handover_gap(Statistic::Max, self.handover_gap_max_ms),
            total(Total::Migrations, count(self.migrations)),
            total(Total::PluginFaults, count(self.plugin_faults)),
            total(Total::Applied, count(self.applied)),
            total(Total::Refused, count(self.refused)),
            total(Total::Driven, Some(self.driven_m)),
            total(Total::Blind, Some(self.blind_m)),
            total(Total::LongestBlind, Some(self.longest_blind_m)),
            other("passed", passed(self.verdict())),
        ]
    }
}

impl MeasuredService {
    fn of(summary: &ServiceSummary) -> Self {
        let service_time = |of: fn(&Quantiles) -> f64| summary.service_time_ms.as_ref().map(of);
        Self {
            robot: summary.robot.clone(),
            service: summary.service.clone(),
            in_total: summary.in_total,
            service_time_target_ms: summary.service_time_target_ms,
            samples: summary.samples,
            unanswered: summary.unanswered,
            above_target: summary.above_target,
            service_time_p50_ms: service_time(|q| q.p50),
            service_time_p95_ms: service_time(|q| q.p95),
            service_time_p99_ms: service_time(|q| q.p99),
            service_time_max_ms: service_time(|q| q.max),
            keep: summary.kept.keep,
            kpis: summary.kpis.clone(),
        }
    }

    /// Returns the verdict on all of its KPIs; `None` if nothing is demanded beside the target.
    pub fn verdict(&self) -> Option<Verdict> {
        Verdict::of_all([self.kept().verdict].into_iter().chain(self.kpis.iter().map(|kpi| kpi.verdict)))
    }

    /// Returns the share of samples within the target, and the verdict on it.
    pub fn kept(&self) -> Kept {
        Kept::beside(self.above_target, self.samples, self.keep)
    }

    /// Returns the figures by the names of the table's columns; `None` where a figure is missing.
    pub(crate) fn figures(&self) -> [Column<Option<f64>>; 13] {
        let Kept { kept, kept_low, kept_high, keep, .. } = self.kept();
        [
            other("service_time_target_ms", Some(self.service_time_target_ms)),
            total(Total::Samples, Some(self.samples as f64)),
            total(Total::Unanswered, Some(self.unanswered as f64)),
            above_target(self.above_target),
            service_time(Statistic::P50, self.service_time_p50_ms),
            service_time(Statistic::P95, self.service_time_p95_ms),
            service_time(Statistic::P99, self.service_time_p99_ms),
            service_time(Statistic::Max, self.service_time_max_ms),
            total(Total::Kept, kept),
            other("kept_low", kept_low),
            other("kept_high", kept_high),
            other("keep", keep),
            other("passed", passed(self.verdict())),
        ]
    }
}

/// Returns 1 for PASS and 0 for FAIL.
pub(super) fn passed(verdict: Option<Verdict>) -> Option<f64> {
    verdict.map(|verdict| if verdict == Verdict::Pass { 1.0 } else { 0.0 })
}

#[cfg(test)]
mod tests {
    use cotorra_graph::{FIGURES, FigureKind};

    use super::*;

    #[test]
    fn columns_have_the_names_of_declared_figures() {
        let of = |figure: &cotorra_graph::Declared| match figure.kind {
            FigureKind::Samples => Statistic::ALL.iter().map(|its| figure.column(Some(*its))).collect(),
            FigureKind::Total => vec![figure.column(None)],
        };
        let declared: Vec<String> = FIGURES.iter().flat_map(|figure| of(figure)).collect();
        let others: Vec<_> = Measured::default()
            .figures()
            .into_iter()
            .map(|(name, _)| name)
            .filter(|name| !declared.contains(name))
            .collect();
        assert_eq!(others, ["walked", "above_target", "passed"], "words and a complement of `kept`");
    }
}
