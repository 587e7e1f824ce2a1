//! What a run leaves: the summary, the samples, the published figure's layout. All but how far
//! off localization was is read off the events.

mod driving;
mod end;
mod figure;
mod folder;
mod run_folder;
mod samples;
mod summary;

pub(crate) use end::End;
pub use figure::{Panel, draw, svg};
pub use folder::{FolderError, Place, write_file};
pub use run_folder::RunFolder;
pub use summary::{
    DecisionRecord, Fidelity, HandoverRecord, LatenessSummary, LocalizationSummary, Losses, PlacementRecord,
    Quantiles, RegionSummary, Report, ServiceSummary, Summary, service_time_ms,
};
