//! A run in virtual time that leaves no files. It returns the summary only.

use std::{fs, path::Path, sync::Arc, time::Duration};

use cotorra_graph::{Stamped, Testbed, Timestamp};
use cotorra_network_control::InstructionError;

use super::{
    Altered, Simulation, Stretch,
    run::{Conduct, simulate_with},
};
use crate::{
    clock::wall_clock,
    error::RunError,
    options::Options,
    plugins::{
        lockstep::{Guarded, PATIENCE},
        programs, reads_history,
    },
    report::{End, Losses, Place, Report, Summary},
};

/// Events of a run between two calls of `go_on`.
const EVENTS_PER_CHECK: usize = 1000;

/// A run of which only results stay.
#[derive(Debug, Clone, Copy)]
pub struct Unrecorded<'a> {
    pub seed: u64,
    /// End of the run; by default that of its walks.
    pub until: Option<Duration>,
    /// Differences from the testbed file.
    pub altered: &'a Altered,
    /// Folder of the run, if a plug-in is a program. It is removed at the end, but stays with the program's log if a
    /// plug-in was cut off. Whatever it held before is lost.
    pub folder: &'a Path,
    /// Text of the testbed file, for the folder.
    pub text: &'a str,
}

/// The result of a run of which only results stay.
#[derive(Debug)]
pub struct UnrecordedRun {
    pub summary: Summary,
    /// The outcome of the fork's alternative; `None` if the run had no fork, or did not reach it.
    pub forked: Option<Result<(), InstructionError>>,
}

/// Runs a testbed in virtual time to the end of its walks, or up to `until`. Calls `observe` with each event. Returns `None`
/// if `go_on` stopped it; it is called now and then.
///
/// # Errors
/// [`RunError`]. A testbed without walks needs an `until`: virtual time has no other end.
pub fn simulate_unrecorded(
    testbed: Arc<Testbed>,
    run: &Unrecorded<'_>,
    observe: impl FnMut(&Stamped),
    go_on: impl FnMut() -> bool,
) -> Result<Option<UnrecordedRun>, RunError> {
    if programs(&testbed).next().is_some() || reads_history(&testbed) {
        in_folder(testbed, run, observe, go_on)
    } else {
        in_memory(testbed, run, observe, go_on)
    }
}

fn in_memory(
    testbed: Arc<Testbed>,
    run: &Unrecorded<'_>,
    mut observe: impl FnMut(&Stamped),
    mut go_on: impl FnMut() -> bool,
) -> Result<Option<UnrecordedRun>, RunError> {
    let until = run.until.map(|until| Timestamp::ZERO + until);
    if until.is_none() && testbed.walks.is_empty() {
        return Err(RunError::Endless);
    }
    let simulation = Simulation::new(Arc::clone(&testbed), run.seed)?.altered(run.altered);
    let mut simulation = Guarded::new(simulation, wall_clock());
    let mut report = Report::new(&testbed, run.seed).in_virtual_time(&testbed);
    loop {
        simulation.go(Stretch::Events(EVENTS_PER_CHECK, until));
        if !simulation.run(&mut go_on) {
            return Ok(None);
        }
        while let Some(event) = simulation.poll_event() {
            report.absorb(&event);
            observe(&event);
        }
        let (now, end) = match until {
            _ if simulation.is_finished() => (simulation.now(), End::Walked),
            Some(until) if simulation.now() >= until => (simulation.now(), End::Until),
            None if simulation.is_stuck() => {
                report.stuck(simulation.stand());
                (simulation.now(), End::NoProgress)
            }
            _ if !go_on() => return Ok(None),
            _ => continue,
        };
        report.carried(simulation.traffic());
        report.computed(simulation.computed());
        report.sent(simulation.airtimes());
        report.inferred(simulation.inferred());
        report.migrated(simulation.migrated());
        let summary = report.summary(now, end.as_str(), Losses::default());
        return Ok(Some(UnrecordedRun { summary, forked: simulation.forked().cloned() }));
    }
}

/// Runs a testbed whose plug-ins are programs or read the history. Programs need the API, which needs a history and logs.
fn in_folder(
    testbed: Arc<Testbed>,
    run: &Unrecorded<'_>,
    mut observe: impl FnMut(&Stamped),
    mut go_on: impl FnMut() -> bool,
) -> Result<Option<UnrecordedRun>, RunError> {
    // A killed process may have left it.
    let _ = fs::remove_dir_all(run.folder);
    let folder = Place::At(run.folder.to_owned());
    let options = Options { seed: Some(run.seed), until: run.until, folder, ..Options::default() };
    let (patience, wall, altered) = (PATIENCE, wall_clock(), run.altered);
    let conduct = Conduct { patience, wall, altered, observe: &mut observe, watched: None };
    let (finished, forked) = simulate_with(testbed, run.text, &options, conduct, |_| go_on())?;
    if finished.was_stopped() || finished.summary.void.wrong().is_none() {
        // The folder is not needed any more; failing to remove it does no harm.
        let _ = fs::remove_dir_all(run.folder);
    }
    Ok((!finished.was_stopped()).then_some(UnrecordedRun { summary: finished.summary, forked }))
}
