//! Many runs in virtual time, several at a time. Each goes into a journal as soon as it is done.

use std::{
    num::NonZero,
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicUsize, Ordering},
        mpsc,
    },
};

use cotorra_graph::{Stamped, Testbed};
use cotorra_testbed::{FolderError, RunError, Unrecorded, UnrecordedRun, panic_text, simulate_unrecorded};
use serde::{Serialize, de::DeserializeOwned};

use crate::journal::Journal;

/// Error that ends many runs. Those finished until then are in the journal.
#[derive(Debug, thiserror::Error)]
pub enum BatchError {
    /// The folder cannot be read or written.
    #[error(transparent)]
    Folder(#[from] FolderError),
    /// A run cannot start.
    #[error("{run}: {source}")]
    Run {
        /// Name of the run.
        run: String,
        /// Error of the run.
        source: RunError,
    },
    /// A plug-in was cut off, so that the run shows nothing of it.
    #[error("{run}: {fault}")]
    CutOff {
        /// Name of the run.
        run: String,
        /// The plug-in, and the reason.
        fault: String,
    },
    /// A run panicked, which is a bug.
    #[error("{run} panicked, which is a bug: {reason}")]
    Panicked {
        /// Name of the run.
        run: String,
        /// The panic's message.
        reason: String,
    },
}

/// Makes one run of many for a search. Unlike a sweep, which counts them, a search accepts no run in which a plug-in was cut
/// off: it would find what the testbed does without the plug-in.
pub(crate) fn sound(
    testbed: Arc<Testbed>,
    run: &Unrecorded<'_>,
    name: &str,
    observe: impl FnMut(&Stamped),
    go_on: impl FnMut() -> bool,
) -> Result<Option<UnrecordedRun>, BatchError> {
    let ended = simulate_unrecorded(testbed, run, observe, go_on);
    let ended = ended.map_err(|source| BatchError::Run { run: name.to_owned(), source })?;
    match ended.as_ref().and_then(|ended| ended.summary.plugin_faults.first()) {
        None => Ok(ended),
        Some(fault) => {
            let logs = run.folder.join("logs");
            let logs = logs.exists().then(|| format!("; its log is in {}", logs.display()));
            let fault = format!("plug-in {fault}{}", logs.unwrap_or_default());
            Err(BatchError::CutOff { run: name.to_owned(), fault })
        }
    }
}

/// The results of many runs.
pub(crate) struct Batch<M> {
    /// In the order of the names; `None` for runs that were not made before the stop.
    pub(crate) done: Vec<Option<M>>,
    /// Number of results that the journal already had.
    pub(crate) resumed: usize,
}

/// Makes the runs that the journal does not have yet, `jobs` at a time, and adds each to the journal as soon as it is done.
/// `measure` makes the run of that index; it returns `None` if it was stopped. Calls `go_on` with the number of finished
/// runs, at the beginning and after each run; `false` stops all.
pub(crate) fn run<M: Serialize + DeserializeOwned + Send, E: From<BatchError> + Send>(
    journal: &Journal,
    jobs: NonZero<usize>,
    names: &[String],
    measure: impl Fn(usize, &AtomicBool) -> Result<Option<M>, E> + Sync,
    mut go_on: impl FnMut(usize) -> bool,
) -> Result<Batch<M>, E> {
    let mut kept = journal.kept().map_err(BatchError::from)?;
    let mut done: Vec<Option<M>> = names.iter().map(|name| kept.remove(name)).collect();
    let missing: Vec<usize> = (0..names.len()).filter(|&i| done[i].is_none()).collect();
    let resumed = names.len() - missing.len();
    let (next, stop) = (AtomicUsize::new(0), AtomicBool::new(!go_on(resumed)));
    let (sender, results) = mpsc::channel();
    let mut failed = None;
    std::thread::scope(|scope| {
        for _ in 0..jobs.get().min(missing.len()) {
            let (sender, measure, missing, next, stop) = (sender.clone(), &measure, &missing, &next, &stop);
            scope.spawn(move || {
                while !stop.load(Ordering::Relaxed)
                    && let Some(&place) = missing.get(next.fetch_add(1, Ordering::Relaxed))
                {
                    let result = match catch_unwind(AssertUnwindSafe(|| measure(place, stop))) {
                        Ok(Ok(None)) => return,
                        Ok(Ok(Some(measured))) => Ok(measured),
                        Ok(Err(error)) => Err(error),
                        Err(panic) => {
                            let (run, reason) = (names[place].clone(), panic_text(&*panic).to_owned());
                            Err(BatchError::Panicked { run, reason }.into())
                        }
                    };
                    if sender.send((place, result)).is_err() {
                        return;
                    }
                }
            });
        }
        drop(sender);
        let mut count = resumed;
        for (place, result) in &results {
            let result = result.and_then(|measured| {
                journal.keep(&names[place], &measured).map_err(BatchError::from)?;
                Ok(measured)
            });
            match result {
                Ok(measured) => {
                    done[place] = Some(measured);
                    count += 1;
                    if !go_on(count) {
                        stop.store(true, Ordering::Relaxed);
                    }
                }
                Err(error) => {
                    failed = Some(error);
                    stop.store(true, Ordering::Relaxed);
                }
            }
        }
    });
    failed.map_or(Ok(Batch { done, resumed }), Err)
}
