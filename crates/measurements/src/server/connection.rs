//! Connections to MySQL and MariaDB: sets up sessions, migrates the schema, and translates the server's errors.

use std::{sync::Arc, time::Duration};

use mysql::{Conn, Opts, OptsBuilder, prelude::Queryable};

use crate::{
    error::{Error, Result},
    location::Server,
    schema::for_server,
    sql::quoted,
};

pub(super) type Fallible<T> = std::result::Result<T, mysql::Error>;

/// Timeout of a connection attempt.
const CONNECT: Duration = Duration::from_secs(2);

/// Most time to wait for another process that migrates the schema, seconds.
const MIGRATE_S: u32 = 20;

/// Prepared statements that a session keeps.
const STATEMENTS: usize = 256;

/// Connects to a server. An answer that takes longer than `patience` counts as a lost server.
pub(super) fn connect(server: &Server, patience: Duration) -> Fallible<Conn> {
    let build = |database: Option<&str>| {
        OptsBuilder::new()
            .ip_or_hostname(Some(&*server.host))
            .tcp_port(server.port)
            .socket(server.socket.as_deref())
            .prefer_socket(false)
            .user(Some(&*server.user))
            .pass(server.password.as_deref())
            .db_name(database)
            .tcp_connect_timeout(Some(CONNECT))
            .read_timeout(Some(patience))
            .write_timeout(Some(patience))
            .stmt_cache_size(STATEMENTS)
            .init(vec![
                "SET SESSION sql_mode = 'ANSI_QUOTES,STRICT_TRANS_TABLES,NO_ENGINE_SUBSTITUTION'",
                "SET SESSION TRANSACTION ISOLATION LEVEL REPEATABLE READ",
            ])
    };
    match Conn::new(Opts::from(build(Some(&server.database)))) {
        Err(mysql::Error::MySqlError(error)) if error.code == code::UNKNOWN_DATABASE => {
            let mut connection = Conn::new(Opts::from(build(None)))?;
            connection.query_drop(format!("CREATE DATABASE IF NOT EXISTS {}", quoted(&server.database)))?;
            Conn::new(Opts::from(build(Some(&server.database))))
        }
        other => other,
    }
}

/// Checks that the database is a history before anything in it is touched, then migrates it.
pub(super) fn prepare(connection: &mut Conn, server: &Server, migrations: &[&str]) -> Result<()> {
    let engine = |e| engine_error(&server.name, e);
    let known = migrations.len() as u32;
    if version(connection, server, known)? == Some(known) {
        return Ok(());
    }
    // One process at a time; the server frees the lock with the session.
    let lock = "MD5(CONCAT('cotorra/', DATABASE()))";
    let got: Option<Option<i64>> =
        connection.query_first(format!("SELECT GET_LOCK({lock}, {MIGRATE_S})")).map_err(engine)?;
    if got.flatten() != Some(1) {
        return Err(Error::Busy { history: server.name.clone() });
    }
    let found = version(connection, server, known)?.unwrap_or(0);
    let mut migrate = || -> Fallible<()> {
        // Created first, so that a database with half a schema is recognised as a history.
        connection.query_drop(
            "CREATE TABLE IF NOT EXISTS cotorra_schema (one BIGINT PRIMARY KEY, version BIGINT NOT NULL) ENGINE = InnoDB",
        )?;
        for (version, migration) in (1_i64..).zip(migrations).skip(found as usize) {
            for statement in for_server(migration) {
                match connection.query_drop(statement) {
                    // Added by a migration that was killed before it was noted.
                    Err(mysql::Error::MySqlError(error)) if error.code == code::COLUMN_EXISTS => {}
                    done => done?,
                }
            }
            connection.exec_drop("REPLACE INTO cotorra_schema (one, version) VALUES (1, ?)", (version,))?;
        }
        connection.query_drop(format!("DO RELEASE_LOCK({lock})"))
    };
    migrate().map_err(engine)
}

/// Returns the schema version of a database that may be a history; `None` for an empty one.
fn version(connection: &mut Conn, server: &Server, known: u32) -> Result<Option<u32>> {
    let mut ask = || -> Fallible<(Vec<String>, Option<i64>)> {
        let tables: Vec<String> = connection.query("SHOW TABLES")?;
        if !tables.iter().any(|table| table == "cotorra_schema") {
            return Ok((tables, None));
        }
        let found: Option<i64> =
            connection.query_first("SELECT version FROM cotorra_schema WHERE one = 1")?;
        Ok((tables, Some(found.unwrap_or(0))))
    };
    let (tables, found) = ask().map_err(|e| engine_error(&server.name, e))?;
    match found.map(|found| u32::try_from(found).unwrap_or(u32::MAX)) {
        Some(found) if found > known => {
            Err(Error::UnknownSchema { history: server.name.clone(), found, known })
        }
        Some(found) => Ok(Some(found)),
        None if tables.is_empty() => Ok(None),
        None => Err(Error::NotAHistory { history: server.name.clone() }),
    }
}

/// Error codes, from MySQL's and MariaDB's error references.
mod code {
    pub const UNKNOWN_DATABASE: u16 = 1049;
    pub const COLUMN_EXISTS: u16 = 1060;
    /// Disk full, table full.
    pub const FULL: [u16; 2] = [1021, 1114];
    /// `--read-only` and similar options, read-only table, read-only transaction.
    pub const READ_ONLY: [u16; 3] = [1290, 1036, 1792];
    /// Lock wait timeout, deadlock.
    pub const BUSY: [u16; 2] = [1205, 1213];
    /// Incorrect key file, table crashed, index corrupted.
    pub const CORRUPT: [u16; 4] = [1034, 1194, 1712, 1877];
    /// Too many connections, shutdown in progress, connection killed, aborted.
    pub const AWAY: [u16; 7] = [1040, 1053, 1080, 1152, 1184, 1927, 3169];
}

pub(super) fn engine_error(history: &Arc<str>, error: mysql::Error) -> Error {
    let history = history.clone();
    match error {
        mysql::Error::MySqlError(error) => {
            let cause = || Arc::from(error.message.as_str());
            match error.code {
                c if code::FULL.contains(&c) => Error::Full { history },
                c if code::READ_ONLY.contains(&c) => Error::ReadOnly { history },
                c if code::BUSY.contains(&c) => Error::Busy { history },
                c if code::CORRUPT.contains(&c) => Error::Corrupt { history, detail: error.message },
                c if code::AWAY.contains(&c) => Error::Unreachable { history, cause: cause() },
                _ => Error::Server { history, cause: cause() },
            }
        }
        mysql::Error::FromValueError(_) | mysql::Error::FromRowError(_) => {
            Error::Corrupt { history, detail: "a column is of another type than the schema says".to_owned() }
        }
        // The text of these without the name of their type.
        mysql::Error::DriverError(error) => Error::Unreachable { history, cause: error.to_string().into() },
        mysql::Error::IoError(error) => Error::Unreachable { history, cause: error.to_string().into() },
        // A session whose bytes were cut off, or whose answer came too late.
        other => Error::Unreachable { history, cause: other.to_string().into() },
    }
}
