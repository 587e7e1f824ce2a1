//! Many runs in virtual time, several at a time. Each goes into a journal as soon as it is done.

use std::{
    collections::BTreeMap,
    fmt, fs, io,
    num::NonZero,
    panic::{AssertUnwindSafe, catch_unwind},
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicUsize, Ordering},
        mpsc,
    },
};

use cotorra_graph::{Stamped, Testbed};
use cotorra_numbers::seed;
use cotorra_testbed::{
    FolderError, RunError, Unrecorded, UnrecordedRun, Void, panic_text, simulate_unrecorded,
};
use serde::{Serialize, de::DeserializeOwned};

use crate::{
    journal::{Found, Journal},
    key::{Key, Keys, Listed},
    outcome::Outcome,
};

/// Folder with the output of programs whose runs are void, in the folder of a journal.
pub const LOGS: &str = "logs";
/// Most letters of a run's name in the name of its folder of logs.
const MAX_NAME: usize = 100;

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
    /// A file changed while the run was made, so that its version is not known.
    #[error("{run}: {} changed during the run: start it again when they stay as they are", Listed(changed))]
    Changed {
        /// Name of the run.
        run: String,
        /// Names of the files.
        changed: Vec<String>,
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

/// A run that is to be made, unless the journal has it.
#[derive(Debug, Clone)]
pub(crate) struct Wanted {
    pub(crate) name: String,
    pub(crate) key: Key,
    /// The file with the samples of the run, of which batches of one kind have one.
    pub(crate) samples: Option<SamplesFile>,
}

/// A file with the samples of a run. It is made after the run's line in the journal, and removed before a new one, so that it
/// is that of the run's last line.
#[derive(Debug, Clone)]
pub(crate) struct SamplesFile {
    pub(crate) path: PathBuf,
    /// Whether the run must leave it.
    pub(crate) is_wanted: bool,
}

impl SamplesFile {
    /// Returns the place where the run writes it.
    pub(crate) fn draft(&self) -> PathBuf {
        self.path.with_extension("part")
    }

    /// Moves the draft to its place.
    pub(crate) fn finish(&self) -> Result<(), FolderError> {
        fs::rename(self.draft(), &self.path).map_err(|e| FolderError::new(&self.path, e))
    }

    /// Removes the file, if there is one.
    pub(crate) fn remove(&self) -> Result<(), FolderError> {
        match fs::remove_file(&self.path) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => Err(FolderError::new(&self.path, error)),
            _ => Ok(()),
        }
    }
}

/// Runs that were made again although the journal had them: their number, by the reason.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Again(BTreeMap<String, usize>);

impl Again {
    /// Adds those of another batch.
    pub(crate) fn add(&mut self, other: Self) {
        other.0.into_iter().for_each(|(reason, runs)| *self.0.entry(reason).or_default() += runs);
    }
}

impl fmt::Display for Again {
    /// Writes a line for each reason.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|(reason, runs)| {
            writeln!(f, "{reason}: {runs} {} again", if *runs == 1 { "run" } else { "runs" })
        })
    }
}

/// Makes wanted runs for a journal.
#[derive(Clone, Copy)]
pub(crate) struct Maker<'a> {
    pub(crate) journal: &'a Journal,
    pub(crate) keys: &'a Keys,
    /// Returns the reasons for which a run does not count.
    pub(crate) judge: fn(&Void) -> Option<Void>,
}

impl Maker<'_> {
    /// Makes a run. One that is void leaves the output of its programs in [`LOGS`]. Returns `None` if `go_on` stopped it.
    pub(crate) fn make(
        self,
        wanted: &Wanted,
        testbed: Arc<Testbed>,
        run: &Unrecorded<'_>,
        observe: impl FnMut(&Stamped),
        go_on: impl FnMut() -> bool,
    ) -> Result<Option<Outcome<UnrecordedRun>>, BatchError> {
        let name = || wanted.name.clone();
        let ended = simulate_unrecorded(Arc::clone(&testbed), run, observe, go_on);
        let ended = ended.map_err(|source| BatchError::Run { run: name(), source })?;
        let Some(ended) = ended else { return Ok(None) };
        let changed = self.keys.changed_since(&wanted.key, &testbed, run.text);
        if !changed.is_empty() {
            return Err(BatchError::Changed { run: name(), changed });
        }
        let void = (self.judge)(&ended.summary.void);
        keep_logs(self.journal, run.folder, &wanted.name, void.is_some())?;
        Ok(Some(void.map_or(Outcome::Measured(ended), Outcome::Void)))
    }
}

/// Moves the logs in the folder of a void run to [`LOGS`], in place of those of the same run before, and removes the folder.
fn keep_logs(journal: &Journal, folder: &Path, name: &str, is_void: bool) -> Result<(), BatchError> {
    let to = journal.path().join(LOGS).join(plain_name(name, name));
    let absent = |result: io::Result<()>| match result {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(FolderError::new(&to, error)),
        _ => Ok(()),
    };
    absent(fs::remove_dir_all(&to))?;
    if is_void && folder.join(LOGS).exists() {
        fs::create_dir_all(journal.path().join(LOGS)).map_err(|e| FolderError::new(&to, e))?;
        absent(fs::rename(folder.join(LOGS), &to))?;
        absent(fs::remove_dir_all(folder))?;
    }
    Ok(())
}

/// Returns a name for files of a run: the run's name, in letters that need no quotes, and the hash of a text that tells them
/// apart.
pub(crate) fn plain_name(run: &str, text: &str) -> String {
    let fits = |c: char| c.is_ascii_alphanumeric() || "=._-,+".contains(c);
    let plain = run.chars().map(|c| if fits(c) { c } else { '_' }).take(MAX_NAME);
    format!("{}-{:08x}", plain.collect::<String>(), seed::split(0, text) >> 32)
}

/// Makes a run without which nothing else can be made. Unlike others, it must not be void.
pub(crate) fn sound(
    testbed: Arc<Testbed>,
    run: &Unrecorded<'_>,
    name: &str,
    observe: impl FnMut(&Stamped),
    go_on: impl FnMut() -> bool,
) -> Result<Option<UnrecordedRun>, BatchError> {
    let ended = simulate_unrecorded(testbed, run, observe, go_on);
    let ended = ended.map_err(|source| BatchError::Run { run: name.to_owned(), source })?;
    match ended.as_ref().and_then(|ended| ended.summary.void.wrong()) {
        None => Ok(ended),
        Some(void) => Err(BatchError::void(name, &void, &run.folder.join(LOGS))),
    }
}

impl BatchError {
    /// Returns the error that a run is void whose logs are in this folder.
    fn void(run: &str, void: &Void, logs: &Path) -> Self {
        let logs = if logs.exists() { format!("; its log is in {}", logs.display()) } else { String::new() };
        Self::CutOff { run: run.to_owned(), fault: format!("{}{logs}", void.reason()) }
    }

    /// Returns the error that a run of a batch is void.
    pub(crate) fn void_in(journal: &Journal, run: &str, void: &Void) -> Self {
        Self::void(run, void, &journal.path().join(LOGS).join(plain_name(run, run)))
    }
}

/// The outcomes of many runs.
pub(crate) struct Batch<M> {
    /// In the order of the runs; `None` for those that were not made before the stop.
    pub(crate) done: Vec<Option<Outcome<M>>>,
    /// Number of outcomes that the journal already had.
    pub(crate) resumed: usize,
    /// Runs that the journal had otherwise.
    pub(crate) again: Again,
}

impl<M> Batch<M> {
    /// Whether all runs were made.
    pub(crate) fn is_whole(&self) -> bool {
        self.done.iter().all(Option::is_some)
    }

    /// Returns the number of runs that were made.
    pub(crate) fn made(&self) -> usize {
        self.done.iter().flatten().count()
    }

    /// Returns the number of void runs.
    pub(crate) fn void(&self) -> usize {
        self.done.iter().flatten().filter(|outcome| outcome.void().is_some()).count()
    }
}

/// Makes the runs that the journal does not have yet, or has with another key, without results or without samples, `jobs` at a
/// time, and adds each to the journal as soon as it is done. `file` is the name of the testbed file. `measure` makes the run of
/// that index; it returns `None` if it was stopped. Calls `go_on` with the number of finished runs, at the beginning and after
/// each run; `false` stops all.
pub(crate) fn run<M: Serialize + DeserializeOwned + Send, E: From<BatchError> + Send>(
    journal: &Journal,
    jobs: NonZero<usize>,
    (wanted, file): (&[Wanted], &str),
    measure: impl Fn(usize, &AtomicBool) -> Result<Option<Outcome<M>>, E> + Sync,
    mut go_on: impl FnMut(usize) -> bool,
) -> Result<Batch<M>, E> {
    let kept = journal.kept().map_err(BatchError::from)?;
    let mut again = Again::default();
    let mut find = |wanted: &Wanted| {
        let reason = match kept.find(&wanted.name, &wanted.key, file) {
            Found::Outcome(Outcome::Measured(measured)) => match &wanted.samples {
                Some(file) if file.is_wanted && !file.path.is_file() => "samples not kept before".to_owned(),
                _ => return Some(Outcome::Measured(measured)),
            },
            Found::Nothing => return None,
            // Its reason may be gone.
            Found::Outcome(Outcome::Void(_)) => "void before".to_owned(),
            Found::Stale(reason) => reason,
        };
        *again.0.entry(reason).or_default() += 1;
        None
    };
    let files = || wanted.iter().filter_map(|wanted| Some((wanted, wanted.samples.as_ref()?)));
    for (_, file) in files().filter(|(its, _)| !kept.is_last(&its.name, &its.key)) {
        file.remove().map_err(BatchError::from)?;
    }
    let mut done: Vec<Option<Outcome<M>>> = wanted.iter().map(&mut find).collect();
    let missing: Vec<usize> = (0..wanted.len()).filter(|&i| done[i].is_none()).collect();
    let resumed = wanted.len() - missing.len();
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
                            let (run, reason) = (wanted[place].name.clone(), panic_text(&*panic).to_owned());
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
            let result = result.and_then(|outcome| {
                let Wanted { name, key, samples } = &wanted[place];
                journal.keep(name, key, &outcome).map_err(BatchError::from)?;
                if let Some(file) = samples.as_ref().filter(|file| file.is_wanted)
                    && outcome.measured().is_some()
                {
                    file.finish().map_err(BatchError::from)?;
                }
                Ok(outcome)
            });
            match result {
                Ok(outcome) => {
                    done[place] = Some(outcome);
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
    failed.map_or(Ok(Batch { done, resumed, again }), Err)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn different_runs_have_different_folders_of_logs() {
        let name_of_logs = |run: &str| plain_name(run, run);
        assert!(name_of_logs("plugin=okpi seed=1").starts_with("plugin=okpi_seed=1-"));
        let [a, b] = ["w.shadowing={deviation: 2 dB} seed=1", "w.shadowing={deviation_ 2 dB} seed=1"];
        assert_ne!(name_of_logs(a), name_of_logs(b));
        assert!(name_of_logs(&"x".repeat(500)).len() < 120);
    }
}
