//! A sweep's folder: a journal of finished runs, and the tables and the plot made from it.

use std::{
    collections::HashMap,
    fmt::Write as _,
    fs::{self, File},
    io::{self, BufRead, BufReader, Write as _},
    path::{Path, PathBuf},
};

use cotorra_testbed::{FolderError, write_file};
use serde::{Deserialize, Serialize};

use super::{Interval, Measured, Runs, Sweep, figure};

/// Files that [`SweepFolder::write`] makes: a row per run, a row per combination, a row per region of a run, and the plot.
pub const FILES: [&str; 4] = ["runs.csv", "cells.csv", "regions.csv", "sweep.svg"];

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
        let [of_runs, of_cells, of_regions, plot] = FILES;
        write_file(&self.path, of_runs, &runs_csv(sweep, runs))?;
        write_file(&self.path, of_cells, &cells_csv(sweep, &cells))?;
        write_file(&self.path, of_regions, &regions_csv(sweep, runs))?;
        write_file(&self.path, plot, &figure::draw(sweep, &cells))
    }
}

fn runs_csv(sweep: &Sweep, runs: &Runs) -> String {
    let mut text = heads(sweep);
    text += "seed";
    for (name, _) in runs.done.first().iter().flat_map(|done| done.measured.figures()) {
        text += &format!(",{name}");
    }
    text.push('\n');
    for done in &runs.done {
        values(&mut text, &done.point.values);
        text += &done.point.seed.to_string();
        for (_, figure) in done.measured.figures() {
            push(&mut text, figure);
        }
        text.push('\n');
    }
    text
}

fn cells_csv(sweep: &Sweep, cells: &[super::Cell]) -> String {
    let mut text = heads(sweep);
    text += "runs";
    for (name, _) in cells.first().iter().flat_map(|cell| cell.intervals()) {
        text += &format!(",{name},{name}_low,{name}_high");
    }
    text.push('\n');
    for cell in cells {
        values(&mut text, &cell.values);
        text += &cell.runs.to_string();
        for (_, interval) in cell.intervals() {
            let Interval { mean, low, high } =
                interval.unwrap_or(Interval { mean: f64::NAN, low: None, high: None });
            for figure in [Some(mean).filter(|mean| !mean.is_nan()), low, high] {
                push(&mut text, figure);
            }
        }
        text.push('\n');
    }
    text
}

fn regions_csv(sweep: &Sweep, runs: &Runs) -> String {
    let mut text = heads(sweep);
    text += "seed,robot,attachment,server,from_ns,until_ns,samples,service_time_p50_ms\n";
    for done in &runs.done {
        for region in &done.measured.regions {
            values(&mut text, &done.point.values);
            let attachment = region.attachment.as_ref().map_or("", |attachment| attachment.as_str());
            let fixed = write!(
                text,
                "{},{},{attachment},{},{},{},{}",
                done.point.seed,
                region.robot,
                region.server,
                region.from.as_nanos(),
                region.until.as_nanos(),
                region.samples
            );
            fixed.expect("writing into a string cannot fail");
            push(&mut text, region.service_time_p50_ms);
            text.push('\n');
        }
    }
    text
}

fn heads(sweep: &Sweep) -> String {
    let mut text = String::new();
    values(&mut text, &sweep.axes().iter().map(|axis| axis.path().to_owned()).collect::<Vec<_>>());
    text
}

/// Appends fields, each followed by a comma, quoted where necessary (RFC 4180, 2).
fn values(text: &mut String, values: &[String]) {
    for value in values {
        if value.contains(['"', ',', '\n', '\r']) {
            *text += &format!("\"{}\",", value.replace('"', "\"\""));
        } else {
            *text += &format!("{value},");
        }
    }
}

/// Appends a comma and the figure, if there is one.
fn push(text: &mut String, figure: Option<f64>) {
    text.push(',');
    if let Some(figure) = figure {
        // Nanosecond resolution for figures in milliseconds.
        *text += &format!("{}", (figure * 1e6).round() / 1e6);
    }
}
