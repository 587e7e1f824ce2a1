//! What can go wrong with a history, in words that say what would be right.

use std::sync::Arc;

use crate::run::RunId;

/// Why a history did not do what it was asked for. Cheap to clone: everyone who waits for a write gets its error.
#[derive(Debug, Clone, thiserror::Error)]
pub enum Error {
    /// The file cannot be opened or created.
    #[error(
        "{history}: cannot be opened as a history: {cause}; name a file in an existing folder that you can write to"
    )]
    Open {
        /// Its file, or its server and database.
        history: Arc<str>,
        /// What the engine says.
        cause: Arc<rusqlite::Error>,
    },
    /// The file or database is something else.
    #[error("{history}: is not a history of cotorra; name another file or database")]
    NotAHistory {
        /// Its file, or its server and database.
        history: Arc<str>,
    },
    /// A newer cotorra wrote it, or one from before the first release, whose schema had versions of its own.
    #[error(
        "{history}: has schema version {found}, but this cotorra knows versions up to {known}; a newer cotorra wrote it, or one from before the first release: use that one (its `cotorra history export` and this one's `import` carry runs over), or name another history"
    )]
    UnknownSchema {
        /// Its file, or its server and database.
        history: Arc<str>,
        /// Its version.
        found: u32,
        /// The newest version that this library reads.
        known: u32,
    },
    /// An older cotorra wrote it, and it cannot be brought up to date where it is.
    #[error(
        "{history}: was written by an older cotorra, and is read-only; copy it to where it can be brought up to date"
    )]
    OlderSchema {
        /// Its file.
        history: Arc<str>,
    },
    /// It may be read but not written.
    #[error("{history}: is read-only; give write permission on it, or name another")]
    ReadOnly {
        /// Its file, or its server and database.
        history: Arc<str>,
    },
    /// There is no room for more.
    #[error("{history}: the disk is full; free some space, and recording goes on by itself")]
    Full {
        /// Its file, or its server and database.
        history: Arc<str>,
    },
    /// Another process holds it for too long.
    #[error("{history}: another process keeps the history locked; end it, and recording goes on by itself")]
    Busy {
        /// Its file, or its server and database.
        history: Arc<str>,
    },
    /// What it holds makes no sense.
    #[error(
        "{history}: is damaged: {detail}; `sqlite3 FILE .recover` or the server's `mariadb-check` save what can be read"
    )]
    Corrupt {
        /// Its file, or its server and database.
        history: Arc<str>,
        /// Where.
        detail: String,
    },
    /// Any other error of SQLite.
    #[error("{history}: {cause}")]
    Engine {
        /// Its file, or its server and database.
        history: Arc<str>,
        /// What the engine says.
        cause: Arc<rusqlite::Error>,
    },
    /// Servers are left out of this build.
    #[error(
        "{history}: this cotorra was built without MySQL and MariaDB: build it with `--features mariadb`, or name a file"
    )]
    WithoutServers {
        /// Its server and database.
        history: Arc<str>,
    },
    /// The server cannot be reached, or went away.
    #[error("{history}: the server does not answer: {cause}; start it, or name another host or port")]
    Unreachable {
        /// Its server and database.
        history: Arc<str>,
        /// What the system says.
        cause: Arc<str>,
    },
    /// Any other error of a server.
    #[error("{history}: {cause}")]
    Server {
        /// Its server and database.
        history: Arc<str>,
        /// What the server says.
        cause: Arc<str>,
    },
    /// What is recorded while a server is away cannot be kept.
    #[error(
        "{spool}: cannot keep what is recorded while the server is away: {cause}; put the spool elsewhere with `?spool=FOLDER` in the URL"
    )]
    Spool {
        /// The file, or its folder.
        spool: Arc<str>,
        /// What the system says.
        cause: Arc<std::io::Error>,
    },
    /// A server is away for so long that there is no room for more.
    #[error(
        "{spool}: is full with {megabytes} MB that were recorded while the server is away; start the server, and recording goes on by itself"
    )]
    SpoolFull {
        /// The file.
        spool: Arc<str>,
        /// Its bound.
        megabytes: u64,
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
