//! A session with a server, as the shared statements use it.

use std::{cell::RefCell, sync::Arc};

use mysql::{Conn, Params, Value, prelude::Queryable};

use super::connection::{Fallible, engine_error};
use crate::{
    codec::ReadError,
    error::{Error, Result},
    kind::Kind,
    run::RunId,
    sql::{Cell, Dialect, Row, Session, integer, integers},
};

/// A session that runs statements.
pub(super) struct ServerSession {
    pub connection: RefCell<Conn>,
    history: Arc<str>,
}

impl ServerSession {
    pub fn new(connection: Conn, history: &Arc<str>) -> Self {
        Self { connection: RefCell::new(connection), history: history.clone() }
    }

    fn engine<T>(&self, result: Fallible<T>) -> Result<T> {
        result.map_err(|e| engine_error(&self.history, e))
    }

    fn mismatch(&self) -> Error {
        let detail = "a column is of another type than the schema says".to_owned();
        Error::Corrupt { history: self.history.clone(), detail }
    }

    fn cell(&self, value: Value) -> Result<Cell> {
        Ok(match value {
            Value::NULL => Cell::Null,
            Value::Int(n) => Cell::Integer(n),
            Value::UInt(n) => Cell::Integer(n.cast_signed()),
            Value::Double(f64::MAX) => Cell::Real(f64::INFINITY),
            Value::Double(f64::MIN) => Cell::Real(f64::NEG_INFINITY),
            Value::Double(x) => Cell::Real(x),
            Value::Bytes(bytes) => Cell::Blob(bytes),
            _ => return Err(self.mismatch()),
        })
    }

    /// Checks that the server still answers.
    pub fn ping(&self) -> Result<()> {
        self.engine(self.connection.borrow_mut().ping())
    }

    /// Executes a statement with its parameters, without copying them.
    pub fn execute_with(&self, sql: &str, parameters: impl Iterator<Item = Cell>) -> Result<u64> {
        let parameters = Params::Positional(parameters.map(value).collect());
        let mut connection = self.connection.borrow_mut();
        self.engine(connection.exec_drop(sql, parameters))?;
        Ok(connection.affected_rows())
    }
}

fn value(cell: Cell) -> Value {
    match cell {
        Cell::Null => Value::NULL,
        Cell::Integer(n) => Value::Int(n),
        Cell::Real(x) if x.is_nan() => Value::NULL,
        // A server has no infinity: the largest numbers stand for it.
        Cell::Real(x) => Value::Double(x.clamp(f64::MIN, f64::MAX)),
        Cell::Text(text) => Value::Bytes(text.into_bytes()),
        Cell::Blob(bytes) => Value::Bytes(bytes),
    }
}

/// The last stretch of each series of a kind. Grouped by all of the key, constant or not: MariaDB then takes one look
/// at the key for each series, and otherwise one for each stretch.
pub(super) const LAST_STRETCHES: &str = "SELECT a, b, max(stretch) FROM presence
     WHERE run = ? AND kind = ? AND stretch <= ? GROUP BY run, kind, a, b";

impl Session for ServerSession {
    const DIALECT: Dialect = Dialect {
        begin_reading: "START TRANSACTION WITH CONSISTENT SNAPSHOT, READ ONLY",
        begin_writing: "START TRANSACTION",
        ordered_join: "STRAIGHT_JOIN",
        integer_division: "DIV",
        keys: 256,
        // All that may be needed, because each statement is a round trip.
        rows_ahead: usize::MAX,
        ids_ahead: 200,
    };

    fn history(&self) -> &Arc<str> {
        &self.history
    }

    fn run(&self, sql: &str) -> Result<()> {
        self.engine(self.connection.borrow_mut().query_drop(sql))
    }

    fn rows(&self, sql: &str, parameters: &[Cell]) -> Result<Vec<Row>> {
        let parameters = Params::Positional(parameters.iter().cloned().map(value).collect());
        let rows: Vec<mysql::Row> = self.engine(self.connection.borrow_mut().exec(sql, parameters))?;
        rows.into_iter().map(|row| row.unwrap().into_iter().map(|value| self.cell(value)).collect()).collect()
    }

    fn figures(&self, sql: &str, parameters: &[i64], each: &mut dyn FnMut(i64, f64)) -> Result<()> {
        let parameters = Params::Positional(parameters.iter().map(|n| Value::Int(*n)).collect());
        let mut connection = self.connection.borrow_mut();
        for row in self.engine(connection.exec_iter(sql, parameters))? {
            let mut columns = self.engine(row)?.unwrap().into_iter().map(|value| self.cell(value));
            let (time, figure) = (columns.next().transpose()?, columns.next().transpose()?);
            match (time, figure) {
                (Some(Cell::Integer(t)), Some(Cell::Integer(n))) => each(t, n as f64),
                (Some(Cell::Integer(t)), Some(Cell::Real(x))) => each(t, x),
                _ => return Err(self.mismatch()),
            }
        }
        Ok(())
    }

    fn execute(&self, sql: &str, parameters: &[Cell]) -> Result<u64> {
        self.execute_with(sql, parameters.iter().cloned())
    }

    fn insert(&self, sql: &str, parameters: &[Cell]) -> Result<i64> {
        self.execute(sql, parameters)?;
        Ok(self.connection.borrow().last_insert_id().cast_signed())
    }

    fn last_stretches(&self, run: RunId, kind: Kind, stretch: i64) -> Result<Vec<([i64; 2], i64)>> {
        let rows = self.rows(LAST_STRETCHES, &integers([run.0, kind as i64, stretch]))?;
        let last = |row: &Row| Ok(([integer(row, 0)?, integer(row, 1)?], integer(row, 2)?));
        rows.iter()
            .map(last)
            .collect::<std::result::Result<_, _>>()
            .map_err(|e: ReadError| e.of(&self.history))
    }
}
