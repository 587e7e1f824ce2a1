//! Errors of the transport.

use std::{io, net::SocketAddr};

/// The transport cannot be opened or used.
#[derive(Debug, thiserror::Error)]
pub enum TransportError {
    /// A key or certificate cannot be used.
    #[error("the credentials are not valid: {0}")]
    Credentials(String),
    /// The core cannot listen there.
    #[error("cannot listen for agents at {address}: {source}")]
    Listen { address: SocketAddr, source: io::Error },
    /// The address of the core has no host or no port.
    #[error("`{0}` is not the address of a core")]
    Address(String),
    /// The system gives no thread or no way to wait.
    #[error("cannot start a thread for agents: {0}")]
    Thread(#[from] io::Error),
    /// The core does not have a file, or does not send it.
    #[error("the core does not send {sha256}: {reason}")]
    NoFile { sha256: String, reason: &'static str },
}
