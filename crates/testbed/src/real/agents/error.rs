//! Errors of agents.

use std::{io, path::PathBuf};

use cotorra_agent_transport::TransportError;
use cotorra_enrolment::EnrolmentError;
use cotorra_graph::AgentId;

/// The agents of a testbed cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum AgentsError {
    /// There is no folder of the authority.
    #[error("the testbed has agents, and neither XDG_CONFIG_HOME nor HOME is set: use `--authority`")]
    NoAuthority,
    /// An agent of the testbed file may not connect.
    #[error("agent `{0}` is not enrolled, or is revoked: `cotorra agent enrol {0}` makes its credentials")]
    NotEnrolled(AgentId),
    /// The authority.
    #[error(transparent)]
    Enrolment(#[from] EnrolmentError),
    /// The connections.
    #[error(transparent)]
    Transport(#[from] TransportError),
    /// A file of the run.
    #[error("cannot read {}: {source}", path.display())]
    File {
        path: PathBuf,
        /// The error of the system.
        source: io::Error,
    },
    /// The run's files are too large to be sent to agents.
    #[error("the testbed's files have more than {most} bytes, which are too many for agents: {}", path.display())]
    TooLarge { path: PathBuf, most: u64 },
    /// The thread.
    #[error("cannot start the agents' thread: {0}")]
    Thread(io::Error),
}
