//! `cotorra history`: asks what runs recorded. Every answer is bounded, and says how to see more.

mod args;
mod data;
mod diff;
mod events;
mod place;
mod plot;
mod prune;
mod runs;
mod series;
mod source;
mod state;
mod transfer;

use std::{fmt::Write as _, ops::Bound, process::ExitCode};

use cotorra_graph::Timestamp;
use cotorra_measurements::{Cursor, Gap, Page, PageRequest};

use self::args::GapsArgs;
pub use self::{
    args::{EXAMPLES, History, HistoryPlace, Span},
    place::{HISTORY_VARIABLE, Place, location},
    source::{Error, Source, folder},
};
use crate::{output, table::Table};

/// Answers.
pub fn history(question: &History) -> miette::Result<ExitCode> {
    match question {
        History::Runs(args) => runs::runs(args)?,
        History::State(args) => state::state(args)?,
        History::Series(args) => series::series(args)?,
        History::Events(args) => events::events(args)?,
        History::Diff(args) => diff::diff(args)?,
        History::Data(args) => data::data(args)?,
        History::Gaps(args) => gaps(args)?,
        History::Export(args) => transfer::export(args)?,
        History::Import(args) => transfer::import(args)?,
        History::Prune(args) => prune::prune(args)?,
    }
    Ok(ExitCode::SUCCESS)
}

impl Span {
    fn range(&self) -> (Bound<Timestamp>, Bound<Timestamp>) {
        let at = |after_start| Timestamp::ZERO + after_start;
        let end = self.to.map_or(Bound::Unbounded, |to| Bound::Excluded(at(to)));
        (self.from.map_or(Bound::Unbounded, |from| Bound::Included(at(from))), end)
    }
}

/// Where events were lost.
fn gaps(args: &GapsArgs) -> miette::Result<()> {
    let source = Source::find(&args.run, &args.place)?;
    let request = PageRequest { limit: args.page.limit.get(), after: args.page.after };
    let page = source.history.gaps(source.run.id, args.span.range(), request).map_err(Error::from)?;
    if page.items.is_empty() && args.page.after.is_none() {
        return output::print("nothing was lost in that time\n");
    }
    let mut table = Table::new(">>>");
    table.row(["from, s", "to, s", "events lost"]);
    for Gap { from, until, events } in &page.items {
        table.row([seconds(*from), seconds(*until), events.to_string()]);
    }
    output::print(&(table.render("") + &more(&page)))
}

/// A moment in seconds, to the millisecond.
fn seconds(at: Timestamp) -> String {
    format!("{:.3}", at.as_secs_f64())
}

/// How to see what comes after a page; nothing if that was all.
fn more<T>(page: &Page<T>) -> String {
    page.next.map(|next: Cursor| format!("... more with --after {next}\n")).unwrap_or_default()
}

/// Joins lines of which only so many are shown.
fn first_of(text: &mut String, shown: usize, of: usize, how: &str) {
    if of > shown {
        writeln!(text, "  ... and {} more: {how}", of - shown).expect("writing into a string cannot fail");
    }
}
