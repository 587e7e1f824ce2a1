//! `cotorra experiment`: repeats a published experiment, and shows the result beside the published one.

mod args;
mod federation;
mod folder;
mod okpi;

use std::process::ExitCode;

pub use args::Experiment;

/// Runs an experiment.
pub fn experiment(experiment: &Experiment) -> miette::Result<ExitCode> {
    match experiment {
        Experiment::Okpi(args) => okpi::okpi(args),
        Experiment::Federation(args) => federation::federation(args),
    }
}
