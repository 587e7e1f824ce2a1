//! Batches into SQLite: one transaction each, prepared statements, names and conditions written once and then
//! referred to.

use std::{
    collections::{BTreeMap, HashMap},
    fmt::Write as _,
};

use cotorra_graph::Conditions;
use rusqlite::{
    CachedStatement, Connection, OptionalExtension, Transaction, TransactionBehavior, params, types::Null,
};

use super::Fallible;
use crate::{
    chunk::{Chunk, has_chunks},
    codec::{self, Fields, Role, Value},
    kind::{Kind, Series},
    schema::STRETCH,
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
    /// Places in `of_series`.
    series: HashMap<Series, usize>,
    of_series: Vec<KnownSeries>,
    /// The next place in the order of recording that this process left, by run. If it is another one, another process
    /// records the same run.
    next_seq: BTreeMap<RunId, i64>,
}

/// What is known of a series.
#[derive(Debug)]
struct KnownSeries {
    /// As `presence` has them.
    ids: [i64; 2],
    /// The last stretch that was noted.
    presence: Option<(RunId, i64)>,
    /// All samples in it, if all of them are known.
    chunk: Option<Chunk>,
    /// The last conditions and their id, by role.
    conditions: [Option<(Conditions, i64)>; Role::COUNT],
}

impl Known {
    fn forget_if_full(&mut self) {
        if self.names.len().max(self.series.len()) > REMEMBERED {
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
    next_seq: BTreeMap<RunId, i64>,
}

impl<'t> Batch<'t> {
    fn new(transaction: &'t Transaction<'t>, known: &'t mut Known) -> Self {
        Self {
            transaction,
            known,
            rows: [const { None }; Kind::ALL.len()],
            children: [const { None }; Kind::ALL.len()],
            next_seq: BTreeMap::new(),
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
            match Series::of(&stamped.event) {
                None => self.row(kind, &key, None, &row.0)?,
                Some(series) => {
                    let (series, ids) = self.series(series)?;
                    self.presence(kind, *run, t, series)?;
                    // The ids are the row's first columns.
                    let width = codec::table(kind).series.len();
                    let [run, t, seq] = key;
                    let key_and_ids = [run, t, seq, ids[0], ids[1]];
                    self.row(kind, &key_and_ids[..3 + width], Some(series), &row.0[width..])?;
                    if let Some(chunk) = &mut self.known.of_series[series].chunk {
                        chunk.push(kind, t, &row.0);
                    }
                }
            }
            self.child_rows(kind, key, &children)?;
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
        self.known.next_seq.extend(&self.next_seq);
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
                if self.known.next_seq.get(&run).is_some_and(|left| *left != next) {
                    for series in &mut self.known.of_series {
                        series.chunk = None;
                    }
                }
                self.next_seq.entry(run).or_insert(next)
            }
        };
        *next += 1;
        Ok(*next - 1)
    }

    fn row(&mut self, kind: Kind, key: &[i64], series: Option<usize>, row: &[Value<'_>]) -> Fallible<()> {
        let mut statement = match self.rows[kind as usize].take() {
            Some(statement) => statement,
            None => {
                self.transaction.prepare_cached(&insert(kind.as_str(), &[], codec::table(kind).columns))?
            }
        };
        self.execute(&mut statement, key, series, row)?;
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
            self.execute(&mut statement, &[run, t, seq, place], None, row)?;
        }
        self.children[kind as usize] = Some(statement);
        Ok(())
    }

    fn execute(
        &mut self,
        statement: &mut CachedStatement<'t>,
        key: &[i64],
        series: Option<usize>,
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
                Value::Conditions(role, conditions) => {
                    let series = series.expect("conditions are those of a link, which makes a series");
                    let id = self.conditions(series, *role, conditions)?;
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

    /// Where a series is known, and its ids.
    fn series(&mut self, series: Series) -> Fallible<(usize, [i64; 2])> {
        if let Some(place) = self.known.series.get(&series) {
            return Ok((*place, self.known.of_series[*place].ids));
        }
        let ids = match &series {
            Series::Robot(node) | Series::Radio(node) => [self.name(node.as_str())?, 0],
            Series::Link(link, direction) => [self.name(link.as_str())?, codec::direction_code(*direction)],
            Series::Placement(vnf) => [self.name(vnf.as_str())?, 0],
            Series::VirtualLink(from, to) => [self.name(from.as_str())?, self.name(to.as_str())?],
        };
        let place = self.known.of_series.len();
        self.known.of_series.push(KnownSeries {
            ids,
            presence: None,
            chunk: None,
            conditions: [const { None }; Role::COUNT],
        });
        self.known.series.insert(series, place);
        Ok((place, ids))
    }

    /// The id of a link's conditions, which are written when they differ from its last.
    fn conditions(&mut self, series: usize, role: Role, conditions: &Conditions) -> Fallible<i64> {
        if let Some((last, id)) = &self.known.of_series[series].conditions[role as usize]
            && last == conditions
        {
            return Ok(*id);
        }
        let mut row = Fields::default();
        codec::encode_conditions(conditions, &mut row);
        let mut statement = self.transaction.prepare_cached(&insert_into("conditions", codec::CONDITIONS))?;
        self.execute(&mut statement, &[], None, &row.0)?;
        let id = self.transaction.last_insert_rowid();
        self.known.of_series[series].conditions[role as usize] = Some((conditions.clone(), id));
        Ok(id)
    }

    /// Notes that a series has a sample in a stretch, unless that is known; writes the chunk of the one before.
    fn presence(&mut self, kind: Kind, run: RunId, t: i64, series: usize) -> Fallible<()> {
        let known = &mut self.known.of_series[series];
        let stretch = t / STRETCH;
        let before = known.presence.replace((run, stretch));
        if before == Some((run, stretch)) {
            return Ok(());
        }
        let [a, b] = known.ids;
        if let Some((run, stretch)) = before
            && let Some(chunk) = known.chunk.take().and_then(|chunk| chunk.finish(kind))
        {
            self.transaction
                .prepare_cached(
                    "INSERT INTO chunk (run, kind, a, b, stretch, samples) VALUES (?1, ?2, ?3, ?4, ?5, ?6)",
                )?
                .execute(params![run.0, kind as i64, a, b, stretch, chunk])?;
        }
        let noted = self
            .transaction
            .prepare_cached(
                "INSERT INTO presence (run, kind, a, b, stretch) VALUES (?1, ?2, ?3, ?4, ?5) ON CONFLICT DO NOTHING",
            )?
            .execute(params![run.0, kind as i64, a, b, stretch])?;
        if noted == 1 {
            known.chunk = has_chunks(kind).then(Chunk::default);
        } else if has_chunks(kind) {
            // It has samples that are not known here, and the chunk that it may have will not hold this one.
            self.transaction
                .prepare_cached(
                    "DELETE FROM chunk WHERE run = ?1 AND kind = ?2 AND a = ?3 AND b = ?4 AND stretch = ?5",
                )?
                .execute(params![run.0, kind as i64, a, b, stretch])?;
        }
        Ok(())
    }
}

fn insert(table: &str, key: &[&str], columns: &[&str]) -> String {
    let names = [&["run", "t_ns", "seq"], key, columns].concat();
    insert_into(table, &names)
}

fn insert_into(table: &str, columns: &[&str]) -> String {
    let mut sql = format!("INSERT INTO {table} ({}) VALUES (", columns.join(", "));
    for place in 1..=columns.len() {
        let comma = if place == 1 { "" } else { ", " };
        write!(sql, "{comma}?{place}").expect("writing to a string never fails");
    }
    sql + ")"
}
