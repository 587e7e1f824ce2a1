//! Active measurements of links: their settings and results. Passive ones are part of a link's context.

use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::units::{BitRate, millis};

/// Probing by STAMP (RFC 8762) of wired links, and of each robot's present wireless link.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Probing {
    /// Time from one probe of a link to the next; longer where probes would take more than 1 % of its rate, or those
    /// of all robots more than 1 % of a channel's time.
    #[serde(rename = "interval_ms", with = "millis")]
    pub interval: Duration,
    /// Time over which results are averaged.
    #[serde(rename = "window_ms", with = "millis")]
    pub window: Duration,
}

impl Probing {
    /// As many probes as a window may hold.
    pub const MOST: u32 = 10_000;
    /// The shortest interval.
    pub const SHORTEST: Duration = Duration::from_millis(1);
}

/// Two probes a second, over ten seconds.
impl Default for Probing {
    fn default() -> Self {
        Self { interval: Duration::from_millis(500), window: Duration::from_secs(10) }
    }
}

/// Result of probes of one direction of a link, each figure with its age.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Probed {
    /// Mean delay; `None` if no probe came back.
    #[serde(rename = "delay_ms", default, with = "millis::option")]
    #[schema(value_type = Option<f64>)]
    pub delay: Option<Duration>,
    /// Mean difference of the delays of two probes in a row (RFC 3393; RFC 5481, section 4.1).
    #[serde(rename = "jitter_ms", default, with = "millis::option")]
    #[schema(value_type = Option<f64>)]
    pub jitter: Option<Duration>,
    /// Age of both: how long before this was told the latest probe came back.
    #[serde(rename = "delay_age_ms", default, with = "millis::option")]
    #[schema(value_type = Option<f64>)]
    pub delay_age: Option<Duration>,
    /// Share of the probes that this direction lost, from 0 to 1; `None` if none came to it.
    pub loss: Option<f64>,
    /// Age of the loss: how long before this was told the latest probe was sent of which it is known.
    #[serde(rename = "loss_age_ms", with = "millis")]
    #[schema(value_type = f64)]
    pub loss_age: Duration,
}

/// A test of what a direction of a link carries: packets of 1500 bytes at a rate, for a while. It is bounded: 10 s at
/// most, 1 Gbit/s at most, one at a time, and then four times as long none.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ThroughputTest {
    /// Time for which packets are sent, 10 ms to 10 s.
    #[serde(rename = "duration_ms", default = "ThroughputTest::second", with = "millis")]
    #[schema(value_type = f64)]
    pub duration: Duration,
    /// Rate at which packets are sent, bit/s. By default a tenth above the link's configured rate, and 1 Gbit/s at
    /// most.
    #[serde(rename = "rate_limit_bps", default, skip_serializing_if = "Option::is_none")]
    pub rate_limit: Option<BitRate>,
}

impl ThroughputTest {
    /// The shortest.
    pub const SHORTEST: Duration = Duration::from_millis(10);
    /// The longest.
    pub const LONGEST: Duration = Duration::from_secs(10);
    /// Pause after a test, in multiples of its duration.
    pub const REST: u32 = 4;
    /// The fastest.
    pub const FASTEST_BPS: u64 = 1_000_000_000;

    const fn second() -> Duration {
        Duration::from_secs(1)
    }
}

/// A second, as fast as the link can.
impl Default for ThroughputTest {
    fn default() -> Self {
        Self { duration: Self::second(), rate_limit: None }
    }
}

/// Result of the last throughput test of one direction of a link.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Tested {
    /// λ: the rate at which its packets came out, beside whatever else crossed meanwhile, bit/s.
    pub throughput_bps: f64,
    /// The rate at which they were sent. Where it is no higher, the link may carry more.
    pub offered_bps: f64,
    /// Time since the test ended.
    #[serde(rename = "age_ms", with = "millis")]
    #[schema(value_type = f64)]
    pub age: Duration,
}
