//! The journal of finished runs in a folder. It survives any end of the process.

use std::{
    collections::HashMap,
    fs::{self, DirBuilder, File},
    io::{self, BufRead, BufReader, Write},
    os::unix::fs::DirBuilderExt as _,
    path::{Path, PathBuf},
};

use cotorra_testbed::FolderError;
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use serde_json::Value;

use crate::{
    key::{Key, Listed},
    outcome::Outcome,
};

const JOURNAL: &str = "journal.jsonl";

/// A folder with a journal of finished runs. Only one process at a time can open it.
#[derive(Debug)]
pub struct Journal {
    path: PathBuf,
    file: File,
    durable: bool,
    version: String,
}

/// A line of the journal.
#[derive(Serialize, Deserialize)]
struct Line<O> {
    run: String,
    /// The inputs on which the outcome depends. Journals of earlier versions have none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    key: Option<Key>,
    /// A single entry, `measured` or `void`.
    #[serde(flatten)]
    outcome: O,
}

/// The outcomes in a journal, by the names of their runs.
#[derive(Debug, Default)]
pub(crate) struct Kept(HashMap<String, Vec<(Option<Key>, Value)>>);

/// The entry of a run in a journal.
pub(crate) enum Found<M> {
    Outcome(Outcome<M>),
    /// Only outcomes with other keys; the reason not to believe them.
    Stale(String),
    Nothing,
}

impl Kept {
    /// Finds the last outcome of a run with this key. `file` is the name of the testbed file.
    pub(crate) fn find<M: DeserializeOwned>(&self, run: &str, key: &Key, file: &str) -> Found<M> {
        let Some(kept) = self.0.get(run) else { return Found::Nothing };
        let same = kept.iter().rev().find(|(of, _)| of.as_ref() == Some(key));
        if let Some(outcome) = same.and_then(|(_, outcome)| serde_json::from_value(outcome.clone()).ok()) {
            return Found::Outcome(outcome);
        }
        match kept.last() {
            Some((Some(of), _)) if of != key => {
                Found::Stale(format!("{} changed", Listed(&key.changes(of, file))))
            }
            _ => Found::Stale("the journal is of an earlier version of cotorra".to_owned()),
        }
    }

    /// Whether the last outcome of a run has this key. Files of the run are those of its last outcome.
    pub(crate) fn is_last(&self, run: &str, key: &Key) -> bool {
        let last = self.0.get(run).and_then(|kept| kept.last());
        last.is_some_and(|(of, _)| of.as_ref() == Some(key))
    }
}

impl Journal {
    /// Opens a folder, or creates it.
    ///
    /// # Errors
    /// [`FolderError`] if that fails, or another process has opened it.
    pub fn open(path: &Path) -> Result<Self, FolderError> {
        let fail = |path: &Path, source| FolderError::new(path, source);
        DirBuilder::new().recursive(true).mode(0o700).create(path).map_err(|e| fail(path, e))?;
        let path = path.canonicalize().map_err(|e| fail(path, e))?;
        let journal = path.join(JOURNAL);
        let file = File::options().read(true).append(true).create(true).open(&journal);
        let file = file.map_err(|e| fail(&journal, e))?;
        match file.try_lock() {
            Ok(()) => {}
            Err(fs::TryLockError::WouldBlock) => {
                return Err(fail(&journal, io::Error::other("another process uses this folder")));
            }
            Err(fs::TryLockError::Error(error)) => return Err(fail(&journal, error)),
        }
        let version = env!("CARGO_PKG_VERSION").to_owned();
        let folder = Self { path, file, durable: false, version };
        folder.mend().map_err(|e| fail(&journal, e))?;
        Ok(folder)
    }

    /// Makes each run reach the disk before the next one is kept. Without this, the system writes it when it likes, which
    /// may leave a gap if the whole machine ends and the folder is on another one.
    pub fn durable(self) -> Self {
        Self { durable: true, ..self }
    }

    /// Says which program makes the runs, beyond its version: what another program made is made again.
    pub fn by(self, program: &str) -> Self {
        Self { version: format!("{} {program}", self.version), ..self }
    }

    /// Returns the version of the program that makes the runs.
    pub(crate) fn version(&self) -> &str {
        &self.version
    }

    /// Removes an incomplete last line.
    fn mend(&self) -> io::Result<()> {
        let text = fs::read(self.path.join(JOURNAL))?;
        let whole = text.iter().rposition(|&byte| byte == b'\n').map_or(0, |at| at + 1);
        if whole < text.len() { self.file.set_len(whole as u64) } else { Ok(()) }
    }

    /// Returns the absolute path of the folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Removes all runs from the journal.
    ///
    /// # Errors
    /// [`FolderError`].
    pub fn clear(&self) -> Result<(), FolderError> {
        self.file.set_len(0).map_err(|e| FolderError::new(&self.path.join(JOURNAL), e))
    }

    /// Returns the outcomes in the journal.
    pub(crate) fn kept(&self) -> Result<Kept, FolderError> {
        read(&self.path).map_err(|e| FolderError::new(&self.path.join(JOURNAL), e))
    }

    /// Adds a run to the journal. The run survives any end of the process after this returns, and that of the machine if the
    /// journal is [durable](Self::durable).
    pub(crate) fn keep<M: Serialize>(
        &self,
        run: &str,
        key: &Key,
        outcome: &Outcome<M>,
    ) -> Result<(), FolderError> {
        let line = Line { run: run.to_owned(), key: Some(key.clone()), outcome };
        let mut line = serde_json::to_string(&line).expect("results are valid JSON");
        line.push('\n');
        let written = (&self.file).write_all(line.as_bytes());
        let kept = written.and_then(|()| if self.durable { self.file.sync_data() } else { Ok(()) });
        kept.map_err(|e| FolderError::new(&self.path.join(JOURNAL), e))
    }
}

/// Returns the outcomes in the journal of a folder. Another process may be adding to it: an incomplete last line is left
/// out.
pub(crate) fn read(folder: &Path) -> io::Result<Kept> {
    let mut kept = Kept::default();
    let mut journal = BufReader::new(File::open(folder.join(JOURNAL))?);
    let mut line = String::new();
    while journal.read_line(&mut line)? > 0 && line.ends_with('\n') {
        let Line { run, key, outcome } = serde_json::from_str(&line)?;
        kept.0.entry(run).or_default().push((key, outcome));
        line.clear();
    }
    Ok(kept)
}
