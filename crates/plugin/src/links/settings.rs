//! How measurements of links count.

use std::time::Duration;

use serde::{Deserialize, Deserializer};

use crate::settings::{self, Figure};

/// Use of measurements, as a plug-in's settings declare it: `{ tolerance: 1 ms, window: 10 s, every: 5 s, hold: 60 s,
/// candidates: true }`.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Measurements {
    /// Least delay beyond the configured one that counts, in one direction of a link.
    #[serde(deserialize_with = "settings::duration")]
    pub tolerance: Duration,
    /// Time for which the highest measured delay counts. Loads and losses are those over it.
    #[serde(deserialize_with = "window")]
    pub window: Duration,
    /// Longest time between two decisions while measurements differ from the configuration.
    #[serde(deserialize_with = "every")]
    pub every: Duration,
    /// Time for which the figures of a link count that a service left. It doubles with each return.
    #[serde(deserialize_with = "settings::duration")]
    pub hold: Duration,
    /// Whether the air to a radio unit that a robot does not use counts as the unit's stations measure it.
    pub candidates: bool,
}

impl Default for Measurements {
    fn default() -> Self {
        Self {
            tolerance: Duration::from_millis(1),
            window: Duration::from_secs(10),
            every: Duration::from_secs(5),
            hold: Duration::from_secs(60),
            candidates: false,
        }
    }
}

/// A time over which measurements are gathered.
const WINDOW: Figure =
    Figure { what: "a time from 1 s to 1 h", example: "10 s", range: 1.0..=3600.0, ..Figure::TIME };

fn window<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Duration, D::Error> {
    WINDOW.deserialize(deserializer).map(Duration::from_secs_f64)
}

fn every<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Duration, D::Error> {
    Figure { example: "5 s", ..WINDOW }.deserialize(deserializer).map(Duration::from_secs_f64)
}
