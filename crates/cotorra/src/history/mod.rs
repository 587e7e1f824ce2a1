//! `cotorra history`: queries recorded runs. Every answer is bounded, and says how to see more.

mod answer;
mod args;
mod data;
mod diff;
mod drawn;
mod events;
mod gaps;
mod place;
mod plot;
mod prune;
mod regret;
mod runs;
mod series;
mod services;
mod source;
mod state;
mod transfer;

use std::process::ExitCode;

pub use self::{
    args::{EXAMPLES, History, HistoryPlace, Span},
    place::{HISTORY_VARIABLE, Place, location},
    regret::of_folders as regret_of_folders,
    source::{Error as SourceError, Source},
};

/// Answers a query, or exports, imports or prunes a run.
pub fn history(command: &History) -> miette::Result<ExitCode> {
    match command {
        History::Runs(args) => runs::runs(args)?,
        History::State(args) => state::state(args)?,
        History::Series(args) => series::series(args)?,
        History::Events(args) => events::events(args)?,
        History::Diff(args) => diff::diff(args)?,
        History::Regret(args) => regret::regret(args)?,
        History::Data(args) => data::data(args)?,
        History::Gaps(args) => gaps::gaps(args)?,
        History::Export(args) => transfer::export(args)?,
        History::Import(args) => transfer::import(args)?,
        History::Prune(args) => prune::prune(args)?,
    }
    Ok(ExitCode::SUCCESS)
}
