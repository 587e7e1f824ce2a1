//! What a run leaves: the summary, the samples, the published figure's layout. All but how far
//! off localization was is read off the events.

mod driving;
mod figure;
mod folder;
mod samples;
mod summary;

pub(crate) use figure::number_clips;
pub use figure::{Panel, draw};
pub(crate) use folder::write;
pub use folder::{FolderError, Place, RunFolder};
pub(crate) use summary::service_time_ms;
pub use summary::{
    DecisionRecord, Fidelity, HandoverRecord, LatenessSummary, LocalizationSummary, Losses, PlacementRecord,
    Quantiles, RegionSummary, Report, ServiceSummary, Summary,
};
