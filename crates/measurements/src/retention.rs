//! Results of keeping to a [`cotorra_graph::Retention`]: how far samples were rolled up, and what that removes.

use std::{collections::BTreeMap, time::Duration};

use cotorra_graph::{Timestamp, millis};
use serde::{Deserialize, Serialize};

use crate::{
    kind::{Kind, Series},
    page::Cursor,
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
