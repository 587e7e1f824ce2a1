//! Events on their way into tables. Names and conditions are written once and then referred to by their ids; the
//! figures of a series in a stretch of time are packed into a chunk beside its rows.

use std::collections::{BTreeMap, HashMap};

use cotorra_graph::{Conditions, Timestamp};

use super::{read::series_ids, session::Cell};
use crate::{
    chunk::{self, Chunk, has_chunks},
    codec::{self, Columns, Fields, Heard, Role, Value},
    error::Result,
    kind::{Kind, Series},
    run::{Entry, Gap, RunId},
    schema::STRETCH,
};

/// Most names or series that are remembered. Forgotten ones are looked up again.
const REMEMBERED: usize = 100_000;

/// A table that a batch adds rows to.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Target {
    Gaps,
    Events(Kind),
    Children(Kind),
}

impl Target {
    /// Number of tables.
    #[cfg(feature = "databases")]
    pub const COUNT: usize = 1 + 2 * Kind::ALL.len();

    /// Returns all tables, each in the place that [`Self::place`] says.
    pub fn all() -> impl Iterator<Item = Self> {
        let of_kinds =
            Kind::ALL.into_iter().map(Self::Events).chain(Kind::ALL.into_iter().map(Self::Children));
        std::iter::once(Self::Gaps).chain(of_kinds)
    }

    /// Returns the table's place among all, below `COUNT`.
    pub const fn place(self) -> usize {
        match self {
            Self::Gaps => 0,
            Self::Events(kind) => 1 + kind as usize,
            Self::Children(kind) => 1 + Kind::ALL.len() + kind as usize,
        }
    }

    /// Returns the table's name and columns; `None` for child rows of a kind without any.
    pub fn table(self) -> Option<(&'static str, Vec<&'static str>)> {
        const KEY: [&str; 4] = ["run", "at_ns", "seq", "place"];
        Some(match self {
            Self::Gaps => ("gap", [&KEY[..3], &["until_ns", "events"]].concat()),
            Self::Events(kind) => (kind.as_str(), [&KEY[..3], kind.table().columns].concat()),
            Self::Children(kind) => {
                let (table, columns) = kind.table().children?;
                (table, [&KEY, columns].concat())
            }
        })
    }
}

/// A series in a stretch: the key of `presence` and `chunk`.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Stretch {
    pub run: RunId,
    pub kind: Kind,
    pub ids: [i64; 2],
    pub stretch: i64,
}

impl Stretch {
    pub fn key(&self) -> [i64; 5] {
        [self.run.0, self.kind as i64, self.ids[0], self.ids[1], self.stretch]
    }
}

/// The rows of one append, which an engine takes into one transaction.
pub(crate) trait Batch {
    /// Returns the first free place in a run's order of recording, or 0 if the engine adds that to all rows later.
    fn first_seq(&mut self, known: &mut Known, run: RunId) -> Result<i64>;

    /// Returns the id of a name, which is added if it is new.
    fn name_id(&mut self, name: &str) -> Result<i64>;

    /// Adds a row that others refer to, and returns its id.
    fn add_shared(&mut self, table: &str, columns: &[&'static str], cells: Vec<Cell>) -> Result<i64>;

    /// Takes the cells of one or more rows, and leaves none.
    fn push(&mut self, target: Target, cells: &mut Vec<Cell>) -> Result<()>;

    /// Takes the chunk of a stretch that is over. It is ignored if the stretch was rolled up since.
    fn finish_chunk(&mut self, stretch: Stretch, chunk: Vec<u8>) -> Result<()>;

    /// Notes that a series has samples in a stretch. Returns whether it had none so far, i.e. whether a chunk that
    /// begins now will hold all of them. Otherwise removes the chunk of the stretch, which lacks the new samples.
    fn begin_stretch(&mut self, stretch: Stretch) -> Result<bool>;
}

/// Rows that are in the database for certain.
#[derive(Debug, Default)]
pub(crate) struct Known {
    names: HashMap<Box<str>, i64>,
    /// Places in `of_series`.
    series: HashMap<Series, usize>,
    of_series: Vec<KnownSeries>,
    /// Place after that of the series of the last event.
    after_last: usize,
    /// The next place in the order of recording that this process left, by run. If the database has another one,
    /// another process records the same run.
    pub next_seq: BTreeMap<RunId, i64>,
}

#[derive(Debug)]
struct KnownSeries {
    series: Series,
    /// Ids of the series in `presence`.
    ids: [i64; 2],
    /// The last stretch that was noted.
    presence: Option<(RunId, i64)>,
    /// All samples in that stretch, if all of them are known.
    chunk: Option<Chunk>,
    /// The last conditions and their id, by role.
    conditions: [Option<(Conditions, i64)>; Role::COUNT],
    /// The last signals and their id.
    heard: Option<(Heard, i64)>,
}

impl Known {
    /// Forgets everything if it grew too large.
    pub fn bound(&mut self) {
        if self.names.len().max(self.series.len()) > REMEMBERED {
            *self = Self::default();
        }
    }

    /// Drops all chunks: another process has written samples that they lack.
    pub fn drop_chunks(&mut self) {
        self.of_series.iter_mut().for_each(|series| series.chunk = None);
    }

    /// Forgets which stretches were noted, because a transaction was rolled back.
    #[cfg(feature = "databases")]
    pub fn forget_stretches(&mut self) {
        self.of_series.iter_mut().for_each(|series| (series.presence, series.chunk) = (None, None));
    }
}

/// Turns events and gaps into rows of a batch. Returns the next place in the order of recording by run, counted from
/// [`Batch::first_seq`].
pub(crate) fn append<B: Batch>(
    events: &[Entry],
    gaps: &[(RunId, Gap)],
    known: &mut Known,
    batch: &mut B,
) -> Result<BTreeMap<RunId, i64>> {
    let mut append = Append { known, batch, next_seq: BTreeMap::new(), cells: Vec::new() };
    append.events(events)?;
    for (run, gap) in gaps {
        append.gap(*run, gap)?;
    }
    Ok(append.next_seq)
}

struct Append<'a, B> {
    known: &'a mut Known,
    batch: &'a mut B,
    next_seq: BTreeMap<RunId, i64>,
    /// The row that is being built.
    cells: Vec<Cell>,
}

impl<B: Batch> Append<'_, B> {
    fn events(&mut self, events: &[Entry]) -> Result<()> {
        let (mut row, mut children) = (Fields::default(), Fields::default());
        for Entry { run, stamped } in events {
            row.0.clear();
            children.0.clear();
            stamped.put(&mut row, &mut children);
            let kind = Kind::of(&stamped.event);
            let t = stamped.at.as_nanos().cast_signed();
            let key = [run.0, t, self.seq(*run)?];
            let series = self.series(stamped.event.series())?;
            if let Some(series) = series {
                self.enter_stretch(kind, *run, t, series)?;
                if let Some(chunk) = &mut self.known.of_series[series].chunk {
                    chunk.push(kind, t, &row.0);
                }
            }
            self.cells.extend(key.map(Cell::Integer));
            for value in &row.0 {
                self.push_cell(series, value)?;
            }
            self.batch.push(Target::Events(kind), &mut self.cells)?;
            self.child_rows(kind, key, series, &children.0)?;
        }
        Ok(())
    }

    fn child_rows(
        &mut self,
        kind: Kind,
        key: [i64; 3],
        series: Option<usize>,
        children: &[Value<'_>],
    ) -> Result<()> {
        let Some((_, columns)) = kind.table().children else { return Ok(()) };
        for (child, place) in children.chunks(columns.len()).zip(0_i64..) {
            self.cells.extend(key.into_iter().chain([place]).map(Cell::Integer));
            for value in child {
                self.push_cell(None, value)?;
            }
            if let Some((name, figure)) = chunk::of_child(kind, child) {
                let of = self.name(name)?;
                if let Some(chunk) = series.and_then(|series| self.known.of_series[series].chunk.as_mut()) {
                    chunk.push_child(of, figure);
                }
            }
        }
        self.batch.push(Target::Children(kind), &mut self.cells)
    }

    fn gap(&mut self, run: RunId, gap: &Gap) -> Result<()> {
        let clamp = |t: Timestamp| i64::try_from(t.as_nanos()).unwrap_or(i64::MAX);
        let row = [run.0, clamp(gap.from), self.seq(run)?, clamp(gap.until), gap.events.cast_signed()];
        self.cells.extend(row.map(Cell::Integer));
        self.batch.push(Target::Gaps, &mut self.cells)
    }

    fn seq(&mut self, run: RunId) -> Result<i64> {
        let next = match self.next_seq.get_mut(&run) {
            Some(next) => next,
            None => {
                let first = self.batch.first_seq(self.known, run)?;
                self.next_seq.entry(run).or_insert(first)
            }
        };
        *next += 1;
        Ok(*next - 1)
    }

    fn push_cell(&mut self, series: Option<usize>, value: &Value<'_>) -> Result<()> {
        let cell = match value {
            Value::Null => Cell::Null,
            Value::Integer(n) => Cell::Integer(*n),
            Value::Real(x) => Cell::Real(*x),
            Value::Text(text) => Cell::Text(text.to_string()),
            Value::Name(name) => Cell::Integer(self.name(name)?),
            Value::Conditions(role, conditions) => {
                let series = series.expect("conditions are those of a link, which makes a series");
                Cell::Integer(self.conditions(series, *role, conditions)?)
            }
            Value::Heard(heard) => {
                let series = series.expect("signals are those of a robot, which makes a series");
                Cell::Integer(self.heard(series, heard)?)
            }
        };
        self.cells.push(cell);
        Ok(())
    }

    fn name(&mut self, name: &str) -> Result<i64> {
        if let Some(id) = self.known.names.get(name) {
            return Ok(*id);
        }
        let id = self.batch.name_id(name)?;
        self.known.names.insert(name.into(), id);
        Ok(id)
    }

    /// Returns the place of a series, if there is one.
    fn series(&mut self, series: Option<Series>) -> Result<Option<usize>> {
        let Some(series) = series else { return Ok(None) };
        // Series are mostly sampled in turn.
        let guess = self.known.after_last;
        if self.known.of_series.get(guess).is_some_and(|known| known.series == series) {
            self.known.after_last = (guess + 1) % self.known.of_series.len();
            return Ok(Some(guess));
        }
        if let Some(place) = self.known.series.get(&series) {
            self.known.after_last = (place + 1) % self.known.of_series.len();
            return Ok(Some(*place));
        }
        let ids = series_ids(&series, |name| self.name(name).map(Some))?;
        let ids = ids.expect("an unknown name was added");
        let place = self.known.of_series.len();
        self.known.of_series.push(KnownSeries {
            series: series.clone(),
            ids,
            presence: None,
            chunk: None,
            conditions: [const { None }; Role::COUNT],
            heard: None,
        });
        self.known.series.insert(series, place);
        Ok(Some(place))
    }

    /// Returns the id of a link's conditions, which are written when they differ from its last ones.
    fn conditions(&mut self, series: usize, role: Role, conditions: &Conditions) -> Result<i64> {
        if let Some((last, id)) = &self.known.of_series[series].conditions[role as usize]
            && last == conditions
        {
            return Ok(*id);
        }
        let mut row = Fields::default();
        conditions.put(&mut row);
        let began = self.cells.len();
        for value in &row.0 {
            self.push_cell(None, value)?;
        }
        let columns = self.cells.split_off(began);
        let id = self.batch.add_shared("conditions", codec::CONDITIONS, columns)?;
        self.known.of_series[series].conditions[role as usize] = Some((conditions.clone(), id));
        Ok(id)
    }

    /// Returns the id of signals that a robot heard, which are written when they differ from its last ones.
    fn heard(&mut self, series: usize, heard: &Heard) -> Result<i64> {
        if let Some((last, id)) = &self.known.of_series[series].heard
            && last == heard
        {
            return Ok(*id);
        }
        let id = self.batch.add_shared("heard", codec::HEARD, vec![Cell::Text(heard.text())])?;
        self.known.of_series[series].heard = Some((heard.clone(), id));
        Ok(id)
    }

    /// Notes that a series has a sample in a stretch, unless that is known, and finishes the chunk of the one before.
    fn enter_stretch(&mut self, kind: Kind, run: RunId, t: i64, series: usize) -> Result<()> {
        let known = &mut self.known.of_series[series];
        let stretch = t / STRETCH;
        let before = known.presence.replace((run, stretch));
        if before == Some((run, stretch)) {
            return Ok(());
        }
        let ids = known.ids;
        if let Some((run, stretch)) = before
            && let Some(chunk) = known.chunk.take().and_then(|chunk| chunk.finish(kind))
        {
            self.batch.finish_chunk(Stretch { run, kind, ids, stretch }, chunk)?;
        }
        let fresh = self.batch.begin_stretch(Stretch { run, kind, ids, stretch })?;
        known.chunk = (fresh && has_chunks(kind)).then(Chunk::default);
        Ok(())
    }
}
