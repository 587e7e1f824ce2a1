//! The seam behind which histories are kept. An engine is told events in batches and asked for them back; what a
//! question means is said here once, and every engine gives the same answer.

use std::{fmt, str::FromStr};

use cotorra_graph::{Event, Stamped, Timestamp};
use serde::{Deserialize, Serialize};

use crate::{
    error::Result,
    figure::Figure,
    kind::{Kind, Series},
    page::{Cursor, Page, PageRequest},
    retention::{Retained, Thinned},
    rolled::Reading,
    schema::STRETCH,
};

/// Names a run within its history.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct RunId(pub(crate) i64);

impl fmt::Display for RunId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

impl FromStr for RunId {
    type Err = std::num::ParseIntError;
    fn from_str(text: &str) -> std::result::Result<Self, Self::Err> {
        text.parse().map(Self)
    }
}

/// What is known about a run when it begins.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RunInfo {
    /// Its name.
    pub name: String,
    /// The seed of all its randomness.
    pub seed: u64,
    /// When it began, nanoseconds since 1970-01-01 UTC.
    pub started_at_unix_ns: i64,
    /// The testbed file as run.
    pub testbed: String,
}

/// A run in a history.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Run {
    /// Names it.
    pub id: RunId,
    /// What was known when it began.
    #[serde(flatten)]
    pub info: RunInfo,
    /// When it ended; `None` while it goes on, and for good when it was killed.
    #[serde(rename = "ended_ns")]
    pub ended: Option<Timestamp>,
}

/// Events that were lost, never silently: the queue was full, or no history can hold what they say (a time more
/// than 292 years after the run began, NaN in a change of conditions).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Gap {
    /// Time of the earliest that is missing.
    #[serde(rename = "from_ns")]
    pub from: Timestamp,
    /// Time of the latest that is missing.
    #[serde(rename = "until_ns")]
    pub until: Timestamp,
    /// How many are.
    pub events: u64,
}

impl Gap {
    /// Both as one.
    pub(crate) fn with(self, other: Self) -> Self {
        Self {
            from: self.from.min(other.from),
            until: self.until.max(other.until),
            events: self.events + other.events,
        }
    }
}

/// Which events are asked for.
#[derive(Debug, Clone)]
pub(crate) enum Selection<'a> {
    /// All of these kinds.
    Kinds(&'a [Kind]),
    /// Those of one series.
    Series(Series),
}

/// Of samples `e` of a kind: only those that no rolled-up step has. `over` divides whole numbers.
pub(crate) fn not_rolled_up(kind: Kind, over: &str) -> String {
    let series = crate::codec::table(kind).series;
    let b = series.get(1).map_or("0".to_owned(), |column| format!("e.{column}"));
    format!(
        " AND NOT EXISTS (SELECT 1 FROM rolled_up u WHERE u.run = e.run AND u.kind = {} AND u.a = e.{} AND u.b = {b}
          AND u.stretch = e.at_ns {over} {STRETCH} AND u.next_seq > e.seq)",
        kind as i64, series[0],
    )
}

/// All tables that have rows of runs.
pub(crate) fn tables_of_runs() -> impl Iterator<Item = &'static str> {
    let of_kinds = Kind::ALL.into_iter().flat_map(|kind| {
        let children = crate::codec::table(kind).children.map(|(table, _)| table);
        std::iter::once(kind.as_str()).chain(children)
    });
    of_kinds.chain(["gap", "presence", "chunk", "rolled_up", "retained"])
}

/// A span of time, both ends within, in nanoseconds since the run began.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Span {
    pub from: i64,
    pub until: i64,
}

/// An event on its way into a history. [`crate::codec::storable`] holds for it.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Entry {
    pub run: RunId,
    pub stamped: Stamped,
}

/// Keeps histories. Events of a run are ordered by time and, at the same time, by the order in which they were
/// appended; a clock that steps back so sorts its events in where they say they belong.
pub(crate) trait Store: Send + Sync {
    /// A new run.
    fn begin_run(&self, info: &RunInfo) -> Result<RunId>;

    /// Notes that a run has ended.
    fn end_run(&self, run: RunId, at: Timestamp) -> Result<()>;

    /// One run.
    fn run(&self, run: RunId) -> Result<Run>;

    /// Runs after a given one, oldest first.
    fn runs(&self, after: Option<RunId>, limit: usize) -> Result<Vec<Run>>;

    /// Appends all or nothing; durable when it returns. After an error the same may be tried again.
    fn append(&self, events: &[Entry], gaps: &[(RunId, Gap)]) -> Result<()>;

    /// Selected events in a span, in order.
    fn events(
        &self,
        run: RunId,
        what: &Selection<'_>,
        span: Span,
        page: PageRequest,
    ) -> Result<Page<Stamped>>;

    /// Gaps that begin in a span, in order.
    fn gaps(&self, run: RunId, span: Span, page: PageRequest) -> Result<Page<Gap>>;

    /// The last event of each series at a time or before.
    fn latest(&self, run: RunId, at: i64) -> Result<Vec<Stamped>>;

    /// Calls `each` with the times and values of a figure in a span, in order; what is no number is left out. What was
    /// rolled up is told at the time of the last sample of its step.
    fn values(
        &self,
        run: RunId,
        figure: &Figure,
        span: Span,
        each: &mut dyn FnMut(i64, Reading),
    ) -> Result<()>;

    /// Times of the first and the last event of a kind in a span.
    fn extent(&self, run: RunId, kind: Kind, span: Span) -> Result<Option<(i64, i64)>>;

    /// Removes a run and all that there is of it.
    fn remove_run(&self, _run: RunId) -> Result<()> {
        Ok(())
    }

    /// Keeps it from growing, as a full disk does, or lets it grow again.
    fn set_full(&self, _full: bool) -> Result<()> {
        Ok(())
    }

    // Below: retention. What keeps everything needs none of it.

    /// Samples of a kind in a span and behind a cursor, in order; `raw` leaves out those that rolled-up steps have.
    fn samples(
        &self,
        _run: RunId,
        _kind: Kind,
        _span: Span,
        _after: Cursor,
        _limit: usize,
        _raw: bool,
    ) -> Result<Vec<(Cursor, Event)>> {
        Ok(Vec::new())
    }

    /// Leaves of some series what they are thinned to: all or nothing, and nothing if some of what is to go is gone.
    fn thin(&self, _run: RunId, _kind: Kind, _thinned: &[Thinned]) -> Result<()> {
        Ok(())
    }

    /// How far samples of a run were rolled up, by kind.
    fn retained(&self, run: RunId) -> Result<Vec<Retained>> {
        self.run(run).map(|_| Vec::new())
    }

    /// Notes how far samples of a kind were rolled up.
    fn note_retained(&self, _run: RunId, _retained: &Retained) -> Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests;
