//! Errors of requests to an engine.

use std::time::Duration;

/// An error of a request.
#[derive(Debug, Clone, thiserror::Error)]
pub(crate) enum DaemonError {
    /// The engine does not answer.
    #[error("the engine does not answer: {0}")]
    Lost(String),
    /// The engine accepts a request, and hangs.
    #[error("the engine hangs: it did not answer within {} s", .0.as_secs())]
    Silent(Duration),
    /// The engine rejects the request.
    #[error("{message}")]
    Rejected {
        /// Status code of HTTP.
        status: u16,
        /// Its reason.
        message: String,
    },
}

impl DaemonError {
    /// Whether the engine has no such container or image.
    pub(crate) fn is_missing(&self) -> bool {
        matches!(self, Self::Rejected { status: 404, .. })
    }

    /// Whether the engine may answer later.
    pub(crate) fn is_away(&self) -> bool {
        matches!(self, Self::Lost(_) | Self::Silent(_))
    }
}
