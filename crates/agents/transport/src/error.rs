//! Errors of the transport.

/// The transport cannot be opened or used.
#[derive(Debug, thiserror::Error)]
pub enum TransportError {
    /// Zenoh rejects a setting.
    #[error("zenoh rejects its configuration: {0}")]
    Configuration(String),
    /// The core cannot listen there.
    #[error("cannot listen for agents at {address}: {reason}")]
    Listen {
        /// Where.
        address: std::net::SocketAddr,
        reason: String,
    },
    /// The session does not work.
    #[error("zenoh: {0}")]
    Session(String),
    /// The core does not have or send a file.
    #[error("the core does not send {0}")]
    NoFile(String),
}

/// Converts an error of the session.
pub(crate) fn session(error: impl std::fmt::Display) -> TransportError {
    TransportError::Session(error.to_string())
}
