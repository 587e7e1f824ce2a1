//! KPIs and the verdicts on them, and the values of the figures that they bound.

use std::{cell::LazyCell, sync::Arc};

use cotorra_graph::{Bound, Event, Figure, Kpis, Measure, ServiceId, Stamped, Testbed, Total, WifiStandard};
use serde::{Deserialize, Serialize};

use super::{in_use::InUse, kept::Verdict, stream::Stream};

/// A KPI and the verdict on it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
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
    /// The reason for which there is no verdict, or no value.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
}

/// The KPIs of a service in a recorded run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct ServiceKpis {
    pub service: ServiceId,
    /// Its KPIs beside the target.
    #[serde(default)]
    pub kpis: Vec<Judged>,
}

/// The KPIs of all services, and the values so far of the figures that they bound.
#[derive(Debug, Default)]
pub(super) struct Judge {
    /// Services with KPIs beside the target, in the file's order.
    pub(super) services: Vec<(ServiceId, Vec<Kpi>)>,
    streams: Vec<(Figure, Stream)>,
    in_use: Vec<(ServiceId, InUse)>,
}

/// A KPI of a service.
#[derive(Debug)]
pub(super) enum Kpi {
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

    pub(super) fn stream(&self, figure: &Figure) -> Option<&Stream> {
        self.streams.iter().find(|(its, _)| its == figure).map(|(_, stream)| stream)
    }

    pub(super) fn in_use(&self, service: &ServiceId) -> Option<&InUse> {
        self.in_use.iter().find(|(its, _)| its == service).map(|(_, in_use)| in_use)
    }

    pub(super) fn absorb(&mut self, Stamped { event, .. }: &Stamped) {
        for (figure, stream) in &mut self.streams {
            figure.of(event, |value| stream.add(value));
            if is_unanswered(figure, event) {
                stream.add_unanswered();
            }
        }
        self.in_use.iter_mut().for_each(|(_, in_use)| in_use.absorb(event));
    }
}

/// Whether an event is a sample of a service time that has no answer.
fn is_unanswered(figure: &Figure, event: &Event) -> bool {
    let (Figure::ServiceTime { service, robot }, Event::ServiceTime(sample)) = (figure, event) else {
        return false;
    };
    sample.took.is_none()
        && service.as_ref().is_none_or(|service| *service == sample.service)
        && robot.as_ref().is_none_or(|robot| *robot == sample.robot)
}
