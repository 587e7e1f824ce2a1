//! Runs, and what a history holds of one: events and gaps.

use std::{fmt, str::FromStr};

use cotorra_graph::{Stamped, Timestamp};
use serde::{Deserialize, Serialize};

/// The id of a run within its history.
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

/// Facts about a run that are known when it begins.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RunInfo {
    pub name: String,
    /// Seed of all randomness.
    pub seed: u64,
    /// Wall-clock time of the beginning, nanoseconds since 1970-01-01 UTC.
    pub started_at_unix_ns: i64,
    /// The testbed file as run.
    pub testbed: String,
}

/// A run in a history.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Run {
    pub id: RunId,
    #[serde(flatten)]
    pub info: RunInfo,
    /// Time of the end; `None` while the run goes on, and for good if it was killed or its last events could not be
    /// written.
    #[serde(rename = "ended_ns")]
    pub ended: Option<Timestamp>,
}

/// Events that were lost because the queue was full, or because no history can hold them: a time more than 292 years
/// after the run began, or NaN in a change of conditions.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Gap {
    /// Time of the earliest lost event.
    #[serde(rename = "from_ns")]
    pub from: Timestamp,
    /// Time of the latest lost event.
    #[serde(rename = "until_ns")]
    pub until: Timestamp,
    /// Number of lost events.
    pub events: u64,
}

impl Gap {
    /// Returns one gap that covers both.
    pub(crate) fn with(self, other: Self) -> Self {
        Self {
            from: self.from.min(other.from),
            until: self.until.max(other.until),
            events: self.events + other.events,
        }
    }
}

/// An event on its way into a history. [`Stamped::is_storable`] holds for it.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Entry {
    pub run: RunId,
    pub stamped: Stamped,
}
