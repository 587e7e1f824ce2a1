//! Questions to SQLite. Each is one transaction, and so sees one state of the history.

use std::{
    cell::RefCell,
    collections::{BTreeMap, BTreeSet, HashMap},
    path::Path,
    sync::Arc,
};

use cotorra_graph::{Conditions, Event, Stamped, Timestamp};
use rusqlite::{
    CachedStatement, Connection, OpenFlags, OptionalExtension, Row, Rows,
    config::DbConfig,
    fallible_streaming_iterator::FallibleStreamingIterator,
    params,
    types::{FromSql, ValueRef},
};

use super::{BUSY, Fallible, engine_error, thin};
use crate::{
    chunk::{self, Part},
    codec::{self, ReadError, Source},
    error::{Error, Result},
    figure::Figure,
    kind::{Kind, Series},
    page::{Cursor, Page, PageRequest},
    retention::Retained,
    rolled::{self, Of, Reading},
    schema::STRETCH,
    store::{Gap, RunId, Selection, Span, not_rolled_up},
};

/// More conditions are not remembered.
const REMEMBERED: usize = 4096;

/// A connection that reads.
pub(crate) struct Reader {
    pub connection: Connection,
    history: Arc<str>,
    names: RefCell<HashMap<i64, Arc<str>>>,
    conditions: RefCell<HashMap<i64, Conditions>>,
}

/// Which rows of a kind, as SQL: all of them, or those of one series.
pub fn select(kind: Kind, series: bool) -> String {
    let table = kind.as_str();
    let columns = columns(kind, "e.");
    if !series {
        return format!(
            "SELECT e.at_ns, e.seq, {columns} FROM {table} e
             WHERE e.run = ?1 AND (e.at_ns, e.seq) > (?2, ?3) AND e.at_ns <= ?4
             ORDER BY e.at_ns, e.seq LIMIT ?5"
        );
    }
    // CROSS JOIN: stretch by stretch, in order. The unary plus keeps SQLite from beginning each stretch at the
    // cursor instead of the stretch's own beginning.
    let same: String = codec::table(kind)
        .series
        .iter()
        .zip(["a", "b"])
        .map(|(column, id)| format!(" AND e.{column} = p.{id}"))
        .collect();
    format!(
        "SELECT e.at_ns, e.seq, {columns} FROM presence p CROSS JOIN {table} e
         WHERE p.run = ?1 AND p.kind = ?6 AND p.a = ?7 AND p.b = ?8
           AND p.stretch >= ?2 / {STRETCH} AND p.stretch <= ?4 / {STRETCH}
           AND e.run = ?1 AND e.at_ns >= max(?2, p.stretch * {STRETCH})
           AND e.at_ns <= min(?4, p.stretch * {STRETCH} + {last}) AND (+e.at_ns, +e.seq) > (?2, ?3){same}
         ORDER BY p.stretch, e.at_ns, e.seq LIMIT ?5",
        last = STRETCH - 1,
    )
}

fn columns(kind: Kind, table: &str) -> String {
    let names = codec::table(kind).columns.iter().map(|column| format!("{table}{column}"));
    names.collect::<Vec<_>>().join(", ")
}

impl Reader {
    pub fn open(path: &Path, history: &Arc<str>) -> Result<Self> {
        let flags =
            OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_URI | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        let open = || -> Fallible<Connection> {
            let connection = Connection::open_with_flags(path, flags)?;
            connection.busy_timeout(BUSY)?;
            connection.set_prepared_statement_cache_capacity(64);
            // Plans that hold for all parameters: otherwise a new LIMIT has SQLite prepare the statement again.
            connection.set_db_config(DbConfig::SQLITE_DBCONFIG_ENABLE_QPSG, true)?;
            Ok(connection)
        };
        Ok(Self {
            connection: open().map_err(|e| engine_error(history, e))?,
            history: history.clone(),
            names: RefCell::default(),
            conditions: RefCell::default(),
        })
    }

    /// Asks within one transaction, of a run that exists.
    fn ask<T>(&self, run: RunId, question: impl FnOnce() -> std::result::Result<T, ReadError>) -> Result<T> {
        let engine = |e| engine_error(&self.history, e);
        let transaction = self.connection.unchecked_transaction().map_err(engine)?;
        let exists = transaction
            .prepare_cached("SELECT 1 FROM run WHERE id = ?1")
            .and_then(|mut statement| statement.exists([run.0]))
            .map_err(engine)?;
        if !exists {
            return Err(Error::NoSuchRun(run));
        }
        question().map_err(|error| match error {
            ReadError::Unreadable(detail) => Error::Corrupt { history: self.history.clone(), detail },
            ReadError::Engine(error) => error,
        })
    }

    fn engine<T>(&self, result: Fallible<T>) -> std::result::Result<T, ReadError> {
        result.map_err(|e| ReadError::Engine(engine_error(&self.history, e)))
    }

    pub fn events(
        &self,
        run: RunId,
        what: &Selection<'_>,
        span: Span,
        page: PageRequest,
    ) -> Result<Page<Stamped>> {
        self.ask(run, || {
            let (kinds, ids) = match what {
                Selection::Kinds(kinds) => (kinds.iter().copied().collect::<BTreeSet<_>>(), None),
                Selection::Series(series) => match self.ids(series)? {
                    Some(ids) => (BTreeSet::from([series.kind()]), Some(ids)),
                    None => return Ok(Page { items: Vec::new(), next: None }),
                },
            };
            self.merge(run, &kinds, ids, span, page)
        })
    }

    /// Merges the tables of several kinds, row by row, until the page is full.
    fn merge(
        &self,
        run: RunId,
        kinds: &BTreeSet<Kind>,
        ids: Option<[i64; 2]>,
        span: Span,
        page: PageRequest,
    ) -> std::result::Result<Page<Stamped>, ReadError> {
        let start = page.after.max(Some(Cursor::before(span.from))).unwrap_or(Cursor::before(0));
        let limit = page.size() as i64 + 1;
        let mut statements = Vec::with_capacity(kinds.len());
        for kind in kinds {
            let sql = select(*kind, ids.is_some());
            statements.push((*kind, self.engine(self.connection.prepare_cached(&sql))?));
        }
        let mut tables: Vec<(Kind, Rows<'_>)> = Vec::with_capacity(kinds.len());
        for (kind, statement) in &mut statements {
            let asked = match ids {
                None => statement.query(params![run.0, start.t, start.seq, span.until, limit]),
                Some([a, b]) => {
                    statement.query(params![run.0, start.t, start.seq, span.until, limit, *kind as i64, a, b])
                }
            };
            let mut rows = self.engine(asked)?;
            self.engine(rows.advance())?;
            tables.push((*kind, rows));
        }

        let mut found = Page { items: Vec::new(), next: None };
        let mut last = start;
        loop {
            let mut first: Option<(Cursor, usize)> = None;
            for (i, (_, rows)) in tables.iter().enumerate() {
                if let Some(row) = rows.get() {
                    let cursor = self.engine(cursor(row))?;
                    if first.is_none_or(|(least, _)| cursor < least) {
                        first = Some((cursor, i));
                    }
                }
            }
            let Some((cursor, i)) = first else { return Ok(found) };
            if found.items.len() == page.size() {
                found.next = Some(last);
                return Ok(found);
            }
            let (kind, rows) = &mut tables[i];
            let row = rows.get().expect("it was there a moment ago");
            found.items.push(self.stamped(run, *kind, cursor, row)?);
            last = cursor;
            self.engine(rows.advance())?;
        }
    }

    pub fn gaps(&self, run: RunId, span: Span, page: PageRequest) -> Result<Page<Gap>> {
        let start = page.after.max(Some(Cursor::before(span.from))).unwrap_or(Cursor::before(0));
        let ask = || -> Fallible<Page<Gap>> {
            let mut statement = self.connection.prepare_cached(
                "SELECT at_ns, seq, until_ns, events FROM gap
                 WHERE run = ?1 AND (at_ns, seq) > (?2, ?3) AND at_ns <= ?4 ORDER BY at_ns, seq LIMIT ?5",
            )?;
            let limit = page.size() as i64 + 1;
            let mut rows = statement.query(params![run.0, start.t, start.seq, span.until, limit])?;
            let mut found = Page { items: Vec::new(), next: None };
            let mut last = start;
            while let Some(row) = rows.next()? {
                if found.items.len() == page.size() {
                    found.next = Some(last);
                    break;
                }
                last = cursor(row)?;
                found.items.push(Gap {
                    from: timestamp(last.t),
                    until: timestamp(row.get(2)?),
                    events: row.get::<_, i64>(3)?.cast_unsigned(),
                });
            }
            Ok(found)
        };
        self.ask(run, || self.engine(ask()))
    }

    /// Looks each series up in the last stretch that it has, and goes through each such stretch once, backwards.
    pub fn latest(&self, run: RunId, at: i64) -> Result<Vec<Stamped>> {
        self.ask(run, || {
            let mut found = Vec::new();
            for kind in Series::KINDS {
                let mut stretches = self.engine(self.last_stretches(run, kind, at))?;
                while let Some((stretch, series)) = stretches.pop_last() {
                    let missing = self.last_in_stretch(run, kind, at, stretch, series, &mut found)?;
                    for ids in missing {
                        if let Some(earlier) = self.engine(self.stretch_before(run, kind, ids, stretch))? {
                            stretches.entry(earlier).or_default().insert(ids);
                        }
                    }
                }
            }
            Ok(found)
        })
    }

    /// All series of a kind by the last stretch, at a time or before, that they have.
    fn last_stretches(&self, run: RunId, kind: Kind, at: i64) -> Fallible<BTreeMap<i64, BTreeSet<[i64; 2]>>> {
        let mut stretches = BTreeMap::<i64, BTreeSet<[i64; 2]>>::new();
        // From series to series by the index, behind the last stretch that there can be: SQLite begins at the bound
        // itself, and would otherwise step through all stretches of the series before.
        let mut next = self.connection.prepare_cached(
            "SELECT a, b FROM presence WHERE run = ?1 AND kind = ?2 AND (a, b, stretch) > (?3, ?4, ?5)
             ORDER BY a, b, stretch LIMIT 1",
        )?;
        let mut ids = [i64::MIN; 2];
        while let Some(series) = next
            .query_row(params![run.0, kind as i64, ids[0], ids[1], i64::MAX], |row| {
                Ok([row.get(0)?, row.get(1)?])
            })
            .optional()?
        {
            ids = series;
            if let Some(stretch) = self.stretch_before(run, kind, ids, at / STRETCH + 1)? {
                stretches.entry(stretch).or_default().insert(ids);
            }
        }
        Ok(stretches)
    }

    fn stretch_before(
        &self,
        run: RunId,
        kind: Kind,
        [a, b]: [i64; 2],
        stretch: i64,
    ) -> Fallible<Option<i64>> {
        self.connection
            .prepare_cached(
                "SELECT stretch FROM presence WHERE run = ?1 AND kind = ?2 AND a = ?3 AND b = ?4 AND stretch < ?5
                 ORDER BY stretch DESC LIMIT 1",
            )?
            .query_row(params![run.0, kind as i64, a, b, stretch], |row| row.get(0))
            .optional()
    }

    /// Adds the last event of each wanted series in a stretch; gives back those that have none there at `at` or
    /// before.
    fn last_in_stretch(
        &self,
        run: RunId,
        kind: Kind,
        at: i64,
        stretch: i64,
        mut wanted: BTreeSet<[i64; 2]>,
        found: &mut Vec<Stamped>,
    ) -> std::result::Result<BTreeSet<[i64; 2]>, ReadError> {
        let sql = format!(
            "SELECT at_ns, seq, {} FROM {} WHERE run = ?1 AND at_ns >= ?2 AND at_ns <= ?3
             ORDER BY at_ns DESC, seq DESC",
            columns(kind, ""),
            kind.as_str(),
        );
        let from = stretch * STRETCH;
        let until = at.min(from.saturating_add(STRETCH - 1));
        let mut statement = self.engine(self.connection.prepare_cached(&sql))?;
        let mut rows = self.engine(statement.query(params![run.0, from, until]))?;
        let two = codec::table(kind).series.len() == 2;
        while !wanted.is_empty() {
            let Some(row) = self.engine(rows.next())? else { break };
            let ids = || -> Fallible<[i64; 2]> { Ok([row.get(2)?, if two { row.get(3)? } else { 0 }]) };
            if wanted.remove(&self.engine(ids())?) {
                let cursor = self.engine(cursor(row))?;
                found.push(self.stamped(run, kind, cursor, row)?);
            }
        }
        Ok(wanted)
    }

    /// The ids of a series as `presence` has them; `None` if a name was never recorded.
    fn ids(&self, series: &Series) -> std::result::Result<Option<[i64; 2]>, ReadError> {
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

    /// Stretch by stretch for what makes series, from its chunk where there is one.
    pub fn values(
        &self,
        run: RunId,
        figure: &Figure,
        span: Span,
        each: &mut dyn FnMut(i64, Reading),
    ) -> Result<()> {
        let kept = figure.kept();
        let sql = kept.sql("CROSS JOIN");
        let mut each = |t: i64, reading: Reading| {
            if (span.from..=span.until).contains(&t) && reading.is_number() {
                each(t, reading);
            }
        };
        self.ask(run, || {
            let mut named = Vec::new();
            for name in kept.named.iter().chain(&kept.child).map(|(_, name)| *name) {
                match self.id(name)? {
                    Some(id) => named.push(id),
                    None => return Ok(()),
                }
            }
            let mut statement = self.engine(self.connection.prepare_cached(&sql))?;
            let Some(series) = &kept.series else {
                let mut each = |t, value| each(t, Reading::Sample(value));
                return self.rows_of(&mut statement, [run.0, span.from, span.until, 0], &named, &mut each);
            };
            let Some(ids) = self.ids(series)? else { return Ok(()) };
            let width = codec::table(kept.kind).series.len();
            let named = [&ids[..width], &named].concat();
            let part = match kept.child {
                None => chunk::column(kept.kind, kept.column),
                Some(_) => named.last().map(|id| Part::children(kept.kind, *id)),
            };
            let of = match (part.and_then(Part::column), kept.child) {
                (Some(place), _) => Of::Column(place),
                (_, child) => Of::Child(child.map(|(_, name)| name.to_owned()).unwrap_or_default()),
            };
            let mut stretches = self.engine(self.connection.prepare_cached(
                "SELECT p.stretch, c.samples, r.next_seq, r.steps FROM presence p LEFT JOIN chunk c
                 ON c.run = p.run AND c.kind = p.kind AND c.a = p.a AND c.b = p.b AND c.stretch = p.stretch
                 LEFT JOIN rolled_up r
                 ON r.run = p.run AND r.kind = p.kind AND r.a = p.a AND r.b = p.b AND r.stretch = p.stretch
                 WHERE p.run = ?1 AND p.kind = ?2 AND p.a = ?3 AND p.b = ?4 AND p.stretch >= ?5 AND p.stretch <= ?6
                 ORDER BY p.stretch",
            ))?;
            let bounds = [span.from / STRETCH, span.until / STRETCH];
            let asked = params![run.0, kept.kind as i64, ids[0], ids[1], bounds[0], bounds[1]];
            let mut rows = self.engine(stretches.query(asked))?;
            while let Some(row) = self.engine(rows.next())? {
                let stretch: i64 = self.engine(row.get(0))?;
                let samples = self.engine(row.get_ref(1))?;
                let mut raw = |first, each: &mut dyn FnMut(i64, f64)| {
                    if let (Some(part), ValueRef::Blob(samples)) = (part, samples)
                        && chunk::read(samples, part, &mut *each)?
                    {
                        return Ok(());
                    }
                    let from = span.from.max(stretch * STRETCH);
                    let until = span.until.min((stretch * STRETCH).saturating_add(STRETCH - 1));
                    self.rows_of(&mut statement, [run.0, from, until, first], &named, each)
                };
                match self.engine(row.get_ref(3))? {
                    ValueRef::Blob(steps) => {
                        let first = self.engine(row.get(2))?;
                        rolled::merged(steps, &of, |each| raw(first, each), &mut each)?;
                    }
                    _ => raw(0, &mut |t, value| each(t, Reading::Sample(value)))?,
                }
            }
            Ok(())
        })
    }

    /// Times and figures that a statement finds.
    fn rows_of(
        &self,
        statement: &mut CachedStatement<'_>,
        of: [i64; 4],
        named: &[i64],
        each: &mut dyn FnMut(i64, f64),
    ) -> std::result::Result<(), ReadError> {
        let mut ask = || -> Fallible<()> {
            let mut rows = statement.query(rusqlite::params_from_iter(of.iter().chain(named)))?;
            while let Some(row) = rows.next()? {
                let value = match row.get_ref(1)? {
                    ValueRef::Integer(n) => n as f64,
                    _ => row.get(1)?,
                };
                each(row.get(0)?, value);
            }
            Ok(())
        };
        self.engine(ask())
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
        let sql = format!(
            "SELECT e.at_ns, e.seq, {} FROM {} e WHERE e.run = ?1 AND (e.at_ns, e.seq) > (?2, ?3) AND e.at_ns <= ?4{}
             ORDER BY e.at_ns, e.seq LIMIT ?5",
            columns(kind, "e."),
            kind.as_str(),
            if raw { not_rolled_up(kind, "/") } else { String::new() },
        );
        self.ask(run, || {
            let mut statement = self.engine(self.connection.prepare_cached(&sql))?;
            let asked = params![run.0, after.t, after.seq, span.until, limit as i64];
            let mut rows = self.engine(statement.query(asked))?;
            let mut found = Vec::new();
            while let Some(row) = self.engine(rows.next())? {
                let cursor = self.engine(cursor(row))?;
                found.push((cursor, self.stamped(run, kind, cursor, row)?.event));
            }
            Ok(found)
        })
    }

    /// How far samples of a run were rolled up.
    pub fn retained(&self, run: RunId) -> Result<Vec<Retained>> {
        self.ask(run, || self.engine(thin::retained(&self.connection, run)))
    }

    pub fn extent(&self, run: RunId, kind: Kind, span: Span) -> Result<Option<(i64, i64)>> {
        self.ask(run, || {
            let one = |order: &str| {
                let sql = format!(
                    "SELECT at_ns FROM {} WHERE run = ?1 AND at_ns >= ?2 AND at_ns <= ?3 ORDER BY at_ns {order} LIMIT 1",
                    kind.as_str(),
                );
                let ask = |mut statement: CachedStatement<'_>| {
                    statement.query_row(params![run.0, span.from, span.until], |row| row.get(0)).optional()
                };
                self.engine(self.connection.prepare_cached(&sql).and_then(ask))
            };
            Ok(one("ASC")?.zip(one("DESC")?))
        })
    }

    fn id(&self, name: &str) -> std::result::Result<Option<i64>, ReadError> {
        let ask = || {
            self.connection
                .prepare_cached("SELECT id FROM name WHERE text = ?1")?
                .query_row([name], |row| row.get::<_, i64>(0))
                .optional()
        };
        self.engine(ask())
    }

    fn stamped(
        &self,
        run: RunId,
        kind: Kind,
        cursor: Cursor,
        row: &Row<'_>,
    ) -> std::result::Result<Stamped, ReadError> {
        let mut source = RowSource { reader: self, row, column: 2, kind, key: [run.0, cursor.t, cursor.seq] };
        Ok(Stamped { at: timestamp(cursor.t), event: codec::decode(kind, &mut source)? })
    }

    fn name(&self, id: i64) -> Fallible<Arc<str>> {
        if let Some(name) = self.names.borrow().get(&id) {
            return Ok(name.clone());
        }
        let name: Arc<str> = self
            .connection
            .prepare_cached("SELECT text FROM name WHERE id = ?1")?
            .query_row([id], |row| row.get(0))?;
        self.names.borrow_mut().insert(id, name.clone());
        Ok(name)
    }

    fn conditions(&self, id: i64) -> std::result::Result<Conditions, ReadError> {
        if let Some(conditions) = self.conditions.borrow().get(&id) {
            return Ok(conditions.clone());
        }
        let sql = format!("SELECT {} FROM conditions WHERE id = ?1", codec::CONDITIONS.join(", "));
        let mut statement = self.engine(self.connection.prepare_cached(&sql))?;
        let mut rows = self.engine(statement.query([id]))?;
        let row = self.engine(rows.next())?;
        let row = row.ok_or_else(|| ReadError::Unreadable(format!("there are no conditions {id}")))?;
        let mut source = RowSource { reader: self, row, column: 0, kind: Kind::Link, key: [0; 3] };
        let conditions = codec::decode_conditions(&mut source)?;
        let mut remembered = self.conditions.borrow_mut();
        if remembered.len() >= REMEMBERED {
            remembered.clear();
        }
        remembered.insert(id, conditions.clone());
        Ok(conditions)
    }
}

fn cursor(row: &Row<'_>) -> Fallible<Cursor> {
    Ok(Cursor { t: row.get(0)?, seq: row.get(1)? })
}

fn timestamp(t: i64) -> Timestamp {
    Timestamp::from_nanos(t.cast_unsigned())
}

/// A row that is read column by column.
struct RowSource<'r> {
    reader: &'r Reader,
    row: &'r Row<'r>,
    column: usize,
    kind: Kind,
    key: [i64; 3],
}

impl RowSource<'_> {
    fn next<T: FromSql>(&mut self) -> std::result::Result<T, ReadError> {
        let value = self.reader.engine(self.row.get(self.column))?;
        self.column += 1;
        Ok(value)
    }
}

impl Source for RowSource<'_> {
    fn integer(&mut self) -> std::result::Result<Option<i64>, ReadError> {
        self.next()
    }

    fn real(&mut self) -> std::result::Result<Option<f64>, ReadError> {
        self.next()
    }

    fn text(&mut self) -> std::result::Result<Option<String>, ReadError> {
        self.next()
    }

    fn name(&mut self) -> std::result::Result<Option<Arc<str>>, ReadError> {
        let Some(id) = self.integer()? else { return Ok(None) };
        self.reader.engine(self.reader.name(id)).map(Some)
    }

    fn conditions(&mut self) -> std::result::Result<Conditions, ReadError> {
        let id = self.next()?;
        self.reader.conditions(id)
    }

    fn children(
        &mut self,
        read: &mut dyn FnMut(&mut dyn Source) -> std::result::Result<(), ReadError>,
    ) -> std::result::Result<(), ReadError> {
        let Some((table, columns)) = codec::table(self.kind).children else { return Ok(()) };
        let sql = format!(
            "SELECT {} FROM {table} WHERE run = ?1 AND at_ns = ?2 AND seq = ?3 ORDER BY place",
            columns.join(", "),
        );
        let reader = self.reader;
        let mut statement = reader.engine(reader.connection.prepare_cached(&sql))?;
        let mut rows = reader.engine(statement.query(self.key))?;
        while let Some(row) = reader.engine(rows.next())? {
            read(&mut RowSource { reader, row, column: 0, kind: self.kind, key: self.key })?;
        }
        Ok(())
    }
}
