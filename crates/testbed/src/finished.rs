//! The result of a run.

use std::path::PathBuf;

use cotorra_figure::Format;
use cotorra_measurements::RunId;
use cotorra_recording::RecordingSummary;

use crate::report::{End, FolderError, Report, StalenessRegret, Summary, rewrite_summary, write_figure};

/// The result of a run.
#[derive(Debug)]
pub struct Finished {
    /// The summary, as in `summary.json`.
    pub summary: Summary,
    /// The report that the summary is made from.
    pub report: Report,
    /// Absolute path of the run's folder.
    pub folder: PathBuf,
    /// The run's number in its history.
    pub run: RunId,
    /// The recording's summary, if the run was recorded or watched.
    pub recording: Option<RecordingSummary>,
    /// Outputs that could not be written, as on a full disk, each with the error.
    pub unrecorded: Vec<String>,
}

impl Finished {
    /// Whether a user stopped the run before its end.
    pub fn was_stopped(&self) -> bool {
        self.summary.ended == End::Stopped.as_str()
    }

    /// Adds what old context cost to the summary, also in the folder.
    ///
    /// # Errors
    /// [`FolderError`].
    pub fn add_staleness_regret(&mut self, regret: Vec<StalenessRegret>) -> Result<(), FolderError> {
        self.summary.staleness_regret = regret;
        rewrite_summary(&self.folder, &self.summary)
    }

    /// Writes `service_time` in a further format beside `service_time.svg`.
    ///
    /// # Errors
    /// [`FolderError`].
    pub fn write_figure(&self, format: Format) -> Result<(), FolderError> {
        write_figure(&self.folder, &self.report, &self.summary, format)
    }
}
