//! Roaming as wpa_supplicant 2.11 decides it on Linux: when a station scans, and whether it then changes its radio unit. The
//! rules are those of hostap's `wpa_supplicant/bgscan_simple.c` and `events.c`.
//!
//! - [`average`] is the signal of the own radio unit's beacons, as the driver reports it.
//! - [`decision`] weighs a radio unit that a scan found against the own one.

mod average;
mod decision;

use std::time::Duration;

use cotorra_graph::{BackgroundScan, Dbm, Timestamp, WirelessNetwork};

use self::{
    average::{Average, Side},
    decision::Rules,
};
use crate::port::RadioUnitIndex;

/// The decision after a scan.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Decision {
    /// The station keeps its radio unit.
    Stay,
    /// The station changes to this one.
    Roam(RadioUnitIndex),
}

/// The interval of background scans in force.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Pace {
    Short,
    Long,
}

/// wpa_supplicant of one attached station.
#[derive(Debug)]
pub(super) struct Supplicant {
    scans: BackgroundScan,
    rules: Rules,
    average: Average,
    pace: Pace,
    /// Scans at the short interval that count against [`Self::most_short_scans`].
    short_scans: u32,
    last_scan: Timestamp,
    next_scan: Timestamp,
}

impl Supplicant {
    /// Creates the supplicant of a station, before [`Self::attached`].
    pub(super) fn new(scans: BackgroundScan, network: &WirelessNetwork) -> Self {
        let WirelessNetwork { standard, width, noise_floor, .. } = *network;
        Self {
            scans,
            rules: Rules { standard, width, noise: level(noise_floor), threshold: scans.threshold.0 },
            average: Average::default(),
            pace: Pace::Short,
            short_scans: 0,
            last_scan: Timestamp::ZERO,
            next_scan: Timestamp::MAX,
        }
    }

    /// Starts anew at a radio unit with this signal. The first scan is due after a whole interval.
    pub(super) fn attached(&mut self, now: Timestamp, signal: Dbm) {
        self.average = Average::default();
        self.short_scans = 0;
        self.last_scan = now;
        self.pace = if f64::from(level(signal)) >= self.scans.threshold.0 { Pace::Long } else { Pace::Short };
        self.next_scan = now + self.interval();
    }

    /// Takes a beacon of the own radio unit. If the average signal has crossed the threshold, the next scan may be due
    /// sooner, even at once, or later.
    pub(super) fn beacon(&mut self, now: Timestamp, signal: Dbm) {
        let side = self.average.add(level(signal), self.scans.threshold.0);
        if self.scans.short_interval == self.scans.long_interval {
            return;
        }
        let since_scan = seconds(now) - seconds(self.last_scan);
        match (side, self.pace) {
            (Some(Side::Below), Pace::Long) => {
                self.pace = Pace::Short;
                if since_scan > 1 && self.short_scans <= self.most_short_scans() {
                    self.next_scan = now;
                } else if self.last_scan + self.scans.long_interval > now + self.scans.short_interval {
                    self.next_scan = now + self.scans.short_interval;
                }
            }
            // The signal fell further.
            (Some(Side::Below), Pace::Short) if since_scan > 10 => self.next_scan = now,
            (Some(Side::Above), Pace::Short) => {
                self.pace = Pace::Long;
                self.next_scan = now + self.scans.long_interval;
            }
            (Some(Side::Below), Pace::Short) | (Some(Side::Above), Pace::Long) | (None, _) => {}
        }
    }

    /// Returns when the next background scan is due.
    pub(super) fn deadline(&self) -> Timestamp {
        self.next_scan
    }

    /// Records that the station leaves for a background scan. After too many at the short interval, the long one holds.
    pub(super) fn scans(&mut self, now: Timestamp) {
        self.last_scan = now;
        match self.pace {
            Pace::Short => {
                self.short_scans += 1;
                if self.short_scans >= self.most_short_scans() {
                    self.pace = Pace::Long;
                }
            }
            Pace::Long => self.short_scans = self.short_scans.saturating_sub(1),
        }
    }

    /// Weighs the radio units that a scan heard. `own` is the station's.
    pub(super) fn scanned(
        &mut self,
        now: Timestamp,
        own: RadioUnitIndex,
        heard: impl IntoIterator<Item = (RadioUnitIndex, Dbm)>,
    ) -> Decision {
        self.next_scan = now + self.interval();
        let mut own_level = None;
        let mut strongest = None;
        for (unit, signal) in heard {
            let level = level(signal);
            if unit == own {
                own_level = Some(level);
            }
            // With radio units of one standard, wpa_supplicant's order of scan results is that of their signals.
            if strongest.is_none_or(|(_, best)| level > best) {
                strongest = Some((unit, level));
            }
        }
        match (strongest, own_level) {
            (Some((unit, _)), None) => Decision::Roam(unit),
            (Some((unit, level)), Some(own_level)) if unit != own => {
                let own_level = self.average.dbm().unwrap_or(own_level);
                if self.rules.roams(own_level, level) { Decision::Roam(unit) } else { Decision::Stay }
            }
            _ => Decision::Stay,
        }
    }

    fn interval(&self) -> Duration {
        match self.pace {
            Pace::Short => self.scans.short_interval,
            Pace::Long => self.scans.long_interval,
        }
    }

    /// Returns the number of scans at the short interval after which the long one holds.
    fn most_short_scans(&self) -> u32 {
        let BackgroundScan { short_interval, long_interval, .. } = self.scans;
        (long_interval.as_secs() / short_interval.as_secs().max(1)) as u32 + 1
    }
}

/// Returns a signal in whole dBm, as drivers report it.
fn level(signal: Dbm) -> i32 {
    signal.0.round() as i32
}

/// Returns a time in whole seconds, in which bgscan `simple` compares times.
fn seconds(at: Timestamp) -> u64 {
    at.as_nanos() / 1_000_000_000
}

#[cfg(test)]
mod tests {
    use super::*;

    const OWN: RadioUnitIndex = 0;

    fn at(ms: u64) -> Timestamp {
        Timestamp::from_nanos(ms * 1_000_000)
    }

    fn supplicant(scans: BackgroundScan) -> Supplicant {
        Supplicant::new(scans, &cotorra_graph_testing::wireless())
    }

    /// Runs a station that hears ten beacons a second, with a signal that follows the time in ms, and whose scans take no
    /// time and find nothing better. Returns the times of its scans, ms.
    fn scans(scans: BackgroundScan, until_ms: u64, signal: impl Fn(u64) -> f64) -> Vec<u64> {
        let mut supplicant = supplicant(scans);
        supplicant.attached(at(0), Dbm(signal(0)));
        let mut times = Vec::new();
        for ms in (100..=until_ms).step_by(100) {
            supplicant.beacon(at(ms), Dbm(signal(ms)));
            if supplicant.deadline() <= at(ms) {
                times.push(ms);
                supplicant.scans(at(ms));
                assert_eq!(supplicant.scanned(at(ms), OWN, [(OWN, Dbm(signal(ms)))]), Decision::Stay);
            }
        }
        times
    }

    const SIMPLE: fn() -> BackgroundScan = BackgroundScan::default;

    #[test]
    fn a_good_signal_is_scanned_for_at_the_long_interval() {
        assert_eq!(scans(SIMPLE(), 700_000, |_| -60.0), [300_000, 600_000]);
        assert_eq!(scans(SIMPLE(), 700_000, |_| -65.0), [300_000, 600_000], "the threshold is good enough");
    }

    #[test]
    fn a_weak_signal_is_scanned_for_at_the_short_interval_until_the_budget_is_spent() {
        let times = scans(SIMPLE(), 1_000_000, |_| -70.0);
        // 300 / 30 + 1 scans, then one at each long interval.
        let short: Vec<_> = (1..=11).map(|i| i * 30_000).collect();
        assert_eq!(times[..11], short);
        assert_eq!(times[11..], [630_000, 930_000]);
    }

    #[test]
    fn a_signal_that_falls_below_the_threshold_is_scanned_for_at_once() {
        let falls = |ms| if ms < 50_000 { -60.0 } else { -68.0 };
        // The average falls below -65 dBm at the fifth weak beacon.
        assert_eq!(scans(SIMPLE(), 100_000, falls), [50_400, 80_400]);
        // Further by more than 4 dB: at once again, because the last scan is more than ten seconds ago.
        let further = |ms| if ms < 65_000 { falls(ms) } else { -80.0 };
        assert_eq!(scans(SIMPLE(), 100_000, further), [50_400, 65_100, 95_100]);
        let sooner = |ms| if ms < 58_000 { falls(ms) } else { -80.0 };
        assert_eq!(scans(SIMPLE(), 100_000, sooner), [50_400, 80_400]);
    }

    #[test]
    fn a_signal_that_rises_again_is_scanned_for_at_the_long_interval() {
        let dips = |ms| if (50_000..60_000).contains(&ms) { -70.0 } else { -60.0 };
        let times = scans(SIMPLE(), 800_000, dips);
        assert_eq!(times[0], 50_300);
        // The average is more than 4 dB above the last report 1 s after the dip.
        assert_eq!(times.len(), 3, "{times:?}");
        assert!((360_000..361_500).contains(&times[1]), "{times:?}");
    }

    #[test]
    fn a_signal_at_the_threshold_does_not_make_a_station_scan() {
        let wobbles = |ms| if ms / 1000 % 2 == 0 { -63.0 } else { -67.0 };
        let times = scans(SIMPLE(), 600_000, wobbles);
        assert!(times.len() <= 3, "{times:?}");
    }

    #[test]
    fn one_interval_makes_the_threshold_meaningless() {
        let ten = Duration::from_secs(10);
        let even = BackgroundScan { short_interval: ten, long_interval: ten, ..SIMPLE() };
        let falls = |ms| if ms < 15_000 { -60.0 } else { -80.0 };
        assert_eq!(scans(even, 35_000, falls), [10_000, 20_000, 30_000]);
    }

    /// Returns the decision of a station with this average signal.
    fn decision(own: f64, heard: &[(RadioUnitIndex, f64)]) -> Decision {
        let mut supplicant = supplicant(SIMPLE());
        supplicant.attached(at(0), Dbm(own));
        supplicant.beacon(at(100), Dbm(own));
        supplicant.scanned(at(200), OWN, heard.iter().map(|(unit, dbm)| (*unit, Dbm(*dbm))))
    }

    #[test]
    fn the_strongest_that_the_scan_heard_is_weighed() {
        assert_eq!(decision(-80.0, &[(OWN, -80.0), (1, -70.0), (2, -68.0)]), Decision::Roam(2));
        assert_eq!(decision(-78.0, &[(OWN, -78.0), (1, -77.0)]), Decision::Stay);
        assert_eq!(decision(-80.0, &[(OWN, -80.0)]), Decision::Stay);
        assert_eq!(decision(-80.0, &[]), Decision::Stay, "nothing was heard");
    }

    #[test]
    fn a_station_leaves_a_radio_unit_that_the_scan_did_not_hear() {
        assert_eq!(decision(-80.0, &[(1, -90.0)]), Decision::Roam(1));
    }

    #[test]
    fn the_average_counts_and_not_the_own_signal_in_the_scan() {
        assert_eq!(decision(-72.0, &[(OWN, -90.0), (1, -71.0)]), Decision::Stay);
        assert_eq!(decision(-85.0, &[(OWN, -73.0), (1, -72.0)]), Decision::Roam(1));
    }

    #[test]
    fn a_station_between_two_radio_units_stays_with_its_own() {
        // Each scan hears the other one 2 dB stronger or weaker; 3 dB are needed.
        let mut supplicant = supplicant(SIMPLE());
        supplicant.attached(at(0), Dbm(-73.0));
        for i in 1..100 {
            let now = at(i * 1000);
            supplicant.beacon(now, Dbm(-73.0));
            let other = if i % 2 == 0 { -71.0 } else { -75.0 };
            assert_eq!(supplicant.scanned(now, OWN, [(OWN, Dbm(-73.0)), (1, Dbm(other))]), Decision::Stay);
        }
    }
}
