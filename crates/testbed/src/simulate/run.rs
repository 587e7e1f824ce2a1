//! A whole run in virtual time: what a run leaves, in a folder.

use std::sync::Arc;

use cotorra_graph::{Testbed, Timestamp};
use cotorra_measurements::{History, RunInfo};

use super::Simulation;
use crate::{
    core_loop::End,
    report::{Losses, Report, RunFolder},
    run::{Finished, Options, RunError},
};

/// After so many events the history is waited for, which virtual time would leave behind.
const HISTORY_PACE: usize = 10_000;

/// Runs a testbed in virtual time to the end of its walks, or up to `options.until`, and leaves what a run leaves; gives
/// what it came to. `go_on` is asked now and then, with the time, whether to. The API is not served.
///
/// The same testbed, seed and version give the same bytes in every file but the log.
///
/// # Errors
/// [`RunError`]. A testbed without walks needs an `until`: virtual time has no other end.
pub fn simulate(
    testbed: Testbed,
    text: &str,
    options: &Options,
    mut go_on: impl FnMut(Timestamp) -> bool,
) -> Result<Finished, RunError> {
    let testbed = Arc::new(testbed);
    let seed = options.seed.unwrap_or(testbed.seed);
    let until = options.until.map(|until| Timestamp::ZERO + until);
    if until.is_none() && testbed.walks.is_empty() {
        return Err(RunError::Endless);
    }
    let mut simulation = Simulation::new(Arc::clone(&testbed), seed)?;
    let folder = RunFolder::create(&options.folder, &testbed.name, text)?;
    let history = History::open(folder.history())?;
    // The calendar is not part of virtual time.
    let info = RunInfo { name: testbed.name.clone(), seed, started_at_unix_ns: 0, testbed: text.to_owned() };
    let run = history.begin_run(&info)?;
    let recorder = history.recorder(run)?;
    let mut report = Report::new(&testbed, seed);
    let mut unwritten = 0;
    let (now, end) = loop {
        let now = simulation.step();
        while let Some(event) = simulation.poll_event() {
            report.absorb(&event);
            recorder.record(event);
            unwritten += 1;
        }
        if unwritten >= HISTORY_PACE {
            unwritten = 0;
            recorder.flush()?;
            if !go_on(now) {
                break (now, End::Stopped);
            }
        }
        if simulation.is_finished() {
            break (now, End::Walked);
        }
        if until.is_some_and(|until| now >= until) {
            break (now, End::Until);
        }
    };
    recorder.flush()?;
    let losses = Losses { frames_dropped: 0, history_dropped: recorder.stats().dropped };
    let summary = report.summary(now, end.as_str(), losses);
    folder.write_report(&report, &summary)?;
    history.end_run(run, now)?;
    Ok(Finished { summary, report, folder: folder.path().to_owned() })
}
