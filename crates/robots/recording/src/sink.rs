//! Where encoded messages end: the seam between the encoder and files or viewers.

use std::{io, net::SocketAddr, path::PathBuf};

use crate::channel::Encoded;

/// Takes messages in the order in which they were known.
pub trait Sink: Send {
    /// Takes a message. Channels are numbered from 0 in the order of their first message.
    ///
    /// # Errors
    /// [`RecordingError`]; it is told nothing more then.
    fn write(&mut self, message: &Encoded<'_>) -> Result<(), RecordingError>;

    /// Nothing more comes.
    ///
    /// # Errors
    /// [`RecordingError`] if what was taken may not be complete.
    fn finish(&mut self) -> Result<(), RecordingError>;
}

/// Why something is not recorded or served.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// There is such a file.
    #[error("{} is there already; name a file that is not, or remove it", .0.display())]
    Taken(PathBuf),
    /// The file cannot be written.
    #[error("cannot write {}: {source}", path.display())]
    File {
        /// Which.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// The thread that writes cannot be started.
    #[error("cannot start the thread that records: {0}")]
    Thread(io::Error),
    /// Foxglove cannot be served there.
    #[error("cannot serve Foxglove on {address}: {reason}")]
    Serve {
        /// Where.
        address: SocketAddr,
        /// Why not.
        reason: String,
    },
    /// This program has no Foxglove in it.
    #[error(
        "this cotorra was built without Foxglove: build it with `--features foxglove`, or record the run with --record \
         and open the file"
    )]
    NoFoxglove,
}
