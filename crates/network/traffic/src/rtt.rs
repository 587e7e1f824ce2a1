//! Round-trip times of a TCP connection, and its retransmission timeout (RFC 6298).

use std::time::Duration;

use cotorra_graph::Timestamp;

/// Timeout before the first round trip (RFC 6298, 2.1).
const INITIAL: Duration = Duration::from_secs(1);
/// Least share of variation in the timeout. RFC 6298 wants a timeout of 1 s at least. Linux has this, beside the smoothed round
/// trip (`TCP_RTO_MIN` in `tcp_rtt_estimator`).
const LEAST_VARIATION: Duration = Duration::from_millis(200);
/// Longest timeout: Linux's `TCP_RTO_MAX`.
const LONGEST: Duration = Duration::from_secs(120);

/// Estimates of the round trip.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct RoundTrips {
    smoothed: Option<Duration>,
    variation: Duration,
    least: Option<Duration>,
    /// Timeouts since the last sample, each of which doubles the next.
    timeouts: u32,
}

impl RoundTrips {
    /// Adds a round trip of a segment that was sent once (Karn's algorithm).
    pub(crate) fn add(&mut self, sample: Duration) {
        self.timeouts = 0;
        self.least = Some(self.least.map_or(sample, |least| least.min(sample)));
        let Some(smoothed) = self.smoothed else {
            (self.smoothed, self.variation) = (Some(sample), sample / 2);
            return;
        };
        self.variation = (self.variation * 3 + smoothed.abs_diff(sample)) / 4;
        self.smoothed = Some((smoothed * 7 + sample) / 8);
    }

    /// Doubles the timeout.
    pub(crate) fn back_off(&mut self) {
        self.timeouts += 1;
    }

    pub(crate) fn smoothed(&self) -> Option<Duration> {
        self.smoothed
    }

    pub(crate) fn least(&self) -> Option<Duration> {
        self.least
    }

    /// Returns the retransmission timeout.
    pub(crate) fn timeout(&self) -> Duration {
        let base =
            self.smoothed.map_or(INITIAL, |smoothed| smoothed + (self.variation * 4).max(LEAST_VARIATION));
        base.saturating_mul(1 << self.timeouts.min(10)).min(LONGEST)
    }
}

/// Returns a time in the unit of the option of timestamps.
pub(crate) fn milliseconds(now: Timestamp) -> u32 {
    (now.as_nanos() / 1_000_000) as u32
}

#[cfg(test)]
mod tests {
    use super::*;

    const fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    #[test]
    fn estimates_follow_rfc_6298_with_linuxs_least_variation() {
        let mut trips = RoundTrips::default();
        assert_eq!(trips.timeout(), ms(1000));
        trips.add(ms(160));
        assert_eq!((trips.smoothed(), trips.timeout()), (Some(ms(160)), ms(160 + 320)));
        trips.add(ms(80));
        // 7/8 · 160 + 1/8 · 80, and 3/4 · 80 + 1/4 · 80.
        assert_eq!((trips.smoothed(), trips.timeout()), (Some(ms(150)), ms(150 + 320)));
        (0..40).for_each(|_| trips.add(ms(80)));
        assert!(trips.timeout() < ms(285) && trips.timeout() >= ms(280), "{:?}", trips.timeout());
        trips.back_off();
        assert!(trips.timeout() >= ms(560));
        (0..20).for_each(|_| trips.back_off());
        assert_eq!((trips.timeout(), trips.least()), (LONGEST, Some(ms(80))));
    }
}
