//! Rejected requests.

use cotorra_mec::{InvalidRequest, Problem, RequestError};

/// A rejected request. Nothing has changed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum BandwidthError {
    /// The request is invalid, or asks for what no link can keep.
    #[error(transparent)]
    Request(#[from] RequestError),
    /// The state of the testbed does not allow it.
    #[error("{0}")]
    Refused(String),
}

impl From<InvalidRequest> for BandwidthError {
    fn from(error: InvalidRequest) -> Self {
        Self::Request(error.into())
    }
}

impl From<BandwidthError> for Problem {
    fn from(error: BandwidthError) -> Self {
        match error {
            BandwidthError::Request(error) => error.into(),
            BandwidthError::Refused(reason) => Self::forbidden(reason),
        }
    }
}
