//! Errors of nodes and their topics.

use std::io;

use crate::names::NameError;

/// Reason why a node or a topic could not be set up.
#[derive(Debug, thiserror::Error)]
pub enum NodeError {
    /// A name is invalid.
    #[error(transparent)]
    Name(#[from] NameError),
    /// DDS failed, for example because of missing ports or memory.
    #[error("DDS: {0}")]
    Dds(#[from] rustdds::dds::CreateError),
    /// Zenoh failed.
    #[error("Zenoh: {0}")]
    Zenoh(String),
    /// The build lacks Zenoh.
    #[error("this program was built without Zenoh: build it with `--features zenoh`")]
    WithoutZenoh,
    /// The thread, or its waker, could not be created.
    #[error("the node cannot run: {0}")]
    Io(#[from] io::Error),
    /// The node was shut down.
    #[error("the node was shut down")]
    ShutDown,
}
