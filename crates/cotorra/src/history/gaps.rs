//! `cotorra history gaps`: the parts of a run whose events were lost, and those without samples.

use cotorra_graph::Timestamp;
use cotorra_measurements::{Gap, PageRequest, Silence};
use cotorra_testbed::sampled_services;

use super::{
    answer::{first_of, more, seconds},
    args::GapsArgs,
    services::testbed,
    source::{Error, Source},
};
use crate::{output, table::Table};

/// Lists gaps. What came after the last event of a run without an end is unknown.
pub fn gaps(args: &GapsArgs) -> miette::Result<()> {
    let source = Source::find(&args.run, &args.place)?;
    let lost = lost(args, &source)?;
    // Later pages go on with lost events only.
    let silences = if args.page.after.is_none() { silences(args, &source)? } else { String::new() };
    output::print(&(lost + &silences))
}

fn lost(args: &GapsArgs, source: &Source) -> Result<String, Error> {
    let Source { history, run, .. } = source;
    let request = PageRequest { limit: args.page.limit.get(), after: args.page.after };
    let page = history.gaps(run.id, args.span.range(), request)?;
    let known = history.known_until(run.id)?;
    let is_after_known = |end: Option<_>| end.is_none_or(|end| Timestamp::ZERO + end > known);
    let unknown = (run.ended.is_none() && is_after_known(args.span.to)).then(|| seconds(known));
    let mut text = String::new();
    if !page.items.is_empty() || args.page.after.is_some() {
        let mut table = Table::new(">>>");
        table.row(["from, s", "to, s", "events lost"]);
        for Gap { from, until, events } in &page.items {
            table.row([seconds(*from), seconds(*until), events.to_string()]);
        }
        text += &(table.render("") + &more(&page));
    } else {
        text += &match &unknown {
            None => "no events were lost in that time\n".to_owned(),
            Some(known) => format!("no events were lost up to {known} s\n"),
        };
    }
    if let Some(known) = unknown {
        text += &format!(
            "how many were lost after {known} s is unknown: the run has no end, because it goes on, was killed, or could \
             not write its history\n"
        );
    }
    Ok(text)
}

fn silences(args: &GapsArgs, source: &Source) -> Result<String, Error> {
    let testbed = testbed(source);
    let expected = testbed.iter().flat_map(sampled_services);
    let expected = expected.map(|service| (service.id.clone(), service.robot.clone()));
    let silences = source.history.silences(source.run.id, expected, args.span.range())?;
    let mut text = String::new();
    if silences.is_empty() {
        text += "no service stopped sampling in that time\n";
    } else {
        let shown = silences.len().min(args.page.limit.get());
        let mut table = Table::new(">><");
        table.row(["from, s", "to, s", "no samples of"]);
        for Silence { service, from, until } in &silences[..shown] {
            let what = service.as_ref().map(|(service, robot)| format!("{service} of {robot}"));
            table.row([seconds(*from), seconds(*until), what.unwrap_or_else(|| "anything".to_owned())]);
        }
        text += &format!("\n{}", table.render(""));
        first_of(&mut text, shown, silences.len(), "--limit shows them");
    }
    if let Err(wrong) = testbed {
        text += &format!("services without any sample are not listed: {wrong}\n");
    }
    Ok(text)
}
