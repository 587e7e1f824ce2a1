//! Decisions from beacons: whether a station's radio unit is lost, and whether another has been better for long enough. It
//! takes one call per beacon.

use std::time::Duration;

use cotorra_graph::{Dbm, NodeId, Roaming, Timestamp, WirelessNetwork};
use cotorra_numbers::Draws;

use super::supplicant::Supplicant;
use crate::port::RadioUnitIndex;

/// Beacon interval: 100 time units of 1.024 ms (IEEE 802.11-2020, 9.4.1.3), the default of most radio units.
pub(super) const BEACON_INTERVAL: Duration = Duration::from_micros(102_400);
/// Consecutive missed beacons after which a radio unit is lost: the default of Linux's mac80211.
const BEACONS_TO_LOSE: u32 = 7;

/// Returns the time of the first beacon after `now`.
pub(super) fn next_beacon(now: Timestamp) -> Timestamp {
    let interval = BEACON_INTERVAL.as_nanos() as u64;
    Timestamp::from_nanos((now.as_nanos() / interval + 1).saturating_mul(interval))
}

/// Returns the number of the last beacon.
pub(super) fn beacon_number(now: Timestamp) -> u64 {
    now.as_nanos() / BEACON_INTERVAL.as_nanos() as u64
}

/// The component that decides when a station changes its radio unit, and what it keeps for that.
#[derive(Debug)]
pub(super) enum Policy {
    Instructed,
    Signal(Thresholds),
    /// The numbers decide which beacons are lost.
    Supplicant(Supplicant, Draws),
}

impl Policy {
    /// Creates the policy of a robot in a network.
    pub(super) fn new(roaming: Roaming, network: &WirelessNetwork, seed: u64, robot: &NodeId) -> Self {
        match roaming {
            Roaming::Instructed => Self::Instructed,
            Roaming::Signal => Self::Signal(Thresholds {
                hysteresis_db: network.hysteresis_db,
                time_to_trigger: network.time_to_trigger,
            }),
            Roaming::Supplicant(scans) => Self::Supplicant(
                Supplicant::new(scans, network),
                Draws::new(seed, &format!("beacons {robot}")),
            ),
        }
    }

    /// Returns the thresholds, if the station decides by signal.
    pub(super) fn thresholds(&self) -> Option<Thresholds> {
        match self {
            Self::Signal(thresholds) => Some(*thresholds),
            Self::Instructed | Self::Supplicant(..) => None,
        }
    }

    /// Returns the supplicant, if there is one.
    pub(super) fn supplicant(&self) -> Option<&Supplicant> {
        match self {
            Self::Supplicant(supplicant, _) => Some(supplicant),
            Self::Instructed | Self::Signal(_) => None,
        }
    }

    /// Returns the supplicant, if there is one.
    pub(super) fn supplicant_mut(&mut self) -> Option<&mut Supplicant> {
        match self {
            Self::Supplicant(supplicant, _) => Some(supplicant),
            Self::Instructed | Self::Signal(_) => None,
        }
    }
}

/// Thresholds by which a station changes its radio unit: the entering condition of 3GPP's event A3 (TS 36.331, 5.5.4.4),
/// which Wi-Fi stations resemble.
#[derive(Debug, Clone, Copy)]
pub(super) struct Thresholds {
    pub(super) hysteresis_db: f64,
    pub(super) time_to_trigger: Duration,
}

/// The decision after a beacon.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Verdict {
    /// Nothing changes until the robot moves.
    Stay,
    /// The next beacon matters, even if the robot stands still.
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
    /// The radio unit that exceeds the own one by the hysteresis, and since when.
    stronger: Option<(RadioUnitIndex, Timestamp)>,
}

impl Beacons {
    /// Forgets everything, after the station has been off its channel.
    pub(super) fn reset(&mut self) {
        *self = Self::default();
    }

    /// Weighs a beacon of the own radio unit (`None` if too weak) against the signals of others. The others matter only
    /// with
    /// `thresholds`.
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
            // The known candidate keeps its rank while it stays above the hysteresis. Otherwise the strongest wins.
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

#[cfg(test)]
mod tests {
    use super::*;

    const THRESHOLDS: Thresholds =
        Thresholds { hysteresis_db: 4.0, time_to_trigger: Duration::from_millis(300) };

    /// Returns the verdicts on beacons with these signals of the own radio unit and of two others.
    fn verdicts(signals: &[(Option<f64>, [f64; 2])], thresholds: Option<Thresholds>) -> Vec<Verdict> {
        let mut beacons = Beacons::default();
        let mut now = Timestamp::ZERO;
        let mut weigh = |(own, others): &(Option<f64>, [f64; 2])| {
            now = next_beacon(now);
            let others = others.iter().enumerate().map(|(i, dbm)| (i + 1, Dbm(*dbm)));
            beacons.weigh(now, own.map(Dbm), others, thresholds)
        };
        signals.iter().map(&mut weigh).collect()
    }

    #[test]
    fn beacons_come_every_102_4_ms() {
        assert_eq!(next_beacon(Timestamp::ZERO), Timestamp::from_nanos(102_400_000));
        assert_eq!(next_beacon(Timestamp::from_nanos(102_400_000)), Timestamp::from_nanos(204_800_000));
        assert_eq!(next_beacon(Timestamp::from_nanos(204_799_999)), Timestamp::from_nanos(204_800_000));
    }

    #[test]
    fn a_station_stays_within_the_hysteresis() {
        let signals = [(Some(-70.0), [-66.0, -90.0]); 20];
        assert_eq!(verdicts(&signals, Some(THRESHOLDS)), [Verdict::Stay; 20]);
    }

    #[test]
    fn a_station_roams_after_an_unbroken_time_to_trigger() {
        let better = (Some(-70.0), [-65.9, -90.0]);
        let equal = (Some(-70.0), [-70.0, -90.0]);
        use Verdict::{Roam, Stay, Watch};
        // 300 ms are three intervals of 102.4 ms.
        assert_eq!(verdicts(&[better; 4], Some(THRESHOLDS)), [Watch, Watch, Watch, Roam]);
        let broken = [better, better, equal, better, better, better, better];
        assert_eq!(verdicts(&broken, Some(THRESHOLDS)), [Watch, Watch, Stay, Watch, Watch, Watch, Roam]);
        let at_once = Thresholds { time_to_trigger: Duration::ZERO, ..THRESHOLDS };
        assert_eq!(verdicts(&[better], Some(at_once)), [Roam]);
    }

    #[test]
    fn a_candidate_is_kept_when_a_better_one_appears() {
        let signals = [(Some(-70.0), [-60.0, -90.0]), (Some(-70.0), [-60.0, -50.0])];
        let signals = [&signals[..], &signals[1..], &signals[1..]].concat();
        assert_eq!(verdicts(&signals, Some(THRESHOLDS))[3], Verdict::Roam);
    }

    #[test]
    fn other_signals_are_ignored_without_thresholds() {
        assert_eq!(verdicts(&[(Some(-90.0), [-30.0, -30.0]); 9], None), [Verdict::Stay; 9]);
    }

    #[test]
    fn seven_missed_beacons_in_a_row_lose_the_radio_unit() {
        let (missed, heard) = ((None, [-90.0; 2]), (Some(-80.0), [-90.0; 2]));
        let mut signals = vec![missed; 6];
        signals.push(heard);
        signals.extend([missed; 7]);
        let verdicts = verdicts(&signals, None);
        assert_eq!(verdicts[5..8], [Verdict::Watch, Verdict::Stay, Verdict::Watch]);
        assert_eq!(verdicts[12..], [Verdict::Watch, Verdict::Lost]);
    }
}
