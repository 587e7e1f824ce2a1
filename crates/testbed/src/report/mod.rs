//! The results of a run: summary, samples, and the figure in the published layout. Everything is computed from events,
//! except localization errors.

mod amount;
mod away;
mod bill;
mod computing;
mod doubts;
mod driving;
mod end;
mod energy;
mod fidelity;
mod figure;
mod fleet;
mod folder;
mod forged;
mod gateways;
mod in_use;
mod inference;
mod instructed;
mod judged;
mod kept;
mod measured_frames;
mod metering;
mod migrations;
mod run_folder;
mod samples;
mod sent_late;
mod services;
mod staleness_regret;
mod stream;
mod summary;
mod table;
mod time_parts;
mod times;
mod verdicts;
mod vnf_waits;
mod void;
mod whole;

pub use bill::{Bill, DomainBill, EnergyBill, LinkBill, ServerBill, ServiceBill, Taken};
pub use computing::{ComputerSummary, ComputingSummary, VnfComputing};
pub use doubts::sampled_services;
pub(crate) use end::End;
pub use energy::{
    Battery, DomainEnergy, EnergySummary, RadioEnergy, RobotEnergy, ServerEnergy, ServiceEnergy,
};
pub use fidelity::Fidelity;
pub use figure::panels;
pub use fleet::{FEW_ROBOTS, WORST_ROBOTS, robots_by_name};
pub(crate) use folder::read_file;
pub use folder::{FolderError, Place, write_file};
pub use forged::ForgedSummary;
pub use gateways::GatewaySummary;
pub use inference::{AcceleratorsSummary, InferenceSummary, ModelSummary, PolicySummary};
pub use judged::{Judged, ServiceKpis};
pub use kept::{Kept, Verdict};
pub use migrations::MigrationSummary;
pub(crate) use run_folder::rewrite_summary;
pub use run_folder::{RunFolder, write_figure, write_samples};
pub use services::{by_service, name_of_total};
pub use staleness_regret::StalenessRegret;
pub use summary::{
    LocalizationSummary, Losses, RegionSummary, Report, RobotSummary, ServiceSummary, Summary,
    service_time_ms,
};
pub use table::DataTable;
pub use time_parts::{LostSummary, MeanParts, PartSummary, ServiceParts};
pub use times::Quantiles;
pub use void::Void;
