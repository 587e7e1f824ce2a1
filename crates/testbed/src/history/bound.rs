//! Bounds the size of a run's history, so that a run that is left alone does not fill the disk.

use std::{fs, path::PathBuf, time::Duration};

use cotorra_graph::Timestamp;
use cotorra_measurements::Location;

use crate::{
    options::{HistoryLimit, Options},
    report::RunFolder,
};

/// Interval of looks at the size.
const LOOK: Duration = Duration::from_secs(1);

/// The file of a run's history, and how far the run may let it grow.
#[derive(Debug, Clone, Default)]
pub(crate) struct HistoryBound {
    limit: HistoryLimit,
    /// The file and its log; none if the history is on a server, which has bounds of its own.
    files: Vec<PathBuf>,
    /// Size before the run, of a history that runs share, bytes.
    before: u64,
    next_look: Timestamp,
}

impl HistoryBound {
    pub(crate) fn new(options: &Options, folder: &RunFolder) -> Self {
        let file = match &options.history {
            None => Some(folder.history()),
            Some(Location::File(file)) => Some(file.clone()),
            Some(Location::Server(_)) => None,
        };
        let with_log = |file: PathBuf| {
            let mut log = file.clone().into_os_string();
            log.push("-wal");
            [file, log.into()]
        };
        let files = file.into_iter().flat_map(with_log).collect();
        let mut bound = Self { limit: options.history_limit, files, ..Self::default() };
        bound.before = bound.size();
        bound
    }

    /// Whether the history has reached its limit.
    pub(crate) fn is_reached(&self) -> bool {
        !self.files.is_empty() && self.size().saturating_sub(self.before) >= self.limit.bytes
    }

    /// Returns the size of the files, bytes.
    fn size(&self) -> u64 {
        self.files.iter().map(|file| fs::metadata(file).map_or(0, |file| file.len())).sum()
    }

    /// Does the same as [`Self::is_reached`], but looks only once a second.
    pub(crate) fn is_full(&mut self, now: Timestamp) -> bool {
        if now < self.next_look {
            return false;
        }
        self.next_look = now + LOOK;
        self.is_reached()
    }

    /// Says what is not recorded, for people.
    pub(crate) fn what(&self) -> String {
        format!(
            "the rest of the run, which ended because its history reached {}: --history-limit sets another limit, and \
             `retention` in the testbed file keeps a history short",
            self.limit
        )
    }
}
