//! Sweeps: one testbed file in virtual time for every combination of some settings' values, each with many seeds.
//!
//! ```no_run
//! use std::path::Path;
//! use cotorra_experiments::sweep::{Sweep, SweepFolder};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let text = std::fs::read_to_string("testbeds/corridor.yaml")?;
//! let sweep = Sweep::new("corridor.yaml", text, Path::new("testbeds"))
//!     .axis("links.*.delay_scale=1..2:0.5".parse()?)
//!     .axis("plugin=probing,okpi".parse()?)
//!     .seeds(10);
//! let folder = SweepFolder::open(&sweep.default_folder(Path::new("sweeps"))?)?;
//! // Runs that the folder has are not repeated; what runs is kept at once.
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

use std::{
    fs,
    num::NonZero,
    panic::{AssertUnwindSafe, catch_unwind},
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicUsize, Ordering},
        mpsc,
    },
    time::Duration,
};

use cotorra_graph::{PluginProgram, Testbed, seed};
use cotorra_testbed::{FolderError, Options, Place, RunError, panic_text, simulate, simulate_unrecorded};
use cotorra_testbed_file::{Diagnostics, InvalidSetting, Setting};

pub use self::{
    axis::{Axis, InvalidAxis},
    cells::{Cell, Interval},
    folder::{FILES, SweepFolder},
    measured::{Measured, Region},
};

/// A testbed file, the settings to vary, and how often to repeat each combination.
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
    /// A value for each axis, in their order.
    pub values: Vec<String>,
    /// The run's seed.
    pub seed: u64,
}

/// A run that is done.
#[derive(Debug, Clone, PartialEq)]
pub struct Done {
    /// Which.
    pub point: Point,
    /// What came of it.
    pub measured: Measured,
}

/// What a sweep came to.
#[derive(Debug, Clone, PartialEq)]
pub struct Runs {
    /// The runs that are done, in the order of [`Sweep::points`].
    pub done: Vec<Done>,
    /// How many of them the folder had.
    pub resumed: usize,
    /// How many there are in all; more than are done if the sweep was stopped.
    pub total: usize,
}

/// Why a sweep cannot go on. What was done until then is in its folder.
#[derive(Debug, thiserror::Error)]
pub enum SweepError {
    /// The testbed file, or a setting.
    #[error(transparent)]
    Testbed(#[from] Diagnostics),
    /// A setting's path or value cannot be one.
    #[error(transparent)]
    Setting(#[from] InvalidSetting),
    /// The folder.
    #[error(transparent)]
    Folder(#[from] FolderError),
    /// A run cannot begin.
    #[error("{point}: {source}")]
    Run {
        /// Which.
        point: String,
        /// Why.
        source: RunError,
    },
    /// A run panicked, which is a bug.
    #[error("{point} broke off, which is a bug: {reason}")]
    Panicked {
        /// Which.
        point: String,
        /// What it said.
        reason: String,
    },
}

impl Sweep {
    /// A sweep over nothing yet: one run of a testbed file's text. `source_name` is what mistakes are told with, and the
    /// paths in the file begin at `base_dir`.
    pub fn new(source_name: &str, text: String, base_dir: &Path) -> Self {
        let (source_name, base_dir) = (source_name.to_owned(), base_dir.to_owned());
        Self { source_name, text, base_dir, axes: Vec::new(), seeds: 1, until: None }
    }

    /// Varies a setting as well.
    pub fn axis(mut self, axis: Axis) -> Self {
        self.axes.push(axis);
        self
    }

    /// Runs each combination with so many seeds, from the file's on.
    pub fn seeds(self, seeds: u32) -> Self {
        Self { seeds, ..self }
    }

    /// Ends each run after so long, walks finished or not.
    pub fn until(self, until: Option<Duration>) -> Self {
        Self { until, ..self }
    }

    /// The settings that vary.
    pub fn axes(&self) -> &[Axis] {
        &self.axes
    }

    /// All combinations of the axes' values, the last axis's changing fastest.
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

    /// All runs: the combinations, each with its seeds.
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

    /// A folder in `parent` that is this sweep's alone: its name says the testbed, the settings that vary and, in a few
    /// letters, all that the runs depend on but the settings' values and the number of seeds. So the same sweep goes
    /// on in it, and so does one with more values or seeds.
    ///
    /// # Errors
    /// [`SweepError::Testbed`] if the file cannot be run as it is.
    pub fn default_folder(&self, parent: &Path) -> Result<PathBuf, SweepError> {
        let testbed = cotorra_testbed_file::parse(&self.source_name, &self.text, &self.base_dir)?;
        let paths: Vec<_> = self.axes.iter().map(Axis::path).collect();
        // Its map and traces are in it.
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

    /// Which run a point is, for people and for the folder.
    pub fn name(&self, point: &Point) -> String {
        let settings =
            self.axes.iter().zip(&point.values).map(|(axis, value)| format!("{}={value}", axis.path()));
        settings.chain([format!("seed={}", point.seed)]).collect::<Vec<_>>().join(" ")
    }

    /// Runs all that the folder does not have yet, `jobs` at a time, and keeps each there as soon as it is done.
    /// `go_on` is told how many are done, of how many, at the beginning and after each; `false` stops the sweep.
    ///
    /// # Errors
    /// [`SweepError`].
    pub fn run(
        &self,
        folder: &SweepFolder,
        jobs: NonZero<usize>,
        mut go_on: impl FnMut(usize, usize) -> bool,
    ) -> Result<Runs, SweepError> {
        let points = self.points()?;
        let mut kept = folder.kept()?;
        let mut done: Vec<Option<Measured>> =
            points.iter().map(|point| kept.remove(&self.name(point))).collect();
        let missing: Vec<usize> = (0..points.len()).filter(|&i| done[i].is_none()).collect();
        let (total, resumed) = (points.len(), points.len() - missing.len());
        let (next, stop) = (AtomicUsize::new(0), AtomicBool::new(!go_on(resumed, total)));
        let (tell, results) = mpsc::channel();
        let mut failed = None;
        std::thread::scope(|scope| {
            for _ in 0..jobs.get().min(missing.len()) {
                let (tell, points, missing, next, stop) = (tell.clone(), &points, &missing, &next, &stop);
                scope.spawn(move || {
                    while !stop.load(Ordering::Relaxed)
                        && let Some(&place) = missing.get(next.fetch_add(1, Ordering::Relaxed))
                    {
                        let run = folder.run(place);
                        let Some(result) = self.measure(&points[place], &run, stop).transpose() else {
                            return;
                        };
                        if tell.send((place, result)).is_err() {
                            return;
                        }
                    }
                });
            }
            drop(tell);
            let mut count = resumed;
            for (place, result) in &results {
                let result = result.and_then(|measured| {
                    folder.keep(&self.name(&points[place]), &measured)?;
                    Ok(measured)
                });
                match result {
                    Ok(measured) => {
                        done[place] = Some(measured);
                        count += 1;
                        if !go_on(count, total) {
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
        if let Some(error) = failed {
            return Err(error);
        }
        let done = points.into_iter().zip(done);
        let done = done.filter_map(|(point, measured)| Some(Done { point, measured: measured? })).collect();
        Ok(Runs { done, resumed, total })
    }

    /// One run; `None` if it was stopped before its end.
    fn measure(
        &self,
        point: &Point,
        folder: &Path,
        stop: &AtomicBool,
    ) -> Result<Option<Measured>, SweepError> {
        let testbed = self.testbed(&point.values)?;
        let run = || {
            if testbed.plugins.iter().any(|spec| matches!(spec.program, PluginProgram::Command(_))) {
                self.simulate_with_programs(testbed, point.seed, folder, stop)
            } else {
                let go_on = || !stop.load(Ordering::Relaxed);
                let summary = simulate_unrecorded(Arc::new(testbed), point.seed, self.until, go_on)?;
                Ok(summary.as_ref().map(Measured::of))
            }
        };
        let named = || self.name(point);
        match catch_unwind(AssertUnwindSafe(run)) {
            Ok(result) => result.map_err(|source| SweepError::Run { point: named(), source }),
            Err(panic) => {
                Err(SweepError::Panicked { point: named(), reason: panic_text(&*panic).to_owned() })
            }
        }
    }

    /// Runs a point whose plug-ins are programs, which need a run's folder. The folder stays if a plug-in was cut off:
    /// it holds the program's log.
    fn simulate_with_programs(
        &self,
        testbed: Testbed,
        seed: u64,
        folder: &Path,
        stop: &AtomicBool,
    ) -> Result<Option<Measured>, RunError> {
        // What another process left that was killed.
        let _ = fs::remove_dir_all(folder);
        let place = Place::At(folder.to_owned());
        let options = Options { seed: Some(seed), until: self.until, folder: place, ..Options::default() };
        let finished = simulate(testbed, &self.text, &options, |_| !stop.load(Ordering::Relaxed))?;
        if finished.was_stopped() || finished.summary.plugin_faults.is_empty() {
            // Nobody needs it any more, and what cannot be removed harms nobody.
            let _ = fs::remove_dir_all(folder);
        }
        Ok((!finished.was_stopped()).then(|| Measured::of(&finished.summary)))
    }

    /// What the runs say of each combination, in the order of [`Sweep::combinations`]; those without a run are left out.
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
}

#[cfg(test)]
mod tests;
