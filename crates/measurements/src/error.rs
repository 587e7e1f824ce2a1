//! Errors of a history.

use std::sync::Arc;

use crate::run::RunId;

/// An operation on a history that failed. Cheap to clone, because every caller that waits for a write gets its error.
#[derive(Debug, Clone, thiserror::Error)]
pub enum Error {
    /// The file cannot be opened or created.
    #[error(
        "{history}: cannot be opened as a history: {cause}; name a file in an existing folder that you can write to"
    )]
    Open {
        /// File, or server and database.
        history: Arc<str>,
        cause: Arc<rusqlite::Error>,
    },
    /// The file or database holds something else.
    #[error("{history}: is not a history of cotorra; name another file or database")]
    NotAHistory {
        /// File, or server and database.
        history: Arc<str>,
    },
    /// The file holds more than a history, such as a view or a trigger.
    #[error(
        "{history}: {detail}; another program changed it, and it is not used: remove that from it, or name another file"
    )]
    Foreign {
        /// File of the history.
        history: Arc<str>,
        /// Its content.
        detail: String,
    },
    /// The history was written by a newer cotorra, or by one from before the first release, whose schema had versions
    /// of its own.
    #[error(
        "{history}: has schema version {found}, but this cotorra knows versions up to {known}; a newer cotorra wrote it, or one from before the first release: use that one (its `cotorra history export` and this one's `import` carry runs over), or name another history"
    )]
    UnknownSchema {
        /// File, or server and database.
        history: Arc<str>,
        /// Schema version of the history.
        found: u32,
        /// Newest schema version that this library reads.
        known: u32,
    },
    /// The history was written by an older cotorra, and is on a medium where it cannot be migrated.
    #[error(
        "{history}: was written by an older cotorra, and is read-only; copy it to where it can be brought up to date"
    )]
    OlderSchema {
        /// File of the history.
        history: Arc<str>,
    },
    /// The history can be read but not written.
    #[error("{history}: is read-only; give write permission on it, or name another")]
    ReadOnly {
        /// File, or server and database.
        history: Arc<str>,
    },
    /// The disk is full.
    #[error("{history}: the disk is full; free some space, and recording goes on by itself")]
    Full {
        /// File, or server and database.
        history: Arc<str>,
    },
    /// Another process keeps the history locked.
    #[error("{history}: another process keeps the history locked; end it, and recording goes on by itself")]
    Busy {
        /// File, or server and database.
        history: Arc<str>,
    },
    /// The history holds invalid data.
    #[error(
        "{history}: is damaged: {detail}; `sqlite3 FILE .recover` or the server's `mariadb-check` save what can be read"
    )]
    Corrupt {
        /// File, or server and database.
        history: Arc<str>,
        /// The invalid part.
        detail: String,
    },
    /// Any other error of SQLite.
    #[error("{history}: {cause}")]
    Engine {
        /// File, or server and database.
        history: Arc<str>,
        cause: Arc<rusqlite::Error>,
    },
    /// This build lacks support for servers.
    #[error(
        "{history}: this cotorra was built without MySQL and MariaDB: build it with `--features databases`, or name a file"
    )]
    WithoutServers {
        /// Server and database.
        history: Arc<str>,
    },
    /// The server cannot be reached, or went away.
    #[error("{history}: the server does not answer: {cause}; start it, or name another host or port")]
    Unreachable {
        /// Server and database.
        history: Arc<str>,
        cause: Arc<str>,
    },
    /// Any other error of a server.
    #[error("{history}: {cause}")]
    Server {
        /// Server and database.
        history: Arc<str>,
        cause: Arc<str>,
    },
    /// Events recorded during a server's outage cannot be written to the spool.
    #[error(
        "{spool}: events recorded during the server's outage cannot be spooled: {cause}; put the spool elsewhere with `?spool=FOLDER` in the URL"
    )]
    Spool {
        /// The spool's file, or its folder.
        spool: Arc<str>,
        cause: Arc<std::io::Error>,
    },
    /// The spool reached its bound during a server's outage.
    #[error(
        "{spool}: is full with {megabytes} MB recorded during the server's outage; start the server, and recording goes on by itself"
    )]
    SpoolFull {
        /// The spool's file.
        spool: Arc<str>,
        /// Bound of the spool, MB.
        megabytes: u64,
    },
    /// The history has no such run.
    #[error("there is no run {0} in this history")]
    NoSuchRun(RunId),
    /// The system refused a thread for the writer.
    #[error("no thread to write the history: {cause}; raise the limit on processes")]
    Thread { cause: Arc<std::io::Error> },
    /// The writer's thread panicked.
    #[error("nothing is recorded any more: the writer of this history has stopped")]
    Stopped,
}

/// Result of an operation on a history.
pub type Result<T> = std::result::Result<T, Error>;
