//! Puts a testbed together and runs it: the core of the three blocks, the API, the plug-in host, and what a run leaves.
//!
//! [`Run::start`] is the way in, [`Run::finish`] the way out.
#![forbid(unsafe_code)]

mod answerers;
mod api;
mod bundled;
mod carried;
mod confined;
mod core;
mod core_loop;
mod domain;
pub mod faults;
mod images;
mod keeping;
mod live;
mod plugins;
mod previous_run;
mod real_links;
mod real_network;
mod recorded;
mod reflected;
pub mod replay;
mod report;
mod retaining;
mod robots;
mod run;
mod script;
mod simulate;

pub use api::{ApiError, Token, Tokens, TokensError, openapi};
pub use bundled::{VnfError, localization, navigation};
pub use cotorra_wais::http::openapi as wais_openapi;
pub use live::{Live, Snapshot};
pub use plugins::{PluginError, panic_text};
pub use previous_run::{CannotGoOn, PreviousRun, orchestrators};
pub use real_links::{RealLinkError, interface_plans};
pub use recorded::{Recorded, RecordedError};
pub use report::{
    DecisionRecord, Fidelity, FolderError, HandoverRecord, LatenessSummary, LocalizationSummary, Panel,
    Place, PlacementRecord, Quantiles, RegionSummary, Report, ServiceSummary, Summary, draw, service_time_ms,
    svg, write_file,
};
pub use robots::RobotError;
pub use run::{Finished, Leftovers, Options, Run, RunError, Stopper, about, clean, leftovers};
pub use script::{Rehearsal, ScriptError, rehearse};
pub use simulate::{Simulation, simulate, simulate_unrecorded};
