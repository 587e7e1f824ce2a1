//! A connection to an SQL engine, as the shared statements use it.

use std::sync::Arc;

use crate::{codec::ReadError, error::Result, kind::Kind, run::RunId};

/// A value in a column.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Cell {
    Null,
    Integer(i64),
    /// NaN is stored as NULL.
    Real(f64),
    Text(String),
    Blob(Vec<u8>),
}

/// The columns of a row, in the order of the statement.
pub(crate) type Row = Vec<Cell>;

impl From<i64> for Cell {
    fn from(n: i64) -> Self {
        Self::Integer(n)
    }
}

impl From<&str> for Cell {
    fn from(text: &str) -> Self {
        Self::Text(text.to_owned())
    }
}

/// Returns integers as parameters of a statement.
pub(crate) fn integers<const N: usize>(parameters: [i64; N]) -> [Cell; N] {
    parameters.map(Cell::Integer)
}

/// SQL that engines spell differently, and sizes that suit each.
pub(crate) struct Dialect {
    /// Starts a transaction that reads one state of the history.
    pub begin_reading: &'static str,
    /// Starts a transaction that writes.
    pub begin_writing: &'static str,
    /// Joins two tables in the order in which they are written.
    pub ordered_join: &'static str,
    /// Divides integers and rounds down.
    pub integer_division: &'static str,
    /// Most rows that one statement names by their keys.
    pub keys: usize,
    /// Rows that are read ahead of each table when tables are merged.
    pub rows_ahead: usize,
    /// Names or conditions that are fetched when one is needed. Those written after it are likely needed next.
    pub ids_ahead: i64,
}

/// A connection to an engine.
pub(crate) trait Session {
    const DIALECT: Dialect;

    /// Returns the history's name for errors.
    fn history(&self) -> &Arc<str>;

    /// Runs a statement without parameters or rows, such as COMMIT.
    fn run(&self, sql: &str) -> Result<()>;

    /// Returns all rows that a statement finds.
    fn rows(&self, sql: &str, parameters: &[Cell]) -> Result<Vec<Row>>;

    /// Calls `each` with the first two columns of each row, a time and a figure. Rows are not gathered: there may be
    /// millions.
    fn figures(&self, sql: &str, parameters: &[i64], each: &mut dyn FnMut(i64, f64)) -> Result<()>;

    /// Runs a statement that changes rows, and returns their number.
    fn execute(&self, sql: &str, parameters: &[Cell]) -> Result<u64>;

    /// Inserts a row, and returns the id that it got.
    fn insert(&self, sql: &str, parameters: &[Cell]) -> Result<i64>;

    /// Returns the ids of each series of a kind, and its last stretch that is no later than `stretch`.
    fn last_stretches(&self, run: RunId, kind: Kind, stretch: i64) -> Result<Vec<([i64; 2], i64)>>;
}

/// Runs `work` in a transaction that writes. Commits if `work` returns true, and rolls back if it returns false or
/// fails.
pub(crate) fn transaction<S: Session>(session: &S, work: impl FnOnce() -> Result<bool>) -> Result<()> {
    session.run(S::DIALECT.begin_writing)?;
    let outcome = match work() {
        Ok(true) => session.run("COMMIT"),
        Ok(false) => return session.run("ROLLBACK"),
        Err(error) => Err(error),
    };
    if outcome.is_err() {
        // Fails if the engine has rolled back already, or is out of reach. The first error says more.
        let _ = session.run("ROLLBACK");
    }
    outcome
}

/// Returns a name as an identifier.
pub(crate) fn quoted(name: &str) -> String {
    format!("\"{}\"", name.replace('"', "\"\""))
}

/// Returns names as a list of identifiers.
pub(crate) fn column_list<'a>(names: impl IntoIterator<Item = &'a &'a str>) -> String {
    names.into_iter().map(|name| quoted(name)).collect::<Vec<_>>().join(", ")
}

/// Result of reading a column. A value of another type means a damaged history.
type Answer<T> = std::result::Result<T, ReadError>;

fn mismatch(column: usize) -> ReadError {
    ReadError::Unreadable(format!("column {} of a row is of another type than the schema says", column + 1))
}

pub(super) fn required<T>(value: Option<T>) -> Answer<T> {
    value.ok_or_else(|| ReadError::Unreadable("a required column is NULL".to_owned()))
}

pub(super) fn optional_integer(row: &[Cell], column: usize) -> Answer<Option<i64>> {
    match row.get(column) {
        Some(Cell::Null) => Ok(None),
        Some(Cell::Integer(n)) => Ok(Some(*n)),
        _ => Err(mismatch(column)),
    }
}

pub(crate) fn integer(row: &[Cell], column: usize) -> Answer<i64> {
    required(optional_integer(row, column)?)
}

pub(super) fn real(row: &[Cell], column: usize) -> Answer<Option<f64>> {
    match row.get(column) {
        Some(Cell::Null) => Ok(None),
        Some(Cell::Real(x)) => Ok(Some(*x)),
        Some(Cell::Integer(n)) => Ok(Some(*n as f64)),
        _ => Err(mismatch(column)),
    }
}

/// Returns a text, which a server gives as bytes.
pub(super) fn text(row: &[Cell], column: usize) -> Answer<Option<&str>> {
    match row.get(column) {
        Some(Cell::Null) => Ok(None),
        Some(Cell::Text(text)) => Ok(Some(text)),
        Some(Cell::Blob(bytes)) => str::from_utf8(bytes).map(Some).map_err(|_| mismatch(column)),
        _ => Err(mismatch(column)),
    }
}

pub(super) fn blob(row: &[Cell], column: usize) -> Answer<Option<&[u8]>> {
    match row.get(column) {
        Some(Cell::Null) => Ok(None),
        Some(Cell::Blob(bytes)) => Ok(Some(bytes)),
        _ => Err(mismatch(column)),
    }
}
