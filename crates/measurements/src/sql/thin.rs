//! Thins samples, and notes how far.

use super::{
    read::find_series,
    session::{Cell, Session, blob, integers, quoted, transaction},
};
use crate::{
    chunk,
    error::Result,
    kind::Kind,
    page::Cursor,
    retention::{Retained, Thinned},
    run::RunId,
};

/// Replaces samples of some series by what they are thinned to: all or nothing, and nothing if another process has
/// removed some of them already.
pub(crate) fn thin<S: Session>(session: &S, run: RunId, kind: Kind, thinned: &[Thinned]) -> Result<()> {
    // Looked up before the transaction: a server's first SELECT fixes the state that the transaction reads.
    let mut known = Vec::with_capacity(thinned.len());
    for series in thinned {
        let ids = find_series(session, &series.series).map_err(|error| error.of(session.history()))?;
        let Some(ids) = ids else { return Ok(()) };
        known.push((series, ids));
    }
    transaction(session, || {
        for (series, ids) in &known {
            if !delete_samples(session, run, kind, &series.gone)? {
                return Ok(false);
            }
            for (stretch, steps) in &series.stretches {
                let key = integers([run.0, kind as i64, ids[0], ids[1], *stretch]);
                thin_stretch(session, series, kind, &key, steps.as_deref())?;
            }
        }
        Ok(true)
    })
}

/// Deletes samples and their child rows. Returns whether all samples were there.
fn delete_samples<S: Session>(session: &S, run: RunId, kind: Kind, samples: &[Cursor]) -> Result<bool> {
    for cursors in samples.chunks(S::DIALECT.keys) {
        let keys = cursors.iter().flat_map(|cursor| [cursor.t, cursor.seq]);
        let parameters: Vec<Cell> = std::iter::once(run.0).chain(keys).map(Cell::Integer).collect();
        if session.execute(&deleting(kind.as_str(), cursors.len()), &parameters)? < cursors.len() as u64 {
            return Ok(false);
        }
        if let Some((children, _)) = kind.table().children {
            session.execute(&deleting(children, cursors.len()), &parameters)?;
        }
    }
    Ok(true)
}

fn deleting(table: &str, rows: usize) -> String {
    let keys = vec!["(at_ns = ? AND seq = ?)"; rows].join(" OR ");
    format!("DELETE FROM {} WHERE run = ? AND ({keys})", quoted(table))
}

fn thin_stretch<S: Session>(
    session: &S,
    series: &Thinned,
    kind: Kind,
    key: &[Cell; 5],
    steps: Option<&[u8]>,
) -> Result<()> {
    const OF_STRETCH: &str = "WHERE run = ? AND kind = ? AND a = ? AND b = ? AND stretch = ?";
    let found = session.rows(&format!("SELECT steps FROM rolled_up {OF_STRETCH}"), key)?;
    match (steps, found.first()) {
        (Some(steps), found) => {
            let earlier = found.map_or(Ok(None), |row| blob(row, 0));
            let earlier = earlier.map_err(|error| error.of(session.history()))?;
            let steps = Cell::Blob([earlier.unwrap_or_default(), steps].concat());
            let row = [key.as_slice(), &[(series.last_seq + 1).into(), steps]].concat();
            session.execute("REPLACE INTO rolled_up VALUES (?, ?, ?, ?, ?, ?, ?)", &row)?;
            let row = [key.as_slice(), &[Cell::Blob(chunk::empty(kind))]].concat();
            session.execute("REPLACE INTO chunk VALUES (?, ?, ?, ?, ?, ?)", &row)?;
        }
        // Earlier steps have their last samples in this stretch.
        (None, Some(_)) if !series.drops => {}
        (None, _) => {
            for table in ["presence", "chunk", "rolled_up"] {
                session.execute(&format!("DELETE FROM {table} {OF_STRETCH}"), key)?;
            }
        }
    }
    Ok(())
}

/// Notes how far samples of a kind were rolled up.
pub(crate) fn note_retained<S: Session>(session: &S, run: RunId, retained: &Retained) -> Result<()> {
    let (kind, rolled_up_to, step_ms, dropped_to) = retained.columns();
    let row = [run.0.into(), kind.into(), rolled_up_to.into(), Cell::Real(step_ms), dropped_to.into()];
    session.execute("REPLACE INTO retained VALUES (?, ?, ?, ?, ?)", &row).map(|_| ())
}
