//! The location of a run's history: in its own folder, or shared with other runs. A note in the folder names a shared one.

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use cotorra_measurements::{History, Location, RunId, RunInfo};
use serde::{Deserialize, Serialize};

use crate::report::{FolderError, RunFolder, write_file};

/// Note that names the history of a run without one of its own.
const NOTE: &str = "history.json";
const OWN: &str = "history.sqlite";

/// The location of a run's history, and the run's number in it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Recorded {
    /// The text of a [`Location`], without a password.
    pub history: String,
    /// `None` for the first run of the history.
    #[serde(default)]
    pub run: Option<RunId>,
}

/// Error of finding a run's history by its folder.
#[derive(Debug, thiserror::Error)]
pub enum RecordedError {
    /// The folder is not a run's.
    #[error("{} has neither {OWN} nor {NOTE}: it is not the folder of a run", .0.display())]
    NotARun(PathBuf),
    /// The note cannot be read.
    #[error("cannot read {}: {source}", path.display())]
    Unreadable {
        /// Path of the note.
        path: PathBuf,
        /// The system's or the parser's error.
        source: io::Error,
    },
}

/// Error of beginning a run's history.
#[derive(Debug, thiserror::Error)]
pub(crate) enum BeginError {
    #[error(transparent)]
    History(#[from] cotorra_measurements::Error),
    #[error(transparent)]
    Note(#[from] FolderError),
}

impl Recorded {
    /// Finds the history of the run that made a folder.
    ///
    /// # Errors
    /// [`RecordedError`] if the folder is not a run's, or its note cannot be read.
    pub fn of_folder(folder: &Path) -> Result<Self, RecordedError> {
        let path = folder.join(NOTE);
        match fs::read_to_string(&path) {
            Ok(note) => serde_json::from_str(&note)
                .map_err(|e| RecordedError::Unreadable { path, source: io::Error::other(e) }),
            Err(source) if source.kind() == io::ErrorKind::NotFound => {
                let own = folder.join(OWN);
                let is_there = own.is_file();
                let own = Self { history: own.to_string_lossy().into_owned(), run: None };
                is_there.then_some(own).ok_or_else(|| RecordedError::NotARun(folder.to_owned()))
            }
            Err(source) => Err(RecordedError::Unreadable { path, source }),
        }
    }

    /// Begins a run in a history in its folder, or elsewhere, with a note in the folder.
    pub(crate) fn begin(
        folder: &RunFolder,
        elsewhere: Option<&Location>,
        info: &RunInfo,
    ) -> Result<(History, RunId), BeginError> {
        let Some(location) = elsewhere else {
            let history = History::open(folder.history())?;
            let run = history.begin_run(info)?;
            return Ok((history, run));
        };
        let history = History::connect(location)?;
        let run = history.begin_run(info)?;
        let name = match location {
            Location::File(path) => {
                let path = std::path::absolute(path).map_err(|source| FolderError::new(path, source))?;
                path.to_string_lossy().into_owned()
            }
            Location::Server(_) => location.to_string(),
        };
        let note = serde_json::to_string_pretty(&Self { history: name, run: Some(run) });
        write_file(folder.path(), NOTE, &(note.expect("a note is valid JSON") + "\n"))?;
        Ok((history, run))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::Place;

    fn info() -> RunInfo {
        RunInfo { name: "noted".to_owned(), seed: 1, started_at_unix_ns: 0, testbed: String::new() }
    }

    fn folder(place: &Path) -> RunFolder {
        RunFolder::create(&Place::At(place.to_owned()), "noted", "").unwrap()
    }

    #[test]
    fn a_folder_leads_to_its_runs_history() {
        let place = tempfile::tempdir().unwrap();
        let shared = place.path().join("shared.sqlite");
        for (name, run) in [("first", "1"), ("second", "2")] {
            let folder = folder(&place.path().join(name));
            Recorded::begin(&folder, Some(&Location::File(shared.clone())), &info()).unwrap();
            let found = Recorded::of_folder(folder.path()).unwrap();
            assert_eq!(found.history, shared.to_string_lossy());
            assert_eq!(found.run.unwrap().to_string(), run);
            assert!(!folder.history().exists());
        }
        let own = folder(&place.path().join("own"));
        assert!(matches!(Recorded::of_folder(own.path()), Err(RecordedError::NotARun(_))));
        Recorded::begin(&own, None, &info()).unwrap();
        let found = Recorded::of_folder(own.path()).unwrap();
        assert_eq!((Path::new(&found.history), found.run), (&*own.history(), None));
    }
}
