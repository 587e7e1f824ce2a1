//! The seam between the encoder and files or viewers.

use std::{io, net::SocketAddr, path::PathBuf};

use crate::channel::Encoded;

/// Receives encoded messages in the order of events.
pub trait Sink: Send {
    /// Takes a message. Channels are numbered from 0 in the order of their first message.
    ///
    /// # Errors
    /// [`RecordingError`]. The sink gets no further messages then.
    fn write(&mut self, message: &Encoded<'_>) -> Result<(), RecordingError>;

    /// Ends the sink.
    ///
    /// # Errors
    /// [`RecordingError`] if the output may be incomplete.
    fn finish(&mut self) -> Result<(), RecordingError>;
}

/// Reason why something is not recorded or served.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// The file exists already.
    #[error("{} exists already; choose another file, or remove it", .0.display())]
    Taken(PathBuf),
    /// The file cannot be written.
    #[error("cannot write {}: {source}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// The cause.
        source: io::Error,
    },
    /// The thread that writes cannot be started.
    #[error("cannot start the thread that records: {0}")]
    Thread(io::Error),
    /// Foxglove cannot be served there.
    #[error("cannot serve Foxglove on {address}: {reason}")]
    Serve {
        /// The address.
        address: SocketAddr,
        /// The cause.
        reason: String,
    },
    /// The build lacks Foxglove.
    #[error(
        "this cotorra was built without Foxglove: build it with `--features foxglove`, or record the run with --record \
         and open the file"
    )]
    NoFoxglove,
}
