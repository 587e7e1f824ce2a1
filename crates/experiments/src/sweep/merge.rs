//! Merging of shards: their journals become one, and their runs those of the whole sweep.

use std::{
    collections::{BTreeMap, HashMap},
    fs, io,
    num::NonZero,
    path::{Path, PathBuf},
};

use cotorra_testbed::FolderError;

use super::{
    measured::Measured,
    runs::Runs,
    shard::{Record, Shard},
};
use crate::journal::{self, Journal};

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
        /// What differs.
        difference: &'static str,
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
        let mut kept: HashMap<String, (&PathBuf, Measured)> = HashMap::new();
        for (folder, record) in &shards {
            if let Some(difference) = plan.difference(&record.plan) {
                return Err(MergeError::OtherSweep { folders: [first.clone(), folder.clone()], difference });
            }
            for (run, measured) in journal::read::<Measured>(folder).map_err(unreadable(folder))? {
                match kept.get(&run) {
                    Some((other, same)) if *same != measured => {
                        return Err(MergeError::Conflict {
                            run,
                            folders: [(*other).clone(), folder.clone()],
                        });
                    }
                    Some(_) => {}
                    None => drop(kept.insert(run, (folder, measured))),
                }
            }
        }
        let number = usual_number(shards.iter().map(|(_, record)| record.shard));
        let mut missing: BTreeMap<_, Vec<_>> = BTreeMap::new();
        let runs = plan.points().into_iter().enumerate().map(|(place, point)| {
            let name = point.name(&plan.axes);
            let measured = kept.remove(&name).map(|(_, measured)| measured);
            if measured.is_none() {
                missing.entry(Shard::of_place(place, number)).or_default().push(name);
            }
            (point, measured)
        });
        let runs = Runs::new(&plan.axes, runs.collect::<Vec<_>>().into_iter(), 0);
        let folder = first.parent().unwrap_or(first).to_owned();
        let shards = shards.into_iter().map(|(folder, _)| folder).collect();
        Ok(Self { folder, shards, runs, missing })
    }

    /// Adds the runs to a journal, and writes [`FILES`](super::FILES) into its folder.
    ///
    /// # Errors
    /// [`MergeError::Conflict`] if the journal has a run with another result; [`MergeError::Folder`].
    pub fn write(&self, journal: &Journal) -> Result<(), MergeError> {
        let kept = journal.kept::<Measured>()?;
        let named = || self.runs.done.iter().map(|done| (done.point.name(&self.runs.axes), &done.measured));
        let differs =
            |(run, measured): &(String, &Measured)| kept.get(run).is_some_and(|its| its != *measured);
        if let Some((run, _)) = named().find(differs) {
            let folders = [journal.path().to_owned(), self.folder.clone()];
            return Err(MergeError::Conflict { run, folders });
        }
        for (run, measured) in named().filter(|(run, _)| !kept.contains_key(run)) {
            journal.keep(&run, measured)?;
        }
        Ok(self.runs.write(journal)?)
    }
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
