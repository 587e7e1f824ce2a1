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
pub struct Page<T> {
    /// In the order of time; at the same time, in the order of recording.
    pub items: Vec<T>,
    /// Ask again from here.
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
