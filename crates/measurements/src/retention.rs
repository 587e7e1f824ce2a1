//! Results of keeping to a [`cotorra_graph::Retention`]: how far samples were rolled up, and what that removes.

use std::{collections::BTreeMap, time::Duration};

use cotorra_graph::{Timestamp, millis};
use serde::{Deserialize, Serialize};

use crate::{
    kind::{Kind, Series},
    page::Cursor,
};

/// Progress of rolling up samples of a kind.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Retained {
    /// Kind of the samples.
    #[schema(value_type = String)]
    pub kind: Kind,
    /// Samples before this time are rolled up, nanoseconds since the run began.
    #[serde(rename = "rolled_up_to_ns")]
    pub rolled_up_to: Timestamp,
    /// Time from point to point.
    #[serde(rename = "step_ms", with = "millis")]
    #[schema(value_type = f64)]
    pub step: Duration,
    /// Samples and points before this time are removed, nanoseconds since the run began.
    #[serde(rename = "dropped_to_ns")]
    pub dropped_to: Timestamp,
}

/// Result of keeping to a [`cotorra_graph::Retention`], or of a dry run of that.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Pruned {
    /// Samples that were rolled up.
    pub rolled_up: u64,
    /// Points made of them.
    pub points: u64,
    /// Samples and points that were removed.
    pub dropped: u64,
}

/// Change of one series in a slice of time.
#[derive(Debug)]
pub(crate) struct Thinned {
    pub series: Series,
    /// Steps to append to those of each stretch; `None` if no sample is left in it.
    pub stretches: BTreeMap<i64, Option<Vec<u8>>>,
    /// Last `seq` of the samples in the steps.
    pub last_seq: i64,
    /// Samples to remove.
    pub gone: Vec<Cursor>,
    /// Whether earlier steps are removed as well.
    pub drops: bool,
}

impl Retained {
    /// Reads the columns of a row; `None` if they are invalid.
    pub(crate) fn of((kind, rolled_up_to, step_ms, dropped_to): (i64, i64, f64, i64)) -> Option<Self> {
        let time = |t: i64| Timestamp::from_nanos(t.cast_unsigned());
        Some(Self {
            kind: *Kind::ALL.get(usize::try_from(kind).ok()?)?,
            rolled_up_to: time(rolled_up_to),
            step: millis::duration(step_ms).ok()?,
            dropped_to: time(dropped_to),
        })
    }

    /// Returns the columns of the row.
    pub(crate) fn columns(&self) -> (i64, i64, f64, i64) {
        let nanos = |t: Timestamp| t.as_nanos().cast_signed();
        (self.kind as i64, nanos(self.rolled_up_to), millis::of(self.step), nanos(self.dropped_to))
    }
}
