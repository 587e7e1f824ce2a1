//! Resolves the argument RUN to a run and its history.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
};

use cotorra_graph::ServiceId;
use cotorra_measurements::{History, Location, Run, RunId};
use cotorra_testbed::{Fidelity, Judged, Recorded, RecordedError, ServiceKpis};

use super::args::HistoryPlace;
use super::place::{HISTORY_VARIABLE, WrongPlace, location};

/// Folder of the testbed files that ship with cotorra.
const SHIPPED: &str = "testbeds";
/// Name of the newest run.
const LATEST: &str = "latest";

#[derive(Debug, thiserror::Error, miette::Diagnostic)]
pub enum Error {
    #[error(transparent)]
    #[diagnostic(transparent)]
    Place(#[from] WrongPlace),
    #[error(transparent)]
    #[diagnostic(help("`cotorra history runs` lists all runs"))]
    Folder(#[from] RecordedError),
    #[error("there is no folder {0}")]
    #[diagnostic(help("`cotorra history runs` lists all runs; `latest` is the newest one"))]
    NoFolder(String),
    #[error("run {0} is a number, but no history is named")]
    #[diagnostic(help("name the history with --history or in {HISTORY_VARIABLE}, or the run by its folder"))]
    NoHistory(RunId),
    #[error("there is no run in {}", .0.display())]
    #[diagnostic(help("start one with `cotorra run`, or name another folder with --runs"))]
    NoRuns(PathBuf),
    #[error("there is no history {}", .0.display())]
    #[diagnostic(help("`cotorra run --history {}` creates it", .0.display()))]
    NoFile(PathBuf),
    #[error("{folder} was recorded in {history}")]
    #[diagnostic(help("name that history, with user and password, with --history or in {HISTORY_VARIABLE}"))]
    Elsewhere { folder: String, history: String },
    #[error("{0} has no run")]
    Empty(String),
    #[error(transparent)]
    History(#[from] cotorra_measurements::Error),
}

/// A run and its history.
pub struct Source {
    pub history: History,
    pub run: Run,
    /// The run's folder, if it was found by that.
    pub folder: Option<PathBuf>,
}

impl Source {
    /// Finds a run by its folder, its number in the history that `place` names, or as `latest`.
    pub fn find(run: &str, place: &HistoryPlace) -> Result<Self, Error> {
        let named = location(place.history.as_ref())?;
        if let (Some(location), Ok(number)) = (&named, run.parse()) {
            let history = open(location)?;
            return Ok(Self { run: history.run(number)?, history, folder: None });
        }
        Self::of_folder(&folder(run, &place.runs)?, named.as_ref())
    }

    /// Finds the run of a folder. `named` is the history that the user named, with user and password.
    pub fn of_folder(folder: &Path, named: Option<&Location>) -> Result<Self, Error> {
        let Recorded { history, run } = Recorded::of_folder(folder)?;
        let is_same = |named: &&Location| named.to_string() == history;
        let location = match history.parse() {
            Ok(Location::File(path)) => Location::File(path),
            // The location in the folder lacks the server's user and password.
            _ => named.filter(is_same).cloned().ok_or_else(|| Error::Elsewhere {
                folder: folder.display().to_string(),
                history: history.clone(),
            })?,
        };
        let opened = open(&location)?;
        let run = match run {
            Some(run) => opened.run(run)?,
            None => opened.runs(None, 1)?.into_iter().next().ok_or(Error::Empty(history))?,
        };
        Ok(Self { history: opened, run, folder: Some(folder.to_owned()) })
    }

    /// Returns the verdict on the run; `None` without its folder, or if the run was killed before it had one.
    pub fn verdict(&self) -> Option<Fidelity> {
        Fidelity::of_folder(self.folder.as_deref()?).ok()
    }

    /// Returns the KPIs of the run's services; none without its folder, or if the run was killed before it judged them.
    pub fn kpis(&self) -> BTreeMap<ServiceId, Vec<Judged>> {
        let all = self.folder.as_deref().and_then(|folder| ServiceKpis::of_folder(folder).ok());
        all.into_iter().flatten().map(|its| (its.service, its.kpis)).collect()
    }

    /// Returns the folder that relative paths in the run's testbed file start from, unless the user named one.
    pub fn base(&self, named: Option<&Path>) -> PathBuf {
        named.or(self.folder.as_deref()).unwrap_or(Path::new(SHIPPED)).to_owned()
    }
}

/// Returns the folder of a run: the folder itself, or that of `latest`.
pub fn folder(run: &str, runs: &Path) -> Result<PathBuf, Error> {
    let folder = if run == LATEST { latest(runs)? } else { PathBuf::from(run) };
    if folder.is_dir() {
        return Ok(folder);
    }
    Err(match run.parse() {
        Ok(number) => Error::NoHistory(number),
        Err(_) => Error::NoFolder(run.to_owned()),
    })
}

/// Opens an existing history.
pub fn open(location: &Location) -> Result<History, Error> {
    match location {
        Location::File(path) if !path.exists() => Err(Error::NoFile(path.clone())),
        location => Ok(History::connect_to_read(location)?),
    }
}

/// Lists folders of runs in a folder, including runs inside the folders of experiments, the oldest first.
pub fn folders(runs: &Path) -> Vec<PathBuf> {
    let entries = |folder: &Path| fs::read_dir(folder).into_iter().flatten().flatten().map(|e| e.path());
    // A run writes this file first, and never changes it.
    let started =
        |folder: &Path| fs::metadata(folder.join("testbed.yaml")).and_then(|file| file.modified()).ok();
    let mut found = Vec::new();
    for folder in entries(runs) {
        match started(&folder) {
            Some(started) => found.push((started, folder)),
            None => found.extend(entries(&folder).filter_map(|walk| Some((started(&walk)?, walk)))),
        }
    }
    found.sort();
    found.into_iter().map(|(_, folder)| folder).filter(|folder| Recorded::of_folder(folder).is_ok()).collect()
}

fn latest(runs: &Path) -> Result<PathBuf, Error> {
    folders(runs).pop().ok_or_else(|| Error::NoRuns(runs.to_owned()))
}
