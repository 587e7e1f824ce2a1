//! Batches into SQLite: one transaction each, with prepared statements that take many rows at a time.

use std::fmt::Write as _;

use rusqlite::{CachedStatement, Connection};

use super::{Fallible, session::SqliteSession};
use crate::{
    error::{Error, Result},
    run::{Entry, Gap, RunId},
    sql::{self, Cell, Known, Session, Stretch, Target, integer, integers, transaction},
};

/// Rows of one insert. It finds the table's end once for all of them, which makes it a third cheaper than an insert of
/// each row. More rows buy little.
const ROWS: usize = 50;

/// The connection that writes, and what it knows is in the database.
pub(super) struct Writer {
    pub session: SqliteSession,
    known: Known,
}

impl Writer {
    pub fn new(session: SqliteSession) -> Self {
        Self { session, known: Known::default() }
    }

    /// Forgets what is in the database, because something else has changed it.
    pub fn forget(&mut self) {
        self.known = Known::default();
    }

    /// Appends all or nothing.
    pub fn append(&mut self, events: &[Entry], gaps: &[(RunId, Gap)]) -> Result<()> {
        let session = &self.session;
        // Put back after the commit only: ids of a transaction that failed are not valid.
        let mut known = std::mem::take(&mut self.known);
        known.bound();
        transaction(session, || {
            let mut batch = Batch { session, rows: Target::all().map(Rows::new).collect() };
            let next_seq = sql::append(events, gaps, &mut known, &mut batch)?;
            for rows in batch.rows.iter_mut().flatten() {
                session.engine(rows.write(&session.connection))?;
            }
            for (run, next) in &next_seq {
                session.execute("UPDATE run SET next_seq = ? WHERE id = ?", &integers([*next, run.0]))?;
            }
            known.next_seq.extend(next_seq);
            Ok(true)
        })?;
        self.known = known;
        Ok(())
    }
}

/// A transaction that is being filled.
struct Batch<'t> {
    session: &'t SqliteSession,
    /// By [`Target::place`].
    rows: Vec<Option<Rows<'t>>>,
}

impl sql::Batch for Batch<'_> {
    fn first_seq(&mut self, known: &mut Known, run: RunId) -> Result<i64> {
        let rows = self.session.rows("SELECT next_seq FROM run WHERE id = ?", &integers([run.0]))?;
        let row = rows.first().ok_or(Error::NoSuchRun(run))?;
        let next = integer(row, 0).map_err(|error| error.of(self.session.history()))?;
        if known.next_seq.get(&run).is_some_and(|left| *left != next) {
            known.drop_chunks();
        }
        Ok(next)
    }

    fn name_id(&mut self, name: &str) -> Result<i64> {
        let found = self.session.rows("SELECT id FROM name WHERE text = ?", &[name.into()])?;
        match found.first() {
            Some(row) => integer(row, 0).map_err(|error| error.of(self.session.history())),
            None => self.session.insert("INSERT INTO name (text) VALUES (?)", &[name.into()]),
        }
    }

    fn add_shared(&mut self, table: &str, columns: &[&'static str], cells: Vec<Cell>) -> Result<i64> {
        self.session.insert(&insert_into(table, columns, 1), &cells)
    }

    fn push(&mut self, target: Target, cells: &mut Vec<Cell>) -> Result<()> {
        let Some(rows) = &mut self.rows[target.place()] else { return Ok(()) };
        rows.cells.append(cells);
        self.session.engine(rows.write_if_many(&self.session.connection))
    }

    fn finish_chunk(&mut self, stretch: Stretch, chunk: Vec<u8>) -> Result<()> {
        const SQL: &str =
            "INSERT OR IGNORE INTO chunk (run, kind, a, b, stretch, samples) VALUES (?, ?, ?, ?, ?, ?)";
        let row = [&integers(stretch.key())[..], &[Cell::Blob(chunk)]].concat();
        self.session.execute(SQL, &row).map(|_| ())
    }

    fn begin_stretch(&mut self, stretch: Stretch) -> Result<bool> {
        const NOTE: &str = "INSERT INTO presence (run, kind, a, b, stretch) VALUES (?, ?, ?, ?, ?) \
                            ON CONFLICT DO NOTHING";
        const DROP: &str = "DELETE FROM chunk WHERE run = ? AND kind = ? AND a = ? AND b = ? AND stretch = ?";
        let key = integers(stretch.key());
        let fresh = self.session.execute(NOTE, &key)? == 1;
        if !fresh {
            self.session.execute(DROP, &key)?;
        }
        Ok(fresh)
    }
}

/// Rows on their way into one table.
struct Rows<'t> {
    table: &'static str,
    columns: Vec<&'static str>,
    cells: Vec<Cell>,
    /// For [`ROWS`] rows, and for one.
    statements: [Option<CachedStatement<'t>>; 2],
}

impl<'t> Rows<'t> {
    fn new(target: Target) -> Option<Self> {
        let (table, columns) = target.table()?;
        Some(Self { table, columns, cells: Vec::new(), statements: [const { None }; 2] })
    }

    /// Writes the rows if they are enough for a statement.
    fn write_if_many(&mut self, connection: &'t Connection) -> Fallible<()> {
        if self.cells.len() < ROWS * self.columns.len() { Ok(()) } else { self.write(connection) }
    }

    fn write(&mut self, connection: &'t Connection) -> Fallible<()> {
        let width = self.columns.len();
        let many = self.cells.chunks_exact(ROWS * width);
        let few = many.remainder().chunks_exact(width);
        for (rows, cells) in many.map(|rows| (ROWS, rows)).chain(few.map(|row| (1, row))) {
            let statement = &mut self.statements[usize::from(rows == 1)];
            if statement.is_none() {
                let sql = insert_into(self.table, &self.columns, rows);
                *statement = Some(connection.prepare_cached(&sql)?);
            }
            let statement = statement.as_mut().expect("it was prepared a moment ago");
            for (place, cell) in (1..).zip(cells) {
                statement.raw_bind_parameter(place, cell)?;
            }
            statement.raw_execute()?;
        }
        self.cells.clear();
        Ok(())
    }
}

/// Returns an insert of some rows. A failure undoes the whole transaction, so that SQLite need not remember how to
/// undo the one statement.
fn insert_into(table: &str, columns: &[&str], rows: usize) -> String {
    let mut sql = format!("INSERT OR ROLLBACK INTO {table} ({}) VALUES ", columns.join(", "));
    let row = format!("({})", vec!["?"; columns.len()].join(", "));
    for place in 0..rows {
        write!(sql, "{}{row}", if place == 0 { "" } else { ", " }).expect("writing to a string never fails");
    }
    sql
}
