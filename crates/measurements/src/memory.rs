//! A history in memory, for tests and for runs that leave nothing. It grows without bound.

use std::collections::{BTreeMap, BTreeSet};

use cotorra_graph::{Event, Figure, Stamped, Timestamp};
use parking_lot::RwLock;

use crate::{
    error::{Error, Result},
    kind::{Kind, Series},
    page::{Cursor, Page, PageRequest},
    rolled::Reading,
    run::{Entry, Gap, Run, RunId, RunInfo},
    store::{Selection, Span, Store},
};

/// Runs with their events in ordered maps.
#[derive(Debug, Default)]
pub(crate) struct Memory {
    runs: RwLock<Vec<Recorded>>,
}

#[derive(Debug)]
struct Recorded {
    info: RunInfo,
    ended: Option<Timestamp>,
    next_seq: i64,
    events: BTreeMap<Cursor, Event>,
    series: BTreeMap<Series, BTreeSet<Cursor>>,
    gaps: BTreeMap<Cursor, Gap>,
}

impl Recorded {
    fn cursor(&mut self, at: Timestamp) -> Cursor {
        let seq = self.next_seq;
        self.next_seq += 1;
        Cursor { t: clamp(at), seq }
    }

    fn stamped(&self, cursor: Cursor) -> Stamped {
        Stamped { at: Timestamp::from_nanos(cursor.t as u64), event: self.events[&cursor].clone() }
    }
}

fn clamp(at: Timestamp) -> i64 {
    i64::try_from(at.as_nanos()).unwrap_or(i64::MAX)
}

fn index(run: RunId) -> usize {
    usize::try_from(run.0 - 1).unwrap_or(usize::MAX)
}

fn page<T>(found: impl Iterator<Item = Cursor>, request: PageRequest, item: impl Fn(Cursor) -> T) -> Page<T> {
    let mut cursors: Vec<Cursor> = found.take(request.size() + 1).collect();
    let more = cursors.len() > request.size();
    cursors.truncate(request.size());
    let next = if more { cursors.last().copied() } else { None };
    Page { items: cursors.into_iter().map(item).collect(), next }
}

fn within(span: Span, request: PageRequest) -> impl Fn(&Cursor) -> bool {
    move |cursor| {
        (span.from..=span.until).contains(&cursor.t) && request.after.is_none_or(|after| *cursor > after)
    }
}

impl Memory {
    fn with<T>(&self, run: RunId, ask: impl FnOnce(&Recorded) -> T) -> Result<T> {
        self.runs.read().get(index(run)).map(ask).ok_or(Error::NoSuchRun(run))
    }
}

impl Store for Memory {
    fn begin_run(&self, info: &RunInfo) -> Result<RunId> {
        let mut runs = self.runs.write();
        runs.push(Recorded {
            info: info.clone(),
            ended: None,
            next_seq: 0,
            events: BTreeMap::new(),
            series: BTreeMap::new(),
            gaps: BTreeMap::new(),
        });
        Ok(RunId(runs.len() as i64))
    }

    fn end_run(&self, run: RunId, at: Timestamp) -> Result<()> {
        let mut runs = self.runs.write();
        let recorded = runs.get_mut(index(run)).ok_or(Error::NoSuchRun(run))?;
        recorded.ended = Some(Timestamp::from_nanos(clamp(at) as u64));
        Ok(())
    }

    fn run(&self, run: RunId) -> Result<Run> {
        self.with(run, |recorded| Run { id: run, info: recorded.info.clone(), ended: recorded.ended })
    }

    fn runs(&self, after: Option<RunId>, limit: usize) -> Result<Vec<Run>> {
        let first = after.map_or(0, |run| index(run) + 1);
        let runs = self.runs.read();
        let listed = runs.iter().enumerate().skip(first).take(limit);
        Ok(listed
            .map(|(i, r)| Run { id: RunId(i as i64 + 1), info: r.info.clone(), ended: r.ended })
            .collect())
    }

    fn append(&self, events: &[Entry], gaps: &[(RunId, Gap)]) -> Result<()> {
        let mut runs = self.runs.write();
        let asked = events.iter().map(|e| e.run).chain(gaps.iter().map(|(run, _)| *run));
        if let Some(unknown) = asked.into_iter().find(|run| index(*run) >= runs.len()) {
            return Err(Error::NoSuchRun(unknown));
        }
        for Entry { run, stamped } in events {
            let recorded = &mut runs[index(*run)];
            let cursor = recorded.cursor(stamped.at);
            if let Some(series) = stamped.event.series() {
                recorded.series.entry(series).or_default().insert(cursor);
            }
            recorded.events.insert(cursor, stamped.event.clone());
        }
        for (run, gap) in gaps {
            let recorded = &mut runs[index(*run)];
            let cursor = recorded.cursor(gap.from);
            recorded.gaps.insert(cursor, *gap);
        }
        Ok(())
    }

    fn events(
        &self,
        run: RunId,
        what: &Selection<'_>,
        span: Span,
        request: PageRequest,
    ) -> Result<Page<Stamped>> {
        let wanted = within(span, request);
        self.with(run, |recorded| match what {
            Selection::Kinds(kinds) => page(
                recorded
                    .events
                    .iter()
                    .filter(|(cursor, event)| wanted(cursor) && kinds.contains(&Kind::of(event)))
                    .map(|(cursor, _)| *cursor),
                request,
                |cursor| recorded.stamped(cursor),
            ),
            Selection::Series(series) => page(
                recorded.series.get(series).into_iter().flatten().copied().filter(wanted),
                request,
                |cursor| recorded.stamped(cursor),
            ),
        })
    }

    fn gaps(&self, run: RunId, span: Span, request: PageRequest) -> Result<Page<Gap>> {
        self.with(run, |recorded| {
            let found = recorded.gaps.keys().copied().filter(within(span, request));
            page(found, request, |cursor| recorded.gaps[&cursor])
        })
    }

    fn latest(&self, run: RunId, at: i64) -> Result<Vec<Stamped>> {
        self.with(run, |recorded| {
            let end = Cursor { t: at, seq: i64::MAX };
            let last = recorded.series.values().filter_map(|cursors| cursors.range(..=end).next_back());
            last.map(|cursor| recorded.stamped(*cursor)).collect()
        })
    }

    fn values(
        &self,
        run: RunId,
        figure: &Figure,
        span: Span,
        each: &mut dyn FnMut(i64, Reading),
    ) -> Result<()> {
        self.with(run, |recorded| {
            let wanted = within(span, PageRequest::default());
            for (cursor, event) in recorded.events.iter().filter(|(cursor, _)| wanted(cursor)) {
                figure.of(event, |value| {
                    if !value.is_nan() {
                        each(cursor.t, Reading::Sample(value));
                    }
                });
            }
        })
    }

    fn extent(&self, run: RunId, kind: Kind, span: Span) -> Result<Option<(i64, i64)>> {
        self.with(run, |recorded| {
            let wanted = within(span, PageRequest::default());
            let mut times = recorded
                .events
                .iter()
                .filter(|(cursor, event)| wanted(cursor) && Kind::of(event) == kind)
                .map(|(cursor, _)| cursor.t);
            let first = times.next()?;
            Some((first, times.next_back().unwrap_or(first)))
        })
    }
}
