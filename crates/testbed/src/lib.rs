//! Puts a testbed together and runs it: the core of the three blocks, the API, the plug-in host, and the report.
//!
//! [`Run::start`] brings a testbed up in real time, and [`Run::finish`] takes it down. [`simulate()`] does both in virtual
//! time. [`Replay`](replay::Replay) plays a recorded run. [`Report`] and [`Summary`] are the results. Experiments of many
//! runs are in `cotorra-experiments`, and random faults in `cotorra-faults`.
#![forbid(unsafe_code)]

mod api;
mod border;
mod capture;
mod clock;
mod core;
mod domain;
mod error;
mod events;
mod finished;
mod folder;
mod history;
mod options;
mod plugins;
mod real;
pub mod replay;
mod report;
mod virtual_time;
mod wifi;

pub use self::core::script::{Rehearsal, ScriptError, replayed_conditions};
pub use api::{
    ApiError, Checked, Dashboard, Edited, Editor, Encryption, Identity, Mistake, NetworkApi, Operator,
    TlsError, Token, Tokens, TokensError, app_lcm_openapi, openapi,
};
pub use capture::{CaptureError, CapturePlan, InvalidCapturePlan, create_capture};
pub use cotorra_containers::guard as guard_containers;
pub use cotorra_wais::http::openapi as wais_openapi;
pub use error::RunError;
pub use events::live::{Live, Snapshot};
pub use finished::Finished;
pub use folder::{
    manifest::{Digest, Inputs, Machine, Made, Manifest, ManifestError, Origin, Repeat, Time},
    whole::{ManyInputs, put_all},
};
pub use history::{
    previous_run::{CannotGoOn, PreviousRun, orchestrators},
    recorded::{Recorded, RecordedError},
    run_info::about,
};
pub use options::{HistoryLimit, Options};
pub use plugins::{PluginError, panic_text};
pub use real::{
    agents::{AgentOptions, AgentsError},
    cpus::missing_cpus,
    leftovers::{Leftovers, clean, leftovers},
    links::{InterfacePlan, RealLinkError},
    places::NotForNetem,
    reflectors::ReflectorError,
    rehearse::{interface_plans, rehearse},
    robots::RobotError,
    run::{Run, Stopper},
};
pub use report::{
    AwaySummary, DataTable, DecisionRecord, FEW_ROBOTS, Fidelity, FolderError, ForgedSummary, GatewaySummary,
    HandoverRecord, Judged, Kept, LatenessSummary, LocalizationSummary, LostSummary, MeanParts, PartSummary,
    Place, PlacementRecord, PluginSummary, Quantiles, RegionSummary, Report, RobotSummary, ServiceKpis,
    ServiceParts, ServiceSummary, Summary, Verdict, VnfWaits, Void, WORST_ROBOTS, by_service, name_of_total,
    panels, robots_by_name, sampled_services, service_time_ms, write_file, write_samples,
};
pub use virtual_time::{
    Altered, Fork, Mood, Serving, Simulation, Unrecorded, UnrecordedRun, Watched, is_same_subject, simulate,
    simulate_unrecorded, simulate_watched, time_control::Speed,
};
pub use wifi::{PlanError as WifiPlanError, WIFI_FOLDERS, WifiError, wifi_programs};
