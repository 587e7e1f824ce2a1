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
        let folder = Self { path, file };
        folder.mend().map_err(|e| fail(&journal, e))?;
        Ok(folder)
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

    /// Returns the runs in the journal, by name.
    pub(crate) fn kept<M: DeserializeOwned>(&self) -> Result<HashMap<String, M>, FolderError> {
        let path = self.path.join(JOURNAL);
        let fail = |source| FolderError::new(&path, source);
        let mut kept = HashMap::new();
        for line in BufReader::new(File::open(&path).map_err(fail)?).lines() {
            let Line { run, measured } =
                serde_json::from_str(&line.map_err(fail)?).map_err(|e| fail(e.into()))?;
            kept.insert(run, measured);
        }
        Ok(kept)
    }

    /// Adds a run to the journal. The run survives any end of the process after this returns.
    pub(crate) fn keep<M: Serialize>(&self, run: &str, measured: &M) -> Result<(), FolderError> {
        let line = Line { run: run.to_owned(), measured };
        let mut line = serde_json::to_string(&line).expect("results are valid JSON");
        line.push('\n');
        (&self.file).write_all(line.as_bytes()).map_err(|e| FolderError::new(&self.path.join(JOURNAL), e))
    }
}
