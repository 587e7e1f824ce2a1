//! `cotorra history events`: lists events, one on each line.

use std::fmt::Write as _;

use cotorra_measurements::{Kind, PageRequest};

use super::{
    answer::{more, seconds},
    args::EventsArgs,
    source::{Error, Source},
};
use crate::output;

/// Lists events.
pub fn events(args: &EventsArgs) -> miette::Result<()> {
    let source = Source::find(&args.run, &args.place)?;
    let request = PageRequest { limit: args.page.limit.get(), after: args.page.after };
    let page =
        source.history.events(source.run.id, &args.kinds, args.span.range(), request).map_err(Error::from)?;
    let mut text = String::new();
    for event in &page.items {
        let line = if args.json {
            serde_json::to_string(event).expect("an event holds only what JSON can")
        } else {
            let at = seconds(event.at);
            format!("{at:>10} s  {:<14} {}", Kind::of(&event.event).as_str(), event.event.text())
        };
        writeln!(text, "{line}").expect("writing into a string cannot fail");
    }
    output::print_either(args.json, &text)?;
    // On standard error, so that a program that reads standard output reads only events.
    if page.items.is_empty() {
        note!("no events in that time");
    }
    output::write_note(format_args!("{}", more(&page)));
    Ok(())
}
