//! The seam behind which histories are kept. An engine is told events in batches and asked for them back; what a
//! question means is said here once, and every engine gives the same answer.

use std::{fmt, str::FromStr};

use cotorra_graph::{Direction, Event, LinkId, NodeId, Stamped, Timestamp, VnfId};
use serde::{Deserialize, Serialize};

use crate::error::Result;

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
    pub ended: Option<Timestamp>,
}

/// Where a page ends and the next one begins: an event's time, and its place in the order of recording.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Cursor {
    pub(crate) t: i64,
    pub(crate) seq: i64,
}

impl Cursor {
    /// Before every event at `t` or later.
    pub(crate) const fn before(t: i64) -> Self {
        Self { t, seq: -1 }
    }
}

impl fmt::Display for Cursor {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}-{}", self.t, self.seq)
    }
}

/// Why a text is no cursor.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` is not a cursor: give back the `next` of the page before as it was")]
pub struct InvalidCursor(String);

impl FromStr for Cursor {
    type Err = InvalidCursor;
    fn from_str(text: &str) -> std::result::Result<Self, InvalidCursor> {
        let number = |part: &str| part.parse::<u64>().ok().and_then(|n| i64::try_from(n).ok());
        text.split_once('-')
            .and_then(|(t, seq)| Some(Self { t: number(t)?, seq: number(seq)? }))
            .ok_or_else(|| InvalidCursor(text.chars().take(60).collect()))
    }
}

impl TryFrom<String> for Cursor {
    type Error = InvalidCursor;
    fn try_from(text: String) -> std::result::Result<Self, InvalidCursor> {
        text.parse()
    }
}

impl From<Cursor> for String {
    fn from(cursor: Cursor) -> Self {
        cursor.to_string()
    }
}

/// Part of an answer. With a `next` there is more.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Page<T> {
    /// In the order of time; at the same time, in the order of recording.
    pub items: Vec<T>,
    /// Ask again from here.
    #[cfg_attr(feature = "openapi", schema(value_type = Option<String>))]
    pub next: Option<Cursor>,
}

impl<T> Page<T> {
    pub(crate) fn map<U>(self, item: impl FnMut(T) -> U) -> Page<U> {
        Page { items: self.items.into_iter().map(item).collect(), next: self.next }
    }
}

/// Which part of an answer is wanted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PageRequest {
    /// How many items at most; counted as 1 … [`Self::MAX`].
    pub limit: usize,
    /// The `next` of the page before; `None` for the first page.
    pub after: Option<Cursor>,
}

impl PageRequest {
    /// No page is longer.
    pub const MAX: usize = 10_000;

    /// The first page.
    pub const fn first(limit: usize) -> Self {
        Self { limit, after: None }
    }

    /// The page that begins at a cursor.
    pub const fn after(cursor: Cursor, limit: usize) -> Self {
        Self { limit, after: Some(cursor) }
    }

    pub(crate) fn size(self) -> usize {
        self.limit.clamp(1, Self::MAX)
    }
}

impl Default for PageRequest {
    /// The first 1000.
    fn default() -> Self {
        Self::first(1000)
    }
}

/// Events that were lost, never silently: the queue was full, or no history can hold what they say (a time more
/// than 292 years after the run began, NaN in a change of conditions).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Gap {
    /// Time of the earliest that is missing.
    pub from: Timestamp,
    /// Time of the latest that is missing.
    pub until: Timestamp,
    /// How many are.
    pub events: u64,
}

macro_rules! kinds {
    ($($(#[$doc:meta])* $kind:ident = $name:literal,)*) => {
        /// Kinds of events, one for each variant of [`Event`].
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
        #[serde(rename_all = "snake_case")]
        pub enum Kind { $($(#[$doc])* $kind,)* }

        impl Kind {
            /// All of them.
            pub const ALL: [Self; [$(Self::$kind),*].len()] = [$(Self::$kind),*];

            /// The name that [`Event`] has in JSON, and its table in the schema.
            pub const fn as_str(self) -> &'static str {
                match self { $(Self::$kind => $name),* }
            }
        }
    };
}

kinds! {
    /// κ(r).
    Robot = "robot",
    /// ι(R).
    Radio = "radio",
    /// d, λ, ψ, δ.
    Link = "link",
    /// a(n).
    Placement = "placement",
    /// a(n1,n2).
    VirtualLink = "virtual_link",
    /// Service times.
    ServiceTime = "service_time",
    /// Finished handovers.
    Handover = "handover",
    /// Robots without a radio unit.
    Detached = "detached",
    /// Finished scans.
    Scanned = "scanned",
    /// Life cycle of VNFs.
    Vnf = "vnf",
    /// Decisions of plug-ins.
    Decision = "decision",
    /// Plug-ins that were cut off.
    PluginFault = "plugin_fault",
    /// The emulator's lateness.
    Lateness = "lateness",
    /// Robots at the end of their walk.
    WalkFinished = "walk_finished",
    /// Notices.
    Notice = "notice",
}

impl Kind {
    /// The kind of an event.
    pub const fn of(event: &Event) -> Self {
        match event {
            Event::Robot(_) => Self::Robot,
            Event::Radio(_) => Self::Radio,
            Event::Link(_) => Self::Link,
            Event::Placement(_) => Self::Placement,
            Event::VirtualLink(_) => Self::VirtualLink,
            Event::ServiceTime(_) => Self::ServiceTime,
            Event::Handover(_) => Self::Handover,
            Event::Detached { .. } => Self::Detached,
            Event::Scanned { .. } => Self::Scanned,
            Event::Vnf(_) => Self::Vnf,
            Event::Decision(_) => Self::Decision,
            Event::PluginFault { .. } => Self::PluginFault,
            Event::Lateness(_) => Self::Lateness,
            Event::WalkFinished { .. } => Self::WalkFinished,
            Event::Notice { .. } => Self::Notice,
        }
    }
}

impl FromStr for Kind {
    type Err = InvalidKind;
    fn from_str(name: &str) -> std::result::Result<Self, InvalidKind> {
        let found = Self::ALL.into_iter().find(|k| k.as_str() == name);
        found.ok_or_else(|| InvalidKind(name.chars().take(60).collect()))
    }
}

/// Why a text is no kind.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` is not a kind of event; one of {list}", list = Kind::ALL.map(Kind::as_str).join(", "))]
pub struct InvalidKind(String);

/// What has a state that lasts until its next event: a part of the graph's embedding.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(crate) enum Series {
    Robot(NodeId),
    Radio(NodeId),
    Link(LinkId, Direction),
    Placement(VnfId),
    VirtualLink(VnfId, VnfId),
}

impl Series {
    /// Kinds of which series are made.
    pub const KINDS: [Kind; 5] = [Kind::Robot, Kind::Radio, Kind::Link, Kind::Placement, Kind::VirtualLink];

    /// The series that an event belongs to.
    pub fn of(event: &Event) -> Option<Self> {
        Some(match event {
            Event::Robot(context) => Self::Robot(context.robot.clone()),
            Event::Radio(context) => Self::Radio(context.radio_unit.clone()),
            Event::Link(context) => Self::Link(context.link.clone(), context.direction),
            Event::Placement(placement) => Self::Placement(placement.vnf.clone()),
            Event::VirtualLink(mapping) => Self::VirtualLink(mapping.from.clone(), mapping.to.clone()),
            _ => return None,
        })
    }

    pub const fn kind(&self) -> Kind {
        match self {
            Self::Robot(_) => Kind::Robot,
            Self::Radio(_) => Kind::Radio,
            Self::Link(..) => Kind::Link,
            Self::Placement(_) => Kind::Placement,
            Self::VirtualLink(..) => Kind::VirtualLink,
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
}

#[cfg(test)]
mod tests {
    use proptest::{collection::vec, prelude::*};

    use super::*;
    use crate::{
        error::Error,
        memory::Memory,
        sqlite::Sqlite,
        testing::{run_info, stamped, time},
    };

    /// Both engines, with two runs each: the first is asked, the second is in the way.
    fn engines(folder: &tempfile::TempDir) -> Vec<(Box<dyn Store>, RunId, RunId)> {
        let sqlite = Sqlite::open(&folder.path().join("history.sqlite")).unwrap();
        let stores: [Box<dyn Store>; 2] = [Box::<Memory>::default(), Box::new(sqlite)];
        let prepared = stores.into_iter().map(|store| {
            let run = store.begin_run(&run_info("asked")).unwrap();
            let other = store.begin_run(&run_info("other")).unwrap();
            (store, run, other)
        });
        prepared.collect()
    }

    fn append(store: &dyn Store, run: RunId, other: RunId, events: &[Stamped], batch: usize) {
        for batch in events.chunks(batch) {
            let entries: Vec<_> = batch
                .iter()
                .flat_map(|stamped| [run, other].map(|run| Entry { run, stamped: stamped.clone() }))
                .collect();
            store.append(&entries, &[]).unwrap();
        }
    }

    /// All pages of an answer, one after the other.
    fn pages<T>(limit: usize, ask: impl Fn(PageRequest) -> Page<T>) -> Vec<T> {
        let mut all = Vec::new();
        let mut request = PageRequest::first(limit);
        loop {
            let page = ask(request);
            assert!(page.items.len() <= limit);
            all.extend(page.items);
            match page.next {
                Some(next) => request = PageRequest::after(next, limit),
                None => return all,
            }
        }
    }

    fn sorted(events: &[Stamped]) -> Vec<Stamped> {
        let mut events = events.to_vec();
        events.sort_by_key(|stamped| stamped.at);
        events
    }

    const ALL: Span = Span { from: 0, until: i64::MAX };

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(48))]

        /// What was recorded is read back equal, in the order of time and then of recording, whatever the clock did
        /// and whatever the size of batches and pages.
        #[test]
        fn gives_back_what_it_was_given(events in vec(stamped(), 0..60), batch in 1..20_usize, limit in 1..20_usize) {
            let folder = tempfile::tempdir().unwrap();
            for (store, run, other) in engines(&folder) {
                append(&*store, run, other, &events, batch);
                let what = Selection::Kinds(&Kind::ALL);
                let all = pages(limit, |page| store.events(run, &what, ALL, page).unwrap());
                prop_assert_eq!(all, sorted(&events));
            }
        }

        #[test]
        fn selects_kinds_and_times(
            events in vec(stamped(), 0..60),
            kinds in proptest::sample::subsequence(Kind::ALL.to_vec(), 1..5),
            (from, until) in (time(), time()),
            limit in 1..20_usize,
        ) {
            let folder = tempfile::tempdir().unwrap();
            let span = Span { from: from.as_nanos() as i64, until: until.as_nanos() as i64 };
            for (store, run, other) in engines(&folder) {
                append(&*store, run, other, &events, 10);
                let what = Selection::Kinds(&kinds);
                let found = pages(limit, |page| store.events(run, &what, span, page).unwrap());
                let mut wanted = sorted(&events);
                wanted.retain(|s| from <= s.at && s.at <= until && kinds.contains(&Kind::of(&s.event)));
                prop_assert_eq!(found, wanted);
            }
        }

        #[test]
        fn selects_series_and_times(
            events in vec(stamped(), 0..60),
            (from, until) in (time(), time()),
            limit in 1..5_usize,
        ) {
            let folder = tempfile::tempdir().unwrap();
            let span = Span { from: from.as_nanos() as i64, until: until.as_nanos() as i64 };
            for (store, run, other) in engines(&folder) {
                append(&*store, run, other, &events, 10);
                for series in events.iter().filter_map(|s| Series::of(&s.event)) {
                    let what = Selection::Series(series.clone());
                    let found = pages(limit, |page| store.events(run, &what, span, page).unwrap());
                    let mut wanted = sorted(&events);
                    wanted.retain(|s| {
                        from <= s.at && s.at <= until && Series::of(&s.event).as_ref() == Some(&series)
                    });
                    prop_assert_eq!(found, wanted);
                }
            }
        }

        /// The state at a time holds the last of every series, and nothing else.
        #[test]
        fn knows_the_latest_of_every_series(events in vec(stamped(), 0..60), at in time(), batch in 1..20_usize) {
            let folder = tempfile::tempdir().unwrap();
            let wanted: std::collections::BTreeMap<Series, Stamped> = sorted(&events)
                .into_iter()
                .filter(|stamped| stamped.at <= at)
                .filter_map(|stamped| Some((Series::of(&stamped.event)?, stamped)))
                .collect();
            for (store, run, other) in engines(&folder) {
                append(&*store, run, other, &events, batch);
                let mut found = store.latest(run, at.as_nanos() as i64).unwrap();
                found.sort_by_key(|stamped| Series::of(&stamped.event));
                prop_assert_eq!(found, wanted.values().cloned().collect::<Vec<_>>());
            }
        }

        #[test]
        fn tells_gaps(gaps in vec((time(), time(), 1..u64::MAX), 0..10), limit in 1..5_usize) {
            let folder = tempfile::tempdir().unwrap();
            let gaps: Vec<Gap> = gaps
                .into_iter()
                .map(|(a, b, events)| Gap { from: a.min(b), until: a.max(b), events })
                .collect();
            for (store, run, other) in engines(&folder) {
                let entries: Vec<_> = gaps.iter().flat_map(|gap| [(run, *gap), (other, *gap)]).collect();
                store.append(&[], &entries).unwrap();
                let mut wanted = gaps.clone();
                wanted.sort_by_key(|gap| gap.from);
                prop_assert_eq!(pages(limit, |page| store.gaps(run, ALL, page).unwrap()), wanted);
            }
        }

        #[test]
        fn a_cursor_is_read_as_it_is_written(t in 0..=i64::MAX, seq in 0..=i64::MAX) {
            let cursor = Cursor { t, seq };
            prop_assert_eq!(cursor.to_string().parse(), Ok(cursor));
        }
    }

    #[test]
    fn refuses_what_is_no_cursor() {
        for text in ["", "-", "1", "1-", "-1-1", "1-x", "99999999999999999999-1"] {
            let error = text.parse::<Cursor>().unwrap_err();
            assert_eq!(
                error.to_string(),
                format!("`{text}` is not a cursor: give back the `next` of the page before as it was")
            );
        }
    }

    #[test]
    fn lists_runs_and_knows_none_that_is_not_there() {
        let folder = tempfile::tempdir().unwrap();
        for (store, first, second) in engines(&folder) {
            store.end_run(first, Timestamp::from_nanos(7)).unwrap();
            let runs = store.runs(None, 10).unwrap();
            assert_eq!(runs.iter().map(|run| run.id).collect::<Vec<_>>(), [first, second]);
            assert_eq!(runs[0].info, run_info("asked"));
            assert_eq!(runs[0].ended, Some(Timestamp::from_nanos(7)));
            assert_eq!(runs[1].ended, None);
            assert_eq!(store.runs(Some(first), 10).unwrap(), runs[1..]);
            assert_eq!(store.runs(None, 1).unwrap(), runs[..1]);

            let nobody = RunId(99);
            assert!(matches!(store.run(nobody), Err(Error::NoSuchRun(_))));
            assert!(matches!(store.end_run(nobody, Timestamp::ZERO), Err(Error::NoSuchRun(_))));
            assert!(matches!(store.latest(nobody, 0), Err(Error::NoSuchRun(_))));
            assert!(matches!(store.gaps(nobody, ALL, PageRequest::default()), Err(Error::NoSuchRun(_))));
        }
    }

    proptest! {
        #[test]
        fn a_kind_is_named_as_its_event_is_in_json(stamped in stamped()) {
            let kind = Kind::of(&stamped.event);
            let json = serde_json::to_value(&stamped).unwrap();
            prop_assert_eq!(&json["event"], kind.as_str());
            prop_assert_eq!(kind.as_str().parse(), Ok(kind));
            prop_assert_eq!(serde_json::to_value(kind).unwrap(), kind.as_str());
        }
    }

    #[test]
    fn refuses_what_is_no_kind() {
        let error = "weather".parse::<Kind>().unwrap_err();
        assert!(error.to_string().starts_with("`weather` is not a kind of event; one of robot, radio, link"));
    }
}
