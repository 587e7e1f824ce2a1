//! The seam to the engines that keep histories. An engine takes events in batches and answers questions about them;
//! every engine gives the same answers.

use cotorra_graph::{Event, Figure, Stamped, Timestamp};

use crate::{
    error::Result,
    kind::{Kind, Series},
    page::{Cursor, Page, PageRequest},
    retention::{Retained, Thinned},
    rolled::Reading,
    run::{Entry, Gap, Run, RunId, RunInfo},
};

/// Events that a question is about.
#[derive(Debug, Clone)]
pub(crate) enum Selection<'a> {
    /// All of these kinds.
    Kinds(&'a [Kind]),
    /// Events of one series.
    Series(Series),
}

/// A span of time, both ends included, in nanoseconds since the run began.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Span {
    pub from: i64,
    pub until: i64,
}

/// Keeps histories. Events of a run are ordered by time and then by the order in which they were appended. A clock that
/// steps back thus sorts its events in by their times.
pub(crate) trait Store: Send + Sync {
    /// Adds a run.
    fn begin_run(&self, info: &RunInfo) -> Result<RunId>;

    /// Notes when a run ended.
    fn end_run(&self, run: RunId, at: Timestamp) -> Result<()>;

    /// Returns one run.
    fn run(&self, run: RunId) -> Result<Run>;

    /// Returns runs after a given one, oldest first.
    fn runs(&self, after: Option<RunId>, limit: usize) -> Result<Vec<Run>>;

    /// Appends all or nothing. The events are durable when it returns. After an error the same events may be appended
    /// again.
    fn append(&self, events: &[Entry], gaps: &[(RunId, Gap)]) -> Result<()>;

    /// Returns selected events in a span, in order.
    fn events(
        &self,
        run: RunId,
        what: &Selection<'_>,
        span: Span,
        page: PageRequest,
    ) -> Result<Page<Stamped>>;

    /// Returns gaps that begin in a span, in order.
    fn gaps(&self, run: RunId, span: Span, page: PageRequest) -> Result<Page<Gap>>;

    /// Returns the last event of each series at a time or before.
    fn latest(&self, run: RunId, at: i64) -> Result<Vec<Stamped>>;

    /// Calls `each` with the times and values of a figure in a span, in order, without NaN. Samples that were rolled up
    /// come at the time of the last sample of their step.
    fn values(
        &self,
        run: RunId,
        figure: &Figure,
        span: Span,
        each: &mut dyn FnMut(i64, Reading),
    ) -> Result<()>;

    /// Returns the times of the first and the last event of a kind in a span.
    fn extent(&self, run: RunId, kind: Kind, span: Span) -> Result<Option<(i64, i64)>>;

    /// Removes a run and everything recorded of it.
    fn remove_run(&self, _run: RunId) -> Result<()> {
        Ok(())
    }

    /// Sets whether the history is kept from growing, as by a full disk.
    fn set_full(&self, _full: bool) -> Result<()> {
        Ok(())
    }

    // Retention. Engines that keep everything need none of it.

    /// Returns samples of a kind in a span and after a cursor, in order; without those that rolled-up steps hold, if
    /// `raw`.
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

    /// Replaces samples of some series by what they are thinned to: all or nothing, and nothing if some of the samples
    /// to remove are gone already.
    fn thin(&self, _run: RunId, _kind: Kind, _thinned: &[Thinned]) -> Result<()> {
        Ok(())
    }

    /// Returns how far samples of a run were rolled up, by kind.
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
