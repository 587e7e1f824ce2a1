//! Merging of shards: their journals become one, and their runs those of the whole sweep.

use std::{
    collections::BTreeMap,
    fs, io,
    num::NonZero,
    path::{Path, PathBuf},
};

use cotorra_testbed::FolderError;

use super::{
    measured::Measured,
    runs::{Done, Runs},
    samples,
    shard::{Record, Shard},
};
use crate::{
    batch::{Again, SamplesFile},
    journal::{self, Found, Journal, Kept},
    key::Key,
    outcome::Outcome,
};

/// The runs of several shards.
#[derive(Debug)]
pub struct Merge {
    /// Folder that holds the first shard.
    pub folder: PathBuf,
    /// Folders of the shards.
    pub shards: Vec<PathBuf>,
    pub runs: Runs,
    /// Names of the runs that are missing, by their shard.
    pub missing: BTreeMap<Shard, Vec<String>>,
    /// Names and keys of the runs that are done.
    keys: Vec<(String, Key)>,
    /// Samples of runs in the folders of shards, by the runs' names.
    samples: BTreeMap<String, PathBuf>,
}

/// Error of merging shards. Nothing was changed.
#[derive(Debug, thiserror::Error)]
pub enum MergeError {
    /// A folder of a shard cannot be read.
    #[error("cannot read {}: {source}", path.display())]
    Unreadable { path: PathBuf, source: io::Error },
    /// The folder of the sweep cannot be written.
    #[error(transparent)]
    Folder(#[from] FolderError),
    /// A folder has no shards.
    #[error(
        "there is no shard in {}: name the folder of a sweep that has some, or folders of shards", .0.display()
    )]
    NoShards(PathBuf),
    /// Two folders belong to different sweeps.
    #[error(
        "{} and {} are shards of different sweeps: they have another {difference}", .folders[0].display(),
        .folders[1].display()
    )]
    OtherSweep {
        folders: [PathBuf; 2],
        /// The difference, for people.
        difference: String,
    },
    /// A run has two results, although runs in virtual time repeat.
    #[error("{run} has other results in {} than in {}", .folders[0].display(), .folders[1].display())]
    Conflict {
        /// Name of the run.
        run: String,
        folders: [PathBuf; 2],
    },
}

impl Merge {
    /// Reads shards from their folders, or from folders that hold them. Shards that are still running are read, too.
    ///
    /// # Errors
    /// [`MergeError`].
    pub fn read(folders: &[PathBuf]) -> Result<Self, MergeError> {
        let mut shards = Vec::new();
        for folder in folders {
            shards.extend(shards_in(folder)?);
        }
        shards.sort_by_key(|(_, record)| record.shard);
        let Some((first, Record { plan, .. })) = shards.first() else {
            return Err(MergeError::NoShards(folders.first().cloned().unwrap_or_default()));
        };
        let mut kept = Vec::new();
        for (folder, record) in &shards {
            if let Some(difference) = plan.difference(&record.plan) {
                return Err(MergeError::OtherSweep { folders: [first.clone(), folder.clone()], difference });
            }
            kept.push((folder, journal::read(folder).map_err(unreadable(folder))?));
        }
        let number = usual_number(shards.iter().map(|(_, record)| record.shard));
        let mut missing: BTreeMap<_, Vec<_>> = BTreeMap::new();
        let (mut runs, mut keys, mut samples) = (Vec::new(), Vec::new(), BTreeMap::new());
        for (place, point) in plan.points().into_iter().enumerate() {
            let (name, key) = (point.name(&plan.axes), plan.key(place));
            let outcome = outcome(&name, key, &kept)?;
            let of_run = samples::place(&name);
            let with_run = kept.iter().filter(|(_, kept)| kept.is_last(&name, key));
            let files = with_run.map(|(folder, _)| folder.join(&of_run));
            samples.extend(files.filter(|file| file.is_file()).map(|file| (name.clone(), file)));
            match outcome {
                Some(_) => keys.push((name, key.clone())),
                None => missing.entry(Shard::of_place(place, number)).or_default().push(name),
            }
            runs.push((point, of_run, outcome));
        }
        let runs = Runs::new(&plan.axes, runs.into_iter(), 0, Again::default());
        let folder = first.parent().unwrap_or(first).to_owned();
        let shards = shards.into_iter().map(|(folder, _)| folder).collect();
        Ok(Self { folder, shards, runs, missing, keys, samples })
    }

    /// Adds the runs with their samples to a journal, and writes [`FILES`](super::FILES) into its folder.
    ///
    /// # Errors
    /// [`MergeError::Conflict`] if the journal has a run with another result; [`MergeError::Folder`].
    pub fn write(&self, journal: &Journal) -> Result<(), MergeError> {
        let kept = journal.kept()?;
        let mut new = Vec::new();
        for ((run, key), done) in self.keys.iter().zip(&self.runs.done) {
            match find(&kept, run, key) {
                Some(before) if before == done.outcome && kept.is_last(run, key) => {}
                Some(before @ Outcome::Measured(_))
                    if before != done.outcome && done.outcome.measured().is_some() =>
                {
                    let folders = [journal.path().to_owned(), self.folder.clone()];
                    return Err(MergeError::Conflict { run: run.clone(), folders });
                }
                _ => new.push((run, key, done)),
            }
        }
        let file = |done: &Done| SamplesFile { path: journal.path().join(&done.samples), is_wanted: true };
        for (run, key, done) in new {
            file(done).remove()?;
            journal.keep(run, key, &done.outcome)?;
        }
        for ((run, _), done) in self.keys.iter().zip(&self.runs.done) {
            if let Some(from) = self.samples.get(run)
                && !file(done).path.is_file()
            {
                samples::copy(from, &file(done))?;
            }
        }
        Ok(self.runs.write(journal)?)
    }
}

fn find(kept: &Kept, run: &str, key: &Key) -> Option<Outcome<Measured>> {
    match kept.find(run, key, "") {
        Found::Outcome(outcome) => Some(outcome),
        Found::Stale(_) | Found::Nothing => None,
    }
}

/// Returns the outcome of a run in any of these folders. One with results is preferred to a void one.
fn outcome(run: &str, key: &Key, kept: &[(&PathBuf, Kept)]) -> Result<Option<Outcome<Measured>>, MergeError> {
    let mut found: Option<(&PathBuf, Outcome<Measured>)> = None;
    for (folder, kept) in kept {
        let Some(outcome) = find(kept, run, key) else { continue };
        match &found {
            Some((other, before)) if before.measured().is_some() => {
                if outcome.measured().is_some() && outcome != *before {
                    let folders = [(*other).clone(), (*folder).clone()];
                    return Err(MergeError::Conflict { run: run.to_owned(), folders });
                }
            }
            _ => found = Some((folder, outcome)),
        }
    }
    Ok(found.map(|(_, outcome)| outcome))
}

fn unreadable(path: &Path) -> impl FnOnce(io::Error) -> MergeError + '_ {
    move |source| MergeError::Unreadable { path: path.to_owned(), source }
}

/// Returns the folders of shards that a folder is or holds.
fn shards_in(folder: &Path) -> Result<Vec<(PathBuf, Record)>, MergeError> {
    let folder = &folder.canonicalize().map_err(unreadable(folder))?;
    if let Some(record) = Record::read(folder).map_err(unreadable(folder))? {
        return Ok(vec![(folder.clone(), record)]);
    }
    let mut shards = Vec::new();
    for entry in fs::read_dir(folder).map_err(unreadable(folder))? {
        let below = entry.map_err(unreadable(folder))?.path();
        if below.is_dir()
            && let Some(record) = Record::read(&below).map_err(unreadable(&below))?
        {
            shards.push((below, record));
        }
    }
    if shards.is_empty() { Err(MergeError::NoShards(folder.clone())) } else { Ok(shards) }
}

/// Returns the number of shards that most of these have: a sweep may have been divided anew.
fn usual_number(shards: impl Iterator<Item = Shard>) -> NonZero<usize> {
    let mut counts = BTreeMap::new();
    for shard in shards {
        *counts.entry(shard.shards()).or_insert(0) += 1;
    }
    let usual = counts.into_iter().max_by_key(|(_, count)| *count);
    usual.map_or(NonZero::<usize>::MIN, |(number, _)| number)
}
