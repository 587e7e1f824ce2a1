//! Figures of both directions of a link.

use std::time::Duration;

/// Figures of both directions of a link.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RoundTrip {
    /// Configured delay there and back.
    pub configured: Duration,
    /// Configured rate of the slower direction, bit/s; infinite without a limit.
    pub rate_bps: f64,
    /// What was measured beyond that.
    pub beyond: Beyond,
}

impl RoundTrip {
    /// Returns the rate that a service can use beside others, bit/s; below 0 where others declare more than the link carries.
    ///
    /// It is the rate less the larger of two: the metered load without what the service itself declares over the link, and what
    /// others declare, reserved or not.
    pub fn free_bps(&self, own_bps: f64, others_bps: f64) -> f64 {
        self.rate_bps - others_bps.max(self.beyond.load_bps - own_bps)
    }
}

/// What was measured beyond the configuration of a link.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Beyond {
    /// Further delay there and back.
    pub delay: Duration,
    /// Load of the busier direction, bit/s.
    pub load_bps: f64,
    /// Probability that a packet and its answer cross.
    pub delivery: f64,
}

/// Nothing.
impl Default for Beyond {
    fn default() -> Self {
        Self { delay: Duration::ZERO, load_bps: 0.0, delivery: 1.0 }
    }
}

impl Beyond {
    /// Returns the worse of each figure.
    pub(crate) fn worse(self, other: Self) -> Self {
        Self {
            delay: self.delay.max(other.delay),
            load_bps: self.load_bps.max(other.load_bps),
            delivery: self.delivery.min(other.delivery),
        }
    }
}
