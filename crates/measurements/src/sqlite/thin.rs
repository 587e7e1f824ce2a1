//! Thins samples in SQLite, and notes how far.

use rusqlite::{Connection, OptionalExtension, Transaction, TransactionBehavior, params};

use super::Fallible;
use crate::{
    chunk,
    codec::{self, direction_code},
    kind::{Kind, Series},
    retention::{Retained, Thinned},
    store::RunId,
};

/// Leaves of some series what they are thinned to, unless some of what is to go is gone.
pub(super) fn thin(connection: &mut Connection, run: RunId, kind: Kind, thinned: &[Thinned]) -> Fallible<()> {
    let transaction = connection.transaction_with_behavior(TransactionBehavior::Immediate)?;
    let table = codec::table(kind);
    let deleting = |table: &str| format!("DELETE FROM {table} WHERE run = ?1 AND at_ns = ?2 AND seq = ?3");
    for its in thinned {
        let Some(ids) = ids(&transaction, &its.series)? else { return Ok(()) };
        let mut delete = transaction.prepare_cached(&deleting(kind.as_str()))?;
        for cursor in &its.gone {
            if delete.execute(params![run.0, cursor.t, cursor.seq])? == 0 {
                // Another process was faster. What was done here is rolled back.
                return Ok(());
            }
        }
        if let Some((children, _)) = table.children {
            let mut delete = transaction.prepare_cached(&deleting(children))?;
            for cursor in &its.gone {
                delete.execute(params![run.0, cursor.t, cursor.seq])?;
            }
        }
        for (stretch, steps) in &its.stretches {
            let place = params![run.0, kind as i64, ids[0], ids[1], stretch];
            let found = transaction
                .prepare_cached(&format!("SELECT steps FROM rolled_up {OF_STRETCH}"))?
                .query_row(place, |row| row.get::<_, Vec<u8>>(0))
                .optional()?;
            match (steps, found) {
                (Some(steps), before) => {
                    let mut all = before.unwrap_or_default();
                    all.extend(steps);
                    transaction
                        .prepare_cached("REPLACE INTO rolled_up VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7)")?
                        .execute(params![
                            run.0,
                            kind as i64,
                            ids[0],
                            ids[1],
                            stretch,
                            its.last_seq + 1,
                            all
                        ])?;
                    transaction
                        .prepare_cached("REPLACE INTO chunk VALUES (?1, ?2, ?3, ?4, ?5, ?6)")?
                        .execute(params![run.0, kind as i64, ids[0], ids[1], stretch, chunk::empty(kind)])?;
                }
                // Earlier steps have their last samples there.
                (None, Some(_)) if !its.drops => {}
                (None, _) => {
                    for table in ["presence", "chunk", "rolled_up"] {
                        transaction
                            .prepare_cached(&format!("DELETE FROM {table} {OF_STRETCH}"))?
                            .execute(place)?;
                    }
                }
            }
        }
    }
    transaction.commit()
}

const OF_STRETCH: &str = "WHERE run = ?1 AND kind = ?2 AND a = ?3 AND b = ?4 AND stretch = ?5";

/// The ids of a series as `presence` has them.
fn ids(transaction: &Transaction<'_>, series: &Series) -> Fallible<Option<[i64; 2]>> {
    let id = |name: &str| -> Fallible<Option<i64>> {
        let mut find = transaction.prepare_cached("SELECT id FROM name WHERE text = ?1")?;
        find.query_row([name], |row| row.get(0)).optional()
    };
    let (a, b) = match series {
        Series::Robot(node) | Series::Radio(node) => (id(node.as_str())?, Some(0)),
        Series::Link(link, direction) => (id(link.as_str())?, Some(direction_code(*direction))),
        Series::Placement(vnf) => (id(vnf.as_str())?, Some(0)),
        Series::VirtualLink(from, to) => (id(from.as_str())?, id(to.as_str())?),
        Series::Sensor(robot, sensor) => (id(robot.as_str())?, id(sensor.as_str())?),
    };
    Ok(a.zip(b).map(|(a, b)| [a, b]))
}

/// How far samples of a run were rolled up.
pub(super) fn retained(connection: &Connection, run: RunId) -> Fallible<Vec<Retained>> {
    let mut ask = connection.prepare_cached(
        "SELECT kind, rolled_up_to_ns, step_ms, dropped_to_ns FROM retained WHERE run = ?1 ORDER BY kind",
    )?;
    let rows = ask.query_map([run.0], |row| Ok((row.get(0)?, row.get(1)?, row.get(2)?, row.get(3)?)))?;
    rows.filter_map(|row| row.map(Retained::of).transpose()).collect()
}

/// Notes how far samples of a kind were rolled up.
pub(super) fn note_retained(connection: &Connection, run: RunId, retained: &Retained) -> Fallible<()> {
    let (kind, rolled_up_to, step_ms, dropped_to) = retained.columns();
    let mut note = connection.prepare_cached("REPLACE INTO retained VALUES (?1, ?2, ?3, ?4, ?5)")?;
    note.execute(params![run.0, kind, rolled_up_to, step_ms, dropped_to])?;
    Ok(())
}
