//! Service times of a recorded run by robot and service: a table, and a verdict on each.

use std::ops::Bound;

use cotorra_graph::{Event, Stamped, Timestamp};
use cotorra_measurements::PageRequest;
use cotorra_testbed::{Report, ServiceParts, ServiceSummary, by_service};

use super::source::{Error, Source};
use crate::{table::Table, testbed_file, verdict::verdicts};

/// Describes the services of a run in a range of time. A plot describes the figures of a single one.
pub fn services(source: &Source, range: (Bound<Timestamp>, Bound<Timestamp>)) -> Result<String, Error> {
    let info = &source.run.info;
    // A run of another machine may lack its map.
    let testbed = match testbed_file::recorded(&info.testbed, &info.name, &source.base(None), None) {
        Ok(testbed) => testbed,
        Err(wrong) => return Ok(format!("services are not listed: {wrong}\n")),
    };
    let mut report = Report::new(&testbed, info.seed);
    let mut request = PageRequest::first(PageRequest::MAX);
    loop {
        let page = source.history.service_times(source.run.id, range, request)?;
        for sample in page.items {
            report.absorb(&Stamped { at: sample.at, event: Event::ServiceTime(sample.value) });
        }
        let Some(next) = page.next else { break };
        request = PageRequest::after(next, PageRequest::MAX);
    }
    Ok(describe(&report.services(), &report.time_parts()))
}

fn describe(services: &[ServiceSummary], parts: &[ServiceParts]) -> String {
    let table = match services {
        [] | [_] => String::new(),
        several => Table::of(by_service(several).rows(), 2).render("  ") + "\n",
    };
    verdicts(services, parts).iter().fold(table, |text, verdict| text + "  " + verdict + "\n")
}
