//! Service times of a recorded run by robot and service: a table, and a verdict on each.

use std::ops::Bound;

use cotorra_graph::{Event, ServiceId, Stamped, Testbed, Timestamp};
use cotorra_measurements::PageRequest;
use cotorra_testbed::{Judged, Report, ServiceParts, ServiceSummary, Verdict, by_service};
use cotorra_testbed_file::Diagnostics;

use super::source::{Error, Source};
use crate::{
    service_table::service_table,
    table::{columns, wrap},
    testbed_file,
    verdict::{by_name, verdicts},
};

/// Returns the service that stands for all of the run, or of a robot, because no other is in the total; `None` if there are
/// several.
pub fn only_service(source: &Source, robot: Option<&str>) -> Option<ServiceId> {
    let testbed = testbed(source).ok()?;
    let mut services = testbed
        .services_in_total()
        .filter(|service| robot.is_none_or(|robot| service.robot.as_str() == robot));
    let first = services.next()?.id.clone();
    services.next().is_none().then_some(first)
}

/// Whether the run has services that its total leaves out.
pub fn has_services_apart(source: &Source) -> bool {
    testbed(source).is_ok_and(|testbed| testbed.services_in_total().count() < testbed.services.len())
}

/// Parses the testbed file of a run. One of another machine may lack its map.
pub fn testbed(source: &Source) -> Result<Testbed, Diagnostics> {
    let info = &source.run.info;
    testbed_file::recorded(&info.testbed, &info.name, &source.base(None), None)
}

/// Describes the services of a run in a range of time, with the verdicts that the whole run got for its KPIs. A plot describes the figures of a single one.
pub fn services(source: &Source, range: (Bound<Timestamp>, Bound<Timestamp>)) -> Result<String, Error> {
    let testbed = match testbed(source) {
        Ok(testbed) => testbed,
        Err(wrong) => return Ok(format!("services are not listed: {wrong}\n")),
    };
    let mut report = Report::new(&testbed, source.run.info.seed);
    let mut request = PageRequest::first(PageRequest::MAX);
    loop {
        let page = source.history.service_times(source.run.id, range, request)?;
        for sample in page.items {
            report.absorb(&Stamped { at: sample.at, event: Event::ServiceTime(sample.value) });
        }
        let Some(next) = page.next else { break };
        request = PageRequest::after(next, PageRequest::MAX);
    }
    let (mut services, mut kpis) = (report.services(), source.kpis());
    let is_whole = range == (Bound::Unbounded, Bound::Unbounded);
    for its in &mut services {
        its.kpis = kpis.remove(&its.service).unwrap_or_default();
        if !is_whole {
            its.kpis.iter_mut().for_each(Judged::of_whole_run);
        }
        let verdicts = its.kpis.iter().map(|kpi| kpi.verdict);
        its.verdict = Verdict::of_all(verdicts.chain([its.verdict]));
    }
    Ok(describe(&services, &report.time_parts()))
}

fn describe(services: &[ServiceSummary], parts: &[ServiceParts]) -> String {
    let table = match services {
        [] | [_] => String::new(),
        several => {
            let shown = by_name(several);
            let is_shown = |service: &str| shown.iter().any(|its| its.service == *service);
            service_table(&by_service(several), is_shown) + "\n"
        }
    };
    verdicts(services, parts).iter().fold(table, |text, verdict| text + &wrap(verdict, "  ", columns()))
}
