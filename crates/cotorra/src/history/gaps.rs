//! `cotorra history gaps`: the parts of a run whose events were lost.

use cotorra_measurements::{Gap, PageRequest};

use super::{
    answer::{more, seconds},
    args::GapsArgs,
    source::{Error, Source},
};
use crate::{output, table::Table};

/// Lists gaps.
pub fn gaps(args: &GapsArgs) -> miette::Result<()> {
    let source = Source::find(&args.run, &args.place)?;
    let request = PageRequest { limit: args.page.limit.get(), after: args.page.after };
    let page = source.history.gaps(source.run.id, args.span.range(), request).map_err(Error::from)?;
    if page.items.is_empty() && args.page.after.is_none() {
        return output::print("no events were lost in that time\n");
    }
    let mut table = Table::new(">>>");
    table.row(["from, s", "to, s", "events lost"]);
    for Gap { from, until, events } in &page.items {
        table.row([seconds(*from), seconds(*until), events.to_string()]);
    }
    output::print(&(table.render("") + &more(&page)))
}
