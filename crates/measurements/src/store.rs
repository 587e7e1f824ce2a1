//! The seam behind which histories are kept. An engine is told events in batches and asked for them back; what a
//! question means is said here once, and every engine gives the same answer.

use cotorra_graph::{Event, Stamped, Timestamp};

use crate::{
    error::Result,
    figure::Figure,
    kind::{Kind, Series},
    page::{Cursor, Page, PageRequest},
    retention::{Retained, Thinned},
    rolled::Reading,
    run::{Entry, Gap, Run, RunId, RunInfo},
};

/// Which events are asked for.
#[derive(Debug, Clone)]
pub(crate) enum Selection<'a> {
    /// All of these kinds.
    Kinds(&'a [Kind]),
    /// Those of one series.
    Series(Series),
}

/// A span of time, both ends within, in nanoseconds since the run began.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Span {
    pub from: i64,
    pub until: i64,
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
