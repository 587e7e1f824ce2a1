//! Exports a run to a folder of tables for other programs, and imports it again. Both read the run once, in the order of
//! time, in memory that does not grow with it.

#[cfg(feature = "databases")]
mod arrow;
mod csv;
mod read;
mod table;
#[cfg(test)]
mod tests;
mod write;

use std::{
    fmt, fs, io,
    path::{Path, PathBuf},
    str::FromStr,
};

use cotorra_graph::Timestamp;
use serde::{Deserialize, Serialize};

use crate::{History, PageRequest, RunId, RunInfo, codec::ReadError};
use table::TableWriter;

/// File that marks a folder as an export. Written last, so that an incomplete export is not taken for one.
const NOTE: &str = "run.json";
const VERSION: u32 = 6;

/// Format of an export's tables.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Format {
    /// Comma-separated values (RFC 4180). A missing value is an empty field.
    Csv,
    /// Apache Parquet. Needs the feature `databases`.
    Parquet,
    /// Apache Arrow's IPC file format, also known as Feather 2. Needs the feature `databases`.
    Arrow,
}

impl Format {
    pub const ALL: [Self; 3] = [Self::Csv, Self::Parquet, Self::Arrow];

    /// Returns the format's name, which is also the extension of its files.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Csv => "csv",
            Self::Parquet => "parquet",
            Self::Arrow => "arrow",
        }
    }
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.as_str())
    }
}

impl FromStr for Format {
    type Err = String;
    fn from_str(name: &str) -> Result<Self, String> {
        let found = Self::ALL.into_iter().find(|format| format.as_str() == name);
        found.ok_or_else(|| "formats are csv, parquet and arrow".to_owned())
    }
}

/// A failed export or import.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    /// The history failed.
    #[error(transparent)]
    History(#[from] crate::Error),
    /// A file cannot be read or written.
    #[error("{}: {source}", path.display())]
    File { path: PathBuf, source: io::Error },
    /// The folder is not empty.
    #[error("{} exists already; name a folder that does not exist or is empty", .0.display())]
    Taken(PathBuf),
    /// The folder is not an export.
    #[error("{} is not the folder of an export: it has no {NOTE}", .0.display())]
    NotAnExport(PathBuf),
    /// The export is of a newer cotorra, or of one from before the first release.
    #[error(
        "{}: has version {found} of the format, but this cotorra reads version {VERSION}; a newer cotorra wrote it, or one from \
         before the first release: use that, or export the run again",
        path.display()
    )]
    OtherVersion {
        /// The file with the version.
        path: PathBuf,
        /// Version of the export's format.
        found: u32,
    },
    /// A table is malformed.
    #[error("{}: {problem}", path.display())]
    Malformed {
        path: PathBuf,
        /// The defect.
        problem: String,
    },
    /// This build lacks the format.
    #[error("this cotorra was built without {0}: build it with `--features databases`, or use csv")]
    NotBuilt(Format),
    /// The caller stopped it.
    #[error("stopped after {0} events")]
    Stopped(u64),
}

impl ExportError {
    fn file(path: &Path) -> impl FnOnce(io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self::File { path, source }
    }

    fn malformed(path: &Path, problem: impl fmt::Display) -> Self {
        Self::Malformed { path: path.to_owned(), problem: problem.to_string() }
    }

    fn unreadable(path: &Path, error: ReadError) -> Self {
        match error {
            ReadError::Unreadable(problem) => Self::malformed(path, problem),
            ReadError::Engine(error) => Self::History(error),
        }
    }
}

type Result<T, E = ExportError> = std::result::Result<T, E>;

/// Content of [`NOTE`].
#[derive(Debug, Serialize, Deserialize)]
struct Note {
    version: u32,
    format: Format,
    #[serde(flatten)]
    info: RunInfo,
    #[serde(rename = "ended_ns")]
    ended: Option<Timestamp>,
    events: u64,
}

/// Events of one page.
const STEP: usize = 5_000;

impl History {
    /// Writes a run as tables into a new folder, and returns the number of events. Each kind of events has a table, with
    /// name and columns as in the schema (`schema/1.sql`). `n`, the event's place in the run, replaces run and `seq`, and
    /// names replace their ids and codes. `go_on` is called from time to time with the number of events so far, and stops the
    /// export by returning false.
    ///
    /// # Errors
    /// [`ExportError`]. The tables written so far stay, without the mark of an export.
    pub fn export(
        &self,
        run: RunId,
        format: Format,
        folder: &Path,
        mut go_on: impl FnMut(u64) -> bool,
    ) -> Result<u64> {
        let run = self.run(run)?;
        let is_free = match fs::read_dir(folder) {
            Ok(mut entries) => entries.next().is_none(),
            Err(_) => !folder.exists(),
        };
        if !is_free {
            return Err(ExportError::Taken(folder.to_owned()));
        }
        fs::create_dir_all(folder).map_err(ExportError::file(folder))?;
        let mut tables = write::Tables::new(folder, format)?;
        let mut request = PageRequest::first(STEP);
        loop {
            let page = self.events(run.id, &[], .., request)?;
            page.items.iter().try_for_each(|event| tables.event(event))?;
            let Some(next) = page.next else { break };
            if !go_on(tables.events()) {
                return Err(ExportError::Stopped(tables.events()));
            }
            request = PageRequest::after(next, STEP);
        }
        let mut request = PageRequest::first(STEP);
        loop {
            let page = self.gaps(run.id, .., request)?;
            page.items.iter().try_for_each(|gap| tables.gap(gap))?;
            let Some(next) = page.next else { break };
            request = PageRequest::after(next, STEP);
        }
        let events = tables.finish()?;
        let note = Note { version: VERSION, format, info: run.info, ended: run.ended, events };
        let text = serde_json::to_string_pretty(&note).expect("a note holds only what JSON can") + "\n";
        let path = folder.join(NOTE);
        fs::write(&path, text).map_err(ExportError::file(&path))?;
        Ok(events)
    }

    /// Imports an exported run from its folder as a new run of this history. Returns its id and the number of events.
    ///
    /// # Errors
    /// [`ExportError`]. The history then has nothing of the run.
    pub fn import(&self, folder: &Path, go_on: impl FnMut(u64) -> bool) -> Result<(RunId, u64)> {
        let path = folder.join(NOTE);
        let text = fs::read_to_string(&path).map_err(|source| match source.kind() {
            io::ErrorKind::NotFound | io::ErrorKind::NotADirectory => {
                ExportError::NotAnExport(folder.to_owned())
            }
            _ => ExportError::File { path: path.clone(), source },
        })?;
        let note: Note = serde_json::from_str(&text).map_err(|e| ExportError::malformed(&path, e))?;
        if note.version != VERSION {
            return Err(ExportError::OtherVersion { path, found: note.version });
        }
        let mut tables = read::Tables::open(folder, note.format)?;
        // Opened first, so that no run begins for tables that cannot be opened.
        let run = self.begin_run(&note.info)?;
        let taken = self.take_in(run, &mut tables, &note, &path, go_on);
        if let Err(error) = &taken
            && let Err(and) = self.store.remove_run(run)
        {
            tracing::warn!(%error, %and, %run, "cannot remove a partly imported run");
        }
        taken.map(|()| (run, tables.events()))
    }

    fn take_in(
        &self,
        run: RunId,
        tables: &mut read::Tables,
        note: &Note,
        path: &Path,
        mut go_on: impl FnMut(u64) -> bool,
    ) -> Result<()> {
        let mut batch = Vec::new();
        while let Some(stamped) = tables.event()? {
            batch.push(crate::run::Entry { run, stamped });
            if batch.len() == STEP {
                self.store.append(&batch, &[])?;
                batch.clear();
                if !go_on(tables.events()) {
                    return Err(ExportError::Stopped(tables.events()));
                }
            }
        }
        if tables.events() != note.events {
            let problem = format!("says {} events, but the tables have {}", note.events, tables.events());
            return Err(ExportError::malformed(path, problem));
        }
        self.store.append(&batch, &[])?;
        while let Some(gap) = tables.gap()? {
            self.store.append(&[], &[(run, gap)])?;
        }
        if let Some(ended) = note.ended {
            self.store.end_run(run, ended)?;
        }
        Ok(())
    }
}

/// Creates a table.
fn create(format: Format, folder: &Path, table: &table::Shape) -> Result<Box<dyn TableWriter>> {
    let path = folder.join(format!("{}.{format}", table.name));
    match format {
        Format::Csv => Ok(Box::new(csv::Writer::create(&path, table)?)),
        #[cfg(feature = "databases")]
        Format::Parquet => Ok(Box::new(arrow::Writer::parquet(&path, table)?)),
        #[cfg(feature = "databases")]
        Format::Arrow => Ok(Box::new(arrow::Writer::ipc(&path, table)?)),
        #[cfg(not(feature = "databases"))]
        other => Err(ExportError::NotBuilt(other)),
    }
}

/// Opens a table; a missing one has no rows.
fn open(format: Format, folder: &Path, table: &table::Shape) -> Result<table::Rows> {
    let path = folder.join(format!("{}.{format}", table.name));
    if !path.exists() {
        return Ok(table::Rows::none(path));
    }
    let rows: Box<dyn Iterator<Item = Result<Vec<table::Cell>>>> = match format {
        Format::Csv => Box::new(csv::Reader::open(&path, table)?),
        #[cfg(feature = "databases")]
        Format::Parquet => Box::new(arrow::parquet(&path, table)?),
        #[cfg(feature = "databases")]
        Format::Arrow => Box::new(arrow::ipc(&path, table)?),
        #[cfg(not(feature = "databases"))]
        other => return Err(ExportError::NotBuilt(other)),
    };
    let (shape, file) = (table.clone(), path.clone());
    let coded = rows.map(move |row| {
        let mut cells = row?;
        shape.code(&mut cells).map_err(|problem| ExportError::malformed(&file, problem))?;
        Ok(cells)
    });
    Ok(table::Rows::new(path, Box::new(coded)))
}
