//! Batches into SQLite: one transaction each, prepared statements, names and conditions written once and then
//! referred to.

use std::collections::{BTreeMap, HashMap};

use cotorra_graph::{Conditions, Event};
use rusqlite::{
    Connection, OptionalExtension, Transaction, TransactionBehavior, params, types::Value as Sql,
};

use super::{
    Fallible,
    rows::{Rows, insert_into},
};
use crate::{
    chunk::{self, Chunk, has_chunks},
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
    /// The place behind that of the last series that was met.
    after_last: usize,
    /// The next place in the order of recording that this process left, by run. If it is another one, another process
    /// records the same run.
    next_seq: BTreeMap<RunId, i64>,
}

/// What is known of a series.
#[derive(Debug)]
struct KnownSeries {
    series: Series,
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

    /// Something else changed what is in the database.
    pub fn forget(&mut self) {
        self.known = Known::default();
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
    /// By kind.
    rows: [Option<Rows<'t>>; Kind::ALL.len()],
    children: [Option<Rows<'t>>; Kind::ALL.len()],
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
            let series = self.series(&stamped.event)?;
            if let Some(series) = series {
                self.presence(kind, *run, t, series)?;
                if let Some(chunk) = &mut self.known.of_series[series].chunk {
                    chunk.push(kind, t, &row.0);
                }
            }
            self.row(kind, key, series, &row.0)?;
            self.child_rows(kind, key, series, &children.0)?;
        }
        Ok(())
    }

    fn gap(&mut self, run: RunId, gap: &Gap) -> Fallible<()> {
        let seq = self.seq(run)?;
        let clamp = |t: cotorra_graph::Timestamp| i64::try_from(t.as_nanos()).unwrap_or(i64::MAX);
        self.transaction
            .prepare_cached(
                "INSERT INTO gap (run, at_ns, seq, until_ns, events) VALUES (?1, ?2, ?3, ?4, ?5)",
            )?
            .execute(params![run.0, clamp(gap.from), seq, clamp(gap.until), gap.events.cast_signed()])?;
        Ok(())
    }

    fn finish(mut self) -> Fallible<()> {
        for rows in self.rows.iter_mut().chain(&mut self.children).flatten() {
            rows.write(self.transaction)?;
        }
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

    fn row(&mut self, kind: Kind, key: [i64; 3], series: Option<usize>, row: &[Value<'_>]) -> Fallible<()> {
        let mut rows = self.rows[kind as usize].take().unwrap_or_else(|| {
            Rows::new(kind.as_str(), &["run", "at_ns", "seq"], codec::table(kind).columns)
        });
        key.into_iter().for_each(|part| rows.push(part.into()));
        for value in row {
            rows.push(self.value(series, value)?);
        }
        rows.write_if_many(self.transaction)?;
        self.rows[kind as usize] = Some(rows);
        Ok(())
    }

    fn child_rows(
        &mut self,
        kind: Kind,
        key: [i64; 3],
        series: Option<usize>,
        children: &[Value<'_>],
    ) -> Fallible<()> {
        let Some((table, columns)) = codec::table(kind).children else { return Ok(()) };
        let mut rows = self.children[kind as usize]
            .take()
            .unwrap_or_else(|| Rows::new(table, &["run", "at_ns", "seq", "place"], columns));
        for (child, place) in children.chunks(columns.len()).zip(0_i64..) {
            key.into_iter().chain([place]).for_each(|part| rows.push(part.into()));
            for value in child {
                rows.push(self.value(None, value)?);
            }
            if let Some((name, figure)) = chunk::of_child(kind, child) {
                let of = self.name(name)?;
                if let Some(chunk) = series.and_then(|series| self.known.of_series[series].chunk.as_mut()) {
                    chunk.push_child(of, figure);
                }
            }
        }
        rows.write_if_many(self.transaction)?;
        self.children[kind as usize] = Some(rows);
        Ok(())
    }

    fn value(&mut self, series: Option<usize>, value: &Value<'_>) -> Fallible<Sql> {
        Ok(match value {
            Value::Null => Sql::Null,
            Value::Integer(n) => Sql::Integer(*n),
            Value::Real(x) => Sql::Real(*x),
            Value::Text(text) => Sql::Text(text.to_string()),
            Value::Name(name) => Sql::Integer(self.name(name)?),
            Value::Conditions(role, conditions) => {
                let series = series.expect("conditions are those of a link, which makes a series");
                Sql::Integer(self.conditions(series, *role, conditions)?)
            }
        })
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

    /// Where the series of an event is known, if it belongs to one.
    fn series(&mut self, event: &Event) -> Fallible<Option<usize>> {
        // Series are mostly sampled in turn.
        let guess = self.known.after_last;
        if self.known.of_series.get(guess).is_some_and(|known| known.series.holds(event)) {
            self.known.after_last = (guess + 1) % self.known.of_series.len();
            return Ok(Some(guess));
        }
        let Some(series) = Series::of(event) else { return Ok(None) };
        if let Some(place) = self.known.series.get(&series) {
            self.known.after_last = (place + 1) % self.known.of_series.len();
            return Ok(Some(*place));
        }
        let ids = match &series {
            Series::Robot(node) | Series::Radio(node) => [self.name(node.as_str())?, 0],
            Series::Link(link, direction) => [self.name(link.as_str())?, codec::direction_code(*direction)],
            Series::Placement(vnf) => [self.name(vnf.as_str())?, 0],
            Series::VirtualLink(from, to) => [self.name(from.as_str())?, self.name(to.as_str())?],
            Series::Sensor(robot, sensor) => [self.name(robot.as_str())?, self.name(sensor.as_str())?],
        };
        let place = self.known.of_series.len();
        self.known.of_series.push(KnownSeries {
            series: series.clone(),
            ids,
            presence: None,
            chunk: None,
            conditions: [const { None }; Role::COUNT],
        });
        self.known.series.insert(series, place);
        Ok(Some(place))
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
        let mut values = Vec::with_capacity(row.0.len());
        for value in &row.0 {
            values.push(self.value(None, value)?);
        }
        let sql = insert_into("conditions", codec::CONDITIONS, 1);
        let id = self.transaction.prepare_cached(&sql)?.insert(rusqlite::params_from_iter(values))?;
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
            // There is one if it was rolled up since.
            self.transaction
                .prepare_cached(
                    "INSERT OR IGNORE INTO chunk (run, kind, a, b, stretch, samples) VALUES (?1, ?2, ?3, ?4, ?5, ?6)",
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
