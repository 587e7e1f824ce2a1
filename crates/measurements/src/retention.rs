//! How long samples are kept as they were recorded, and what is left of them afterwards: of each series one point a step
//! of time, with the count, the least, the greatest, the mean and the last of its samples.
//!
//! A slice of time is read, and then written back by a few series at a time: what is left of them and what is gone are
//! one transaction, so that a process that is killed leaves either, and those who record wait for no more than that.

use std::{
    collections::{BTreeMap, BTreeSet},
    time::Duration,
};

use cotorra_graph::{Retention, Timestamp, millis};
use serde::{Deserialize, Serialize};

use crate::{
    History, Kind, RunId,
    codec::{self, Fields},
    error::Result,
    kind::Series,
    page::Cursor,
    rolled::Step,
    schema::STRETCH,
    store::Span,
};

/// How far samples of a kind were rolled up.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Retained {
    /// Of which kind.
    #[cfg_attr(feature = "openapi", schema(value_type = String))]
    pub kind: Kind,
    /// Samples before this time are rolled up, nanoseconds since the run began.
    #[serde(rename = "rolled_up_to_ns")]
    pub rolled_up_to: Timestamp,
    /// Into points so far apart.
    #[serde(rename = "step_ms", with = "millis")]
    #[cfg_attr(feature = "openapi", schema(value_type = f64))]
    pub step: Duration,
    /// Before this time there is nothing left.
    #[serde(rename = "dropped_to_ns")]
    pub dropped_to: Timestamp,
}

/// What keeping to a [`Retention`] does, or would do.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Pruned {
    /// Samples that become parts of points.
    pub rolled_up: u64,
    /// Points that they become.
    pub points: u64,
    /// Samples and points of which nothing is left.
    pub dropped: u64,
}

/// What becomes of one series in a slice of time.
#[derive(Debug)]
pub(crate) struct Thinned {
    pub series: Series,
    /// By stretch, what to put behind its steps; `None` if no sample is left in it.
    pub stretches: BTreeMap<i64, Option<Vec<u8>>>,
    /// Samples of the series after these are not in the steps.
    pub last_seq: i64,
    /// Samples that go.
    pub gone: Vec<Cursor>,
    /// Whether its steps go as well.
    pub drops: bool,
}

/// Samples that go in one transaction, about.
const AT_ONCE: usize = 5_000;

/// Samples that are read at a time.
const READ: usize = 10_000;

impl Retained {
    /// From the columns of a row; `None` if they are none.
    pub(crate) fn of((kind, rolled_up_to, step_ms, dropped_to): (i64, i64, f64, i64)) -> Option<Self> {
        let time = |t: i64| Timestamp::from_nanos(t.cast_unsigned());
        Some(Self {
            kind: *Kind::ALL.get(usize::try_from(kind).ok()?)?,
            rolled_up_to: time(rolled_up_to),
            step: millis::duration(step_ms).ok()?,
            dropped_to: time(dropped_to),
        })
    }

    /// The columns of its row.
    pub(crate) fn columns(&self) -> (i64, i64, f64, i64) {
        let nanos = |t: Timestamp| t.as_nanos().cast_signed();
        (self.kind as i64, nanos(self.rolled_up_to), millis::of(self.step), nanos(self.dropped_to))
    }
}

impl History {
    /// How far samples of a run were rolled up, by kind; none if all are as they were recorded.
    ///
    /// # Errors
    /// See [`History`].
    pub fn retained(&self, run: RunId) -> Result<Vec<Retained>> {
        self.store.retained(run)
    }

    /// Keeps to a retention at a time of the run: rolls up samples of a kind that are older, and drops points that are.
    /// With `dry`, it only says what it would do. `go_on` is asked now and then whether to.
    ///
    /// Of a run that goes on, nothing of the last 10 s is touched. Whoever records or asks meanwhile is in nobody's way. A
    /// history in memory keeps everything.
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
        let mut told = known.unwrap_or(Retained {
            kind,
            rolled_up_to: Timestamp::ZERO,
            step: Duration::ZERO,
            dropped_to: Timestamp::ZERO,
        });
        let time = |t: i64| Timestamp::from_nanos(t.cast_unsigned());

        let drop_to = retention.keep.map_or(0, before).min(end);
        let from = (told.dropped_to.as_nanos().cast_signed()).max(first) / slice * slice;
        let mut at = from;
        while at < drop_to && go_on() {
            let until = at.saturating_add(slice);
            pruned.dropped += self.slice(run, kind, Span { from: at, until: until - 1 }, None, dry)?.0;
            at = until;
            told.dropped_to = time(at);
            if !dry {
                self.store.note_retained(run, &told)?;
            }
        }
        let roll_to = before(retention.raw).min(end);
        let mut at = (told.rolled_up_to.as_nanos().cast_signed().max(first).max(drop_to)) / slice * slice;
        while at < roll_to && go_on() {
            let until = at.saturating_add(slice);
            let (gone, points) =
                self.slice(run, kind, Span { from: at, until: until - 1 }, Some(step), dry)?;
            pruned.rolled_up += gone + points;
            pruned.points += points;
            at = until;
            (told.rolled_up_to, told.step) = (time(at), retention.step);
            if !dry {
                self.store.note_retained(run, &told)?;
            }
        }
        Ok(pruned)
    }

    /// Rolls up a slice of time, or drops it without a step; gives how many samples go and how many stay as the last of a
    /// point.
    fn slice(&self, run: RunId, kind: Kind, span: Span, step: Option<i64>, dry: bool) -> Result<(u64, u64)> {
        /// The samples of a series: cursors, and their steps.
        #[derive(Default)]
        struct Its {
            cursors: Vec<Cursor>,
            steps: BTreeMap<i64, (Cursor, Step)>,
        }
        let mut all: BTreeMap<Series, Its> = BTreeMap::new();
        let mut after = Cursor::before(span.from);
        loop {
            let rows = self.store.samples(run, kind, span, after, READ, step.is_some())?;
            let more = rows.len() == READ;
            for (cursor, event) in &rows {
                let Some(series) = Series::of(event) else { continue };
                let its = all.entry(series).or_default();
                its.cursors.push(*cursor);
                if let Some(step) = step {
                    let (mut row, mut children) = (Fields::default(), Fields::default());
                    codec::encode(event, &mut row, &mut children);
                    let (last, gathered) =
                        its.steps.entry(cursor.t / step).or_insert_with(|| (*cursor, Step::default()));
                    *last = *cursor;
                    gathered.push(kind, &row.0, &children.0);
                }
                after = *cursor;
            }
            if !more {
                break;
            }
        }
        let (mut gone, mut points) = (0, 0);
        let mut thinned: Vec<Thinned> = Vec::new();
        for (series, Its { mut cursors, steps }) in all {
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
