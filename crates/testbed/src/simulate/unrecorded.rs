//! A run in virtual time that leaves no files. It returns the summary only.

use std::{sync::Arc, time::Duration};

use cotorra_graph::{Stamped, Testbed, Timestamp};
use cotorra_network_control::InstructionError;

use super::{Altered, Simulation, Stretch};
use crate::{
    clock::wall_clock,
    error::RunError,
    plugins::lockstep::Guarded,
    report::{End, Losses, Report, Summary},
};

/// Events of a run between two calls of `go_on`.
const EVENTS_PER_CHECK: usize = 1000;

/// A finished run with differences from its testbed file.
#[derive(Debug)]
pub struct AlteredRun {
    pub summary: Summary,
    /// The outcome of the fork's alternative; `None` if the run had no fork, or did not reach it.
    pub forked: Option<Result<(), InstructionError>>,
}

/// Runs a testbed in virtual time to the end of its walks, or up to `until`, without a folder or a history. Returns `None`
/// if `go_on` stopped it; it is called now and then.
///
/// # Errors
/// [`RunError`]. A testbed without walks needs an `until`: virtual time has no other end. A plug-in that is a program needs
/// [`simulate`](super::simulate).
pub fn simulate_unrecorded(
    testbed: Arc<Testbed>,
    seed: u64,
    until: Option<Duration>,
    go_on: impl FnMut() -> bool,
) -> Result<Option<Summary>, RunError> {
    let run = simulate_altered(testbed, seed, until, &Altered::default(), |_| {}, go_on)?;
    Ok(run.map(|run| run.summary))
}

/// Does the same as [`simulate_unrecorded`] with differences from the testbed file. Calls `observe` with each event.
///
/// # Errors
/// Those of [`simulate_unrecorded`].
pub fn simulate_altered(
    testbed: Arc<Testbed>,
    seed: u64,
    until: Option<Duration>,
    altered: &Altered,
    mut observe: impl FnMut(&Stamped),
    mut go_on: impl FnMut() -> bool,
) -> Result<Option<AlteredRun>, RunError> {
    let until = until.map(|until| Timestamp::ZERO + until);
    if until.is_none() && testbed.walks.is_empty() {
        return Err(RunError::Endless);
    }
    let simulation = Simulation::new(Arc::clone(&testbed), seed)?.altered(altered);
    let mut simulation = Guarded::new(simulation, wall_clock());
    let mut report = Report::new(&testbed, seed);
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
            _ if !go_on() => return Ok(None),
            _ => continue,
        };
        let summary = report.summary(now, end.as_str(), Losses::default());
        return Ok(Some(AlteredRun { summary, forked: simulation.forked().cloned() }));
    }
}
