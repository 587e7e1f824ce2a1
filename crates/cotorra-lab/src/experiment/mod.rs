//! `cotorra-lab experiment`: repeats a published experiment, and shows the result beside the published one; or compares kinds of
//! radio.

pub mod args;
mod bundled;
mod federation;
mod folder;
mod handover;
mod okpi;

use std::process::ExitCode;

use cotorra::note;
use cotorra_testbed::Finished;
use miette::IntoDiagnostic;

use args::{Experiment, FederationArgs, HandoverArgs, OkpiArgs};
use bundled::Bundled;

/// Says what is wrong with a run of an experiment.
fn tell_faults(name: &str, finished: &Finished) {
    let Finished { summary, unrecorded, .. } = finished;
    summary.void.reasons().for_each(|reason| note!("{name}: NOT VALID: {reason}"));
    summary.no_progress.iter().for_each(|stand| note!("{name}: {}: {stand}", summary.ended));
    unrecorded.iter().for_each(|what| note!("{name}: not recorded: {what}"));
}

/// Whether a run of an experiment was void.
pub fn is_void(error: &miette::Report) -> bool {
    error.is::<folder::VoidRun>()
}

/// Runs an experiment. `given` are the words of the command line that have a part in results.
pub fn experiment(mut experiment: Experiment, given: Vec<String>) -> miette::Result<ExitCode> {
    let (Experiment::Okpi(OkpiArgs { testbed, walks, .. })
    | Experiment::Federation(FederationArgs { testbed, walks, .. })
    | Experiment::Handover(HandoverArgs { testbed, walks, .. })) = &mut experiment;
    walks.given = given;
    let _bundled = Bundled::instead_of(testbed).into_diagnostic()?;
    match &experiment {
        Experiment::Okpi(args) => okpi::okpi(args),
        Experiment::Federation(args) => federation::federation(args),
        Experiment::Handover(args) => handover::handover(args),
    }
}
