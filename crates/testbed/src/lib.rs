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
mod computed;
mod core;
mod domain;
mod error;
mod events;
mod finished;
mod folder;
mod followed;
mod given;
mod history;
mod options;
mod parcel;
mod plugins;
mod real;
pub mod replay;
mod report;
mod traffic;
mod twin;
mod virtual_time;
mod wifi;

pub use self::core::script::{Rehearsal, ScriptError, replayed_conditions};
pub use api::{
    ApiError, Checked, Dashboard, Edited, Editor, Encryption, Mistake, NetworkApi, Operator, Token, Tokens,
    TokensError, app_lcm_openapi, openapi,
};
pub use capture::{CaptureError, CapturePlan, create_capture};
pub use cotorra_bandwidth::openapi as bwm_openapi;
pub use cotorra_containers::guard as guard_containers;
pub use cotorra_location::http::openapi as location_openapi;
pub use cotorra_wais::http::openapi as wais_openapi;
pub use error::RunError;
pub use events::live::{Live, Snapshot};
pub use finished::Finished;
pub use folder::{
    manifest::{Digest, Inputs, Machine, Made, Manifest, ManifestError, Origin, Repeat, Time},
    whole::{ManyInputs, put_all},
};
pub use given::Given;
pub use history::{
    previous_run::{CannotGoOn, PreviousRun, orchestrators},
    recorded::{Recorded, RecordedError},
    run_info::about,
};
pub use options::{AgentOptions, HistoryLimit, Options};
pub use plugins::{PluginError, inexact, panic_text};
pub use real::{
    cpus::missing_cpus,
    leftovers::{Leftovers, clean, leftovers},
    links::{InterfacePlan, RealLinkError},
    rehearse::{interface_plans, rehearse},
    run::Run,
};
pub use report::{
    AcceleratorsSummary, Battery, Bill, ComputerSummary, ComputingSummary, DataTable, DomainBill,
    DomainEnergy, EnergyBill, EnergySummary, FEW_ROBOTS, Fidelity, FolderError, ForgedSummary,
    GatewaySummary, InferenceSummary, Judged, Kept, LinkBill, LocalizationSummary, LostSummary, MeanParts,
    MigrationSummary, ModelSummary, PartSummary, Place, PolicySummary, Quantiles, RadioEnergy, RegionSummary,
    Report, RobotEnergy, RobotSummary, ServerBill, ServerEnergy, ServiceBill, ServiceEnergy, ServiceKpis,
    ServiceParts, ServiceSummary, StalenessRegret, Summary, Taken, Verdict, VnfComputing, Void, WORST_ROBOTS,
    by_service, name_of_total, panels, robots_by_name, sampled_services, service_time_ms, write_file,
    write_samples,
};
pub use twin::{MaybeTwin, TwinError, beside_core, check_twin, distant};
pub use virtual_time::{
    Altered, Fork, Mood, Serving, Simulation, Unrecorded, UnrecordedRun, Watched, first_requests,
    is_same_subject, simulate, simulate_unrecorded, simulate_watched, time_control::Speed,
};
pub use wifi::{WIFI_FOLDERS, wifi_programs};
