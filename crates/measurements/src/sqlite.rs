//! Histories in SQLite. A write-ahead log lets readers go on while one connection writes; `synchronous = FULL` has
//! SQLite call fsync at every commit, so that a committed batch survives both kill -9 and a loss of power.

mod guard;
mod session;
#[cfg(test)]
mod tests;
mod write;

use std::{fs::OpenOptions, os::unix::fs::OpenOptionsExt as _, path::Path, sync::Arc, time::Duration};

use cotorra_graph::{Event, Figure, Stamped, Timestamp};
use parking_lot::Mutex;
use rusqlite::{Connection, ErrorCode, OpenFlags, TransactionBehavior};

use self::{
    guard::{guard, stranger},
    session::SqliteSession,
    write::Writer,
};
use crate::{
    error::{Error, Result},
    kind::Kind,
    page::{Cursor, Page, PageRequest},
    retention::{Retained, Thinned},
    rolled::Reading,
    run::{Entry, Gap, Run, RunId, RunInfo},
    schema::MIGRATIONS,
    sql,
    store::{Selection, Span, Store},
};

/// Marks a database as a history of cotorra ("coto"), as SQLite's file format provides.
const APPLICATION_ID: i32 = 0x636f_746f;

/// Most time to wait for another process that locks the file.
const BUSY: Duration = Duration::from_secs(5);

/// Memory for pages of the connection that writes, KiB.
const CACHE_KIB: i32 = 8192;

/// SQLite's own bound on a file, pages.
const MOST_PAGES: u32 = 4_294_967_294;

/// Length of the log, in pages of 4 KiB, at which it is folded into the file.
const LOG_PAGES: i32 = 4096;

/// Most idle connections for reading that are kept.
const IDLE_READERS: usize = 4;

type Reader = sql::Reader<SqliteSession>;

type Fallible<T> = std::result::Result<T, rusqlite::Error>;

/// A database file.
pub(crate) struct Sqlite {
    path: Arc<Path>,
    /// The path in errors.
    name: Arc<str>,
    readers: Mutex<Vec<Reader>>,
    /// Dropped last: the last connection to close folds the log into the file, which one that only reads cannot do.
    writer: Mutex<Writer>,
}

impl Sqlite {
    /// Opens a history, or creates one.
    pub fn open(path: &Path) -> Result<Self> {
        let name: Arc<str> = path.to_string_lossy().into();
        let path: Arc<Path> = path.into();
        let flags = OpenFlags::SQLITE_OPEN_READ_WRITE
            | OpenFlags::SQLITE_OPEN_CREATE
            | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        // Readable for its user only, as are its journals: SQLite gives them the same mode. It reports what fails here.
        let _ = OpenOptions::new().write(true).create_new(true).mode(0o600).open(&path);
        check_file(&path, &name)?;
        let mut connection = Connection::open_with_flags(&path, flags)
            .map_err(|e| Error::Open { history: name.clone(), cause: Arc::new(e) })?;
        let steps = guard(&mut connection, None).map_err(|e| engine_error(&name, e))?;
        prepare(&mut connection, &name, MIGRATIONS)?;
        let writer = Writer::new(SqliteSession::new(connection, &name, steps));
        Ok(Self { path, name, writer: Mutex::new(writer), readers: Mutex::default() })
    }

    /// Opens a history to read it, even one that cannot be written.
    pub fn open_to_read(path: &Path) -> Result<Self> {
        let refused = match Self::open(path) {
            Err(refused @ (Error::ReadOnly { .. } | Error::Open { .. })) => refused,
            other => return other,
        };
        let name: Arc<str> = path.to_string_lossy().into();
        let is_history =
            |connection: &Connection| -> Fallible<Result<usize>> { version(connection, &name, MIGRATIONS) };
        // On a read-only medium SQLite cannot read along with a writer, but there is none either.
        for place in [path.into(), immutable(path)] {
            let flags = OpenFlags::SQLITE_OPEN_READ_ONLY
                | OpenFlags::SQLITE_OPEN_URI
                | OpenFlags::SQLITE_OPEN_NO_MUTEX;
            let Ok(mut connection) = Connection::open_with_flags(&place, flags) else { continue };
            let Ok(steps) = guard(&mut connection, None) else { continue };
            let Ok(found) = is_history(&connection) else { continue };
            if found? < MIGRATIONS.len() {
                return Err(Error::OlderSchema { history: name });
            }
            let log = std::fs::metadata(with_ending(path, "-wal")).is_ok_and(|log| log.len() > 0);
            if log && *place != *path {
                tracing::warn!(history = %name, "events that only the log has are missing: the log cannot be read on this medium");
            }
            let writer = Writer::new(SqliteSession::new(connection, &name, steps));
            return Ok(Self {
                path: place.into(),
                name,
                writer: Mutex::new(writer),
                readers: Mutex::default(),
            });
        }
        Err(refused)
    }

    fn read<T>(&self, ask: impl FnOnce(&Reader) -> Result<T>) -> Result<T> {
        let taken = self.readers.lock().pop();
        let reader = match taken {
            Some(reader) => reader,
            None => Reader::new(SqliteSession::open(&self.path, &self.name)?),
        };
        let answer = ask(&reader)?;
        let mut idle = self.readers.lock();
        if idle.len() < IDLE_READERS {
            idle.push(reader);
        }
        Ok(answer)
    }
}

/// Rejects a path at which there is something other than a file, such as a pipe, which may never get a writer.
fn check_file(path: &Path, history: &Arc<str>) -> Result<()> {
    let is_other = std::fs::metadata(path).is_ok_and(|metadata| !metadata.is_file() && !metadata.is_dir());
    if is_other { Err(Error::NotAHistory { history: history.clone() }) } else { Ok(()) }
}

fn with_ending(path: &Path, ending: &str) -> std::path::PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(ending);
    name.into()
}

/// Returns a URI that declares the file unchanging.
fn immutable(path: &Path) -> std::path::PathBuf {
    let mut uri = "file:".to_owned();
    for byte in path.as_os_str().as_encoded_bytes() {
        match byte {
            b'a'..=b'z' | b'A'..=b'Z' | b'0'..=b'9' | b'/' | b'.' | b'-' | b'_' => {
                uri.push(char::from(*byte))
            }
            other => uri += &format!("%{other:02X}"),
        }
    }
    (uri + "?immutable=1").into()
}

/// Checks that the file is a history before anything in it is touched, then migrates it.
fn prepare(connection: &mut Connection, history: &Arc<str>, migrations: &[&str]) -> Result<()> {
    let work = |connection: &mut Connection| -> Fallible<Result<()>> {
        connection.busy_timeout(BUSY)?;
        match version(connection, history, migrations) {
            // On a read-only medium SQLite cannot read a file in this mode either: it would have to create a log.
            Err(_) if connection.is_readonly("main")? => {
                return Ok(Err(Error::ReadOnly { history: history.clone() }));
            }
            Err(e) => return Err(e),
            Ok(Err(e)) => return Ok(Err(e)),
            Ok(Ok(_)) => {}
        }
        if connection.is_readonly("main")? {
            return Ok(Err(Error::ReadOnly { history: history.clone() }));
        }
        let mode: String = connection.query_row("PRAGMA journal_mode = WAL", [], |row| row.get(0))?;
        if mode != "wal" {
            tracing::warn!(%history, mode, "the file system has no write-ahead log: readers wait");
        }
        connection.pragma_update(None, "synchronous", "FULL")?;
        // A batch fits in the cache, and is written once: to the log at its commit. From there it is folded into the
        // file later.
        connection.pragma_update(None, "cache_size", -CACHE_KIB)?;
        connection.pragma_update(None, "wal_autocheckpoint", LOG_PAGES)?;

        let transaction = connection.transaction_with_behavior(TransactionBehavior::Immediate)?;
        let found = match version(&transaction, history, migrations)? {
            Ok(found) => found,
            Err(e) => return Ok(Err(e)),
        };
        for migration in &migrations[found..] {
            transaction.execute_batch(migration)?;
        }
        if found < migrations.len() {
            transaction.pragma_update(None, "application_id", APPLICATION_ID)?;
            transaction.pragma_update(None, "user_version", migrations.len() as u32)?;
        }
        transaction.commit().map(Ok)
    };
    work(connection).map_err(|e| engine_error(history, e))?
}

/// Returns the schema version of a file that may be a history; 0 for an empty one.
fn version(connection: &Connection, history: &Arc<str>, migrations: &[&str]) -> Fallible<Result<usize>> {
    let application: i32 = connection.pragma_query_value(None, "application_id", |row| row.get(0))?;
    let found: u32 = connection.pragma_query_value(None, "user_version", |row| row.get(0))?;
    let empty: bool = connection.query_row("SELECT count(*) = 0 FROM sqlite_schema", [], |row| row.get(0))?;
    let known = migrations.len() as u32;
    Ok(match (application, found) {
        (0, 0) if empty => Ok(0),
        (APPLICATION_ID, found) if found > known => {
            Err(Error::UnknownSchema { history: history.clone(), found, known })
        }
        (APPLICATION_ID, found) => match stranger(connection, &migrations[..found as usize])? {
            Some(detail) => Err(Error::Foreign { history: history.clone(), detail }),
            None => Ok(found as usize),
        },
        _ => Err(Error::NotAHistory { history: history.clone() }),
    })
}

fn engine_error(history: &Arc<str>, error: rusqlite::Error) -> Error {
    let history = history.clone();
    if let rusqlite::Error::InvalidColumnType(..) | rusqlite::Error::IntegralValueOutOfRange(..) = error {
        return Error::Corrupt { history, detail: error.to_string() };
    }
    match error.sqlite_error_code() {
        Some(ErrorCode::DiskFull) => Error::Full { history },
        Some(ErrorCode::ReadOnly) => Error::ReadOnly { history },
        Some(ErrorCode::DatabaseBusy | ErrorCode::DatabaseLocked) => Error::Busy { history },
        Some(ErrorCode::TooBig) => Error::Corrupt {
            history,
            detail: format!("a value has more than {} MiB", guard::VALUE_BYTES >> 20),
        },
        Some(ErrorCode::OutOfMemory) => {
            Error::Corrupt { history, detail: "a query takes more memory than there is for it".to_owned() }
        }
        Some(ErrorCode::OperationInterrupted) => Error::Corrupt {
            history,
            detail: "a query takes more steps than any of a history does".to_owned(),
        },
        Some(ErrorCode::DatabaseCorrupt) => Error::Corrupt { history, detail: error.to_string() },
        Some(ErrorCode::NotADatabase) => Error::NotAHistory { history },
        _ => Error::Engine { history, cause: Arc::new(error) },
    }
}

impl Store for Sqlite {
    fn begin_run(&self, info: &RunInfo) -> Result<RunId> {
        sql::begin_run(&self.writer.lock().session, info)
    }

    fn end_run(&self, run: RunId, at: Timestamp) -> Result<()> {
        sql::end_run(&self.writer.lock().session, run, at)
    }

    fn run(&self, run: RunId) -> Result<Run> {
        self.read(|reader| reader.run(run))
    }

    fn runs(&self, after: Option<RunId>, limit: usize) -> Result<Vec<Run>> {
        self.read(|reader| reader.runs(after, limit))
    }

    fn append(&self, events: &[Entry], gaps: &[(RunId, Gap)]) -> Result<()> {
        self.writer.lock().append(events, gaps)
    }

    fn events(
        &self,
        run: RunId,
        what: &Selection<'_>,
        span: Span,
        page: PageRequest,
    ) -> Result<Page<Stamped>> {
        self.read(|reader| reader.events(run, what, span, page))
    }

    fn gaps(&self, run: RunId, span: Span, page: PageRequest) -> Result<Page<Gap>> {
        self.read(|reader| reader.gaps(run, span, page))
    }

    fn latest(&self, run: RunId, at: i64) -> Result<Vec<Stamped>> {
        self.read(|reader| reader.latest(run, at))
    }

    fn values(
        &self,
        run: RunId,
        figure: &Figure,
        span: Span,
        each: &mut dyn FnMut(i64, Reading),
    ) -> Result<()> {
        self.read(|reader| reader.values(run, figure, span, each))
    }

    fn extent(&self, run: RunId, kind: Kind, span: Span) -> Result<Option<(i64, i64)>> {
        self.read(|reader| reader.extent(run, kind, span))
    }

    fn samples(
        &self,
        run: RunId,
        kind: Kind,
        span: Span,
        after: Cursor,
        limit: usize,
        raw: bool,
    ) -> Result<Vec<(Cursor, Event)>> {
        self.read(|reader| reader.samples(run, kind, span, after, limit, raw))
    }

    fn retained(&self, run: RunId) -> Result<Vec<Retained>> {
        self.read(|reader| reader.retained(run))
    }

    fn thin(&self, run: RunId, kind: Kind, thinned: &[Thinned]) -> Result<()> {
        sql::thin(&self.writer.lock().session, run, kind, thinned)
    }

    fn note_retained(&self, run: RunId, retained: &Retained) -> Result<()> {
        sql::note_retained(&self.writer.lock().session, run, retained)
    }

    fn remove_run(&self, run: RunId) -> Result<()> {
        let mut writer = self.writer.lock();
        sql::remove_run(&writer.session, run)?;
        writer.forget();
        Ok(())
    }

    fn set_full(&self, full: bool) -> Result<()> {
        // SQLite takes no bound below what there is already.
        let pages = if full { 1 } else { MOST_PAGES };
        let writer = self.writer.lock();
        let set =
            writer.session.connection.pragma_update_and_check(None, "max_page_count", pages, |_| Ok(()));
        writer.session.engine(set)
    }
}
