//! The journal of finished runs in a folder. It survives any end of the process.

use std::{
    collections::HashMap,
    fs::{self, File},
    io::{self, BufRead, BufReader, Write},
    path::{Path, PathBuf},
};

use cotorra_testbed::FolderError;
use serde::{Deserialize, Serialize, de::DeserializeOwned};

const JOURNAL: &str = "journal.jsonl";

/// A folder with a journal of finished runs. Only one process at a time can open it.
#[derive(Debug)]
pub struct Journal {
    path: PathBuf,
    file: File,
    durable: bool,
}

/// A line of the journal.
#[derive(Serialize, Deserialize)]
struct Line<M> {
    run: String,
    measured: M,
}

impl Journal {
    /// Opens a folder, or creates it.
    ///
    /// # Errors
    /// [`FolderError`] if that fails, or another process has opened it.
    pub fn open(path: &Path) -> Result<Self, FolderError> {
        let fail = |path: &Path, source| FolderError::new(path, source);
        fs::create_dir_all(path).map_err(|e| fail(path, e))?;
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
        let folder = Self { path, file, durable: false };
        folder.mend().map_err(|e| fail(&journal, e))?;
        Ok(folder)
    }

    /// Makes each run reach the disk before the next one is kept. Without this, the system writes it when it likes, which
    /// may leave a gap if the whole machine ends and the folder is on another one.
    pub fn durable(self) -> Self {
        Self { durable: true, ..self }
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

    /// Returns whether the journal has no runs.
    pub(crate) fn is_empty(&self) -> Result<bool, FolderError> {
        let file = self.file.metadata().map_err(|e| FolderError::new(&self.path.join(JOURNAL), e))?;
        Ok(file.len() == 0)
    }

    /// Returns the runs in the journal, by name.
    pub(crate) fn kept<M: DeserializeOwned>(&self) -> Result<HashMap<String, M>, FolderError> {
        read(&self.path).map_err(|e| FolderError::new(&self.path.join(JOURNAL), e))
    }

    /// Adds a run to the journal. The run survives any end of the process after this returns, and that of the machine if the
    /// journal is [durable](Self::durable).
    pub(crate) fn keep<M: Serialize>(&self, run: &str, measured: &M) -> Result<(), FolderError> {
        let line = Line { run: run.to_owned(), measured };
        let mut line = serde_json::to_string(&line).expect("results are valid JSON");
        line.push('\n');
        let written = (&self.file).write_all(line.as_bytes());
        let kept = written.and_then(|()| if self.durable { self.file.sync_data() } else { Ok(()) });
        kept.map_err(|e| FolderError::new(&self.path.join(JOURNAL), e))
    }
}

/// Returns the runs in the journal of a folder, by name. Another process may be adding to it: an incomplete last line is
/// left out.
pub(crate) fn read<M: DeserializeOwned>(folder: &Path) -> io::Result<HashMap<String, M>> {
    let mut kept = HashMap::new();
    let mut journal = BufReader::new(File::open(folder.join(JOURNAL))?);
    let mut line = String::new();
    while journal.read_line(&mut line)? > 0 && line.ends_with('\n') {
        let Line { run, measured } = serde_json::from_str(&line)?;
        kept.insert(run, measured);
        line.clear();
    }
    Ok(kept)
}
