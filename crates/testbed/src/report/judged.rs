//! Verdicts on KPIs: the value of each bounded figure beside its bound.

use std::{cell::LazyCell, collections::BTreeMap, io, path::Path, sync::Arc};

use cotorra_graph::{
    Bound, Figure, Kpis, Measure, ServiceId, Stamped, Testbed, Timestamp, Total, WifiStandard,
};
use serde::{Deserialize, Serialize};

use super::{
    folder::{SUMMARY, read_file},
    in_use::InUse,
    kept::Verdict,
    stream::Stream,
    summary::{ServiceSummary, Summary},
    void::LONGEST_SUMMARY,
};

/// A KPI and the verdict on it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Judged {
    /// The KPI, such as `service_time p95 <= 15 ms`.
    pub kpi: String,
    /// Measured value, in its unit; `None` if nothing was measured, or nothing can be.
    pub value: Option<f64>,
    /// Unit of the value; empty for a share and a bare number.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub unit: String,
    /// The value with its unit, as people read it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub measured: Option<String>,
    /// The verdict; `None` if no run can tell.
    pub verdict: Option<Verdict>,
    /// The reason for which there is no verdict.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
}

/// The KPIs of all services, and the values so far of the figures that they bound.
#[derive(Debug, Default)]
pub(super) struct Judge {
    /// Services with KPIs beside the target, in the file's order.
    services: Vec<(ServiceId, Vec<Kpi>)>,
    streams: Vec<(Figure, Stream)>,
    in_use: Vec<(ServiceId, InUse)>,
}

/// A KPI of a service.
#[derive(Debug)]
enum Kpi {
    /// A bound on a figure.
    Bound(Bound, Measure),
    /// The radio technology, which the check of a testbed file demands of the robot's network.
    Radio(WifiStandard),
    /// The area of the service.
    Area,
}

impl Judge {
    pub(super) fn new(testbed: &Testbed) -> Self {
        let mut judge = Self::default();
        let graph = LazyCell::new(|| Arc::new(testbed.graph.clone()));
        for service in &testbed.services {
            let Kpis { area, radio, .. } = &service.kpis;
            let bounds = service.kpis.bounds().into_iter();
            // A file with other subjects does not pass its check.
            let bounds = bounds.filter_map(|bound| {
                let measure = bound.measure(&service.id, &service.robot).ok()?;
                Some(Kpi::Bound(bound, measure))
            });
            let area = area.as_ref().map(|_| Kpi::Area);
            let kpis: Vec<_> = bounds.chain(radio.map(Kpi::Radio)).chain(area).collect();
            for kpi in &kpis {
                match kpi {
                    Kpi::Bound(_, Measure::Of(figure, _)) if judge.stream(figure).is_none() => {
                        judge.streams.push((figure.clone(), Stream::default()));
                    }
                    Kpi::Bound(_, Measure::Total(Total::Reliability | Total::Cost))
                        if judge.in_use(&service.id).is_none() =>
                    {
                        judge.in_use.push((service.id.clone(), InUse::new(Arc::clone(&graph), service)));
                    }
                    _ => {}
                }
            }
            if !kpis.is_empty() {
                judge.services.push((service.id.clone(), kpis));
            }
        }
        judge
    }

    fn stream(&self, figure: &Figure) -> Option<&Stream> {
        self.streams.iter().find(|(its, _)| its == figure).map(|(_, stream)| stream)
    }

    fn in_use(&self, service: &ServiceId) -> Option<&InUse> {
        self.in_use.iter().find(|(its, _)| its == service).map(|(_, in_use)| in_use)
    }

    pub(super) fn absorb(&mut self, Stamped { event, .. }: &Stamped) {
        for (figure, stream) in &mut self.streams {
            figure.of(event, |value| stream.add(value));
        }
        self.in_use.iter_mut().for_each(|(_, in_use)| in_use.absorb(event));
    }

    /// Judges the services of a summary, and with them its robots and the run.
    pub(super) fn judge(&self, summary: &mut Summary) {
        for (service, kpis) in &self.services {
            let Some(place) = summary.services.iter().position(|its| its.service == *service) else {
                continue;
            };
            let judged = |kpi: &Kpi| self.judged(kpi, summary, &summary.services[place]);
            let judged: Vec<_> = kpis.iter().map(judged).collect();
            let its = &mut summary.services[place];
            its.verdict =
                Verdict::of_all([its.verdict].into_iter().chain(judged.iter().map(|kpi| kpi.verdict)));
            its.kpis = judged;
        }
        let of_robot = |robot: &cotorra_graph::NodeId| {
            let services = summary.services.iter().filter(|its| its.robot == *robot);
            Verdict::of_all(services.map(|its| its.verdict))
        };
        let verdicts: Vec<_> = summary.robots.iter().map(|its| of_robot(&its.robot)).collect();
        summary.robots.iter_mut().zip(verdicts).for_each(|(robot, verdict)| robot.verdict = verdict);
        summary.verdict = Verdict::of_all(summary.services.iter().map(|its| its.verdict));
    }

    fn judged(&self, kpi: &Kpi, summary: &Summary, its: &ServiceSummary) -> Judged {
        match kpi {
            Kpi::Bound(bound, measure) => {
                let value = self.value(measure, summary, its);
                let unit = bound.figure().unit;
                Judged {
                    kpi: bound.to_string(),
                    value,
                    unit: unit.symbol().to_owned(),
                    measured: value.map(|value| unit.describe(value)),
                    verdict: Some(if bound.holds(value) { Verdict::Pass } else { Verdict::Fail }),
                    reason: None,
                }
            }
            Kpi::Radio(standard) => Judged {
                verdict: Some(Verdict::Pass),
                measured: Some("that of the robot's network".to_owned()),
                ..Judged::without_value(format!("radio {}", standard.described()))
            },
            Kpi::Area => Judged {
                reason: Some("a run shows the places that its robot visits only".to_owned()),
                ..Judged::without_value("area".to_owned())
            },
        }
    }

    /// Returns the value of a figure in a run; `None` if it was not measured.
    fn value(&self, measure: &Measure, summary: &Summary, its: &ServiceSummary) -> Option<f64> {
        match measure {
            Measure::Of(figure, statistic) => self.stream(figure)?.of(*statistic),
            Measure::Total(total @ (Total::Reliability | Total::Cost)) => {
                self.in_use(&its.service)?.of(*total)
            }
            Measure::Total(total) => summary.total(*total, its),
        }
    }
}

impl Judged {
    /// Reads the KPIs of all services from a run's folder.
    ///
    /// # Errors
    /// That of the system, if the folder has no `summary.json`; `InvalidData` if the file is not that of a run.
    pub fn of_folder(folder: &Path) -> io::Result<BTreeMap<ServiceId, Vec<Self>>> {
        #[derive(Deserialize)]
        struct Run {
            services: Vec<Service>,
        }
        #[derive(Deserialize)]
        struct Service {
            service: ServiceId,
            #[serde(default)]
            kpis: Vec<Judged>,
        }
        let run: Run = serde_json::from_slice(&read_file(&folder.join(SUMMARY), LONGEST_SUMMARY)?)?;
        Ok(run.services.into_iter().map(|its| (its.service, its.kpis)).collect())
    }

    fn without_value(kpi: String) -> Self {
        Self { kpi, value: None, unit: String::new(), measured: None, verdict: None, reason: None }
    }
}

impl ServiceSummary {
    /// Returns its KPIs beside the target and the demanded share, which has a verdict of its own.
    pub fn further_kpis(&self) -> impl Iterator<Item = &Judged> {
        let share = self.kept.keep.map(|keep| Bound::at_least(Total::Kept, keep).to_string());
        self.kpis.iter().filter(move |judged| Some(&judged.kpi) != share.as_ref())
    }
}

impl Summary {
    /// Returns a figure of which the run has one number; of a service or its robot, if the figure is. `None` if it was not
    /// measured. The reliability and the cost are in no summary.
    pub fn total(&self, total: Total, its: &ServiceSummary) -> Option<f64> {
        let robot = || self.robots.iter().find(|robot| robot.robot == its.robot);
        let driving = || self.driving.iter().find(|driving| driving.robot == its.robot);
        let count = |number: usize| number as f64;
        match total {
            Total::Answered => (its.samples > 0).then(|| 1.0 - count(its.unanswered) / count(its.samples)),
            Total::Kept => its.kept.kept,
            Total::Samples => Some(count(its.samples)),
            Total::Unanswered => Some(count(its.unanswered)),
            Total::Reliability | Total::Cost => None,
            Total::Handovers => robot().map(|robot| count(robot.handovers)),
            Total::Detached => robot().map(|robot| robot.detached_ms),
            Total::Driven => driving().map(|driving| driving.driven_m),
            Total::Blind => driving().map(|driving| driving.blind_m),
            Total::LongestBlind => driving().map(|driving| driving.longest_blind_m),
            Total::Duration => Some(self.duration_ms),
            Total::Migrations => {
                Some(count(self.placements.iter().filter(|its| its.at > Timestamp::ZERO).count()))
            }
            Total::PluginFaults => Some(count(self.plugin_faults.len())),
            Total::Applied => Some(count(self.plugins.iter().map(|plugin| plugin.applied).sum())),
            Total::Refused => Some(count(self.plugins.iter().map(|plugin| plugin.refused).sum())),
        }
    }
}
