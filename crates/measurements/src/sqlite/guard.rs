//! Guards against histories that others made: a file may hold more than a history, and is then neither read nor written.

use std::{
    collections::BTreeSet,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
};

use rusqlite::{Connection, config::DbConfig, limits::Limit};

use super::Fallible;

/// The most bytes of a value. A run has its testbed file in one, of 32 MiB at most.
pub(super) const VALUE_BYTES: usize = 64 << 20;
/// The most bytes of all values of an answer.
pub(super) const ANSWER_BYTES: usize = 512 << 20;
/// The most memory of SQLite in this process, bytes.
const HEAP_BYTES: i64 = 512 << 20;
/// The most steps of SQLite's machine for one statement: some minutes. A query of a hundred million samples takes far less.
const STEPS: u64 = 20_000_000_000;
/// Steps between two looks at their number.
const LOOK: u64 = 1_000_000;

/// The steps of a connection's present statement.
#[derive(Clone, Default)]
pub(super) struct Steps(Arc<AtomicU64>);

impl Steps {
    /// Begins to count those of another statement.
    pub(super) fn begin(&self) {
        self.0.store(0, Ordering::Relaxed);
    }
}

/// Has SQLite trust nothing that a file says beside its rows, and bounds what a statement takes.
pub(super) fn guard(connection: &mut Connection, most: Option<u64>) -> Fallible<Steps> {
    for (config, value) in [
        (DbConfig::SQLITE_DBCONFIG_DEFENSIVE, true),
        (DbConfig::SQLITE_DBCONFIG_TRUSTED_SCHEMA, false),
        (DbConfig::SQLITE_DBCONFIG_ENABLE_TRIGGER, false),
        (DbConfig::SQLITE_DBCONFIG_ENABLE_VIEW, false),
    ] {
        connection.set_db_config(config, value)?;
    }
    for (limit, most) in [
        (Limit::SQLITE_LIMIT_LENGTH, VALUE_BYTES as i32),
        (Limit::SQLITE_LIMIT_SQL_LENGTH, 1 << 20),
        (Limit::SQLITE_LIMIT_COLUMN, 200),
        (Limit::SQLITE_LIMIT_EXPR_DEPTH, 100),
        (Limit::SQLITE_LIMIT_COMPOUND_SELECT, 100),
        (Limit::SQLITE_LIMIT_VDBE_OP, 100_000),
        (Limit::SQLITE_LIMIT_ATTACHED, 0),
        (Limit::SQLITE_LIMIT_TRIGGER_DEPTH, 1),
        (Limit::SQLITE_LIMIT_WORKER_THREADS, 0),
    ] {
        connection.set_limit(limit, most)?;
    }
    let done = |_: &rusqlite::Row<'_>| Ok(());
    connection.pragma_update_and_check(None, "hard_heap_limit", HEAP_BYTES, done)?;
    connection.pragma_update(None, "cell_size_check", true)?;
    // A file that shrinks while it is mapped would end the process.
    connection.pragma_update_and_check(None, "mmap_size", 0, done).or_else(|error| match error {
        rusqlite::Error::QueryReturnedNoRows => Ok(()),
        other => Err(other),
    })?;
    let steps = Steps::default();
    let (counted, most) = (steps.clone(), most.unwrap_or(STEPS));
    let look = move || counted.0.fetch_add(LOOK.min(most), Ordering::Relaxed) >= most;
    connection.progress_handler(LOOK.min(most) as i32, Some(look))?;
    Ok(steps)
}

/// An object of a schema: type, name, table and statement.
type Object = (String, String, String, Option<String>);

/// Returns what a file has that no history with these migrations has, or the other way round; `None` if it is a history.
pub(super) fn stranger(connection: &Connection, migrations: &[&str]) -> Fallible<Option<String>> {
    let model = Connection::open_in_memory()?;
    migrations.iter().try_for_each(|migration| model.execute_batch(migration))?;
    let (expected, found) = (objects(&model)?, objects(connection)?);
    let different = found.difference(&expected).chain(expected.difference(&found)).next();
    Ok(different.map(|(kind, name, ..)| {
        let name: String = name.chars().take(64).collect();
        let what =
            if ["table", "index", "view", "trigger"].contains(&kind.as_str()) { kind } else { "object" };
        format!("its {what} `{name}` is not that of a history")
    }))
}

/// Returns the objects of a schema, at most some more than a history has.
fn objects(connection: &Connection) -> Fallible<BTreeSet<Object>> {
    let sql =
        "SELECT type, name, tbl_name, sql FROM sqlite_schema WHERE name NOT LIKE 'sqlite!_stat_' ESCAPE '!'
               OR type <> 'table' LIMIT 1000";
    let mut statement = connection.prepare(sql)?;
    let rows = statement.query_map([], |row| {
        let sql: Option<String> = row.get(3)?;
        Ok((row.get(0)?, row.get(1)?, row.get(2)?, sql.as_deref().map(plain)))
    })?;
    rows.collect()
}

/// Returns a statement without comments and with single spaces.
fn plain(sql: &str) -> String {
    let lines = sql.lines().map(|line| line.split("--").next().unwrap_or_default());
    lines.flat_map(str::split_whitespace).collect::<Vec<_>>().join(" ")
}
