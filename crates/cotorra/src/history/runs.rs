//! `cotorra history runs`: lists the runs of a history, or those in folders.

use std::path::Path;

use chrono::{DateTime, Local};
use cotorra_measurements::Run;

use super::args::HistoryRunsArgs;
use super::{
    place::location,
    source::{self, Error, Source},
};
use crate::{output, table::Table, words::clock};

/// Lists runs.
pub fn runs(args: &HistoryRunsArgs) -> miette::Result<()> {
    let named = location(args.place.history.as_ref())?;
    match named {
        Some(location) => {
            let history = source::open(&location)?;
            let limit = args.limit.get();
            let mut runs = history.runs(args.after, limit.saturating_add(1)).map_err(Error::from)?;
            let more = runs.len() > limit;
            runs.truncate(limit);
            let Some(last) = runs.last().map(|run| run.id) else {
                return output::print("no runs\n");
            };
            let mut table = Table::new("<<><>");
            table.row(heads("run"));
            for run in &runs {
                table.row(row(run.id.to_string(), run));
            }
            let rest = if more { format!("... more with --after {last}\n") } else { String::new() };
            output::print(&(table.render("") + &rest))
        }
        None => in_folders(&args.place.runs, args.limit.get()),
    }
}

/// Lists the newest runs of a folder. The newest comes last, where a terminal shows it.
fn in_folders(place: &Path, limit: usize) -> miette::Result<()> {
    let folders = source::folders(place);
    if folders.is_empty() {
        return Err(Error::NoRuns(place.to_owned()).into());
    }
    let older = folders.len().saturating_sub(limit);
    let mut table = Table::new("<<><><");
    table.row(heads("folder").into_iter().chain(["verdict"]));
    for folder in &folders[older..] {
        let name = folder.display().to_string();
        match Source::of_folder(folder, None) {
            Ok(source) => {
                let verdict = source.verdict().map_or("unknown", |verdict| verdict.word());
                table.row(row(name, &source.run).into_iter().chain([verdict.to_owned()]));
            }
            // The other runs are listed nevertheless.
            Err(error) => table.row([name, error.to_string()]),
        }
    }
    let mut text = table.render("");
    if older > 0 {
        text += &format!("... and {older} older: --limit {}\n", folders.len());
    }
    output::print(&text)
}

fn heads(first: &str) -> [&str; 5] {
    [first, "testbed", "seed", "began", "lasted"]
}

fn row(name: String, run: &Run) -> [String; 5] {
    let began = match run.info.started_at_unix_ns {
        0 => "in virtual time".to_owned(),
        ns => {
            let began = DateTime::from_timestamp_nanos(ns).with_timezone(&Local);
            began.format("%Y-%m-%d %H:%M:%S").to_string()
        }
    };
    let lasted = run.ended.map_or("no end".to_owned(), |ended| clock(ended.as_secs_f64()));
    [name, run.info.name.clone(), run.info.seed.to_string(), began, lasted]
}
