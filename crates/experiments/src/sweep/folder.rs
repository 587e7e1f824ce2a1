//! A sweep's folder: a journal of finished runs, and the tables and the plot made from it.

use std::{
    collections::HashMap,
    fs::{self, File},
    io::{self, BufRead, BufReader, Write as _},
    path::{Path, PathBuf},
};

use cotorra_testbed::{DataTable, FolderError, write_file};
use serde::{Deserialize, Serialize};

use super::{Measured, Runs, Sweep, figure, tables};

/// Files that [`SweepFolder::write`] makes: a row per run, a row per combination, a row per region of a run, and the plot;
/// a row per service of a run, a row per service of a combination, and the latter for papers.
pub const FILES: [&str; 7] = [
    "runs.csv",
    "cells.csv",
    "regions.csv",
    "sweep.svg",
    "services.csv",
    "service_cells.csv",
    "service_cells.tex",
];

const JOURNAL: &str = "journal.jsonl";

/// A sweep's folder. Only one process at a time can open it.
#[derive(Debug)]
pub struct SweepFolder {
    path: PathBuf,
    journal: File,
}

/// A line of the journal.
#[derive(Serialize, Deserialize)]
struct Line<M> {
    run: String,
    measured: M,
}

impl SweepFolder {
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
                return Err(fail(&journal, io::Error::other("another process runs this sweep")));
            }
            Err(fs::TryLockError::Error(error)) => return Err(fail(&journal, error)),
        }
        let folder = Self { path, journal: file };
        folder.mend().map_err(|e| fail(&journal, e))?;
        Ok(folder)
    }

    /// Removes an incomplete last line.
    fn mend(&self) -> io::Result<()> {
        let text = fs::read(self.path.join(JOURNAL))?;
        let whole = text.iter().rposition(|&byte| byte == b'\n').map_or(0, |at| at + 1);
        if whole < text.len() { self.journal.set_len(whole as u64) } else { Ok(()) }
    }

    /// Returns the absolute path.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Returns the path of a run's own folder, if the run needs one. `place` is its index among the points.
    pub(crate) fn run(&self, place: usize) -> PathBuf {
        self.path.join(format!("run-{place}"))
    }

    /// Removes all runs from the journal.
    ///
    /// # Errors
    /// [`FolderError`].
    pub fn clear(&self) -> Result<(), FolderError> {
        self.journal.set_len(0).map_err(|e| FolderError::new(&self.path.join(JOURNAL), e))
    }

    /// Returns the runs in the journal, by name.
    pub(crate) fn kept(&self) -> Result<HashMap<String, Measured>, FolderError> {
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
    pub(crate) fn keep(&self, run: &str, measured: &Measured) -> Result<(), FolderError> {
        let line = Line { run: run.to_owned(), measured };
        let mut line = serde_json::to_string(&line).expect("results are valid JSON");
        line.push('\n');
        (&self.journal).write_all(line.as_bytes()).map_err(|e| FolderError::new(&self.path.join(JOURNAL), e))
    }

    /// Writes [`FILES`].
    ///
    /// # Errors
    /// [`FolderError`].
    pub fn write(&self, sweep: &Sweep, runs: &Runs) -> Result<(), FolderError> {
        let cells = sweep.cells(runs);
        let [of_runs, of_cells, of_regions, plot, of_services, of_service_cells, for_papers] = FILES;
        let csv = |name, table: DataTable| write_file(&self.path, name, &table.to_csv());
        csv(of_runs, tables::runs(sweep, runs))?;
        csv(of_cells, tables::cells(sweep, &cells))?;
        csv(of_regions, tables::regions(sweep, runs))?;
        csv(of_services, tables::services(sweep, runs))?;
        csv(of_service_cells, tables::service_cells(sweep, &cells))?;
        write_file(&self.path, for_papers, &tables::by_service(sweep, &cells).to_latex())?;
        write_file(&self.path, plot, &figure::draw(sweep, &cells))
    }
}
