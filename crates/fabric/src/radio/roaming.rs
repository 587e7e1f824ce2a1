//! What a station makes of the beacons that it hears: whether its radio unit is lost, and whether another has been
//! better for long enough. No clock, no radio; one call a beacon.

use std::time::Duration;

use cotorra_graph::{Dbm, Timestamp};

use super::RadioUnitIndex;

/// Beacons come every 100 time units of 1.024 ms (IEEE 802.11-2020, 9.4.1.3; the default of most radio units).
pub(super) const BEACON_INTERVAL: Duration = Duration::from_micros(102_400);
/// After so many beacons missed in a row the radio unit is lost; what Linux's mac80211 takes by default.
const BEACONS_TO_LOSE: u32 = 7;

/// The first beacon after `now`.
pub(super) fn next_beacon(now: Timestamp) -> Timestamp {
    let interval = BEACON_INTERVAL.as_nanos() as u64;
    Timestamp::from_nanos((now.as_nanos() / interval + 1).saturating_mul(interval))
}

/// When a station that decides by signal changes its radio unit; the entering condition of 3GPP's event A3 (TS 36.331,
/// 5.5.4.4), which Wi-Fi stations resemble.
#[derive(Debug, Clone, Copy)]
pub(super) struct Thresholds {
    pub(super) hysteresis_db: f64,
    pub(super) time_to_trigger: Duration,
}

/// What follows from a beacon.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Verdict {
    /// All is well, and stays so until the robot moves.
    Stay,
    /// The next beacon must be looked at, even if the robot stands still.
    Watch,
    /// Another radio unit has been stronger for long enough.
    Roam,
    /// The radio unit is lost.
    Lost,
}

/// A station's memory of past beacons.
#[derive(Debug, Default)]
pub(super) struct Beacons {
    missed: u32,
    /// A radio unit that is stronger than the own one by the hysteresis, and since when.
    stronger: Option<(RadioUnitIndex, Timestamp)>,
}

impl Beacons {
    /// Forgets all: the station has been off its channel.
    pub(super) fn reset(&mut self) {
        *self = Self::default();
    }

    /// Weighs one beacon of the own radio unit (`None`: too weak to be heard) against the others, which are only looked
    /// at when the station decides by signal.
    pub(super) fn weigh(
        &mut self,
        now: Timestamp,
        own: Option<Dbm>,
        others: impl Iterator<Item = (RadioUnitIndex, Dbm)>,
        thresholds: Option<Thresholds>,
    ) -> Verdict {
        self.missed = if own.is_some() { 0 } else { self.missed + 1 };
        if self.missed >= BEACONS_TO_LOSE {
            return Verdict::Lost;
        }
        if let (Some(own), Some(Thresholds { hysteresis_db, time_to_trigger })) = (own, thresholds) {
            let known = self.stronger;
            // The one that is waited for, while it stays above; else the best of those that are.
            let rank =
                |(ru, signal): &(RadioUnitIndex, Dbm)| (known.is_some_and(|(k, _)| k == *ru), signal.0);
            let entered = others
                .filter(|(_, signal)| signal.0 > own.0 + hysteresis_db)
                .max_by(|a, b| rank(a).partial_cmp(&rank(b)).unwrap_or(std::cmp::Ordering::Equal));
            self.stronger = entered.map(|(ru, _)| known.filter(|(k, _)| *k == ru).unwrap_or((ru, now)));
            if self.stronger.is_some_and(|(_, since)| now.since(since) >= time_to_trigger) {
                return Verdict::Roam;
            }
        }
        if self.missed > 0 || self.stronger.is_some() { Verdict::Watch } else { Verdict::Stay }
    }
}
