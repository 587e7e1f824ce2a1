//! Sweeps run one testbed file in virtual time for all combinations of some settings' values, each with several seeds.
//!
//! ```no_run
//! use std::path::Path;
//! use cotorra_experiments::{journal::Journal, sweep::Sweep};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let text = std::fs::read_to_string("testbeds/corridor.yaml")?;
//! let sweep = Sweep::new("corridor.yaml", text, Path::new("testbeds"))
//!     .axis("links.*.delay_scale=1..2:0.5".parse()?)
//!     .axis("plugin=probing,okpi".parse()?)
//!     .seeds(10);
//! let folder = Journal::open(&sweep.default_folder(Path::new("sweeps"))?)?;
//! // Skips the runs that the folder has, and keeps each new one as soon as it is done.
//! let runs = sweep.run(&folder, std::thread::available_parallelism()?, |done, of| {
//!     eprintln!("{done} of {of}");
//!     true
//! })?;
//! for cell in sweep.cells(&runs) {
//!     println!("{:?}: {:?}", cell.values, cell.service_time_p50_ms);
//! }
//! # Ok(())
//! # }
//! ```

mod axis;
mod cells;
mod figure;
mod folder;
mod measured;
mod tables;
mod time_parts;

use std::{
    num::NonZero,
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};

use cotorra_graph::{Testbed, seed};
use cotorra_testbed::{Altered, DataTable, Unrecorded, simulate_unrecorded};
use cotorra_testbed_file::{Diagnostics, InvalidSetting, Setting};

pub use self::{
    axis::{Axis, InvalidAxis},
    cells::{Cell, Interval, ServiceCell},
    folder::FILES,
    measured::{Measured, MeasuredService, Region},
};
use crate::{
    batch::{self, BatchError},
    journal::Journal,
};

/// A testbed file, the settings to vary, and the number of seeds.
#[derive(Debug, Clone)]
pub struct Sweep {
    source_name: String,
    text: String,
    base_dir: PathBuf,
    axes: Vec<Axis>,
    seeds: u32,
    until: Option<Duration>,
}

/// One run of a sweep.
#[derive(Debug, Clone, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Point {
    /// One value per axis, in the order of the axes.
    pub values: Vec<String>,
    pub seed: u64,
}

/// A finished run.
#[derive(Debug, Clone, PartialEq)]
pub struct Done {
    pub point: Point,
    pub measured: Measured,
}

/// The result of a sweep.
#[derive(Debug, Clone, PartialEq)]
pub struct Runs {
    /// The finished runs, in the order of [`Sweep::points`].
    pub done: Vec<Done>,
    /// Number of finished runs that the folder already had.
    pub resumed: usize,
    /// Number of all runs; more than the finished ones if the sweep was stopped.
    pub total: usize,
}

/// Error that ends a sweep. The runs finished until then are in its folder.
#[derive(Debug, thiserror::Error)]
pub enum SweepError {
    /// The testbed file or a setting is invalid.
    #[error(transparent)]
    Testbed(#[from] Diagnostics),
    /// A setting's path or value is malformed.
    #[error(transparent)]
    Setting(#[from] InvalidSetting),
    /// A run failed, or its result cannot be kept.
    #[error(transparent)]
    Run(#[from] BatchError),
}

impl Sweep {
    /// Creates a sweep without axes: one run of a testbed file's text. `source_name` names the file in errors, and paths in
    /// the file are relative to `base_dir`.
    pub fn new(source_name: &str, text: String, base_dir: &Path) -> Self {
        let (source_name, base_dir) = (source_name.to_owned(), base_dir.to_owned());
        Self { source_name, text, base_dir, axes: Vec::new(), seeds: 1, until: None }
    }

    /// Adds an axis.
    pub fn axis(mut self, axis: Axis) -> Self {
        self.axes.push(axis);
        self
    }

    /// Runs each combination with this many seeds, counted up from the file's.
    pub fn seeds(self, seeds: u32) -> Self {
        Self { seeds, ..self }
    }

    /// Ends each run after this duration, even if walks are not finished.
    pub fn until(self, until: Option<Duration>) -> Self {
        Self { until, ..self }
    }

    /// Returns the axes.
    pub fn axes(&self) -> &[Axis] {
        &self.axes
    }

    /// Returns all combinations of the axes' values. The last axis changes fastest.
    pub fn combinations(&self) -> Vec<Vec<String>> {
        self.axes.iter().fold(vec![Vec::new()], |before, axis| {
            let with = |values: &Vec<String>, value: &String| {
                let mut values = values.clone();
                values.push(value.clone());
                values
            };
            before
                .iter()
                .flat_map(|values| axis.values().iter().map(move |value| with(values, value)))
                .collect()
        })
    }

    /// Returns all runs: each combination with each seed.
    ///
    /// # Errors
    /// [`SweepError::Testbed`] or [`SweepError::Setting`] for the first combination that cannot be run.
    pub fn points(&self) -> Result<Vec<Point>, SweepError> {
        let mut points = Vec::new();
        for values in self.combinations() {
            let first = self.testbed(&values)?.seed;
            let seeds = (0..u64::from(self.seeds)).map(|i| first.wrapping_add(i));
            points.extend(seeds.map(|seed| Point { values: values.clone(), seed }));
        }
        Ok(points)
    }

    /// Returns a folder in `parent` for this sweep alone. Its name has the testbed's name, and a hash of the version, the
    /// testbed file, the settings' paths and the duration. Values and the number of seeds are left out, so that a sweep
    /// with more of them continues in the same folder.
    ///
    /// # Errors
    /// [`SweepError::Testbed`] if the file cannot be run as it is.
    pub fn default_folder(&self, parent: &Path) -> Result<PathBuf, SweepError> {
        let testbed = cotorra_testbed_file::parse(&self.source_name, &self.text, &self.base_dir)?;
        let paths: Vec<_> = self.axes.iter().map(Axis::path).collect();
        // The testbed holds its map and traces, wherever they are.
        let testbed = Testbed { folder: PathBuf::new(), ..testbed };
        let depends = format!("{} {testbed:?} {paths:?} {:?}", env!("CARGO_PKG_VERSION"), self.until);
        let digest = seed::split(0, &depends) >> 32;
        Ok(parent.join(format!("{}-{digest:08x}", testbed.name)))
    }

    fn settings(&self, values: &[String]) -> Result<Vec<Setting>, InvalidSetting> {
        self.axes.iter().zip(values).map(|(axis, value)| Setting::new(axis.path(), value)).collect()
    }

    fn testbed(&self, values: &[String]) -> Result<Testbed, SweepError> {
        let settings = self.settings(values)?;
        Ok(cotorra_testbed_file::parse_with(&self.source_name, &self.text, &self.base_dir, &settings)?)
    }

    /// Returns the name of a point, as users and the folder have it.
    pub fn name(&self, point: &Point) -> String {
        let settings =
            self.axes.iter().zip(&point.values).map(|(axis, value)| format!("{}={value}", axis.path()));
        settings.chain([format!("seed={}", point.seed)]).collect::<Vec<_>>().join(" ")
    }

    /// Runs the points that the journal does not have yet, `jobs` at a time, and adds each to it as soon as it is done.
    /// Calls `go_on` with the numbers of finished and of all runs, at the beginning and after each run; `false` stops the
    /// sweep.
    ///
    /// # Errors
    /// [`SweepError`].
    pub fn run(
        &self,
        journal: &Journal,
        jobs: NonZero<usize>,
        mut go_on: impl FnMut(usize, usize) -> bool,
    ) -> Result<Runs, SweepError> {
        let points = self.points()?;
        let total = points.len();
        let names: Vec<_> = points.iter().map(|point| self.name(point)).collect();
        let measure = |place: usize, stop: &AtomicBool| {
            let folder = journal.path().join(format!("run-{place}"));
            self.measure(&points[place], &folder, stop)
        };
        let batch = batch::run(journal, jobs, &names, measure, |done| go_on(done, total))?;
        let done = points.into_iter().zip(batch.done);
        let done = done.filter_map(|(point, measured)| Some(Done { point, measured: measured? })).collect();
        Ok(Runs { done, resumed: batch.resumed, total })
    }

    /// Runs a point; returns `None` if it was stopped before its end.
    fn measure(
        &self,
        point: &Point,
        folder: &Path,
        stop: &AtomicBool,
    ) -> Result<Option<Measured>, SweepError> {
        let testbed = Arc::new(self.testbed(&point.values)?);
        let text = cotorra_testbed_file::annotated(&self.text, &self.settings(&point.values)?);
        let (until, altered) = (self.until, &Altered::default());
        let run = Unrecorded { seed: point.seed, until, altered, folder, text: &text };
        let ended = simulate_unrecorded(testbed, &run, |_| {}, || !stop.load(Ordering::Relaxed));
        let ended = ended.map_err(|source| BatchError::Run { run: self.name(point), source })?;
        Ok(ended.map(|ended| Measured::of(&ended.summary)))
    }

    /// Returns the statistics of each combination, in the order of [`Sweep::combinations`], without those that have no run.
    pub fn cells(&self, runs: &Runs) -> Vec<Cell> {
        let of = |values: Vec<String>| {
            let measured: Vec<_> = runs
                .done
                .iter()
                .filter(|done| done.point.values == values)
                .map(|done| &done.measured)
                .collect();
            (!measured.is_empty()).then(|| Cell::of(values, &measured))
        };
        self.combinations().into_iter().filter_map(of).collect()
    }

    /// Returns a row for each robot and service of each combination, rounded for readers, with confidence intervals.
    /// Several services also have a row for all together.
    pub fn by_service(&self, cells: &[Cell]) -> DataTable {
        tables::by_service(self, cells)
    }
}

#[cfg(test)]
mod tests;
