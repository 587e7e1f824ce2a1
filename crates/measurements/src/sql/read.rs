//! Questions to a history. Each is one transaction that only reads, and so sees one state of the history. A server answers
//! each in a handful of round trips, whatever the number of rows.

use std::{
    cell::RefCell,
    collections::{BTreeMap, BTreeSet, HashMap, VecDeque},
    fmt::Write as _,
    sync::Arc,
};

use cotorra_graph::{
    Conditions, Event, Figure, Stamped, Timestamp,
    record::{self, SeriesPart},
};

use super::session::{
    Cell, Row, Session, blob, column_list, integer, integers, optional_integer, quoted, real, required, text,
};
use crate::{
    chunk::{self, Part},
    codec::{self, Columns, Heard, ReadError, Source},
    error::{Error, Result},
    figure::{Kept, kept},
    kind::{Kind, Series},
    page::{Cursor, Page, PageRequest},
    retention::Retained,
    rolled::{self, FigureKey, Reading},
    run::{Gap, Run, RunId, RunInfo},
    schema::STRETCH,
    store::{Selection, Span},
};

/// Most names, and most conditions, that are remembered.
const REMEMBERED: usize = 100_000;

/// Stretches that are asked for at a time.
const STRETCHES: i64 = 256;

type Answer<T> = std::result::Result<T, ReadError>;

/// A connection that reads.
pub(crate) struct Reader<S> {
    pub session: S,
    names: RefCell<HashMap<i64, Arc<str>>>,
    conditions: RefCell<HashMap<i64, Conditions>>,
    heard: RefCell<HashMap<i64, Heard>>,
}

/// A row of a kind, and its place in the order of events.
type Found = (Cursor, Kind, Row);

impl<S: Session> Reader<S> {
    pub fn new(session: S) -> Self {
        Self { session, names: RefCell::default(), conditions: RefCell::default(), heard: RefCell::default() }
    }

    fn rows(&self, sql: &str, parameters: &[Cell]) -> Answer<Vec<Row>> {
        Ok(self.session.rows(sql, parameters)?)
    }

    /// Answers a question within one transaction. After an error the connection must not be used again.
    fn ask<T>(&self, question: impl FnOnce() -> Answer<T>) -> Result<T> {
        self.session.run(S::DIALECT.begin_reading)?;
        let answer = question().map_err(|error| error.of(self.session.history()))?;
        self.session.run("COMMIT")?;
        Ok(answer)
    }

    /// Answers a question about a run that exists.
    fn ask_of<T>(&self, run: RunId, question: impl FnOnce() -> Answer<T>) -> Result<T> {
        self.ask(|| {
            if self.rows("SELECT 1 FROM run WHERE id = ?", &integers([run.0]))?.is_empty() {
                return Err(Error::NoSuchRun(run).into());
            }
            question()
        })
    }

    /// Returns one run.
    pub fn run(&self, run: RunId) -> Result<Run> {
        let found = self.ask(|| {
            let rows = self.rows(&format!("{RUN} WHERE id = ?"), &integers([run.0]))?;
            rows.first().map(|row| read_run(row)).transpose()
        })?;
        found.ok_or(Error::NoSuchRun(run))
    }

    /// Returns runs after a given one, oldest first.
    pub fn runs(&self, after: Option<RunId>, limit: usize) -> Result<Vec<Run>> {
        let parameters = integers([after.map_or(0, |run| run.0), limit as i64]);
        self.ask(|| {
            let rows = self.rows(&format!("{RUN} WHERE id > ? ORDER BY id LIMIT ?"), &parameters)?;
            rows.iter().map(|row| read_run(row)).collect()
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
        let limit = page.size() + 1;
        self.ask_of(run, || {
            let mut found = match what {
                Selection::Kinds(kinds) => self.merged(run, kinds, after, span.until, limit)?,
                Selection::Series(series) => match self.ids(series)? {
                    Some(ids) => self.series(run, series.kind, ids, after, span.until, limit)?,
                    None => Vec::new(),
                },
            };
            let more = found.len() > page.size();
            found.truncate(page.size());
            let next = if more { found.last().map(|(cursor, ..)| *cursor) } else { None };
            Ok(Page { items: self.decode(run, &found)?, next })
        })
    }

    /// Returns rows of several kinds in one order, read a few at a time.
    fn merged(
        &self,
        run: RunId,
        kinds: &[Kind],
        after: Cursor,
        until: i64,
        limit: usize,
    ) -> Answer<Vec<Found>> {
        struct Table {
            kind: Kind,
            rows: VecDeque<Found>,
            after: Cursor,
            more: bool,
        }
        let kinds: BTreeSet<Kind> = kinds.iter().copied().collect();
        let ahead = if kinds.len() == 1 { limit } else { limit.min(S::DIALECT.rows_ahead) };
        let table = |kind| Table { kind, rows: VecDeque::new(), after, more: true };
        let mut tables: Vec<Table> = kinds.into_iter().map(table).collect();
        let mut found = Vec::new();
        while found.len() < limit {
            let mut first: Option<(Cursor, usize)> = None;
            for (place, table) in tables.iter_mut().enumerate() {
                if table.rows.is_empty() && table.more {
                    let select = Select { kind: table.kind, series: None, until, limit: ahead };
                    table.rows = self.select(run, &select, table.after)?.into();
                    table.more = table.rows.len() == ahead;
                    table.after = table.rows.back().map_or(table.after, |(cursor, ..)| *cursor);
                }
                if let Some((cursor, ..)) = table.rows.front()
                    && first.is_none_or(|(least, _)| *cursor < least)
                {
                    first = Some((*cursor, place));
                }
            }
            let Some((_, place)) = first else { break };
            found.extend(tables[place].rows.pop_front());
        }
        Ok(found)
    }

    /// Returns rows of one series. `presence` finds them among the others: each stretch of time without a break in it
    /// is one range of the table's key.
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
    /// until it returns false.
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
                &integers([run.0, kind as i64, a, b, next, last, STRETCHES]),
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
                Some(last) if stretches.len() as i64 == STRETCHES => next = last + 1,
                _ => return Ok(()),
            }
        }
    }

    /// Returns rows of a kind after a cursor, in order.
    fn select(&self, run: RunId, select: &Select, after: Cursor) -> Answer<Vec<Found>> {
        let mut parameters = vec![run.0, after.t, after.t, after.seq, select.until];
        parameters.extend(select.series.iter().flatten().take(select.kind.table().series.len()));
        parameters.push(select.limit as i64);
        let parameters: Vec<Cell> = parameters.into_iter().map(Cell::Integer).collect();
        let rows = self.rows(&select.sql(), &parameters)?;
        rows.into_iter().map(|row| Ok((cursor(&row)?, select.kind, row))).collect()
    }

    pub fn gaps(&self, run: RunId, span: Span, page: PageRequest) -> Result<Page<Gap>> {
        let after = page.after.max(Some(Cursor::before(span.from))).unwrap_or(Cursor::before(0));
        self.ask_of(run, || {
            let rows = self.rows(
                "SELECT at_ns, seq, until_ns, events FROM gap WHERE run = ? AND at_ns >= ?
                 AND (at_ns > ? OR seq > ?) AND at_ns <= ? ORDER BY at_ns, seq LIMIT ?",
                &integers([run.0, after.t, after.t, after.seq, span.until, page.size() as i64 + 1]),
            )?;
            let gap = |row: &Row| {
                Ok(Gap {
                    from: timestamp(integer(row, 0)?),
                    until: timestamp(integer(row, 2)?),
                    events: integer(row, 3)?.cast_unsigned(),
                })
            };
            let on_page = &rows[..rows.len().min(page.size())];
            let next = match on_page.last() {
                Some(last) if rows.len() > page.size() => Some(cursor(last)?),
                _ => None,
            };
            Ok(Page { items: on_page.iter().map(gap).collect::<Answer<_>>()?, next })
        })
    }

    /// Calls `each` with a figure's values in a span: stretch by stretch for figures of series, from chunks where
    /// there are any.
    pub fn values(
        &self,
        run: RunId,
        figure: &Figure,
        span: Span,
        each: &mut dyn FnMut(i64, Reading),
    ) -> Result<()> {
        let kept = kept(figure);
        let sql = figures_sql(&kept, S::DIALECT.ordered_join);
        let mut each = |t: i64, reading: Reading| {
            if (span.from..=span.until).contains(&t) && reading.is_number() {
                each(t, reading);
            }
        };
        let figures = |key: [i64; 4], named: &[i64], each: &mut dyn FnMut(i64, f64)| {
            Ok(self.session.figures(&sql, &[&key, named].concat(), each)?)
        };
        self.ask_of(run, || {
            let mut named = Vec::new();
            for name in kept.named.iter().chain(&kept.child).map(|(_, name)| *name) {
                match find_name(&self.session, name)? {
                    Some(id) => named.push(id),
                    None => return Ok(()),
                }
            }
            let Some(series) = &kept.series else {
                let mut each = |t, value| each(t, Reading::Sample(value));
                return figures([run.0, span.from, span.until, 0], &named, &mut each);
            };
            let Some(ids) = self.ids(series)? else { return Ok(()) };
            let named = [&ids[..kept.kind.table().series.len()], &named].concat();
            let part = match kept.child {
                None => chunk::column(kept.kind, kept.column),
                Some(_) => named.last().map(|id| Part::children(kept.kind, *id)),
            };
            let of = match (part.and_then(Part::column), kept.child) {
                (Some(place), _) => FigureKey::Column(place),
                (_, child) => FigureKey::Child(child.map(|(_, name)| name.to_owned()).unwrap_or_default()),
            };
            let mut next = span.from / STRETCH;
            loop {
                let [a, b] = ids;
                let last = span.until / STRETCH;
                let stretches =
                    self.rows(PACKED, &integers([run.0, kept.kind as i64, a, b, next, last, STRETCHES]))?;
                for row in &stretches {
                    let stretch = integer(row, 0)?;
                    next = stretch + 1;
                    let samples = blob(row, 1)?;
                    let raw = |first, each: &mut dyn FnMut(i64, f64)| {
                        if let (Some(part), Some(samples)) = (part, samples)
                            && chunk::read(samples, part, &mut *each)?
                        {
                            return Ok(());
                        }
                        let from = span.from.max(stretch * STRETCH);
                        let until = span.until.min((stretch * STRETCH).saturating_add(STRETCH - 1));
                        figures([run.0, from, until, first], &named, each)
                    };
                    match blob(row, 3)? {
                        Some(steps) => {
                            let first = integer(row, 2)?;
                            rolled::merged(steps, &of, |each| raw(first, each), &mut each)?;
                        }
                        None => raw(0, &mut |t, value| each(t, Reading::Sample(value)))?,
                    }
                }
                if (stretches.len() as i64) < STRETCHES {
                    return Ok(());
                }
            }
        })
    }

    /// Returns samples of a kind, and where they belong; without those that rolled-up steps hold, if `raw`.
    pub fn samples(
        &self,
        run: RunId,
        kind: Kind,
        span: Span,
        after: Cursor,
        limit: usize,
        raw: bool,
    ) -> Result<Vec<(Cursor, Event)>> {
        let names = kind.table().columns.iter().map(|column| format!("e.{}", quoted(column)));
        let sql = format!(
            "SELECT e.at_ns, e.seq, {} FROM {} e WHERE e.run = ? AND e.at_ns >= ? AND (e.at_ns > ? OR e.seq > ?)
             AND e.at_ns <= ?{} ORDER BY e.at_ns, e.seq LIMIT ?",
            names.collect::<Vec<_>>().join(", "),
            quoted(kind.as_str()),
            if raw { not_rolled_up(kind, S::DIALECT.integer_division) } else { String::new() },
        );
        self.ask_of(run, || {
            let parameters = [run.0, after.t, after.t, after.seq, span.until, limit as i64];
            let rows = self.rows(&sql, &integers(parameters))?;
            let found =
                rows.into_iter().map(|row| Ok((cursor(&row)?, kind, row))).collect::<Answer<Vec<Found>>>()?;
            let events = self.decode(run, &found)?;
            let cursors = found.iter().map(|(cursor, ..)| *cursor);
            Ok(cursors.zip(events.into_iter().map(|stamped| stamped.event)).collect())
        })
    }

    /// Returns how far samples of a run were rolled up.
    pub fn retained(&self, run: RunId) -> Result<Vec<Retained>> {
        let sql =
            "SELECT kind, rolled_up_to_ns, step_ms, dropped_to_ns FROM retained WHERE run = ? ORDER BY kind";
        self.ask_of(run, || {
            let retained = |row: &Row| {
                let step_ms = required(real(row, 2)?)?;
                Ok(Retained::of((integer(row, 0)?, integer(row, 1)?, step_ms, integer(row, 3)?)))
            };
            let rows = self.rows(sql, &integers([run.0]))?;
            rows.iter().filter_map(|row| retained(row).transpose()).collect()
        })
    }

    /// Returns the times of the first and the last event of a kind in a span.
    pub fn extent(&self, run: RunId, kind: Kind, span: Span) -> Result<Option<(i64, i64)>> {
        self.ask_of(run, || {
            let one = |order: &str| {
                let table = quoted(kind.as_str());
                let sql = format!(
                    "SELECT at_ns FROM {table} WHERE run = ? AND at_ns >= ? AND at_ns <= ? ORDER BY at_ns {order} LIMIT 1"
                );
                let rows = self.rows(&sql, &integers([run.0, span.from, span.until]))?;
                rows.first().map(|row| integer(row, 0)).transpose()
            };
            Ok(one("ASC")?.zip(one("DESC")?))
        })
    }

    /// Returns the last event of each series at a time or before. Looks each series up in its last stretch, and goes
    /// through each such stretch once, backwards.
    pub fn latest(&self, run: RunId, at: i64) -> Result<Vec<Stamped>> {
        self.ask_of(run, || {
            let mut found = Vec::new();
            for kind in Series::kinds() {
                let mut stretches = BTreeMap::<i64, BTreeSet<[i64; 2]>>::new();
                let last = self.session.last_stretches(run, kind, at / STRETCH)?;
                for (ids, stretch) in last {
                    stretches.entry(stretch).or_default().insert(ids);
                }
                while let Some((stretch, series)) = stretches.pop_last() {
                    let missing = self.last_in_stretch(run, kind, at, stretch, series, &mut found)?;
                    for [a, b] in missing {
                        let earlier = self.rows(
                            "SELECT stretch FROM presence WHERE run = ? AND kind = ? AND a = ? AND b = ?
                             AND stretch < ? ORDER BY stretch DESC LIMIT 1",
                            &integers([run.0, kind as i64, a, b, stretch]),
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

    /// Adds the last row of each wanted series in a stretch. Returns the series that have none there at `at` or
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
        let table = kind.table();
        let sql = format!(
            "SELECT at_ns, seq, {} FROM {} WHERE run = ? AND at_ns >= ? AND at_ns <= ? AND (at_ns < ? OR seq < ?)
             ORDER BY at_ns DESC, seq DESC LIMIT ?",
            column_list(table.columns),
            quoted(kind.as_str()),
        );
        let from = stretch * STRETCH;
        let mut before = Cursor { t: at.min(from.saturating_add(STRETCH - 1)), seq: i64::MAX };
        while !wanted.is_empty() {
            // If all series are observed at the same times, this is all of them.
            let limit = wanted.len() as i64 + 16;
            let rows = self.rows(&sql, &integers([run.0, from, before.t, before.t, before.seq, limit]))?;
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

    fn ids(&self, series: &Series) -> Answer<Option<[i64; 2]>> {
        find_series(&self.session, series)
    }

    /// Turns rows and their child rows into events.
    fn decode(&self, run: RunId, found: &[Found]) -> Answer<Vec<Stamped>> {
        let mut children: HashMap<Cursor, Vec<Row>> = HashMap::new();
        for kind in Kind::ALL {
            let Some((table, columns)) = kind.table().children else { continue };
            let parents: Vec<Cursor> =
                found.iter().filter(|(_, its, _)| *its == kind).map(|(cursor, ..)| *cursor).collect();
            let (mut places, mut sql) = (0, String::new());
            for parents in parents.chunks(S::DIALECT.keys) {
                // A few sizes only, powers of two, because a session keeps each statement prepared.
                if places != parents.len().next_power_of_two() {
                    places = parents.len().next_power_of_two();
                    sql = format!(
                        "SELECT at_ns, seq, {} FROM {} WHERE run = ? AND ({}) ORDER BY at_ns, seq, place",
                        column_list(columns),
                        quoted(table),
                        vec!["at_ns = ? AND seq = ?"; places].join(" OR "),
                    );
                }
                let last = parents[parents.len() - 1];
                let padding = std::iter::repeat_n(&last, places - parents.len());
                let keys = parents.iter().chain(padding).flat_map(|parent| [parent.t, parent.seq]);
                let parameters: Vec<Cell> = std::iter::once(run.0).chain(keys).map(Cell::Integer).collect();
                for row in self.rows(&sql, &parameters)? {
                    children.entry(cursor(&row)?).or_default().push(row);
                }
            }
        }
        let event = |(cursor, kind, row): &Found| {
            let children = children.get(cursor).map_or(&[][..], Vec::as_slice);
            let mut source = RowSource { reader: self, row, column: 2, children };
            let at = timestamp(cursor.t);
            Stamped::take(*kind, at, &mut source)
        };
        found.iter().map(event).collect()
    }

    fn name(&self, id: i64) -> Answer<Arc<str>> {
        if let Some(name) = self.names.borrow().get(&id) {
            return Ok(name.clone());
        }
        let rows = self.rows(
            "SELECT id, text FROM name WHERE id >= ? ORDER BY id LIMIT ?",
            &integers([id, S::DIALECT.ids_ahead]),
        )?;
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
        let columns = column_list(codec::CONDITIONS);
        let sql = format!("SELECT id, {columns} FROM conditions WHERE id >= ? ORDER BY id LIMIT ?");
        let rows = self.rows(&sql, &integers([id, S::DIALECT.ids_ahead]))?;
        let mut remembered = self.conditions.borrow_mut();
        if remembered.len() >= REMEMBERED {
            remembered.clear();
        }
        for row in rows {
            let mut source = RowSource { reader: self, row: &row, column: 1, children: &[] };
            remembered.insert(integer(&row, 0)?, Conditions::take(&mut record::Reader(&mut source))?);
        }
        remembered
            .get(&id)
            .cloned()
            .ok_or_else(|| ReadError::Unreadable(format!("there are no conditions {id}")))
    }

    fn heard(&self, id: i64) -> Answer<Heard> {
        if let Some(heard) = self.heard.borrow().get(&id) {
            return Ok(heard.clone());
        }
        let rows = self.rows(
            "SELECT id, signals FROM heard WHERE id >= ? ORDER BY id LIMIT ?",
            &integers([id, S::DIALECT.ids_ahead]),
        )?;
        let mut remembered = self.heard.borrow_mut();
        if remembered.len() >= REMEMBERED {
            remembered.clear();
        }
        for row in rows {
            remembered.insert(integer(&row, 0)?, Heard::parse::<ReadError>(required(text(&row, 1)?)?)?);
        }
        remembered
            .get(&id)
            .cloned()
            .ok_or_else(|| ReadError::Unreadable(format!("there are no signals {id}")))
    }
}

const RUN: &str = "SELECT id, name, seed, started_at_unix_ns, testbed, ended_ns FROM run";

fn read_run(row: &[Cell]) -> Answer<Run> {
    Ok(Run {
        id: RunId(integer(row, 0)?),
        info: RunInfo {
            name: text(row, 1)?.unwrap_or_default().to_owned(),
            seed: integer(row, 2)?.cast_unsigned(),
            started_at_unix_ns: integer(row, 3)?,
            testbed: text(row, 4)?.unwrap_or_default().to_owned(),
        },
        ended: optional_integer(row, 5)?.map(timestamp),
    })
}

/// The stretches of a series with their chunks and steps.
const PACKED: &str = "SELECT p.stretch, c.samples, r.next_seq, r.steps FROM presence p
     LEFT JOIN chunk c
     ON c.run = p.run AND c.kind = p.kind AND c.a = p.a AND c.b = p.b AND c.stretch = p.stretch
     LEFT JOIN rolled_up r
     ON r.run = p.run AND r.kind = p.kind AND r.a = p.a AND r.b = p.b AND r.stretch = p.stretch
     WHERE p.run = ? AND p.kind = ? AND p.a = ? AND p.b = ? AND p.stretch >= ? AND p.stretch <= ?
     ORDER BY p.stretch LIMIT ?";

/// Rows of a kind, of all series or of one.
pub(crate) struct Select {
    pub kind: Kind,
    pub series: Option<[i64; 2]>,
    pub until: i64,
    pub limit: usize,
}

impl Select {
    /// Returns the statement. It compares keys in parts, because servers find no range of an index by a comparison of
    /// pairs.
    pub fn sql(&self) -> String {
        let table = self.kind.table();
        let same: String = match self.series {
            Some(_) => table.series.iter().map(|column| format!(" AND {} = ?", quoted(column))).collect(),
            None => String::new(),
        };
        format!(
            "SELECT at_ns, seq, {} FROM {} WHERE run = ? AND at_ns >= ? AND (at_ns > ? OR seq > ?) AND at_ns <= ?{same}
             ORDER BY at_ns, seq LIMIT ?",
            column_list(table.columns),
            quoted(self.kind.as_str()),
        )
    }
}

/// Returns the statement for a figure's rows in a span, as times and figures. Its parameters are the run, from, until,
/// the first `seq`, the ids of the series' columns, those of the names, and that of the child's name. `join` joins two
/// tables in their order.
fn figures_sql(kept: &Kept<'_>, join: &str) -> String {
    let table = kept.kind.table();
    let child = kept.child.and(table.children);
    let of = if child.is_some() { "c" } else { "e" };
    let mut sql = format!("SELECT e.at_ns, {of}.\"{}\" FROM \"{}\" e", kept.column, kept.kind.as_str());
    let mut add =
        |text: std::fmt::Arguments<'_>| sql.write_fmt(text).expect("writing to a string never fails");
    if let Some((child, _)) = child {
        add(format_args!(" {join} \"{child}\" c ON c.run = e.run AND c.at_ns = e.at_ns AND c.seq = e.seq"));
    }
    add(format_args!(" WHERE e.run = ? AND e.at_ns >= ? AND e.at_ns <= ? AND e.seq >= ?"));
    let series = if kept.series.is_some() { table.series } else { &[] };
    for column in series.iter().copied().chain(kept.named.iter().map(|(column, _)| *column)) {
        add(format_args!(" AND e.{column} = ?"));
    }
    if let (Some(_), Some((column, _))) = (child, kept.child) {
        add(format_args!(" AND c.{column} = ?"));
    }
    add(format_args!(" AND {of}.\"{}\" IS NOT NULL ORDER BY e.at_ns, e.seq", kept.column));
    if child.is_some() {
        add(format_args!(", c.place"));
    }
    sql
}

/// Returns a condition on samples `e` of a kind that no rolled-up step holds.
fn not_rolled_up(kind: Kind, integer_division: &str) -> String {
    let series = kind.table().series;
    let b = series.get(1).map_or("0".to_owned(), |column| format!("e.{column}"));
    format!(
        " AND NOT EXISTS (SELECT 1 FROM rolled_up u WHERE u.run = e.run AND u.kind = {} AND u.a = e.{} AND u.b = {b}
          AND u.stretch = e.at_ns {integer_division} {STRETCH} AND u.next_seq > e.seq)",
        kind as i64, series[0],
    )
}

/// Returns the id of a name; `None` if it was never recorded.
fn find_name<S: Session>(session: &S, name: &str) -> Answer<Option<i64>> {
    let rows = session.rows("SELECT id FROM name WHERE text = ?", &[name.into()])?;
    rows.first().map(|row| integer(row, 0)).transpose()
}

/// Returns the ids of a series as `presence` has them; `None` if a name was never recorded.
pub(super) fn find_series<S: Session>(session: &S, series: &Series) -> Answer<Option<[i64; 2]>> {
    series_ids(series, |name| find_name(session, name))
}

/// Returns the ids of a series as `presence` has them, from those of its names.
pub(super) fn series_ids<E>(
    series: &Series,
    mut id: impl FnMut(&str) -> std::result::Result<Option<i64>, E>,
) -> std::result::Result<Option<[i64; 2]>, E> {
    let mut id = |part: &SeriesPart| match part {
        SeriesPart::None => Ok(Some(0)),
        SeriesPart::Code(code) => Ok(Some(*code)),
        SeriesPart::Name(name) => id(name),
    };
    let [a, b] = &series.parts;
    let (a, b) = (id(a)?, id(b)?);
    Ok(a.zip(b).map(|(a, b)| [a, b]))
}

fn cursor(row: &[Cell]) -> Answer<Cursor> {
    Ok(Cursor { t: integer(row, 0)?, seq: integer(row, 1)? })
}

fn timestamp(t: i64) -> Timestamp {
    Timestamp::from_nanos(t.cast_unsigned())
}

/// A row that is read column by column.
struct RowSource<'r, S> {
    reader: &'r Reader<S>,
    row: &'r [Cell],
    column: usize,
    children: &'r [Row],
}

impl<S> RowSource<'_, S> {
    fn next(&mut self) -> usize {
        self.column += 1;
        self.column - 1
    }
}

impl<S: Session> Source<ReadError> for RowSource<'_, S> {
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
        Ok(text(self.row, column)?.map(str::to_owned))
    }

    fn name(&mut self) -> Answer<Option<Arc<str>>> {
        let Some(id) = self.integer()? else { return Ok(None) };
        self.reader.name(id).map(Some)
    }

    fn heard(&mut self) -> Answer<Option<Heard>> {
        let Some(id) = self.integer()? else { return Ok(None) };
        self.reader.heard(id).map(Some)
    }

    fn conditions(&mut self) -> Answer<Conditions> {
        let id = required(self.integer()?)?;
        self.reader.conditions(id)
    }

    fn children(&mut self, read: &mut dyn FnMut(&mut dyn Source<ReadError>) -> Answer<()>) -> Answer<()> {
        for row in self.children {
            read(&mut RowSource { reader: self.reader, row, column: 2, children: &[] })?;
        }
        Ok(())
    }
}
