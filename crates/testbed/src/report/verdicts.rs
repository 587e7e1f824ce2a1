//! Verdicts on the KPIs of a summary.

use std::{io, path::Path};

use cotorra_graph::{Bound, Measure, NodeId, Timestamp, Total};
use serde::Deserialize;

use super::{
    folder::{SUMMARY, read_file},
    inference::PolicySummary,
    judged::{Judge, Judged, Kpi, ServiceKpis},
    kept::Verdict,
    summary::{RegionSummary, ServiceSummary, Summary},
    whole::LONGEST_SUMMARY,
};

impl Judge {
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
        let of_robot = |robot: &NodeId| {
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
                    reason: if value.is_none() { self.reason(measure) } else { None },
                }
            }
            Kpi::Radio(standard) => {
                // The check of the testbed file compared the standard, which is the same at all radio units of a network.
                let is_its =
                    |region: &&RegionSummary| region.robot == its.robot && region.attachment.is_some();
                let used =
                    summary.regions.iter().find(is_its).map(|_| "that of the robot's network".to_owned());
                Judged {
                    verdict: Some(if used.is_some() { Verdict::Pass } else { Verdict::Fail }),
                    reason: used.is_none().then(|| "no sample crossed a radio unit".to_owned()),
                    measured: used,
                    ..Judged::without_value(format!("radio {}", standard.described()))
                }
            }
            Kpi::Area => Judged {
                reason: Some("a run shows the places that its robot visits only".to_owned()),
                ..Judged::without_value("area".to_owned())
            },
        }
    }

    /// Returns the reason for which a figure has no value; `None` if nothing was measured.
    fn reason(&self, measure: &Measure) -> Option<String> {
        let Measure::Of(figure, _) = measure else { return None };
        let (unanswered, all) = self.stream(figure)?.unanswered();
        (unanswered > 0).then(|| format!("{unanswered} of {all} samples have no answer"))
    }

    /// Returns the value of a figure in a run; `None` if it was not measured, or is that of samples without an answer.
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

impl ServiceKpis {
    /// Reads the KPIs of all services from a run's folder.
    ///
    /// # Errors
    /// That of the system, if the folder has no `summary.json`; `InvalidData` if the file is not that of a run.
    pub fn of_folder(folder: &Path) -> io::Result<Vec<Self>> {
        #[derive(Deserialize)]
        struct Run {
            services: Vec<ServiceKpis>,
        }
        let run: Run = serde_json::from_slice(&read_file(&folder.join(SUMMARY), LONGEST_SUMMARY)?)?;
        Ok(run.services)
    }
}

impl Judged {
    /// Turns the verdict on a whole run into the reason for which a part of the run has none.
    pub fn of_whole_run(&mut self) {
        if let Some(verdict) = self.verdict.take() {
            self.reason = Some(format!("it is {verdict} over the whole run"));
        }
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
    fn policy(&self, its: &ServiceSummary) -> Option<&PolicySummary> {
        self.inference.as_ref()?.policy(&its.service)
    }

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
            Total::Bill => self.bill.as_ref()?.of(&its.service),
            Total::TotalBill => Some(self.bill.as_ref()?.total_price),
            Total::Energy => self.energy.as_ref()?.of_service(&its.service),
            Total::RobotEnergy => self.energy.as_ref()?.of_robot(&its.robot),
            Total::BatteryLeft => self.energy.as_ref()?.battery_left(&its.robot),
            Total::TotalEnergy => self.energy.as_ref()?.total(),
            Total::ActionAge => Some(self.policy(its)?.action_age_ms?.p95),
            Total::Starved => self.policy(its)?.starved,
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
