//! Rolls up old samples: of each series one point a step of time stays, with the count, the least, the greatest, the
//! mean and the last of its samples.
//!
//! A slice of time is read, and then written back by a few series at a time. What stays of them and what goes are one
//! transaction, so that a process that is killed leaves either, and recorders wait for no more than that.

use std::{
    collections::{BTreeMap, BTreeSet},
    time::Duration,
};

use cotorra_graph::{Retention, Stamped, Timestamp};

use super::History;
use crate::{
    codec::Fields,
    error::Result,
    kind::{Kind, Series},
    page::Cursor,
    retention::{Pruned, Retained, Thinned},
    rolled::Step,
    run::RunId,
    schema::STRETCH,
    store::Span,
};

/// Samples that one transaction removes, about.
const AT_ONCE: usize = 5_000;

/// Samples in one read.
const READ: usize = 10_000;

impl History {
    /// Returns how far samples of a run were rolled up, by kind; nothing if all are as recorded.
    ///
    /// # Errors
    /// See [`History`].
    pub fn retained(&self, run: RunId) -> Result<Vec<Retained>> {
        self.store.retained(run)
    }

    /// Keeps to a retention at a time of the run: rolls up old samples of a kind, and drops old points. With `dry`, only
    /// counts them. `go_on` is called from time to time, and stops the work by returning false.
    ///
    /// The last 10 s of a run that goes on are left alone. Recording and reading may go on meanwhile. A history in memory
    /// keeps everything.
    ///
    /// # Errors
    /// See [`History`].
    pub fn retain(
        &self,
        run: RunId,
        kind: Kind,
        retention: &Retention,
        now: Timestamp,
        dry: bool,
        mut go_on: impl FnMut() -> bool,
    ) -> Result<Pruned> {
        let mut pruned = Pruned::default();
        let found = self.store.run(run)?;
        let ever = Span { from: 0, until: i64::MAX };
        let Some((first, last)) = self.store.extent(run, kind, ever)? else { return Ok(pruned) };
        if !Kind::SAMPLED.contains(&kind) || !Retention::is_step(retention.step) {
            return Ok(pruned);
        }
        let nanos = |d: Duration| i64::try_from(d.as_nanos()).unwrap_or(i64::MAX);
        let now = i64::try_from(now.as_nanos()).unwrap_or(i64::MAX);
        let open = if found.ended.is_some() { i64::MAX } else { (last - 2 * STRETCH).max(0) };
        let step = nanos(retention.step);
        // Whole steps, and at least a stretch.
        let slice = step * (STRETCH + step - 1).div_euclid(step);
        let before = |age: Duration| (now - nanos(age)).min(open) / slice * slice;
        let end = (last / slice + 1).saturating_mul(slice);
        let known = self.store.retained(run)?.into_iter().find(|known| known.kind == kind);
        let mut progress = known.unwrap_or(Retained {
            kind,
            rolled_up_to: Timestamp::ZERO,
            step: Duration::ZERO,
            dropped_to: Timestamp::ZERO,
        });
        let time = |t: i64| Timestamp::from_nanos(t.cast_unsigned());

        let drop_to = retention.keep.map_or(0, before).min(end);
        let from = (progress.dropped_to.as_nanos().cast_signed()).max(first) / slice * slice;
        let mut at = from;
        while at < drop_to && go_on() {
            let until = at.saturating_add(slice);
            pruned.dropped += self.slice(run, kind, Span { from: at, until: until - 1 }, None, dry)?.0;
            at = until;
            progress.dropped_to = time(at);
            if !dry {
                self.store.note_retained(run, &progress)?;
            }
        }
        let roll_to = before(retention.raw).min(end);
        let mut at = (progress.rolled_up_to.as_nanos().cast_signed().max(first).max(drop_to)) / slice * slice;
        while at < roll_to && go_on() {
            let until = at.saturating_add(slice);
            let (gone, points) =
                self.slice(run, kind, Span { from: at, until: until - 1 }, Some(step), dry)?;
            pruned.rolled_up += gone + points;
            pruned.points += points;
            at = until;
            (progress.rolled_up_to, progress.step) = (time(at), retention.step);
            if !dry {
                self.store.note_retained(run, &progress)?;
            }
        }
        Ok(pruned)
    }

    /// Rolls up a slice of time, or drops it if there is no step. Returns the number of samples removed, and of those
    /// that stay as the last of a point.
    fn slice(&self, run: RunId, kind: Kind, span: Span, step: Option<i64>, dry: bool) -> Result<(u64, u64)> {
        /// Samples of a series, and their steps.
        #[derive(Default)]
        struct Samples {
            cursors: Vec<Cursor>,
            steps: BTreeMap<i64, (Cursor, Step)>,
        }
        let mut all: BTreeMap<Series, Samples> = BTreeMap::new();
        let mut after = Cursor::before(span.from);
        loop {
            let rows = self.store.samples(run, kind, span, after, READ, step.is_some())?;
            let more = rows.len() == READ;
            for (cursor, event) in rows {
                let Some(series) = event.series() else { continue };
                let its = all.entry(series).or_default();
                its.cursors.push(cursor);
                if let Some(step) = step {
                    let (mut row, mut children) = (Fields::default(), Fields::default());
                    let stamped = Stamped { at: Timestamp::from_nanos(cursor.t.cast_unsigned()), event };
                    stamped.put(&mut row, &mut children);
                    let (last, gathered) =
                        its.steps.entry(cursor.t / step).or_insert_with(|| (cursor, Step::default()));
                    *last = cursor;
                    gathered.push(kind, &row.0, &children.0);
                }
                after = cursor;
            }
            if !more {
                break;
            }
        }
        let (mut gone, mut points) = (0, 0);
        let mut thinned: Vec<Thinned> = Vec::new();
        for (series, Samples { mut cursors, steps }) in all {
            let mut stretches: BTreeMap<i64, Option<Vec<u8>>> =
                cursors.iter().map(|cursor| (cursor.t / STRETCH, None)).collect();
            let last_seq = cursors.iter().map(|cursor| cursor.seq).max().unwrap_or(-1);
            for (last, step) in steps.values() {
                let bytes = stretches.entry(last.t / STRETCH).or_default().get_or_insert_default();
                step.write(last.t, bytes);
            }
            points += steps.len() as u64;
            let stay: BTreeSet<Cursor> = steps.values().map(|(last, _)| *last).collect();
            cursors.retain(|cursor| !stay.contains(cursor));
            gone += cursors.len() as u64;
            thinned.push(Thinned { series, stretches, last_seq, gone: cursors, drops: step.is_none() });
            let samples: usize = thinned.iter().map(|its| its.gone.len()).sum();
            if samples >= AT_ONCE && !dry {
                self.store.thin(run, kind, &std::mem::take(&mut thinned))?;
            }
        }
        if !thinned.is_empty() && !dry {
            self.store.thin(run, kind, &thinned)?;
        }
        Ok((gone, points))
    }
}
