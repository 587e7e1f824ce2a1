//! Errors of tests with faults.

use std::{
    io,
    path::{Path, PathBuf},
};

/// Error of a test with faults.
#[derive(Debug, thiserror::Error)]
pub enum FaultTestError {
    /// The generator made an invalid testbed.
    #[error("seed {seed} gives no testbed that can be run, which is a mistake in the generator: {reason}")]
    Testbed {
        /// Seed of the testbed.
        seed: u64,
        /// The testbed's mistakes.
        reason: String,
    },
    /// A folder cannot be written.
    #[error("{}: {cause}; give write permission on it, or set TMPDIR or --keep to another folder", .folder.display())]
    Folder {
        /// The folder.
        folder: PathBuf,
        /// The system's error.
        cause: io::Error,
    },
    /// A history cannot be opened.
    #[error(transparent)]
    History(#[from] cotorra_measurements::Error),
}

impl FaultTestError {
    pub(crate) fn folder(folder: &Path, cause: io::Error) -> Self {
        Self::Folder { folder: folder.to_owned(), cause }
    }
}
