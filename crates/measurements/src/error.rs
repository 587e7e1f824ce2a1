//! What can go wrong with a history, in words that say what would be right.

use std::{path::Path, sync::Arc};

use crate::RunId;

/// Why a history did not do what it was asked for. Cheap to clone: everyone who waits for a write gets its error.
#[derive(Debug, Clone, thiserror::Error)]
pub enum Error {
    /// The file cannot be opened or created.
    #[error(
        "{path}: cannot be opened as a history: {cause}; name a file in an existing folder that you can write to"
    )]
    Open {
        /// The file.
        path: Arc<Path>,
        /// What the engine says.
        cause: Arc<rusqlite::Error>,
    },
    /// The file is something else.
    #[error("{path}: is not a history of cotorra; name another file")]
    NotAHistory {
        /// The file.
        path: Arc<Path>,
    },
    /// A newer cotorra wrote the file.
    #[error(
        "{path}: has schema version {found}, but this cotorra knows versions up to {known}; use a newer cotorra"
    )]
    NewerSchema {
        /// The file.
        path: Arc<Path>,
        /// Its version.
        found: u32,
        /// The newest version that this library reads.
        known: u32,
    },
    /// The file may be read but not written.
    #[error("{path}: is read-only; give write permission on the file and its folder, or name another file")]
    ReadOnly {
        /// The file.
        path: Arc<Path>,
    },
    /// There is no room for more.
    #[error("{path}: the disk is full; free some space, and recording goes on by itself")]
    Full {
        /// The file.
        path: Arc<Path>,
    },
    /// Another process holds the file for too long.
    #[error("{path}: another process keeps the history locked; end it, and recording goes on by itself")]
    Busy {
        /// The file.
        path: Arc<Path>,
    },
    /// What the file holds makes no sense.
    #[error("{path}: is damaged: {detail}; `sqlite3 {path} .recover` saves what can be read")]
    Corrupt {
        /// The file.
        path: Arc<Path>,
        /// Where.
        detail: String,
    },
    /// Any other error of the engine.
    #[error("{path}: {cause}")]
    Engine {
        /// The file.
        path: Arc<Path>,
        /// What the engine says.
        cause: Arc<rusqlite::Error>,
    },
    /// There is no such run.
    #[error("there is no run {0} in this history")]
    NoSuchRun(RunId),
    /// The system has no thread left to write with.
    #[error("no thread to write the history: {cause}; raise the limit on processes")]
    Thread {
        /// What the system says.
        cause: Arc<std::io::Error>,
    },
    /// The thread that writes is gone, because it panicked.
    #[error("nothing is recorded any more: the writer of this history has stopped")]
    Stopped,
}

/// What a history answers.
pub type Result<T> = std::result::Result<T, Error>;
