//! Batches into a server: encoded first, then one short transaction of inserts of many rows each. Names and conditions
//! are written outside of it, so that they stay valid when it is rolled back.

use std::collections::BTreeMap;

use super::session::ServerSession;
use crate::{
    error::{Error, Result},
    run::{Entry, Gap, RunId},
    sql::{self, Cell, Known, Session, Stretch, Target, column_list, integer, integers, quoted, transaction},
};

/// Values in one insert, about. More buys nothing, and no server takes more than 65,535.
const VALUES: usize = 8192;

/// Memory that is kept between batches, values of each table.
const KEPT: usize = 1 << 18;

const PRESENCE: [&str; 5] = ["run", "kind", "a", "b", "stretch"];
const CHUNK: [&str; 6] = ["run", "kind", "a", "b", "stretch", "samples"];

/// Names a batch by its process and number, so that none is taken in twice.
#[derive(Debug, Clone, Copy)]
pub(super) struct Receipt<'a> {
    pub writer: &'a str,
    pub batch: u64,
}

/// The session that writes, and what it knows is in the database.
pub(super) struct Writer {
    pub session: ServerSession,
    known: Known,
    rows: Buffers,
}

/// Rows of the batch that is being taken. Their memory stays between batches.
struct Buffers {
    /// By [`Target::place`].
    tables: [Vec<Cell>; Target::COUNT],
    presence: Vec<Cell>,
    chunks: Vec<Cell>,
}

impl Writer {
    pub fn new(session: ServerSession) -> Self {
        let tables = [const { Vec::new() }; Target::COUNT];
        let rows = Buffers { tables, presence: Vec::new(), chunks: Vec::new() };
        Self { session, known: Known::default(), rows }
    }

    /// Appends all or nothing.
    pub fn append(&mut self, events: &[Entry], gaps: &[(RunId, Gap)], receipt: Receipt<'_>) -> Result<()> {
        let outcome = self.try_append(events, gaps, receipt);
        let Buffers { tables, presence, chunks } = &mut self.rows;
        for rows in tables.iter_mut().chain([presence, chunks]) {
            rows.clear();
            rows.shrink_to(KEPT);
        }
        if outcome.is_err() {
            // The stretches were rolled back, or may have been.
            self.known.forget_stretches();
        }
        outcome
    }

    fn try_append(&mut self, events: &[Entry], gaps: &[(RunId, Gap)], receipt: Receipt<'_>) -> Result<()> {
        let Self { session, known, rows } = self;
        known.bound();
        let mut batch = Batch { session, rows };
        let mut counters = sql::append(events, gaps, known, &mut batch)?;
        transaction(&*session, || {
            let mut chunks_hold = true;
            for (run, counter) in &mut counters {
                // Locks the run's row, so that processes which record the same run take turns.
                let lock = "SELECT next_seq FROM run WHERE id = ? FOR UPDATE";
                let found = session.rows(lock, &integers([run.0]))?;
                let row = found.first().ok_or(Error::NoSuchRun(*run))?;
                let first = integer(row, 0).map_err(|error| error.of(session.history()))?;
                let left = known.next_seq.insert(*run, first + *counter);
                chunks_hold &= left.is_none_or(|left| left == first);
                let next = integers([first + *counter, run.0]);
                session.execute("UPDATE run SET next_seq = ? WHERE id = ?", &next)?;
                *counter = first;
            }
            for target in Target::all() {
                let Some((table, columns)) = target.table() else { continue };
                let rows = &mut rows.tables[target.place()];
                number(rows, columns.len(), &counters);
                insert(session, table, &columns, rows)?;
            }
            let noted = rows.presence.clone();
            let fresh = insert(session, "presence", &PRESENCE, &mut rows.presence)?;
            if fresh < (noted.len() / PRESENCE.len()) as u64 {
                // Some have samples that are not known here, and chunks that lack those of this batch.
                chunks_hold = false;
                for stretch in noted.chunks(PRESENCE.len()) {
                    const DROP: &str =
                        "DELETE FROM chunk WHERE run = ? AND kind = ? AND a = ? AND b = ? AND stretch = ?";
                    session.execute(DROP, stretch)?;
                }
            }
            if chunks_hold {
                insert(session, "chunk", &CHUNK, &mut rows.chunks)?;
            } else {
                known.drop_chunks();
            }
            session.execute(
                "INSERT INTO spool (writer, batches) VALUES (?, ?) ON DUPLICATE KEY UPDATE batches = VALUES(batches)",
                &[receipt.writer.into(), receipt.batch.cast_signed().into()],
            )?;
            Ok(true)
        })
    }
}

/// The rows of an append. Events are numbered by run from 0, until the transaction has the runs' own counters.
struct Batch<'a> {
    session: &'a ServerSession,
    rows: &'a mut Buffers,
}

impl sql::Batch for Batch<'_> {
    fn first_seq(&mut self, _known: &mut Known, _run: RunId) -> Result<i64> {
        Ok(0)
    }

    fn name_id(&mut self, name: &str) -> Result<i64> {
        let found = self.session.rows("SELECT id FROM name WHERE text = ?", &[name.into()])?;
        match found.first() {
            Some(row) => integer(row, 0).map_err(|error| error.of(self.session.history())),
            // Another process may have been faster: then this gives the id of its row.
            None => self.session.insert(
                "INSERT INTO name (text) VALUES (?) ON DUPLICATE KEY UPDATE id = LAST_INSERT_ID(id)",
                &[name.into()],
            ),
        }
    }

    fn add_shared(&mut self, table: &str, columns: &[&'static str], cells: Vec<Cell>) -> Result<i64> {
        self.session.insert(&inserting(table, columns, 1), &cells)
    }

    fn push(&mut self, target: Target, cells: &mut Vec<Cell>) -> Result<()> {
        self.rows.tables[target.place()].append(cells);
        Ok(())
    }

    fn finish_chunk(&mut self, stretch: Stretch, chunk: Vec<u8>) -> Result<()> {
        self.rows.chunks.extend(integers(stretch.key()));
        self.rows.chunks.push(Cell::Blob(chunk));
        Ok(())
    }

    /// Whether the stretch is new turns out in the transaction.
    fn begin_stretch(&mut self, stretch: Stretch) -> Result<bool> {
        self.rows.presence.extend(integers(stretch.key()));
        Ok(true)
    }
}

/// Adds the counter of its run to the number of each row, which is in its third column.
fn number(rows: &mut [Cell], width: usize, counters: &BTreeMap<RunId, i64>) {
    for row in rows.chunks_exact_mut(width) {
        if let [Cell::Integer(run), _, Cell::Integer(seq), ..] = row {
            *seq += counters[&RunId(*run)];
        }
    }
}

/// Inserts rows, many at a time, and returns their number.
fn insert(session: &ServerSession, table: &str, columns: &[&str], rows: &mut Vec<Cell>) -> Result<u64> {
    let width = columns.len();
    let mut inserted = 0;
    // A few sizes only, powers of two, because a session keeps each statement prepared.
    let most = (VALUES / width).max(1).ilog2();
    let mut left = rows.drain(..);
    while left.len() > 0 {
        let count = 1 << (left.len() / width).ilog2().min(most);
        let sql = inserting(table, columns, count);
        inserted += session.execute_with(&sql, left.by_ref().take(count * width))?;
    }
    Ok(inserted)
}

fn inserting(table: &str, columns: &[&str], rows: usize) -> String {
    let row = format!("({})", vec!["?"; columns.len()].join(", "));
    // A stretch may have been noted already, and have been rolled up since.
    let verb = if matches!(table, "presence" | "chunk") { "INSERT IGNORE" } else { "INSERT" };
    format!(
        "{verb} INTO {} ({}) VALUES {}",
        quoted(table),
        column_list(columns),
        vec![row.as_str(); rows].join(", ")
    )
}
