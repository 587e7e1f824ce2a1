//! Thins samples in a server, and notes how far.

use mysql::{Conn, Params, TxOpts, Value as Sql, prelude::Queryable};

use super::connection::{Fallible, quoted};
use crate::{
    chunk, codec,
    kind::Kind,
    page::Cursor,
    retention::{Retained, Thinned},
    store::RunId,
};

/// Rows that a statement deletes.
const ROWS: usize = 256;

/// Leaves of some series, of which the ids are known, what they are thinned to, unless some of what is to go is gone.
pub(super) fn thin(
    connection: &mut Conn,
    run: RunId,
    kind: Kind,
    thinned: &[(&Thinned, [i64; 2])],
) -> Fallible<()> {
    let mut transaction = connection.start_transaction(TxOpts::default())?;
    let of_stretch = "WHERE run = ? AND kind = ? AND a = ? AND b = ? AND stretch = ?";
    for (its, [a, b]) in thinned {
        for cursors in its.gone.chunks(ROWS) {
            transaction.exec_drop(deleting(kind.as_str(), cursors.len()), of(run, cursors))?;
            if transaction.affected_rows() < cursors.len() as u64 {
                // Another process was faster. What was done here is rolled back.
                return Ok(());
            }
            if let Some((children, _)) = codec::table(kind).children {
                transaction.exec_drop(deleting(children, cursors.len()), of(run, cursors))?;
            }
        }
        for (stretch, steps) in &its.stretches {
            let place = (run.0, kind as i64, a, b, stretch);
            let found: Option<Vec<u8>> =
                transaction.exec_first(format!("SELECT steps FROM rolled_up {of_stretch}"), place)?;
            match (steps, found) {
                (Some(steps), before) => {
                    let mut all = before.unwrap_or_default();
                    all.extend(steps);
                    transaction.exec_drop(
                        "REPLACE INTO rolled_up VALUES (?, ?, ?, ?, ?, ?, ?)",
                        (run.0, kind as i64, a, b, stretch, its.last_seq + 1, all),
                    )?;
                    transaction.exec_drop(
                        "REPLACE INTO chunk VALUES (?, ?, ?, ?, ?, ?)",
                        (run.0, kind as i64, a, b, stretch, chunk::empty(kind)),
                    )?;
                }
                // Earlier steps have their last samples there.
                (None, Some(_)) if !its.drops => {}
                (None, _) => {
                    for table in ["presence", "chunk", "rolled_up"] {
                        transaction.exec_drop(format!("DELETE FROM {table} {of_stretch}"), place)?;
                    }
                }
            }
        }
    }
    transaction.commit()
}

fn deleting(table: &str, rows: usize) -> String {
    let keys = vec!["(at_ns = ? AND seq = ?)"; rows].join(" OR ");
    format!("DELETE FROM {} WHERE run = ? AND ({keys})", quoted(table))
}

fn of(run: RunId, cursors: &[Cursor]) -> Params {
    let keys = cursors.iter().flat_map(|cursor| [cursor.t, cursor.seq]);
    Params::Positional(std::iter::once(run.0).chain(keys).map(Sql::Int).collect())
}

/// Notes how far samples of a kind were rolled up.
pub(super) fn note_retained(connection: &mut Conn, run: RunId, retained: &Retained) -> Fallible<()> {
    let (kind, rolled_up_to, step_ms, dropped_to) = retained.columns();
    let row = (run.0, kind, rolled_up_to, step_ms, dropped_to);
    connection.exec_drop("REPLACE INTO retained VALUES (?, ?, ?, ?, ?)", row)
}
