//! Comparison of results with those of a repeat: to the byte in virtual time, and by distribution in real time.

mod two_samples;

use std::{
    collections::BTreeMap,
    fs::{self, File},
    io::{self, BufRead as _, BufReader, Read as _},
    path::{Path, PathBuf},
};

use cotorra_testbed::{Digest, Manifest, ManifestError, Repeat, Time};
use serde::Deserialize;

pub use self::two_samples::{Sample, Two};

/// Limit of a valid run's lateness at the 99th percentile, milliseconds. Services are not told apart below the lateness of
/// their packets, and this is the most of it that counts.
const MAX_TOLERANCE_MS: f64 = 1.0;

/// Error of comparing a folder with that of a repeat.
#[derive(Debug, thiserror::Error)]
pub enum RepeatError {
    /// A manifest cannot be read.
    #[error(transparent)]
    Manifest(#[from] ManifestError),
    /// A file of results cannot be read.
    #[error("cannot read {}: {source}", path.display())]
    Unreadable { path: PathBuf, source: io::Error },
    /// The results that real time is compared by are not those that the run left.
    #[error("{} was changed after the run, so that a repeat cannot be compared with it", .0.display())]
    Changed(PathBuf),
}

/// A folder beside that of its repeat.
#[derive(Debug, Clone, PartialEq)]
pub struct Compared {
    /// The folder of the run within that of an experiment; empty for the folder itself.
    pub of: PathBuf,
    pub outcome: Outcome,
}

/// The outcome of a repeat.
#[derive(Debug, Clone, PartialEq)]
pub enum Outcome {
    /// Virtual time.
    Bytes {
        /// Number of files that are the same.
        same: usize,
        /// Files that are not the same, or that the repeat does not have.
        different: Vec<PathBuf>,
    },
    /// Real time.
    Distributions {
        services: Vec<Service>,
        /// Difference of service times that is not counted, because packets of both runs may have been so late, milliseconds.
        tolerance_ms: f64,
        /// Whether the figures of both runs are valid.
        valid: [bool; 2],
    },
    /// The repeat does not have this run.
    Missing,
}

/// A service in a run and in its repeat.
#[derive(Debug, Clone, PartialEq)]
pub struct Service {
    pub robot: String,
    pub service: String,
    pub two: Two,
}

impl Compared {
    /// Whether the repeat has the same results; with real time, whether the figures of both runs are valid, some service has
    /// samples, and no test rejects them at a level over all tests of the run.
    pub fn is_same(&self, level: f64) -> bool {
        match &self.outcome {
            Outcome::Bytes { same, different } => *same > 0 && different.is_empty(),
            Outcome::Distributions { services, valid, .. } => {
                let level = each(level, services);
                *valid == [true, true]
                    && !services.is_empty()
                    && services.iter().all(|its| its.two.is_same(level))
            }
            Outcome::Missing => false,
        }
    }
}

/// Returns the level of each test, so that all of a run together reject the same distributions no more often than `level`: two
/// for each service (Bonferroni).
pub fn each(level: f64, services: &[Service]) -> f64 {
    level / (2 * services.len().max(1)) as f64
}

/// Compares a folder with that of its repeat; for an experiment, each run in it.
///
/// # Errors
/// [`RepeatError`].
pub fn compare(folder: &Path, repeat: &Path) -> Result<Vec<Compared>, RepeatError> {
    let manifest = Manifest::read(folder)?;
    let mut all = Vec::new();
    let is_experiment = matches!(&manifest.repeat, Repeat::Words(words) if words.first().is_some_and(|word| word == "experiment"));
    // With real time, the tables of an experiment are compared by its runs.
    if manifest.time == Time::Virtual || !is_experiment {
        all.push(Compared { of: PathBuf::new(), outcome: outcome(&manifest, folder, repeat)? });
    }
    if is_experiment {
        for of in runs(folder)? {
            let (one, other) = (folder.join(&of), repeat.join(&of));
            let outcome = match Manifest::read(&one) {
                _ if !other.is_dir() => Outcome::Missing,
                read => self::outcome(&read?, &one, &other)?,
            };
            all.push(Compared { of, outcome });
        }
    }
    Ok(all)
}

/// Name of the file with the samples of a run.
const SAMPLES: &str = "service_time.csv";
/// Name of the file with the summary of a run.
const SUMMARY: &str = "summary.json";

/// Returns the folders in a folder that have a manifest with results.
fn runs(folder: &Path) -> Result<Vec<PathBuf>, RepeatError> {
    let unreadable = |source| RepeatError::Unreadable { path: folder.to_owned(), source };
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).map_err(unreadable)? {
        let entry = entry.map_err(unreadable)?;
        if Manifest::read(&entry.path()).is_ok_and(|manifest| !manifest.produced.is_empty()) {
            found.push(PathBuf::from(entry.file_name()));
        }
    }
    found.sort();
    Ok(found)
}

fn outcome(manifest: &Manifest, folder: &Path, repeat: &Path) -> Result<Outcome, RepeatError> {
    match manifest.time {
        Time::Virtual => {
            let is_same = |(name, digest): &(&PathBuf, &Digest)| {
                Digest::of_file(&repeat.join(name)).is_ok_and(|its| its == **digest)
            };
            let (same, different): (Vec<_>, Vec<_>) = manifest.produced.iter().partition(is_same);
            let different = different.into_iter().map(|(name, _)| name.clone()).collect();
            Ok(Outcome::Bytes { same: same.len(), different })
        }
        Time::Real => {
            for name in [SAMPLES, SUMMARY] {
                let path = folder.join(name);
                let now = Digest::of_file(&path).ok();
                if now.as_ref() != manifest.produced.get(Path::new(name)) {
                    return Err(RepeatError::Changed(path));
                }
            }
            distributions(&Run::read(folder)?, &Run::read(repeat)?)
        }
    }
}

fn distributions(one: &Run, other: &Run) -> Result<Outcome, RepeatError> {
    let late_ms = |run: &Run| run.fidelity.lateness_us.p99 / 1e3;
    let tolerance_ms = late_ms(one).max(late_ms(other)).clamp(0.0, MAX_TOLERANCE_MS);
    let services = one.services.iter().filter_map(|its| {
        let of = |run: &Run| Sample::new(run.samples_ms(&its.robot, &its.service));
        let (first, second) = (of(one), of(other));
        let are_there = first.len() + second.len() > 0;
        let two = || Two::of(&first, &second, its.service_time_target_ms, tolerance_ms);
        are_there.then(|| Service { robot: its.robot.clone(), service: its.service.clone(), two: two() })
    });
    let valid = [one.fidelity.valid, other.fidelity.valid];
    Ok(Outcome::Distributions { services: services.collect(), tolerance_ms, valid })
}

/// The part of a run that is compared.
#[derive(Deserialize)]
struct Run {
    services: Vec<Served>,
    fidelity: Fidelity,
    /// Service times by robot and service, ms; infinite without an answer.
    #[serde(skip)]
    samples: BTreeMap<(String, String), Vec<f64>>,
}

#[derive(Deserialize)]
struct Served {
    robot: String,
    service: String,
    service_time_target_ms: f64,
}

#[derive(Deserialize)]
struct Fidelity {
    valid: bool,
    lateness_us: Lateness,
}

#[derive(Deserialize)]
struct Lateness {
    p99: f64,
}

/// Largest summary, bytes.
const MAX_SUMMARY: u64 = 64 << 20;
/// Largest file of samples, bytes. Of a line, only the time is kept.
const MAX_SAMPLES: u64 = 1 << 30;
/// Longest line of samples, bytes.
const LONGEST_LINE: u64 = 4096;

impl Run {
    fn read(folder: &Path) -> Result<Self, RepeatError> {
        let wrong = |name: &str, source| RepeatError::Unreadable { path: folder.join(name), source };
        let open = |name: &str, most: u64| {
            let path = folder.join(name);
            // Asked before it is opened, which waits for a pipe's other end.
            let metadata = fs::metadata(&path).map_err(|source| wrong(name, source))?;
            if !metadata.is_file() || metadata.len() > most {
                let reason = format!("it is not a regular file of at most {most} bytes");
                return Err(wrong(name, io::Error::other(reason)));
            }
            let file = File::open(&path).map_err(|source| wrong(name, source))?;
            Ok(BufReader::new(file.take(most)))
        };
        let mut run: Self = serde_json::from_reader(open(SUMMARY, MAX_SUMMARY)?)
            .map_err(|error| wrong(SUMMARY, error.into()))?;
        let services = run.services.iter().map(|its| ((its.robot.clone(), its.service.clone()), Vec::new()));
        run.samples = services.collect();
        let (mut samples, mut line, mut is_head) = (open(SAMPLES, MAX_SAMPLES)?, String::new(), true);
        loop {
            line.clear();
            let read = samples.by_ref().take(LONGEST_LINE).read_line(&mut line);
            if read.map_err(|source| wrong(SAMPLES, source))? == 0 {
                return Ok(run);
            }
            if !std::mem::replace(&mut is_head, false) {
                let not_one = || wrong(SAMPLES, io::Error::other("a line is not a sample"));
                run.add(line.trim_end()).ok_or_else(not_one)?;
            }
        }
    }

    /// Adds a line of the samples, if it is of a service of the summary. Returns `None` if it is no sample.
    fn add(&mut self, line: &str) -> Option<()> {
        let mut cells = line.split(',').skip(1);
        let (robot, service, took) = (cells.next()?, cells.next()?, cells.nth(1)?);
        let took_ms = if took.is_empty() { f64::INFINITY } else { took.parse().ok()? };
        if let Some(samples) = self.samples.get_mut(&(robot.to_owned(), service.to_owned())) {
            samples.push(took_ms);
        }
        Some(())
    }

    /// Returns the times of a service.
    fn samples_ms(&self, robot: &str, service: &str) -> Vec<f64> {
        self.samples.get(&(robot.to_owned(), service.to_owned())).cloned().unwrap_or_default()
    }
}

#[cfg(test)]
mod tests;
