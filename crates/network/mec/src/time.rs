//! Times of the standards: calendar times, which the run's times are converted to.

use cotorra_graph::Timestamp;
use serde::{Deserialize, Serialize};

/// Time since 1970-01-01 UTC.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct TimeStamp {
    /// Whole seconds.
    pub seconds: u32,
    /// Nanoseconds of the second.
    #[schema(maximum = 999_999_999)]
    pub nano_seconds: u32,
}

/// Start of a run, to convert its times to calendar times.
#[derive(Debug, Clone, Copy, Default)]
pub struct Epoch {
    /// Nanoseconds since 1970-01-01 UTC; 0 in virtual time, which has no calendar.
    pub unix_ns: u64,
}

impl Epoch {
    /// Converts a time of the run to calendar time.
    pub fn at(self, now: Timestamp) -> TimeStamp {
        let ns = self.unix_ns.saturating_add(now.as_nanos());
        let seconds = u32::try_from(ns / 1_000_000_000).unwrap_or(u32::MAX);
        TimeStamp { seconds, nano_seconds: (ns % 1_000_000_000) as u32 }
    }

    /// Converts calendar time to a time of the run; its start for earlier times.
    pub fn run_time(self, stamp: TimeStamp) -> Timestamp {
        let ns = u64::from(stamp.seconds) * 1_000_000_000 + u64::from(stamp.nano_seconds);
        Timestamp::from_nanos(ns.saturating_sub(self.unix_ns))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn calendar_and_run_times_convert_both_ways() {
        let epoch = Epoch { unix_ns: 1_700_000_000_250_000_000 };
        let stamp = epoch.at(Timestamp::from_nanos(1_900_000_000));
        assert_eq!(stamp, TimeStamp { seconds: 1_700_000_002, nano_seconds: 150_000_000 });
        assert_eq!(epoch.run_time(stamp), Timestamp::from_nanos(1_900_000_000));
        assert_eq!(epoch.run_time(TimeStamp { seconds: 1, nano_seconds: 0 }), Timestamp::ZERO);
    }
}
