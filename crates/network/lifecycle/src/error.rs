//! Why requests are rejected.

use cotorra_mec::{CallbackError, TooOften};

use crate::descriptor::DescriptorError;

/// Reason for which a request is rejected. Nothing has changed then.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum LifecycleError {
    /// An unknown descriptor, network, instance or occurrence.
    #[error("there is no {0} `{1}`")]
    Unknown(&'static str, String),
    /// A request that does not fit the present state.
    #[error("{0}")]
    Conflict(String),
    /// A request that cannot be.
    #[error("{0}")]
    Invalid(String),
    /// A descriptor that is rejected.
    #[error("the descriptor is rejected: {0}")]
    Descriptor(#[from] DescriptorError),
    /// A callback that cannot be used.
    #[error(transparent)]
    Callback(#[from] CallbackError),
    /// Too many subscriptions.
    #[error("{0}")]
    Full(String),
    /// Too frequent changes of subscriptions.
    #[error(transparent)]
    TooOften(#[from] TooOften),
}

pub(crate) fn conflict<T>(reason: impl Into<String>) -> Result<T, LifecycleError> {
    Err(LifecycleError::Conflict(reason.into()))
}
