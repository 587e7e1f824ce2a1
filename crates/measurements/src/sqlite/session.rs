//! A connection to SQLite.

use std::{path::Path, sync::Arc};

use rusqlite::{
    Connection, OpenFlags, OptionalExtension, ToSql,
    config::DbConfig,
    params, params_from_iter,
    types::{ToSqlOutput, ValueRef},
};

use super::{
    BUSY, Fallible, engine_error,
    guard::{ANSWER_BYTES, Steps, guard},
};
use crate::{
    error::{Error, Result},
    kind::Kind,
    run::RunId,
    sql::{Cell, Dialect, Row, Session},
};

/// A connection that runs statements.
pub(super) struct SqliteSession {
    pub connection: Connection,
    history: Arc<str>,
    steps: Steps,
}

impl SqliteSession {
    pub fn new(connection: Connection, history: &Arc<str>, steps: Steps) -> Self {
        connection.set_prepared_statement_cache_capacity(64);
        Self { connection, history: history.clone(), steps }
    }

    /// Opens a connection that reads.
    pub fn open(path: &Path, history: &Arc<str>) -> Result<Self> {
        let flags =
            OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_URI | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        let open = || -> Fallible<(Connection, Steps)> {
            let mut connection = Connection::open_with_flags(path, flags)?;
            let steps = guard(&mut connection, None)?;
            connection.busy_timeout(BUSY)?;
            // Plans that hold for all parameters: otherwise a new LIMIT has SQLite prepare the statement again.
            connection.set_db_config(DbConfig::SQLITE_DBCONFIG_ENABLE_QPSG, true)?;
            Ok((connection, steps))
        };
        let (connection, steps) = open().map_err(|e| engine_error(history, e))?;
        Ok(Self::new(connection, history, steps))
    }

    pub fn engine<T>(&self, result: Fallible<T>) -> Result<T> {
        result.map_err(|e| engine_error(&self.history, e))
    }
}

impl ToSql for Cell {
    fn to_sql(&self) -> Fallible<ToSqlOutput<'_>> {
        Ok(ToSqlOutput::Borrowed(match self {
            Self::Null => ValueRef::Null,
            Self::Integer(n) => ValueRef::Integer(*n),
            Self::Real(x) => ValueRef::Real(*x),
            Self::Text(text) => ValueRef::Text(text.as_bytes()),
            Self::Blob(bytes) => ValueRef::Blob(bytes),
        }))
    }
}

fn cell(value: ValueRef<'_>) -> Fallible<Cell> {
    Ok(match value {
        ValueRef::Null => Cell::Null,
        ValueRef::Integer(n) => Cell::Integer(n),
        ValueRef::Real(x) => Cell::Real(x),
        ValueRef::Text(_) => Cell::Text(value.as_str()?.to_owned()),
        ValueRef::Blob(bytes) => Cell::Blob(bytes.to_vec()),
    })
}

impl Session for SqliteSession {
    const DIALECT: Dialect = Dialect {
        begin_reading: "BEGIN",
        begin_writing: "BEGIN IMMEDIATE",
        ordered_join: "CROSS JOIN",
        integer_division: "/",
        // A statement costs next to nothing here, and a key of its own is a single search.
        keys: 1,
        rows_ahead: 32,
        ids_ahead: 1,
    };

    fn history(&self) -> &Arc<str> {
        &self.history
    }

    fn run(&self, sql: &str) -> Result<()> {
        self.steps.begin();
        self.engine(self.connection.execute_batch(sql))
    }

    fn rows(&self, sql: &str, parameters: &[Cell]) -> Result<Vec<Row>> {
        self.steps.begin();
        let mut bytes = 0;
        let mut ask = || {
            let mut statement = self.connection.prepare_cached(sql)?;
            let width = statement.column_count();
            let mut rows = statement.query(params_from_iter(parameters))?;
            let mut found = Vec::new();
            while let Some(row) = rows.next()? {
                let mut cells = Vec::with_capacity(width);
                for column in 0..width {
                    let value = row.get_ref(column)?;
                    if let ValueRef::Text(long) | ValueRef::Blob(long) = value {
                        bytes += long.len();
                    }
                    cells.push(cell(value)?);
                }
                if bytes > ANSWER_BYTES {
                    break;
                }
                found.push(cells);
            }
            Ok(found)
        };
        let found = self.engine(ask())?;
        if bytes > ANSWER_BYTES {
            let detail = format!("an answer has more than {} MiB", ANSWER_BYTES >> 20);
            return Err(Error::Corrupt { history: self.history.clone(), detail });
        }
        Ok(found)
    }

    fn figures(&self, sql: &str, parameters: &[i64], each: &mut dyn FnMut(i64, f64)) -> Result<()> {
        self.steps.begin();
        let mut ask = || {
            let mut statement = self.connection.prepare_cached(sql)?;
            let mut rows = statement.query(params_from_iter(parameters))?;
            while let Some(row) = rows.next()? {
                let value = match row.get_ref(1)? {
                    ValueRef::Integer(n) => n as f64,
                    _ => row.get(1)?,
                };
                each(row.get(0)?, value);
            }
            Ok(())
        };
        self.engine(ask())
    }

    fn execute(&self, sql: &str, parameters: &[Cell]) -> Result<u64> {
        self.steps.begin();
        let execute = || self.connection.prepare_cached(sql)?.execute(params_from_iter(parameters));
        self.engine(execute()).map(|changed| changed as u64)
    }

    fn insert(&self, sql: &str, parameters: &[Cell]) -> Result<i64> {
        self.steps.begin();
        let insert = || self.connection.prepare_cached(sql)?.insert(params_from_iter(parameters));
        self.engine(insert())
    }

    fn last_stretches(&self, run: RunId, kind: Kind, stretch: i64) -> Result<Vec<([i64; 2], i64)>> {
        self.steps.begin();
        let ask = || {
            // From series to series by the index, behind the last stretch that there can be: SQLite begins at the
            // bound itself, and would otherwise step through all stretches of the series before.
            let mut next = self.connection.prepare_cached(
                "SELECT a, b FROM presence WHERE run = ?1 AND kind = ?2 AND (a, b, stretch) > (?3, ?4, ?5)
                 ORDER BY a, b, stretch LIMIT 1",
            )?;
            let mut last = self.connection.prepare_cached(
                "SELECT stretch FROM presence WHERE run = ?1 AND kind = ?2 AND a = ?3 AND b = ?4 AND stretch <= ?5
                 ORDER BY stretch DESC LIMIT 1",
            )?;
            let (mut found, mut ids) = (Vec::new(), [i64::MIN; 2]);
            while let Some(series) = next
                .query_row(params![run.0, kind as i64, ids[0], ids[1], i64::MAX], |row| {
                    Ok([row.get(0)?, row.get(1)?])
                })
                .optional()?
            {
                ids = series;
                let key = params![run.0, kind as i64, ids[0], ids[1], stretch];
                found.extend(last.query_row(key, |row| row.get(0)).optional()?.map(|last| (ids, last)));
            }
            Ok(found)
        };
        self.engine(ask())
    }
}
