//! Rows on their way into a table. A statement takes many at a time: it finds the table's end once for all of them,
//! which makes an insert a third cheaper than one of a single row.

use std::fmt::Write as _;

use rusqlite::{CachedStatement, Connection, types::Value};

use super::Fallible;

/// Rows of a statement. More buys little.
const ROWS: usize = 50;

/// Gathers the rows of one table.
pub(super) struct Rows<'t> {
    table: &'static str,
    columns: Vec<&'static str>,
    values: Vec<Value>,
    /// For [`ROWS`] rows, and for one.
    statements: [Option<CachedStatement<'t>>; 2],
}

impl<'t> Rows<'t> {
    pub fn new(table: &'static str, key: &[&'static str], columns: &[&'static str]) -> Self {
        let columns = [key, columns].concat();
        Self { table, columns, values: Vec::new(), statements: [const { None }; 2] }
    }

    /// Adds a figure; once there are as many as columns, they are a row.
    pub fn push(&mut self, value: Value) {
        self.values.push(value);
    }

    /// Writes what was gathered if it is enough for a statement.
    pub fn write_if_many(&mut self, connection: &'t Connection) -> Fallible<()> {
        if self.values.len() < ROWS * self.columns.len() { Ok(()) } else { self.write(connection) }
    }

    /// Writes what was gathered.
    pub fn write(&mut self, connection: &'t Connection) -> Fallible<()> {
        let width = self.columns.len();
        let many = self.values.chunks_exact(ROWS * width);
        let few = many.remainder().chunks_exact(width);
        for (rows, values) in many.map(|rows| (ROWS, rows)).chain(few.map(|row| (1, row))) {
            let statement = &mut self.statements[usize::from(rows == 1)];
            if statement.is_none() {
                let sql = insert_into(self.table, &self.columns, rows);
                *statement = Some(connection.prepare_cached(&sql)?);
            }
            let statement = statement.as_mut().expect("it was prepared a moment ago");
            for (place, value) in (1..).zip(values) {
                statement.raw_bind_parameter(place, value)?;
            }
            statement.raw_execute()?;
        }
        self.values.clear();
        Ok(())
    }
}

/// An insert of some rows. What fails undoes the whole transaction, so that SQLite need not remember how to undo the
/// one statement.
pub(super) fn insert_into(table: &str, columns: &[&str], rows: usize) -> String {
    let mut sql = format!("INSERT OR ROLLBACK INTO {table} ({}) VALUES ", columns.join(", "));
    let row = format!("({})", vec!["?"; columns.len()].join(", "));
    for place in 0..rows {
        write!(sql, "{}{row}", if place == 0 { "" } else { ", " }).expect("writing to a string never fails");
    }
    sql
}
