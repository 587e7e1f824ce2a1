//! Batches into SQLite: one transaction each, prepared statements, names and conditions written once and then
//! referred to.

use std::{collections::HashMap, fmt::Write as _};

use cotorra_graph::{Conditions, Direction};
use rusqlite::{
    CachedStatement, Connection, OptionalExtension, Transaction, TransactionBehavior, params, types::Null,
};

use super::{Fallible, STRETCH};
use crate::{
    codec::{self, Fields, Role, Value},
    kind::{Kind, Series},
    store::{Entry, Gap, RunId},
};

/// More is not remembered; what was forgotten is looked up again.
const REMEMBERED: usize = 100_000;

/// The connection that writes, and what it knows is in the database.
pub(crate) struct Writer {
    pub connection: Connection,
    known: Known,
}

/// What is in the database for certain: only a commit adds to it.
#[derive(Debug, Default)]
struct Known {
    names: HashMap<Box<str>, i64>,
    /// By the link's id and its direction's code.
    conditions: HashMap<(i64, i64, Role), (Conditions, i64)>,
    /// The last stretch by run, kind, a and b.
    presence: HashMap<[i64; 4], i64>,
}

impl Known {
    fn forget_if_full(&mut self) {
        if self.names.len().max(self.conditions.len()).max(self.presence.len()) > REMEMBERED {
            *self = Self::default();
        }
    }
}

impl Writer {
    pub fn new(connection: Connection) -> Self {
        Self { connection, known: Known::default() }
    }

    /// Appends all or nothing.
    pub fn append(&mut self, events: &[Entry], gaps: &[(RunId, Gap)]) -> Fallible<()> {
        let transaction = self.connection.transaction_with_behavior(TransactionBehavior::Immediate)?;
        // Put back after the commit only: what was learnt in a transaction that failed is not so.
        let mut known = std::mem::take(&mut self.known);
        known.forget_if_full();
        let mut batch = Batch::new(&transaction, &mut known);
        batch.events(events)?;
        for (run, gap) in gaps {
            batch.gap(*run, gap)?;
        }
        batch.finish()?;
        transaction.commit()?;
        self.known = known;
        Ok(())
    }
}

/// A transaction being filled.
struct Batch<'t> {
    transaction: &'t Transaction<'t>,
    known: &'t mut Known,
    rows: [Option<CachedStatement<'t>>; Kind::ALL.len()],
    children: [Option<CachedStatement<'t>>; Kind::ALL.len()],
    /// The next place in the order of recording, by run.
    next_seq: HashMap<RunId, i64>,
}

impl<'t> Batch<'t> {
    fn new(transaction: &'t Transaction<'t>, known: &'t mut Known) -> Self {
        Self {
            transaction,
            known,
            rows: [const { None }; Kind::ALL.len()],
            children: [const { None }; Kind::ALL.len()],
            next_seq: HashMap::new(),
        }
    }

    fn events(&mut self, events: &[Entry]) -> Fallible<()> {
        let (mut row, mut children) = (Fields::default(), Fields::default());
        for Entry { run, stamped } in events {
            row.0.clear();
            children.0.clear();
            codec::encode(&stamped.event, &mut row, &mut children);
            let kind = Kind::of(&stamped.event);
            let t = stamped.at.as_nanos().cast_signed();
            let key = [run.0, t, self.seq(*run)?];
            self.row(kind, key, &row)?;
            self.child_rows(kind, key, &children)?;
            if Series::KINDS.contains(&kind) {
                self.presence(kind, key, &row)?;
            }
        }
        Ok(())
    }

    fn gap(&mut self, run: RunId, gap: &Gap) -> Fallible<()> {
        let seq = self.seq(run)?;
        let clamp = |t: cotorra_graph::Timestamp| i64::try_from(t.as_nanos()).unwrap_or(i64::MAX);
        self.transaction
            .prepare_cached("INSERT INTO gap (run, t_ns, seq, until_ns, events) VALUES (?1, ?2, ?3, ?4, ?5)")?
            .execute(params![run.0, clamp(gap.from), seq, clamp(gap.until), gap.events.cast_signed()])?;
        Ok(())
    }

    fn finish(self) -> Fallible<()> {
        for (run, next) in self.next_seq {
            self.transaction
                .prepare_cached("UPDATE run SET next_seq = ?2 WHERE id = ?1")?
                .execute(params![run.0, next])?;
        }
        Ok(())
    }

    fn seq(&mut self, run: RunId) -> Fallible<i64> {
        let next = match self.next_seq.get_mut(&run) {
            Some(next) => next,
            None => {
                let mut statement =
                    self.transaction.prepare_cached("SELECT next_seq FROM run WHERE id = ?1")?;
                let next = statement.query_row([run.0], |row| row.get(0))?;
                self.next_seq.entry(run).or_insert(next)
            }
        };
        *next += 1;
        Ok(*next - 1)
    }

    fn row(&mut self, kind: Kind, key: [i64; 3], row: &Fields<'_>) -> Fallible<()> {
        let mut statement = match self.rows[kind as usize].take() {
            Some(statement) => statement,
            None => {
                self.transaction.prepare_cached(&insert(kind.as_str(), &[], codec::table(kind).columns))?
            }
        };
        self.execute(&mut statement, &key, &row.0)?;
        self.rows[kind as usize] = Some(statement);
        Ok(())
    }

    fn child_rows(&mut self, kind: Kind, [run, t, seq]: [i64; 3], rows: &Fields<'_>) -> Fallible<()> {
        let Some((table, columns)) = codec::table(kind).children else { return Ok(()) };
        let mut statement = match self.children[kind as usize].take() {
            Some(statement) => statement,
            None => self.transaction.prepare_cached(&insert(table, &["place"], columns))?,
        };
        for (row, place) in rows.0.chunks(columns.len()).zip(0..) {
            self.execute(&mut statement, &[run, t, seq, place], row)?;
        }
        self.children[kind as usize] = Some(statement);
        Ok(())
    }

    fn execute(
        &mut self,
        statement: &mut CachedStatement<'t>,
        key: &[i64],
        row: &[Value<'_>],
    ) -> Fallible<()> {
        let mut parameter = 1;
        for part in key {
            statement.raw_bind_parameter(parameter, part)?;
            parameter += 1;
        }
        for value in row {
            match value {
                Value::Null => statement.raw_bind_parameter(parameter, Null)?,
                Value::Integer(n) => statement.raw_bind_parameter(parameter, n)?,
                Value::Real(x) => statement.raw_bind_parameter(parameter, x)?,
                Value::Text(text) => statement.raw_bind_parameter(parameter, &**text)?,
                Value::Name(name) => {
                    let id = self.name(name)?;
                    statement.raw_bind_parameter(parameter, id)?;
                }
                Value::Conditions { link, direction, role, conditions } => {
                    let id = self.conditions(link.as_str(), *direction, *role, conditions)?;
                    statement.raw_bind_parameter(parameter, id)?;
                }
            }
            parameter += 1;
        }
        statement.raw_execute()?;
        Ok(())
    }

    fn name(&mut self, name: &str) -> Fallible<i64> {
        if let Some(id) = self.known.names.get(name) {
            return Ok(*id);
        }
        let found = self
            .transaction
            .prepare_cached("SELECT id FROM name WHERE text = ?1")?
            .query_row([name], |row| row.get(0))
            .optional()?;
        let id = match found {
            Some(id) => id,
            None => self.transaction.prepare_cached("INSERT INTO name (text) VALUES (?1)")?.insert([name])?,
        };
        self.known.names.insert(name.into(), id);
        Ok(id)
    }

    fn conditions(
        &mut self,
        link: &str,
        direction: Direction,
        role: Role,
        conditions: &Conditions,
    ) -> Fallible<i64> {
        let slot = (self.name(link)?, codec::direction_code(direction), role);
        if let Some((last, id)) = self.known.conditions.get(&slot)
            && last == conditions
        {
            return Ok(*id);
        }
        let mut row = Fields::default();
        codec::encode_conditions(conditions, &mut row);
        let mut statement = self.transaction.prepare_cached(&insert_conditions())?;
        self.execute(&mut statement, &[], &row.0)?;
        let id = self.transaction.last_insert_rowid();
        self.known.conditions.insert(slot, (conditions.clone(), id));
        Ok(id)
    }

    /// Notes that a series has a sample in a stretch, unless that is known.
    fn presence(&mut self, kind: Kind, [run, t, _]: [i64; 3], row: &Fields<'_>) -> Fallible<()> {
        let mut ids = [0; 2];
        for (id, value) in ids.iter_mut().zip(&row.0[..codec::table(kind).series.len()]) {
            *id = match value {
                Value::Name(name) => self.name(name)?,
                Value::Integer(n) => *n,
                other => unreachable!("a series is named by names and numbers, not {other:?}"),
            };
        }
        let (series, stretch) = ([run, kind as i64, ids[0], ids[1]], t / STRETCH);
        if self.known.presence.get(&series) == Some(&stretch) {
            return Ok(());
        }
        self.transaction
            .prepare_cached(
                "INSERT INTO presence (run, kind, a, b, stretch) VALUES (?1, ?2, ?3, ?4, ?5) ON CONFLICT DO NOTHING",
            )?
            .execute(params![run, series[1], series[2], series[3], stretch])?;
        self.known.presence.insert(series, stretch);
        Ok(())
    }
}

fn insert(table: &str, key: &[&str], columns: &[&str]) -> String {
    let names = [&["run", "t_ns", "seq"], key, columns].concat();
    insert_into(table, &names)
}

fn insert_conditions() -> String {
    insert_into("conditions", codec::CONDITIONS)
}

fn insert_into(table: &str, columns: &[&str]) -> String {
    let mut sql = format!("INSERT INTO {table} ({}) VALUES (", columns.join(", "));
    for place in 1..=columns.len() {
        let comma = if place == 1 { "" } else { ", " };
        write!(sql, "{comma}?{place}").expect("writing to a string never fails");
    }
    sql + ")"
}
