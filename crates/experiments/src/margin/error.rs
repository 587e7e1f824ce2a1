//! The error of a search.

use cotorra_graph::ServiceId;

use crate::{batch::BatchError, kept::UnknownService};

/// Error of a search.
#[derive(Debug, thiserror::Error)]
pub enum MarginError {
    /// A service is unknown.
    #[error(transparent)]
    Service(#[from] UnknownService),
    /// A name is unknown.
    #[error("`{0}` is no link, wireless network, server or radio unit that can change; these can: {known}", known = .1.join(", "))]
    Unknown(String, Vec<String>),
    /// The testbed has nothing to change.
    #[error("the testbed has nothing of the kinds to change")]
    Nothing,
    /// A recorded run sets the conditions of links.
    #[error(
        "`conditions: {{ replay: … }}` sets delay and loss of links, so that more of them cannot be added: remove it"
    )]
    Replay,
    /// There is no service.
    #[error("the testbed has no service, and so no target")]
    NoService,
    /// A service has no samples.
    #[error("service `{0}` has no samples in virtual time: choose services with --kpi")]
    NoSamples(ServiceId),
    /// A target is broken before anything changes.
    #[error(
        "service `{service}` keeps its target in {:.2} % of its samples before anything changes; {:.2} % are demanded",
        kept * 100.0, keep * 100.0
    )]
    Broken {
        service: ServiceId,
        /// Share of samples within the target.
        kept: f64,
        /// Share that is demanded.
        keep: f64,
    },
    /// A KPI fails before anything changes.
    #[error("service `{service}` does not keep `{kpi}` before anything changes")]
    Fails {
        service: ServiceId,
        /// The KPI.
        kpi: String,
    },
    /// A run failed.
    #[error(transparent)]
    Run(#[from] BatchError),
}
