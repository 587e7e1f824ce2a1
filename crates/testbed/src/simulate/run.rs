//! A whole run in virtual time: what a run leaves, in a folder.

use std::{sync::Arc, time::Duration};

use cotorra_graph::{Stamped, Testbed, Timestamp};
use cotorra_measurements::{PacedRecorder, RunInfo};
use cotorra_recording::{Pace, Recording, Tap};

use super::{
    Simulation,
    apart::{Apart, Asked},
};
use crate::{
    core_loop::End,
    plugins,
    recorded::Recorded,
    report::{Losses, Report, RunFolder},
    run::{Finished, Options, RunError, about},
};

/// After so many events they are written.
const HISTORY_PACE: usize = 10_000;

/// A program that says nothing for so long while time waits for it counts as hung.
const PATIENCE: Duration = Duration::from_secs(60);

/// Runs a testbed in virtual time to the end of its walks, or up to `options.until`, and leaves what a run leaves; gives
/// what it came to. `go_on` is asked now and then, with the time, whether to. The API is served where a plug-in is a
/// program of its own, which time waits for; by default on any free port of 127.0.0.1.
///
/// The same testbed, seed and version give the same bytes in every file but the log.
///
/// # Errors
/// [`RunError`]. A testbed without walks needs an `until`: virtual time has no other end.
pub fn simulate(
    testbed: Testbed,
    text: &str,
    options: &Options,
    go_on: impl FnMut(Timestamp) -> bool,
) -> Result<Finished, RunError> {
    simulate_with(testbed, text, options, PATIENCE, go_on)
}

/// The same with another patience for programs.
pub(super) fn simulate_with(
    testbed: Testbed,
    text: &str,
    options: &Options,
    patience: Duration,
    mut go_on: impl FnMut(Timestamp) -> bool,
) -> Result<Finished, RunError> {
    let testbed = Arc::new(testbed);
    let seed = options.seed.unwrap_or(testbed.seed);
    let until = options.until.map(|until| Timestamp::ZERO + until);
    if until.is_none() && testbed.walks.is_empty() {
        return Err(RunError::Endless);
    }
    plugins::check_programs(&testbed)?;
    let mut simulation = Simulation::without_programs(Arc::clone(&testbed), seed)?;
    let folder = RunFolder::create(&options.folder, &testbed.name, text)?;
    // The calendar is not part of virtual time.
    let info = RunInfo { name: testbed.name.clone(), seed, started_at_unix_ns: 0, testbed: text.to_owned() };
    let recording =
        Recording::begin(&options.recording, folder.path(), &testbed, about(&info), Pace::Waiting)?;
    let tap = recording.as_ref().map(Recording::tap);
    if tap.is_some() {
        simulation.tap_scans();
    }
    let (history, run) = Recorded::begin(&folder, options.history.as_ref(), &info)?;
    let history = Arc::new(history);
    let recorder = history.paced_recorder(run)?;
    let mut books = Books { report: Report::new(&testbed, seed), recorder, unwritten: 0, tap };
    let asked =
        Asked { testbed: &testbed, history: &history, run, recorder: &books.recorder, logs: &folder.logs() };
    let mut apart = Apart::start(&asked, options, patience)?;
    let mut now = Timestamp::ZERO;
    let end = loop {
        // Before the first step, too: programs are there when it begins.
        if let Some(apart) = &mut apart
            && !apart.settle(now, &mut simulation, &mut |event| books.keep(event), &mut go_on)
        {
            break End::Stopped;
        }
        if simulation.is_finished() {
            break End::Walked;
        }
        if until.is_some_and(|until| now >= until) {
            break End::Until;
        }
        now = simulation.step();
        while let Some(event) = simulation.poll_event() {
            if let Some(apart) = &mut apart {
                apart.publish(&event);
            }
            books.keep(event);
        }
        if let Some(tap) = &books.tap {
            while let Some(scan) = simulation.poll_scan() {
                tap.scan(scan);
            }
        }
        if books.unwritten >= HISTORY_PACE {
            books.catch_up()?;
            if !go_on(now) {
                break End::Stopped;
            }
        }
    };
    drop(apart);
    books.catch_up()?;
    let Books { mut report, recorder, .. } = books;
    report.localized(simulation.localization_errors());
    let recording = recording.map(Recording::finish);
    let losses = Losses { frames_dropped: 0, history_dropped: recorder.dropped() };
    let summary = report.summary(now, end.as_str(), losses);
    folder.write_report(&report, &summary)?;
    history.end_run(run, now)?;
    Ok(Finished { summary, report, folder: folder.path().to_owned(), run, recording })
}

/// Where what happens is kept.
struct Books {
    report: Report,
    recorder: PacedRecorder,
    unwritten: usize,
    tap: Option<Tap>,
}

impl Books {
    fn keep(&mut self, event: Stamped) {
        self.report.absorb(&event);
        if let Some(tap) = &self.tap {
            tap.event(Arc::new(event.clone()));
        }
        self.recorder.record(event);
        self.unwritten += 1;
    }

    fn catch_up(&mut self) -> Result<(), cotorra_measurements::Error> {
        self.unwritten = 0;
        self.recorder.flush()
    }
}
