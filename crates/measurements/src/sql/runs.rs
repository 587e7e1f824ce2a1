//! Runs: their begin, their end, and their removal.

use cotorra_graph::Timestamp;

use super::session::{Cell, Session, integers, quoted};
use crate::{
    error::{Error, Result},
    kind::Kind,
    run::{RunId, RunInfo},
};

/// Adds a run, and returns its id.
pub(crate) fn begin_run<S: Session>(session: &S, info: &RunInfo) -> Result<RunId> {
    let row = [
        Cell::from(&*info.name),
        info.seed.cast_signed().into(),
        info.started_at_unix_ns.into(),
        Cell::from(&*info.testbed),
    ];
    let sql = "INSERT INTO run (name, seed, started_at_unix_ns, testbed, next_seq) VALUES (?, ?, ?, ?, 0)";
    session.insert(sql, &row).map(RunId)
}

/// Notes when a run ended.
pub(crate) fn end_run<S: Session>(session: &S, run: RunId, at: Timestamp) -> Result<()> {
    let ended = i64::try_from(at.as_nanos()).unwrap_or(i64::MAX);
    // A server counts rows that an update changed, not those that it found.
    if session.rows("SELECT id FROM run WHERE id = ?", &integers([run.0]))?.is_empty() {
        return Err(Error::NoSuchRun(run));
    }
    session.execute("UPDATE run SET ended_ns = ? WHERE id = ?", &integers([ended, run.0])).map(|_| ())
}

/// Removes a run and everything recorded of it.
pub(crate) fn remove_run<S: Session>(session: &S, run: RunId) -> Result<()> {
    for table in tables_of_runs() {
        session.execute(&format!("DELETE FROM {} WHERE run = ?", quoted(table)), &integers([run.0]))?;
    }
    // Last, so that a removal that was interrupted can be repeated.
    session.execute("DELETE FROM run WHERE id = ?", &integers([run.0])).map(|_| ())
}

/// Returns all tables that have rows of runs.
fn tables_of_runs() -> impl Iterator<Item = &'static str> {
    let of_kinds = Kind::ALL.into_iter().flat_map(|kind| {
        let children = kind.table().children.map(|(table, _)| table);
        std::iter::once(kind.as_str()).chain(children)
    });
    of_kinds.chain(["gap", "presence", "chunk", "rolled_up", "retained"])
}
