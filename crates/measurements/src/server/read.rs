//! Questions to a server. Each is one transaction that only reads, and so sees one state of the history. A question
//! takes a handful of round trips, whatever the number of rows.

use std::{
    cell::RefCell,
    collections::{BTreeMap, BTreeSet, HashMap},
    sync::Arc,
};

use cotorra_graph::{Conditions, Event, Stamped, Timestamp};
use mysql::{Conn, Params, Row, Value as Sql, prelude::Queryable};

use super::{
    connection::{Fallible, columns, engine_error, quoted},
    thin,
};
use crate::{
    chunk::{self, Part},
    codec::{self, ReadError, Source},
    error::{Error, Result},
    figure::Figure,
    kind::{Kind, Series},
    page::{Cursor, Page, PageRequest},
    retention::{Retained, Thinned},
    rolled::{self, Of, Reading},
    schema::STRETCH,
    store::{Gap, RunId, Selection, Span, not_rolled_up, tables_of_runs},
};

/// More names or conditions are not remembered.
const REMEMBERED: usize = 100_000;

/// Names and conditions that are fetched with one that is needed: those written after it are likely needed next.
const AHEAD: u64 = 200;

/// Rows whose child rows are fetched in one question.
const PARENTS: usize = 256;

/// Stretches that are asked for at a time.
const STRETCHES: u64 = 256;

type Answer<T> = std::result::Result<T, ReadError>;

/// A connection that reads.
pub(super) struct Reader {
    connection: RefCell<Conn>,
    history: Arc<str>,
    names: RefCell<HashMap<i64, Arc<str>>>,
    conditions: RefCell<HashMap<i64, Conditions>>,
}

/// A row of a kind and where it belongs.
type Found = (Cursor, Kind, Row);

impl Reader {
    pub fn new(connection: Conn, history: &Arc<str>) -> Self {
        Self {
            connection: RefCell::new(connection),
            history: history.clone(),
            names: RefCell::default(),
            conditions: RefCell::default(),
        }
    }

    fn engine<T>(&self, result: Fallible<T>) -> Answer<T> {
        result.map_err(|e| ReadError::Engine(engine_error(&self.history, e)))
    }

    /// Rows that a statement finds.
    pub fn rows(&self, sql: impl AsRef<str>, parameters: impl Into<Params>) -> Answer<Vec<Row>> {
        let mut connection = self.connection.borrow_mut();
        self.engine(connection.prep(sql).and_then(|statement| connection.exec(statement, parameters)))
    }

    /// Asks within one transaction.
    pub fn ask<T>(&self, question: impl FnOnce() -> Answer<T>) -> Result<T> {
        let say = |sql: &str| self.engine(self.connection.borrow_mut().query_drop(sql));
        let begin = || say("START TRANSACTION WITH CONSISTENT SNAPSHOT, READ ONLY");
        let end = || say("COMMIT");
        let answer = begin().and_then(|()| question()).and_then(|answer| end().map(|()| answer));
        answer.map_err(|error| match error {
            ReadError::Unreadable(detail) => Error::Corrupt { history: self.history.clone(), detail },
            ReadError::Engine(error) => error,
        })
    }

    /// Asks of a run that exists.
    fn ask_of<T>(&self, run: RunId, question: impl FnOnce() -> Answer<T>) -> Result<T> {
        self.ask(|| {
            if self.rows("SELECT 1 FROM run WHERE id = ?", (run.0,))?.is_empty() {
                return Err(ReadError::Engine(Error::NoSuchRun(run)));
            }
            question()
        })
    }

    pub fn events(
        &self,
        run: RunId,
        what: &Selection<'_>,
        span: Span,
        page: PageRequest,
    ) -> Result<Page<Stamped>> {
        let after = page.after.max(Some(Cursor::before(span.from))).unwrap_or(Cursor::before(0));
        self.ask_of(run, || {
            let mut found: Vec<Found> = Vec::new();
            match what {
                Selection::Kinds(kinds) => {
                    for kind in kinds.iter().copied().collect::<BTreeSet<_>>() {
                        let select = Select { kind, series: None, until: span.until, limit: page.size() + 1 };
                        found.extend(self.select(run, &select, after)?);
                    }
                    found.sort_by_key(|(cursor, ..)| *cursor);
                }
                Selection::Series(series) => {
                    if let Some(ids) = self.ids(series)? {
                        found = self.series(run, series.kind(), ids, after, span.until, page.size() + 1)?;
                    }
                }
            }
            let more = found.len() > page.size();
            found.truncate(page.size());
            let next = if more { found.last().map(|(cursor, ..)| *cursor) } else { None };
            Ok(Page { items: self.decode(run, &found)?, next })
        })
    }

    /// Rows of one series. What finds them among the others is `presence`: each stretch of time without a break in
    /// it is one range of the table's key.
    fn series(
        &self,
        run: RunId,
        kind: Kind,
        ids: [i64; 2],
        mut after: Cursor,
        until: i64,
        limit: usize,
    ) -> Answer<Vec<Found>> {
        let mut found = Vec::new();
        self.stretches(run, kind, ids, after.t, until, |from, until| {
            after = after.max(Cursor::before(from));
            let select = Select { kind, series: Some(ids), until, limit: limit - found.len() };
            found.extend(self.select(run, &select, after)?);
            Ok(found.len() < limit)
        })?;
        Ok(found)
    }

    /// Calls `each` with the beginning and the end of every unbroken stretch of time in which a series has samples,
    /// until it says no.
    fn stretches(
        &self,
        run: RunId,
        kind: Kind,
        [a, b]: [i64; 2],
        from: i64,
        until: i64,
        mut each: impl FnMut(i64, i64) -> Answer<bool>,
    ) -> Answer<()> {
        let (mut next, last) = (from / STRETCH, until / STRETCH);
        loop {
            let rows = self.rows(
                "SELECT stretch FROM presence WHERE run = ? AND kind = ? AND a = ? AND b = ?
                 AND stretch >= ? AND stretch <= ? ORDER BY stretch LIMIT ?",
                (run.0, kind as i64, a, b, next, last, STRETCHES),
            )?;
            let stretches = rows.iter().map(|row| integer(row, 0)).collect::<Answer<Vec<_>>>()?;
            for unbroken in stretches.chunk_by(|a, b| a + 1 == *b) {
                let [first, last] = [unbroken[0], unbroken[unbroken.len() - 1]];
                let end = (last * STRETCH).saturating_add(STRETCH - 1);
                if !each(from.max(first * STRETCH), until.min(end))? {
                    return Ok(());
                }
            }
            match stretches.last() {
                Some(last) if stretches.len() as u64 == STRETCHES => next = last + 1,
                _ => return Ok(()),
            }
        }
    }

    /// Rows of a kind behind a cursor, in order.
    fn select(&self, run: RunId, select: &Select, after: Cursor) -> Answer<Vec<Found>> {
        let mut parameters = vec![run.0, after.t, after.t, after.seq, select.until];
        parameters.extend(select.series.iter().flatten().take(codec::table(select.kind).series.len()));
        parameters.push(select.limit as i64);
        let rows =
            self.rows(select.sql(), Params::Positional(parameters.into_iter().map(Sql::Int).collect()))?;
        rows.into_iter().map(|row| Ok((cursor(&row)?, select.kind, row))).collect()
    }

    pub fn gaps(&self, run: RunId, span: Span, page: PageRequest) -> Result<Page<Gap>> {
        let after = page.after.max(Some(Cursor::before(span.from))).unwrap_or(Cursor::before(0));
        self.ask_of(run, || {
            let rows = self.rows(
                "SELECT at_ns, seq, until_ns, events FROM gap WHERE run = ? AND at_ns >= ?
                 AND (at_ns > ? OR seq > ?) AND at_ns <= ? ORDER BY at_ns, seq LIMIT ?",
                (run.0, after.t, after.t, after.seq, span.until, page.size() + 1),
            )?;
            let gap = |row: &Row| {
                Ok(Gap {
                    from: timestamp(integer(row, 0)?),
                    until: timestamp(integer(row, 2)?),
                    events: integer(row, 3)?.cast_unsigned(),
                })
            };
            let page_of = &rows[..rows.len().min(page.size())];
            let next = if rows.len() > page.size() { page_of.last().map(cursor).transpose()? } else { None };
            Ok(Page { items: page_of.iter().map(gap).collect::<Answer<_>>()?, next })
        })
    }

    /// Stretch by stretch for what makes series, from its chunk where there is one.
    pub fn values(
        &self,
        run: RunId,
        figure: &Figure,
        span: Span,
        each: &mut dyn FnMut(i64, Reading),
    ) -> Result<()> {
        let kept = figure.kept();
        let sql = kept.sql("STRAIGHT_JOIN");
        let mut each = |t: i64, reading: Reading| {
            if (span.from..=span.until).contains(&t) && reading.is_number() {
                each(t, reading);
            }
        };
        self.ask_of(run, || {
            let mut named = Vec::new();
            for name in kept.named.iter().chain(&kept.child).map(|(_, name)| *name) {
                match self.id(name)? {
                    Some(id) => named.push(id),
                    None => return Ok(()),
                }
            }
            let Some(series) = &kept.series else {
                let mut each = |t, value| each(t, Reading::Sample(value));
                return self.rows_of(&sql, [run.0, span.from, span.until, 0], &named, &mut each);
            };
            let Some(ids) = self.ids(series)? else { return Ok(()) };
            let named = [&ids[..codec::table(kept.kind).series.len()], &named].concat();
            let part = match kept.child {
                None => chunk::column(kept.kind, kept.column),
                Some(_) => named.last().map(|id| Part::children(kept.kind, *id)),
            };
            let of = match (part.and_then(Part::column), kept.child) {
                (Some(place), _) => Of::Column(place),
                (_, child) => Of::Child(child.map(|(_, name)| name.to_owned()).unwrap_or_default()),
            };
            let mut next = span.from / STRETCH;
            loop {
                let stretches = self.rows(
                    "SELECT p.stretch, c.samples, r.next_seq, r.steps FROM presence p LEFT JOIN chunk c
                     ON c.run = p.run AND c.kind = p.kind AND c.a = p.a AND c.b = p.b AND c.stretch = p.stretch
                 LEFT JOIN rolled_up r
                 ON r.run = p.run AND r.kind = p.kind AND r.a = p.a AND r.b = p.b AND r.stretch = p.stretch
                     WHERE p.run = ? AND p.kind = ? AND p.a = ? AND p.b = ? AND p.stretch >= ? AND p.stretch <= ?
                     ORDER BY p.stretch LIMIT ?",
                    (run.0, kept.kind as i64, ids[0], ids[1], next, span.until / STRETCH, STRETCHES),
                )?;
                for row in &stretches {
                    let stretch = integer(row, 0)?;
                    next = stretch + 1;
                    let raw = |first, each: &mut dyn FnMut(i64, f64)| {
                        if let (Some(part), Some(Sql::Bytes(samples))) = (part, row.as_ref(1))
                            && chunk::read(samples, part, &mut *each)?
                        {
                            return Ok(());
                        }
                        let from = span.from.max(stretch * STRETCH);
                        let until = span.until.min((stretch * STRETCH).saturating_add(STRETCH - 1));
                        self.rows_of(&sql, [run.0, from, until, first], &named, each)
                    };
                    match row.as_ref(3) {
                        Some(Sql::Bytes(steps)) => {
                            let first = integer(row, 2)?;
                            rolled::merged(steps, &of, |each| raw(first, each), &mut each)?;
                        }
                        _ => raw(0, &mut |t, value| each(t, Reading::Sample(value)))?,
                    }
                }
                if (stretches.len() as u64) < STRETCHES {
                    return Ok(());
                }
            }
        })
    }

    /// Times and figures that a statement finds, one after the other.
    fn rows_of(&self, sql: &str, of: [i64; 4], named: &[i64], each: &mut dyn FnMut(i64, f64)) -> Answer<()> {
        let parameters = of.iter().chain(named).map(|n| Sql::Int(*n)).collect();
        let mut connection = self.connection.borrow_mut();
        for row in self.engine(connection.exec_iter(sql, Params::Positional(parameters)))? {
            let row = self.engine(row)?;
            let value = match row.as_ref(1) {
                Some(Sql::Int(n)) => Some(*n as f64),
                _ => real(&row, 1)?,
            };
            each(integer(&row, 0)?, value.unwrap_or(f64::NAN));
        }
        Ok(())
    }

    /// Samples of a kind, and where they belong; without those that rolled-up steps have, if `raw`.
    pub fn samples(
        &self,
        run: RunId,
        kind: Kind,
        span: Span,
        after: Cursor,
        limit: usize,
        raw: bool,
    ) -> Result<Vec<(Cursor, Event)>> {
        let names = codec::table(kind).columns.iter().map(|column| format!("e.{}", quoted(column)));
        let sql = format!(
            "SELECT e.at_ns, e.seq, {} FROM {} e WHERE e.run = ? AND e.at_ns >= ? AND (e.at_ns > ? OR e.seq > ?)
             AND e.at_ns <= ?{} ORDER BY e.at_ns, e.seq LIMIT ?",
            names.collect::<Vec<_>>().join(", "),
            quoted(kind.as_str()),
            if raw { not_rolled_up(kind, "DIV") } else { String::new() },
        );
        self.ask_of(run, || {
            let rows = self.rows(&sql, (run.0, after.t, after.t, after.seq, span.until, limit))?;
            let found =
                rows.into_iter().map(|row| Ok((cursor(&row)?, kind, row))).collect::<Answer<Vec<Found>>>()?;
            let events = self.decode(run, &found)?;
            let cursors = found.iter().map(|(cursor, ..)| *cursor);
            Ok(cursors.zip(events.into_iter().map(|stamped| stamped.event)).collect())
        })
    }

    /// Leaves of some series what they are thinned to.
    pub fn thin(&self, run: RunId, kind: Kind, thinned: &[Thinned]) -> Result<()> {
        let known = self.ask_of(run, || {
            let mut known = Vec::new();
            for its in thinned {
                if let Some(ids) = self.ids(&its.series)? {
                    known.push((its, ids));
                }
            }
            Ok(known)
        })?;
        thin::thin(&mut self.connection.borrow_mut(), run, kind, &known)
            .map_err(|e| engine_error(&self.history, e))
    }

    /// Removes a run.
    pub fn remove_run(&self, run: RunId) -> Result<()> {
        let mut connection = self.connection.borrow_mut();
        let mut remove = || -> Fallible<()> {
            // The run is last: what is stopped half-way can be done again.
            for table in tables_of_runs() {
                connection.exec_drop(format!("DELETE FROM {} WHERE run = ?", quoted(table)), (run.0,))?;
            }
            connection.exec_drop("DELETE FROM run WHERE id = ?", (run.0,))
        };
        remove().map_err(|e| engine_error(&self.history, e))
    }

    /// How far samples of a run were rolled up.
    pub fn retained(&self, run: RunId) -> Result<Vec<Retained>> {
        let sql =
            "SELECT kind, rolled_up_to_ns, step_ms, dropped_to_ns FROM retained WHERE run = ? ORDER BY kind";
        self.ask_of(run, || {
            let of = |row: &Row| {
                let step_ms = required(real(row, 2)?)?;
                Ok(Retained::of((integer(row, 0)?, integer(row, 1)?, step_ms, integer(row, 3)?)))
            };
            self.rows(sql, (run.0,))?.iter().filter_map(|row| of(row).transpose()).collect()
        })
    }

    /// Notes how far samples of a kind were rolled up.
    pub fn note_retained(&self, run: RunId, retained: &Retained) -> Result<()> {
        thin::note_retained(&mut self.connection.borrow_mut(), run, retained)
            .map_err(|e| engine_error(&self.history, e))
    }

    pub fn extent(&self, run: RunId, kind: Kind, span: Span) -> Result<Option<(i64, i64)>> {
        self.ask_of(run, || {
            let one = |order: &str| {
                let table = quoted(kind.as_str());
                let sql = format!(
                    "SELECT at_ns FROM {table} WHERE run = ? AND at_ns >= ? AND at_ns <= ? ORDER BY at_ns {order} LIMIT 1"
                );
                self.rows(sql, (run.0, span.from, span.until))?.first().map(|row| integer(row, 0)).transpose()
            };
            Ok(one("ASC")?.zip(one("DESC")?))
        })
    }

    /// Looks each series up in the last stretch that it has, and goes through each such stretch once, backwards.
    pub fn latest(&self, run: RunId, at: i64) -> Result<Vec<Stamped>> {
        self.ask_of(run, || {
            let mut found = Vec::new();
            for kind in Series::KINDS {
                let mut stretches = self.last_stretches(run, kind, at)?;
                while let Some((stretch, series)) = stretches.pop_last() {
                    let missing = self.last_in_stretch(run, kind, at, stretch, series, &mut found)?;
                    for [a, b] in missing {
                        let earlier = self.rows(
                            "SELECT stretch FROM presence WHERE run = ? AND kind = ? AND a = ? AND b = ?
                             AND stretch < ? ORDER BY stretch DESC LIMIT 1",
                            (run.0, kind as i64, a, b, stretch),
                        )?;
                        if let Some(earlier) = earlier.first() {
                            stretches.entry(integer(earlier, 0)?).or_default().insert([a, b]);
                        }
                    }
                }
            }
            self.decode(run, &found)
        })
    }

    /// All series of a kind by the last stretch, at a time or before, that they have.
    fn last_stretches(&self, run: RunId, kind: Kind, at: i64) -> Answer<BTreeMap<i64, BTreeSet<[i64; 2]>>> {
        let mut stretches = BTreeMap::<i64, BTreeSet<[i64; 2]>>::new();
        for row in self.rows(LAST_STRETCHES, (run.0, kind as i64, at / STRETCH))? {
            stretches.entry(integer(&row, 2)?).or_default().insert([integer(&row, 0)?, integer(&row, 1)?]);
        }
        Ok(stretches)
    }

    /// Adds the last row of each wanted series in a stretch; gives back those that have none there at `at` or
    /// before.
    fn last_in_stretch(
        &self,
        run: RunId,
        kind: Kind,
        at: i64,
        stretch: i64,
        mut wanted: BTreeSet<[i64; 2]>,
        found: &mut Vec<Found>,
    ) -> Answer<BTreeSet<[i64; 2]>> {
        let table = codec::table(kind);
        let sql = format!(
            "SELECT at_ns, seq, {} FROM {} WHERE run = ? AND at_ns >= ? AND at_ns <= ? AND (at_ns < ? OR seq < ?)
             ORDER BY at_ns DESC, seq DESC LIMIT ?",
            columns(table.columns),
            quoted(kind.as_str()),
        );
        let from = stretch * STRETCH;
        let mut before = Cursor { t: at.min(from.saturating_add(STRETCH - 1)), seq: i64::MAX };
        while !wanted.is_empty() {
            // Where all series are observed at the same times, this is all of them.
            let limit = 2 * wanted.len() as i64 + 16;
            let rows = self.rows(&sql, (run.0, from, before.t, before.t, before.seq, limit))?;
            let last = (rows.len() as i64) < limit;
            for row in rows {
                before = cursor(&row)?;
                let second = if table.series.len() == 2 { integer(&row, 3)? } else { 0 };
                if wanted.remove(&[integer(&row, 2)?, second]) {
                    found.push((before, kind, row));
                }
            }
            if last {
                break;
            }
        }
        Ok(wanted)
    }

    /// The ids of a series as `presence` has them; `None` if a name was never recorded.
    fn ids(&self, series: &Series) -> Answer<Option<[i64; 2]>> {
        let (a, b) = match series {
            Series::Robot(node) | Series::Radio(node) => (self.id(node.as_str())?, Some(0)),
            Series::Link(link, direction) => {
                (self.id(link.as_str())?, Some(codec::direction_code(*direction)))
            }
            Series::Placement(vnf) => (self.id(vnf.as_str())?, Some(0)),
            Series::VirtualLink(from, to) => (self.id(from.as_str())?, self.id(to.as_str())?),
            Series::Sensor(robot, sensor) => (self.id(robot.as_str())?, self.id(sensor.as_str())?),
        };
        Ok(a.zip(b).map(|(a, b)| [a, b]))
    }

    fn id(&self, name: &str) -> Answer<Option<i64>> {
        let rows = self.rows("SELECT id FROM name WHERE text = ?", (name,))?;
        rows.first().map(|row| integer(row, 0)).transpose()
    }

    /// Rows with their child rows into events.
    fn decode(&self, run: RunId, found: &[Found]) -> Answer<Vec<Stamped>> {
        let mut children: HashMap<Cursor, Vec<Row>> = HashMap::new();
        for kind in Kind::ALL {
            let Some((table, its)) = codec::table(kind).children else { continue };
            let parents: Vec<Cursor> =
                found.iter().filter(|(_, its, _)| *its == kind).map(|(cursor, ..)| *cursor).collect();
            for parents in parents.chunks(PARENTS) {
                // A few sizes only, powers of two, as each is a statement that the session keeps prepared.
                let places = parents.len().next_power_of_two();
                let sql = format!(
                    "SELECT at_ns, seq, {} FROM {} WHERE run = ? AND ({}) ORDER BY at_ns, seq, place",
                    columns(its),
                    quoted(table),
                    vec!["at_ns = ? AND seq = ?"; places].join(" OR "),
                );
                let last = parents[parents.len() - 1];
                let padding = std::iter::repeat_n(&last, places - parents.len());
                let keys = parents.iter().chain(padding).flat_map(|parent| [parent.t, parent.seq]);
                let parameters = std::iter::once(run.0).chain(keys).map(Sql::Int).collect();
                for row in self.rows(sql, Params::Positional(parameters))? {
                    children.entry(cursor(&row)?).or_default().push(row);
                }
            }
        }
        let event = |(cursor, kind, row): &Found| {
            let children = children.get(cursor).map_or(&[][..], Vec::as_slice);
            let mut source = RowSource { reader: self, row, column: 2, children };
            Ok(Stamped { at: timestamp(cursor.t), event: codec::decode(*kind, &mut source)? })
        };
        found.iter().map(event).collect()
    }

    fn name(&self, id: i64) -> Answer<Arc<str>> {
        if let Some(name) = self.names.borrow().get(&id) {
            return Ok(name.clone());
        }
        let rows = self.rows("SELECT id, text FROM name WHERE id >= ? ORDER BY id LIMIT ?", (id, AHEAD))?;
        let mut names = self.names.borrow_mut();
        if names.len() >= REMEMBERED {
            names.clear();
        }
        for row in rows {
            names.insert(integer(&row, 0)?, required(text(&row, 1)?)?.into());
        }
        names.get(&id).cloned().ok_or_else(|| ReadError::Unreadable(format!("there is no name {id}")))
    }

    fn conditions(&self, id: i64) -> Answer<Conditions> {
        if let Some(conditions) = self.conditions.borrow().get(&id) {
            return Ok(conditions.clone());
        }
        let columns = columns(codec::CONDITIONS);
        let sql = format!("SELECT id, {columns} FROM conditions WHERE id >= ? ORDER BY id LIMIT ?");
        let rows = self.rows(sql, (id, AHEAD))?;
        let mut remembered = self.conditions.borrow_mut();
        if remembered.len() >= REMEMBERED {
            remembered.clear();
        }
        for row in rows {
            let mut source = RowSource { reader: self, row: &row, column: 1, children: &[] };
            remembered.insert(integer(&row, 0)?, codec::decode_conditions(&mut source)?);
        }
        remembered
            .get(&id)
            .cloned()
            .ok_or_else(|| ReadError::Unreadable(format!("there are no conditions {id}")))
    }
}

/// The last stretch of each series of a kind. Grouped by all of the key, constant or not: MariaDB then takes one look
/// at the key for each series, and otherwise one for each stretch.
pub(super) const LAST_STRETCHES: &str = "SELECT a, b, max(stretch) FROM presence
     WHERE run = ? AND kind = ? AND stretch <= ? GROUP BY run, kind, a, b";

/// Which rows of a kind.
pub(super) struct Select {
    pub kind: Kind,
    pub series: Option<[i64; 2]>,
    pub until: i64,
    pub limit: usize,
}

impl Select {
    pub fn sql(&self) -> String {
        let table = codec::table(self.kind);
        let same: String = match self.series {
            Some(_) => table.series.iter().map(|column| format!(" AND {} = ?", quoted(column))).collect(),
            None => String::new(),
        };
        format!(
            "SELECT at_ns, seq, {} FROM {} WHERE run = ? AND at_ns >= ? AND (at_ns > ? OR seq > ?) AND at_ns <= ?{same}
             ORDER BY at_ns, seq LIMIT ?",
            columns(table.columns),
            quoted(self.kind.as_str()),
        )
    }
}

fn required<T>(value: Option<T>) -> Answer<T> {
    value.ok_or_else(|| ReadError::Unreadable("a column is NULL that never is".to_owned()))
}

fn mismatch(row: &Row, column: usize) -> ReadError {
    let name = row.columns_ref().get(column).map_or("?".into(), |column| column.name_str());
    ReadError::Unreadable(format!("column `{name}` is of another type than the schema says"))
}

fn optional_integer(row: &Row, column: usize) -> Answer<Option<i64>> {
    match row.as_ref(column) {
        Some(Sql::NULL) => Ok(None),
        Some(Sql::Int(n)) => Ok(Some(*n)),
        Some(Sql::UInt(n)) => Ok(Some(n.cast_signed())),
        _ => Err(mismatch(row, column)),
    }
}

pub(super) fn integer(row: &Row, column: usize) -> Answer<i64> {
    required(optional_integer(row, column)?)
}

/// A server has no word for the infinite; the largest numbers stand for it.
pub(super) fn real(row: &Row, column: usize) -> Answer<Option<f64>> {
    match row.as_ref(column) {
        Some(Sql::NULL) => Ok(None),
        Some(Sql::Double(f64::MAX)) => Ok(Some(f64::INFINITY)),
        Some(Sql::Double(f64::MIN)) => Ok(Some(f64::NEG_INFINITY)),
        Some(Sql::Double(x)) => Ok(Some(*x)),
        _ => Err(mismatch(row, column)),
    }
}

pub(super) fn text(row: &Row, column: usize) -> Answer<Option<String>> {
    match row.as_ref(column) {
        Some(Sql::NULL) => Ok(None),
        Some(Sql::Bytes(bytes)) => {
            String::from_utf8(bytes.clone()).map(Some).map_err(|_| mismatch(row, column))
        }
        _ => Err(mismatch(row, column)),
    }
}

fn cursor(row: &Row) -> Answer<Cursor> {
    Ok(Cursor { t: integer(row, 0)?, seq: integer(row, 1)? })
}

fn timestamp(t: i64) -> Timestamp {
    Timestamp::from_nanos(t.cast_unsigned())
}

/// A row that is read column by column.
struct RowSource<'r> {
    reader: &'r Reader,
    row: &'r Row,
    column: usize,
    children: &'r [Row],
}

impl RowSource<'_> {
    fn next(&mut self) -> usize {
        self.column += 1;
        self.column - 1
    }
}

impl Source for RowSource<'_> {
    fn integer(&mut self) -> Answer<Option<i64>> {
        let column = self.next();
        optional_integer(self.row, column)
    }

    fn real(&mut self) -> Answer<Option<f64>> {
        let column = self.next();
        real(self.row, column)
    }

    fn text(&mut self) -> Answer<Option<String>> {
        let column = self.next();
        text(self.row, column)
    }

    fn name(&mut self) -> Answer<Option<Arc<str>>> {
        let Some(id) = self.integer()? else { return Ok(None) };
        self.reader.name(id).map(Some)
    }

    fn conditions(&mut self) -> Answer<Conditions> {
        let id = required(self.integer()?)?;
        self.reader.conditions(id)
    }

    fn children(&mut self, read: &mut dyn FnMut(&mut dyn Source) -> Answer<()>) -> Answer<()> {
        for row in self.children {
            read(&mut RowSource { reader: self.reader, row, column: 2, children: &[] })?;
        }
        Ok(())
    }
}
