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
//! for cell in runs.cells() {
//!     println!("{:?}: {:?}", cell.values, cell.service_time_p50_ms);
//! }
//! # Ok(())
//! # }
//! ```

mod axis;
mod cells;
mod column;
mod differences;
mod figure;
mod folder;
mod measured;
mod merge;
mod plan;
mod runs;
mod samples;
mod shard;
mod spent;
mod tables;
mod time_parts;

use std::{
    collections::BTreeMap,
    num::NonZero,
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};

use cotorra_graph::{Event, Stamped, Testbed};
use cotorra_numbers::seed;
use cotorra_testbed::{Altered, Report, Unrecorded, UnrecordedRun, Void, simulate_unrecorded};
use cotorra_testbed_file::{Diagnostics, InvalidSetting, Setting};

pub use self::{
    axis::{Axis, InvalidAxis},
    cells::{Cell, Interval, ServiceCell, SpentCell, Verdicts},
    differences::Difference,
    folder::FILES,
    measured::{Measured, MeasuredService, Region},
    merge::{Merge, MergeError},
    plan::Point,
    runs::{Done, Runs},
    shard::{InvalidShard, Shard},
    spent::Spent,
};
use crate::{
    batch::{self, BatchError, Maker, SamplesFile, Wanted},
    journal::Journal,
    key::Keys,
    outcome::Outcome,
};
use plan::Plan;
use shard::Record;

/// A sweep changes nothing but settings.
static UNALTERED: Altered = Altered { slow: BTreeMap::new(), fork: None };

/// A testbed file, the settings to vary, and the number of seeds.
#[derive(Debug, Clone)]
pub struct Sweep {
    source_name: String,
    text: String,
    base_dir: PathBuf,
    axes: Vec<Axis>,
    seeds: u32,
    until: Option<Duration>,
    keeps_samples: bool,
    keys: Arc<Keys>,
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
    /// There are more shards than runs.
    #[error("there are more shards ({shards}) than runs ({runs})")]
    Shards {
        /// Number of shards.
        shards: usize,
        /// Number of runs.
        runs: usize,
    },
}

impl Sweep {
    /// Creates a sweep without axes: one run of a testbed file's text. `source_name` names the file in errors, and paths in
    /// the file are relative to `base_dir`.
    pub fn new(source_name: &str, text: String, base_dir: &Path) -> Self {
        let (source_name, base_dir) = (source_name.to_owned(), base_dir.to_owned());
        let keys = Arc::new(Keys::new(&source_name));
        let (axes, seeds, until, keeps_samples) = (Vec::new(), 1, None, false);
        Self { source_name, text, base_dir, axes, seeds, until, keeps_samples, keys }
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

    /// Keeps the samples of each run in the folder of the sweep. Runs that it has without their samples are made again.
    pub fn keep_samples(self) -> Self {
        Self { keeps_samples: true, ..self }
    }

    /// Returns the axes.
    pub fn axes(&self) -> &[Axis] {
        &self.axes
    }

    /// Returns all runs: each combination with each seed.
    ///
    /// # Errors
    /// [`SweepError::Testbed`] or [`SweepError::Setting`] for the first combination that cannot be run.
    pub fn points(&self) -> Result<Vec<Point>, SweepError> {
        Ok(self.plan("")?.points())
    }

    /// Returns why runs do not repeat to the byte; `None` if all do.
    ///
    /// # Errors
    /// As [`Self::points`].
    pub fn inexact(&self) -> Result<Option<String>, SweepError> {
        for values in axis::combinations(&self.axes) {
            if let Some(why) = cotorra_testbed::inexact(&self.testbed(&values)?) {
                return Ok(Some(why));
            }
        }
        Ok(None)
    }

    /// Returns the plan of a program of this version.
    fn plan(&self, version: &str) -> Result<Plan, SweepError> {
        let (mut first_seeds, mut keys) = (Vec::new(), Vec::new());
        for values in axis::combinations(&self.axes) {
            let testbed = self.testbed(&values)?;
            first_seeds.push(testbed.seed);
            keys.push(self.keys.key(version, &testbed, &self.text_with(&values)?, self.until));
        }
        Ok(Plan { sweep: self.id()?, axes: self.axes.clone(), seeds: self.seeds, first_seeds, keys })
    }

    /// Returns a folder in `parent` for this sweep alone. Its name has the testbed's name, and a hash of the version, the
    /// testbed file, the settings' paths and the duration. Values and the number of seeds are left out, so that a sweep
    /// with more of them continues in the same folder.
    ///
    /// # Errors
    /// [`SweepError::Testbed`] if the file cannot be run as it is.
    pub fn default_folder(&self, parent: &Path) -> Result<PathBuf, SweepError> {
        Ok(parent.join(self.id()?))
    }

    /// Returns the name of [`Self::default_folder`].
    fn id(&self) -> Result<String, SweepError> {
        let testbed = cotorra_testbed_file::parse(&self.source_name, &self.text, &self.base_dir)?;
        let paths: Vec<_> = self.axes.iter().map(Axis::path).collect();
        // The testbed holds its map and traces, wherever they are.
        let testbed = Testbed { folder: PathBuf::new(), ..testbed };
        let depends = format!("{} {testbed:?} {paths:?} {:?}", env!("CARGO_PKG_VERSION"), self.until);
        let digest = seed::split(0, &depends) >> 32;
        Ok(format!("{}-{digest:08x}", testbed.name))
    }

    fn settings(&self, values: &[String]) -> Result<Vec<Setting>, InvalidSetting> {
        self.axes.iter().zip(values).map(|(axis, value)| Setting::new(axis.path(), value)).collect()
    }

    /// Returns the file's text with the settings of these values.
    fn text_with(&self, values: &[String]) -> Result<String, InvalidSetting> {
        Ok(cotorra_testbed_file::annotated(&self.text, &self.settings(values)?))
    }

    fn testbed(&self, values: &[String]) -> Result<Testbed, SweepError> {
        let settings = self.settings(values)?;
        Ok(cotorra_testbed_file::parse_with(&self.source_name, &self.text, &self.base_dir, &settings)?)
    }

    /// Runs the points that the journal does not have yet, or has with another key, `jobs` at a time, and adds each to it as
    /// soon as it is done. Calls `go_on` with the numbers of finished and of all runs, at the beginning and after each run; `false` stops the
    /// sweep.
    ///
    /// # Errors
    /// [`SweepError`].
    pub fn run(
        &self,
        journal: &Journal,
        jobs: NonZero<usize>,
        go_on: impl FnMut(usize, usize) -> bool,
    ) -> Result<Runs, SweepError> {
        let plan = self.plan(journal.version())?;
        let all = (0..plan.len()).collect();
        self.run_places(&plan, all, journal, jobs, go_on)
    }

    /// Does the same as [`Self::run`] for the runs of a shard. Also records in the journal's folder what the shard is, for
    /// [`Merge`].
    ///
    /// # Errors
    /// [`SweepError`].
    pub fn run_shard(
        &self,
        shard: Shard,
        journal: &Journal,
        jobs: NonZero<usize>,
        go_on: impl FnMut(usize, usize) -> bool,
    ) -> Result<Runs, SweepError> {
        let plan = self.plan(journal.version())?;
        let places = shard.places(plan.len())?;
        let record = Record { shard, plan };
        record.write(journal)?;
        self.run_places(&record.plan, places, journal, jobs, go_on)
    }

    fn run_places(
        &self,
        plan: &Plan,
        places: Vec<usize>,
        journal: &Journal,
        jobs: NonZero<usize>,
        mut go_on: impl FnMut(usize, usize) -> bool,
    ) -> Result<Runs, SweepError> {
        let all = plan.points();
        let total = places.len();
        let samples = |place: usize| samples::place(&all[place].name(&self.axes));
        let want = |&place: &usize| Wanted {
            name: all[place].name(&self.axes),
            key: plan.key(place).clone(),
            samples: Some(SamplesFile {
                path: journal.path().join(samples(place)),
                is_wanted: self.keeps_samples,
            }),
        };
        let wanted: Vec<_> = places.iter().map(want).collect();
        let maker = Maker { journal, keys: &self.keys, judge: Void::void };
        let measure = |i: usize, stop: &AtomicBool| {
            let place = places[i];
            let (testbed, text) = self.of(&all[place])?;
            let folder = &journal.path().join(format!("run-{place}"));
            let run = self.unrecorded(&all[place], folder, &text);
            let mut report = self.keeps_samples.then(|| Report::new(&testbed, all[place].seed));
            let observe = |event: &Stamped| {
                if let (Some(report), Event::ServiceTime(_)) = (&mut report, &event.event) {
                    report.absorb(event);
                }
            };
            let outcome = maker.make(&wanted[i], testbed, &run, observe, || !stop.load(Ordering::Relaxed))?;
            if let (Some(file), Some(report), Some(Outcome::Measured(_))) =
                (&wanted[i].samples, &report, &outcome)
            {
                samples::write(file, &self.axes, &all[place], report).map_err(BatchError::from)?;
            }
            let measured = |ended: UnrecordedRun| Measured::of(&ended.summary);
            Ok::<_, SweepError>(outcome.map(|outcome| outcome.map(measured)))
        };
        let runs = (&wanted[..], self.keys.file());
        let batch = batch::run(journal, jobs, runs, measure, |done| go_on(done, total))?;
        let points = places.iter().map(|&place| (all[place].clone(), samples(place)));
        let done = points.zip(batch.done).map(|((point, samples), outcome)| (point, samples, outcome));
        Ok(Runs::new(&self.axes, done, batch.resumed, batch.again))
    }

    /// Runs a point without keeping it, in a folder that may be needed meanwhile. Returns whether it ended before `go_on`,
    /// which is called now and then, stopped it.
    ///
    /// # Errors
    /// [`SweepError`].
    pub fn try_out(
        &self,
        point: &Point,
        folder: &Path,
        go_on: impl FnMut() -> bool,
    ) -> Result<bool, SweepError> {
        let (testbed, text) = self.of(point)?;
        let ended = simulate_unrecorded(testbed, &self.unrecorded(point, folder, &text), |_| {}, go_on);
        let ended = ended.map_err(|source| BatchError::Run { run: point.name(&self.axes), source })?;
        Ok(ended.is_some())
    }

    /// Returns the testbed of a point, and the text of its file.
    fn of(&self, point: &Point) -> Result<(Arc<Testbed>, String), SweepError> {
        Ok((Arc::new(self.testbed(&point.values)?), self.text_with(&point.values)?))
    }

    fn unrecorded<'a>(&self, point: &Point, folder: &'a Path, text: &'a str) -> Unrecorded<'a> {
        Unrecorded { seed: point.seed, until: self.until, altered: &UNALTERED, folder, text }
    }
}

#[cfg(test)]
mod tests;
