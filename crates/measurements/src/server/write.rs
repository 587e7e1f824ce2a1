//! Batches into a server: rows are gathered by table, and each table gets inserts of many rows, all in one
//! transaction. Names and conditions are written once, by themselves, and then referred to: nobody waits for the
//! transaction of another process because both met the same new name.

use std::collections::{BTreeMap, HashMap};

use cotorra_graph::Conditions;
use mysql::{Conn, Params, TxOpts, Value as Sql, prelude::Queryable};

use super::connection::{Fallible, columns, quoted};
use crate::{
    chunk::{self, Chunk, has_chunks},
    codec::{self, Fields, Role, Value},
    kind::{Kind, Series},
    schema::STRETCH,
    store::{Entry, Gap, RunId},
};

/// More is not remembered; what was forgotten is looked up again.
const REMEMBERED: usize = 100_000;

/// Values in one insert, about: more buys nothing, and no server takes more than 65,535.
const VALUES: usize = 8192;

/// Memory that is kept between batches, values of each table.
const KEPT: usize = 1 << 18;

/// Why a batch was not taken.
#[derive(Debug)]
pub(super) enum Failure {
    Engine(mysql::Error),
    NoSuchRun(RunId),
}

impl From<mysql::Error> for Failure {
    fn from(error: mysql::Error) -> Self {
        Self::Engine(error)
    }
}

/// Which batch of which process this is, so that none is taken in twice.
#[derive(Debug, Clone, Copy)]
pub(super) struct Receipt<'a> {
    pub writer: &'a str,
    pub batch: u64,
}

/// The connection that writes, and what it knows is in the database.
pub(super) struct Writer {
    pub connection: Conn,
    known: Known,
    /// By kind; what was in them is gone after each batch, their memory stays.
    rows: [Vec<Sql>; Kind::ALL.len()],
    children: [Vec<Sql>; Kind::ALL.len()],
    presence: Vec<Sql>,
    chunks: Vec<Sql>,
    gaps: Vec<Sql>,
}

/// What is in the database for certain.
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

/// Numbers the events of a batch by run, from 0; the runs' own counters are added when the transaction has them.
type Counters = BTreeMap<RunId, i64>;

fn next(counters: &mut Counters, run: RunId) -> i64 {
    let counter = counters.entry(run).or_insert(0);
    *counter += 1;
    *counter - 1
}

impl Writer {
    pub fn new(connection: Conn) -> Self {
        Self {
            connection,
            known: Known::default(),
            rows: [const { Vec::new() }; Kind::ALL.len()],
            children: [const { Vec::new() }; Kind::ALL.len()],
            presence: Vec::new(),
            chunks: Vec::new(),
            gaps: Vec::new(),
        }
    }

    /// Appends all or nothing.
    pub fn append(
        &mut self,
        events: &[Entry],
        gaps: &[(RunId, Gap)],
        receipt: Receipt<'_>,
    ) -> Result<(), Failure> {
        let outcome = self.try_append(events, gaps, receipt);
        for rows in self.rows.iter_mut().chain(&mut self.children).chain([
            &mut self.presence,
            &mut self.chunks,
            &mut self.gaps,
        ]) {
            rows.clear();
            rows.shrink_to(KEPT);
        }
        if outcome.is_err() {
            // Their stretches were rolled back, or may have been.
            for series in &mut self.known.of_series {
                (series.presence, series.chunk) = (None, None);
            }
        }
        outcome
    }

    fn try_append(
        &mut self,
        events: &[Entry],
        gaps: &[(RunId, Gap)],
        receipt: Receipt<'_>,
    ) -> Result<(), Failure> {
        if self.known.names.len().max(self.known.series.len()) > REMEMBERED {
            self.known = Known::default();
        }
        let mut counters = Counters::new();
        self.encode(events, &mut counters)?;
        let clamp = |t: cotorra_graph::Timestamp| i64::try_from(t.as_nanos()).unwrap_or(i64::MAX);
        for (run, gap) in gaps {
            let seq = next(&mut counters, *run);
            let row = [run.0, clamp(gap.from), seq, clamp(gap.until), gap.events.cast_signed()];
            self.gaps.extend(row.map(Sql::Int));
        }

        let mut transaction = self.connection.start_transaction(TxOpts::default())?;
        let mut chunks_hold = true;
        for (run, counter) in &mut counters {
            // Locks the run's row, so that processes which record the same run take turns.
            let found: Option<i64> =
                transaction.exec_first("SELECT next_seq FROM run WHERE id = ? FOR UPDATE", (run.0,))?;
            let first = found.ok_or(Failure::NoSuchRun(*run))?;
            let left = self.known.next_seq.insert(*run, first + *counter);
            chunks_hold &= left.is_none_or(|left| left == first);
            transaction.exec_drop("UPDATE run SET next_seq = ? WHERE id = ?", (first + *counter, run.0))?;
            *counter = first;
        }
        for kind in Kind::ALL {
            let table = codec::table(kind);
            let key = [&["run", "at_ns", "seq"], table.columns].concat();
            insert(&mut transaction, kind.as_str(), &key, &mut self.rows[kind as usize], &counters)?;
            if let Some((name, its)) = table.children {
                let key = [&["run", "at_ns", "seq", "place"], its].concat();
                insert(&mut transaction, name, &key, &mut self.children[kind as usize], &counters)?;
            }
        }
        let key = ["run", "at_ns", "seq", "until_ns", "events"];
        insert(&mut transaction, "gap", &key, &mut self.gaps, &counters)?;
        let key = ["run", "kind", "a", "b", "stretch"];
        let noted = self.presence.clone();
        let news = insert(&mut transaction, "presence", &key, &mut self.presence, &Counters::new())?;
        if news < (noted.len() / key.len()) as u64 {
            // Some have samples that are not known here, and chunks that will not hold those of this batch.
            chunks_hold = false;
            for stretch in noted.chunks(key.len()) {
                let gone = "DELETE FROM chunk WHERE run = ? AND kind = ? AND a = ? AND b = ? AND stretch = ?";
                transaction.exec_drop(gone, Params::Positional(stretch.to_vec()))?;
            }
        }
        if chunks_hold {
            let key = ["run", "kind", "a", "b", "stretch", "samples"];
            insert(&mut transaction, "chunk", &key, &mut self.chunks, &Counters::new())?;
        } else {
            self.known.of_series.iter_mut().for_each(|series| series.chunk = None);
        }
        transaction.exec_drop(
            "INSERT INTO spool (writer, batches) VALUES (?, ?) ON DUPLICATE KEY UPDATE batches = VALUES(batches)",
            (receipt.writer, receipt.batch),
        )?;
        Ok(transaction.commit()?)
    }

    fn encode(&mut self, events: &[Entry], counters: &mut Counters) -> Fallible<()> {
        let (mut row, mut children) = (Fields::default(), Fields::default());
        for Entry { run, stamped } in events {
            row.0.clear();
            children.0.clear();
            codec::encode(&stamped.event, &mut row, &mut children);
            let kind = Kind::of(&stamped.event);
            let table = codec::table(kind);
            let t = stamped.at.as_nanos().cast_signed();
            let key = [run.0, t, next(counters, *run)].map(Sql::Int);
            let series = match Series::of(&stamped.event) {
                None => None,
                Some(series) => Some(self.series(series)?),
            };
            if let Some(series) = series {
                self.note_presence(kind, *run, t, series);
            }
            if let Some(chunk) = series.and_then(|series| self.known.of_series[series].chunk.as_mut()) {
                chunk.push(kind, t, &row.0);
            }
            self.rows[kind as usize].extend(key.iter().cloned());
            for value in &row.0 {
                let value = self.value(value, series)?;
                self.rows[kind as usize].push(value);
            }
            let Some((_, columns)) = table.children else { continue };
            for (child, place) in children.0.chunks(columns.len()).zip(0..) {
                let rows = &mut self.children[kind as usize];
                rows.extend(key.iter().cloned());
                rows.push(Sql::Int(place));
                for value in child {
                    let value = self.value(value, None)?;
                    self.children[kind as usize].push(value);
                }
                if let Some((name, figure)) = chunk::of_child(kind, child) {
                    let of = self.name(name)?;
                    if let Some(chunk) = series.and_then(|series| self.known.of_series[series].chunk.as_mut())
                    {
                        chunk.push_child(of, figure);
                    }
                }
            }
        }
        Ok(())
    }

    fn value(&mut self, value: &Value<'_>, series: Option<usize>) -> Fallible<Sql> {
        Ok(match value {
            Value::Null => Sql::NULL,
            Value::Integer(n) => Sql::Int(*n),
            Value::Real(x) if x.is_nan() => Sql::NULL,
            // A server has no word for the infinite; see `read::real`.
            Value::Real(x) => Sql::Double(x.clamp(f64::MIN, f64::MAX)),
            Value::Text(text) => Sql::Bytes(text.as_bytes().to_vec()),
            Value::Name(name) => Sql::Int(self.name(name)?),
            Value::Conditions(role, conditions) => {
                let series = series.expect("conditions are those of a link, which makes a series");
                Sql::Int(self.conditions(series, *role, conditions)?)
            }
        })
    }

    fn name(&mut self, name: &str) -> Fallible<i64> {
        if let Some(id) = self.known.names.get(name) {
            return Ok(*id);
        }
        let find = "SELECT id FROM name WHERE text = ?";
        let found = self.connection.exec_first(find, (name,))?;
        let id = match found {
            Some(id) => id,
            None => {
                // Another process may have been faster: then this gives the id of its row.
                self.connection.exec_drop(
                    "INSERT INTO name (text) VALUES (?) ON DUPLICATE KEY UPDATE id = LAST_INSERT_ID(id)",
                    (name,),
                )?;
                self.connection.last_insert_id().cast_signed()
            }
        };
        self.known.names.insert(name.into(), id);
        Ok(id)
    }

    /// Where a series is known.
    fn series(&mut self, series: Series) -> Fallible<usize> {
        if let Some(place) = self.known.series.get(&series) {
            return Ok(*place);
        }
        let ids = match &series {
            Series::Robot(node) | Series::Radio(node) => [self.name(node.as_str())?, 0],
            Series::Link(link, direction) => [self.name(link.as_str())?, codec::direction_code(*direction)],
            Series::Placement(vnf) => [self.name(vnf.as_str())?, 0],
            Series::VirtualLink(from, to) => [self.name(from.as_str())?, self.name(to.as_str())?],
            Series::Sensor(robot, sensor) => [self.name(robot.as_str())?, self.name(sensor.as_str())?],
        };
        let place = self.known.of_series.len();
        let conditions = [const { None }; Role::COUNT];
        self.known.of_series.push(KnownSeries { ids, presence: None, chunk: None, conditions });
        self.known.series.insert(series, place);
        Ok(place)
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
            values.push(self.value(value, None)?);
        }
        self.connection
            .exec_drop(inserting("conditions", codec::CONDITIONS, 1), Params::Positional(values))?;
        let id = self.connection.last_insert_id().cast_signed();
        self.known.of_series[series].conditions[role as usize] = Some((conditions.clone(), id));
        Ok(id)
    }

    /// Notes that a series has a sample in a stretch, unless that is known; packs the chunk of the one before.
    fn note_presence(&mut self, kind: Kind, run: RunId, t: i64, series: usize) {
        let known = &mut self.known.of_series[series];
        let stretch = t / STRETCH;
        let before = known.presence.replace((run, stretch));
        if before == Some((run, stretch)) {
            return;
        }
        let [a, b] = known.ids;
        if let Some((run, stretch)) = before
            && let Some(chunk) = known.chunk.take().and_then(|chunk| chunk.finish(kind))
        {
            self.chunks.extend([run.0, kind as i64, a, b, stretch].map(Sql::Int));
            self.chunks.push(Sql::Bytes(chunk));
        }
        // Whether all of its samples are known here is found out when the stretch is noted.
        known.chunk = has_chunks(kind).then(Chunk::default);
        self.presence.extend([run.0, kind as i64, a, b, stretch].map(Sql::Int));
    }
}

/// Inserts rows, many at a time, and says how many; the third value of each is its number, to which its run's counter
/// is added.
fn insert(
    transaction: &mut mysql::Transaction<'_>,
    table: &str,
    names: &[&str],
    rows: &mut Vec<Sql>,
    counters: &Counters,
) -> Fallible<u64> {
    let width = names.len();
    let mut inserted = 0;
    if !counters.is_empty() {
        for row in rows.chunks_exact_mut(width) {
            if let [Sql::Int(run), _, Sql::Int(seq), ..] = row {
                *seq += counters[&RunId(*run)];
            }
        }
    }
    // A few sizes only, powers of two, as each is a statement that the session keeps prepared.
    let most = (VALUES / width).max(1).ilog2();
    let mut left = rows.drain(..);
    while left.len() > 0 {
        let count = 1 << (left.len() / width).ilog2().min(most);
        let values: Vec<Sql> = left.by_ref().take(count * width).collect();
        transaction.exec_drop(inserting(table, names, count), Params::Positional(values))?;
        inserted += transaction.affected_rows();
    }
    Ok(inserted)
}

fn inserting(table: &str, names: &[&str], rows: usize) -> String {
    let row = format!("({})", vec!["?"; names.len()].join(", "));
    // What is noted of a stretch may be noted already, and be rolled up since.
    let verb = if matches!(table, "presence" | "chunk") { "INSERT IGNORE" } else { "INSERT" };
    format!(
        "{verb} INTO {} ({}) VALUES {}",
        quoted(table),
        columns(names),
        vec![row.as_str(); rows].join(", ")
    )
}
