//! Errors of an authority.

use std::{io, path::PathBuf};

use chrono::{DateTime, Utc};
use cotorra_graph::AgentId;

use crate::time_text;

/// Error of an [`Authority`](crate::Authority). It has changed nothing, unless it says so.
#[derive(Debug, thiserror::Error)]
pub enum EnrolmentError {
    /// A file or folder cannot be used.
    #[error("{}: {source}", path.display())]
    System {
        /// The file or folder.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
    /// Others may read or replace a file or folder.
    #[error("{} is not this user's alone: {reason}", path.display())]
    NotPrivate {
        /// The file or folder.
        path: PathBuf,
        /// Reason.
        reason: String,
    },
    /// The folder has no authority.
    #[error("there is no authority in {}", folder.display())]
    NoAuthority {
        /// The folder.
        folder: PathBuf,
    },
    /// The authority did not write this file.
    #[error("{} is damaged: {reason}", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// Mistake in the file.
        reason: String,
    },
    /// The agent has credentials.
    #[error("the agent `{name}` is enrolled already, in generation {generation}")]
    AlreadyEnrolled {
        /// The agent.
        name: AgentId,
        /// Its newest generation.
        generation: u32,
    },
    /// The authority does not know the agent.
    #[error("no agent `{name}` is enrolled{}", list(known))]
    NotEnrolled {
        /// The name.
        name: AgentId,
        /// Names of all agents.
        known: Vec<AgentId>,
    },
    /// The agent has been revoked.
    #[error("the agent `{name}` is revoked")]
    Revoked {
        /// The agent.
        name: AgentId,
    },
    /// The validity is under a second, or over that of the authority.
    #[error("the validity of a certificate is at least 1 s, and ends with that of the authority, {}", time_text::format(*authority_ends))]
    Validity {
        /// End of the authority's certificate.
        authority_ends: DateTime<Utc>,
    },
    /// The authority's own certificate has expired.
    #[error("the authority in {} expired at {}", folder.display(), time_text::format(*at))]
    AuthorityExpired {
        /// The folder.
        folder: PathBuf,
        /// End of its certificate.
        at: DateTime<Utc>,
    },
    /// A bound of the registry.
    #[error("there are too many {what}: {most} are the most")]
    TooMany {
        /// The objects of which there are too many.
        what: &'static str,
        /// The bound.
        most: usize,
    },
    /// A certificate cannot be made.
    #[error("cannot make a certificate: {0}")]
    Certificate(String),
}

fn list(known: &[AgentId]) -> String {
    const MOST: usize = 10;
    let names: Vec<_> = known.iter().take(MOST).map(AgentId::as_str).collect();
    match (names.is_empty(), known.len().saturating_sub(MOST)) {
        (true, _) => "; none is".to_owned(),
        (false, 0) => format!("; there are {}", names.join(", ")),
        (false, more) => format!("; there are {} and {more} more", names.join(", ")),
    }
}

impl EnrolmentError {
    /// Returns what would be right, where one thing is.
    pub fn help(&self) -> Option<String> {
        Some(match self {
            Self::System { .. } | Self::Certificate(_) | Self::Validity { .. } => return None,
            Self::NotPrivate { path, .. } => {
                format!("see who uses it; then `chmod go= {}` or name another folder", path.display())
            }
            Self::NoAuthority { .. } => "`cotorra agent enrol NAME --core HOST:PORT` makes one".to_owned(),
            Self::Damaged { .. } => {
                "restore it from a backup, or remove the folder and enrol all agents anew".to_owned()
            }
            Self::AlreadyEnrolled { name, .. } => {
                format!("`cotorra agent renew {name}` makes new credentials for it")
            }
            Self::NotEnrolled { name, .. } => {
                format!("`cotorra agent enrol {name} --core HOST:PORT` enrols it")
            }
            Self::Revoked { name } => {
                format!("`cotorra agent enrol {name} --core HOST:PORT` enrols it again")
            }
            Self::AuthorityExpired { .. } => "remove the folder and enrol all agents anew".to_owned(),
            Self::TooMany { .. } => {
                "use a second authority (`--authority DIR`), or wait for overlaps to end".to_owned()
            }
        })
    }
}
