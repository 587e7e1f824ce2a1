//! The difference that one change makes to services: the figures of two runs with the same seed side by side, and their
//! difference with an interval over blocks of time.

mod paired;

use std::{collections::BTreeMap, time::Duration};

use cotorra_graph::{Event, NodeId, ServiceId, Timestamp, millis};
use cotorra_numbers::quantile;
use serde::{Deserialize, Serialize};

use self::paired::Paired;
use crate::{
    Kind, RunId,
    difference::Targets,
    error::Result,
    page::pages,
    store::{Selection, Span, Store},
};

const EVER: Span = Span { from: 0, until: i64::MAX };

/// Figures of a service in one run.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ServiceFigures {
    /// Number of samples, unanswered ones included.
    pub samples: usize,
    /// Share of samples above the target. Unanswered ones count as above it. `None` without samples.
    pub above_target: Option<f64>,
    /// Median of answered samples, ms.
    pub service_time_p50_ms: Option<f64>,
    /// 99th percentile of answered samples, ms.
    pub service_time_p99_ms: Option<f64>,
}

/// The figure of one run, less that of the other.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Apart {
    /// The difference.
    pub difference: f64,
    /// Lower end of the interval (95 %); `None` if the runs are too short for one.
    pub low: Option<f64>,
    /// Upper end.
    pub high: Option<f64>,
}

/// Differences of a service's figures; `None` where a run has no figure.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct FiguresApart {
    /// Of the share above the target.
    pub above_target: Option<Apart>,
    /// Of the median, ms.
    pub service_time_p50_ms: Option<Apart>,
    /// Of the 99th percentile, ms.
    pub service_time_p99_ms: Option<Apart>,
}

/// A service in two runs with the same seed, of which one has what may be regretted.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ServiceRegret {
    /// The service.
    pub service: ServiceId,
    /// Its robot.
    pub robot: NodeId,
    /// Its target, ms.
    pub service_time_target_ms: f64,
    /// Its figures in the run with what may be regretted.
    pub with: ServiceFigures,
    /// Its figures in the run without it.
    pub without: ServiceFigures,
    /// The former less the latter.
    pub regret: FiguresApart,
}

/// Service times of one service in one run.
#[derive(Debug, Clone, Default)]
pub struct ServiceTimes(Vec<Took>);

/// A service time.
#[derive(Debug, Clone, Copy)]
struct Took {
    emitted: Timestamp,
    /// `None` without an answer.
    ms: Option<f64>,
}

impl ServiceTimes {
    /// Adds a sample, by the time of its emission; `None` without an answer.
    pub fn add(&mut self, emitted: Timestamp, took: Option<Duration>) {
        self.0.push(Took { emitted, ms: took.map(millis::of) });
    }

    /// Returns the figures of the samples. A sample at the target is not above it.
    pub fn figures(&self, target_ms: f64) -> ServiceFigures {
        let mut answered: Vec<f64> = self.0.iter().filter_map(|took| took.ms).collect();
        answered.sort_unstable_by(f64::total_cmp);
        let samples = self.0.len();
        let above = self.0.iter().filter(|took| took.is_above(target_ms)).count();
        ServiceFigures {
            samples,
            above_target: (samples > 0).then(|| above as f64 / samples as f64),
            service_time_p50_ms: quantile(&answered, 0.5),
            service_time_p99_ms: quantile(&answered, 0.99),
        }
    }
}

impl Took {
    fn is_above(&self, target_ms: f64) -> bool {
        self.ms.is_none_or(|ms| ms > target_ms)
    }
}

/// The service times of a run, by service and robot.
type Times = BTreeMap<(ServiceId, NodeId), ServiceTimes>;

/// Compares the services of two runs. A service without a target, or without samples in both, is left out.
pub(crate) fn regrets(
    with: (&dyn Store, RunId),
    without: (&dyn Store, RunId),
    targets: &Targets,
) -> Result<Vec<ServiceRegret>> {
    let [with, mut without] = [times(with)?, times(without)?];
    let mut both: BTreeMap<_, _> = with
        .into_iter()
        .map(|(of, times)| (of.clone(), [times, without.remove(&of).unwrap_or_default()]))
        .collect();
    both.extend(without.into_iter().map(|(of, times)| (of, [ServiceTimes::default(), times])));
    let regret = |((service, robot), [with, without]): (_, [ServiceTimes; 2])| {
        let service_time_target_ms = millis::of(*targets.get(&service)?);
        let figures = [&with, &without].map(|times| times.figures(service_time_target_ms));
        let regret = Paired::new([&with.0, &without.0], service_time_target_ms).apart(figures);
        let [with, without] = figures;
        Some(ServiceRegret { service, robot, service_time_target_ms, with, without, regret })
    };
    Ok(both.into_iter().filter_map(regret).collect())
}

fn times((store, run): (&dyn Store, RunId)) -> Result<Times> {
    let mut all = Times::new();
    pages(
        |page| store.events(run, &Selection::Kinds(&[Kind::ServiceTime]), EVER, page),
        |stamped| {
            if let Event::ServiceTime(sample) = stamped.event {
                all.entry((sample.service, sample.robot)).or_default().add(sample.emitted, sample.took);
            }
        },
    )?;
    Ok(all)
}
