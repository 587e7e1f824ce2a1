//! Errors of the agent.

use std::{io, path::PathBuf};

/// Why the agent cannot run.
#[derive(Debug, thiserror::Error)]
pub(crate) enum AgentError {
    /// A file or folder cannot be used.
    #[error("cannot {action} {}: {source}", path.display())]
    File {
        action: &'static str,
        path: PathBuf,
        /// The error of the system.
        source: io::Error,
    },
    /// The credentials are not valid.
    #[error("{} holds no credentials of an agent: {source}", path.display())]
    Credentials {
        path: PathBuf,
        /// The cause.
        source: cotorra_enrolment::BundleError,
    },
    /// Another agent uses the state.
    #[error("another agent runs with the state in {}; use `--state` for a second one", .0.display())]
    Busy(PathBuf),
    /// There is no folder for the state.
    #[error("neither XDG_STATE_HOME nor HOME is set; use `--state`")]
    NoState,
    /// The core refuses the connection.
    #[error("{core}: {reason}")]
    Refused { core: String, reason: String },
    #[error(transparent)]
    Transport(#[from] cotorra_agent_transport::TransportError),
    #[error(transparent)]
    Vnf(#[from] cotorra_vnfs::VnfError),
    /// A VNF's program cannot be started.
    #[error("cannot start {0}")]
    Hold(io::Error),
    /// A robot whose agent is gone may move.
    #[error("cannot leave the robot at rest: {0}")]
    Guard(io::Error),
    /// Containers are left.
    #[error("cannot remove the containers of an agent that is gone: {0}")]
    GuardContainers(io::Error),
    #[error("cannot listen to Ctrl-C: {0}")]
    Signals(#[from] ctrlc::Error),
    #[error("the system gives no random numbers: {0}")]
    Random(getrandom::Error),
}

/// Converts an error of the system at a path.
pub(crate) fn at(action: &'static str, path: &std::path::Path) -> impl FnOnce(io::Error) -> AgentError {
    let path = path.to_owned();
    move |source| AgentError::File { action, path, source }
}
