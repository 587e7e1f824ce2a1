//! Puts a testbed together and runs it: the core of the three blocks, the API, the plug-in host, and the report.
//!
//! [`Run::start`] brings a testbed up in real time, and [`Run::finish`] takes it down. [`simulate()`] does both in virtual
//! time. [`Replay`](replay::Replay) plays a recorded run. [`Report`] and [`Summary`] are the results. Experiments of many
//! runs are in `cotorra-experiments`, and random faults in `cotorra-faults`.
#![forbid(unsafe_code)]

mod agent_options;
mod agents;
mod answerers;
mod api;
mod border;
mod capture;
mod clock;
mod confined;
mod core;
mod core_loop;
mod cpus;
mod domain;
mod error;
mod event_stream;
mod finished;
mod follower;
mod history_bound;
mod images;
mod keeping;
mod leftovers;
mod live;
mod manifest;
mod message;
mod options;
mod plugins;
mod previous_run;
mod progress;
mod pruner;
mod radio_figures;
mod real_links;
mod real_network;
mod real_place;
mod recorded;
mod reflectors;
mod rehearse;
pub mod replay;
mod report;
mod robots;
mod run;
mod run_info;
mod script;
mod simulate;
mod time_control;
mod traffic;
mod trips;
mod whole;
mod wifi;

pub use agent_options::AgentOptions;
pub use agents::AgentsError;
pub use api::{
    ApiError, Checked, Dashboard, Edited, Editor, Encryption, Identity, Mistake, NetworkApi, Operator,
    TlsError, Token, Tokens, TokensError, app_lcm_openapi, openapi,
};
pub use capture::{CaptureError, CapturePlan, InvalidCapturePlan, create_capture};
pub use cotorra_containers::guard as guard_containers;
pub use cotorra_wais::http::openapi as wais_openapi;
pub use cpus::missing_cpus;
pub use error::RunError;
pub use finished::Finished;
pub use leftovers::{Leftovers, clean, leftovers};
pub use live::{Live, Snapshot};
pub use manifest::{Digest, Inputs, Machine, Made, Manifest, ManifestError, Origin, Repeat, Time};
pub use options::{HistoryLimit, Options};
pub use plugins::{PluginError, panic_text};
pub use previous_run::{CannotGoOn, PreviousRun, orchestrators};
pub use real_links::{InterfacePlan, RealLinkError};
pub use real_place::NotForNetem;
pub use recorded::{Recorded, RecordedError};
pub use reflectors::ReflectorError;
pub use rehearse::{interface_plans, rehearse};
pub use report::{
    AwaySummary, DataTable, DecisionRecord, FEW_ROBOTS, Fidelity, FolderError, ForgedSummary, GatewaySummary,
    HandoverRecord, Judged, Kept, LatenessSummary, LocalizationSummary, LostSummary, MeanParts, PartSummary,
    Place, PlacementRecord, PluginSummary, Quantiles, RegionSummary, Report, RobotSummary, ServiceParts,
    ServiceSummary, Summary, Verdict, VnfWaits, WORST_ROBOTS, by_service, name_of_total, panels,
    robots_by_name, sampled_services, service_time_ms, write_file, write_samples,
};
pub use robots::RobotError;
pub use run::{Run, Stopper};
pub use run_info::about;
pub use script::{Rehearsal, ScriptError, replayed_conditions};
pub use simulate::{
    Altered, Fork, Mood, Serving, Simulation, Unrecorded, UnrecordedRun, Watched, is_same_subject, simulate,
    simulate_unrecorded, simulate_watched,
};
pub use time_control::Speed;
pub use whole::{ManyInputs, put_all};
pub use wifi::{PlanError as WifiPlanError, WIFI_FOLDERS, WifiError, wifi_programs};
