//! The average signal of a radio unit's beacons, and its crossings of a threshold, as Linux's mac80211 tracks them
//! (`net/mac80211/mlme.c`, Linux 5 and 6).

/// Beacons before the first crossing is reported.
const FIRST_BEACONS: u32 = 4;
/// Hysteresis that wpa_supplicant's bgscan `simple` sets, dB.
const HYSTERESIS_DB: i32 = 4;

/// A side of the threshold.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Side {
    Below,
    Above,
}

/// An exponential average with the weight 1/4, in whole dBm.
///
/// A crossing is reported at the first few beacons, and then each time that the average has moved by more than the
/// hysteresis since the last report. It may have stayed on its side of the threshold.
#[derive(Debug, Default)]
pub(super) struct Average {
    /// Attenuation below 0 dBm in sixteenths of a dB, as the kernel's fixed-point average keeps it.
    sixteenths: i32,
    beacons: u32,
    /// The average at the last report.
    reported: Option<i32>,
}

impl Average {
    /// Returns the average, dBm; `None` before the first beacon.
    pub(super) fn dbm(&self) -> Option<i32> {
        (self.beacons > 0).then_some(-(self.sixteenths >> 4))
    }

    /// Adds a beacon's signal, dBm. Returns the side of the threshold if it is to be reported.
    pub(super) fn add(&mut self, signal: i32, threshold: f64) -> Option<Side> {
        let sample = -signal << 4;
        self.sixteenths = if self.beacons == 0 { sample } else { (3 * self.sixteenths + sample) >> 2 };
        self.beacons = self.beacons.saturating_add(1);
        let average = self.dbm().filter(|_| self.beacons >= FIRST_BEACONS)?;
        let fell = self.reported.is_none_or(|last| average < last - HYSTERESIS_DB);
        let rose = self.reported.is_none_or(|last| average > last + HYSTERESIS_DB);
        let side = match f64::from(average) {
            dbm if dbm < threshold && fell => Side::Below,
            dbm if dbm > threshold && rose => Side::Above,
            _ => return None,
        };
        self.reported = Some(average);
        Some(side)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the average after each beacon, and what is reported, at a threshold of -65 dBm.
    fn course(signals: impl IntoIterator<Item = i32>) -> Vec<(i32, Option<Side>)> {
        let mut average = Average::default();
        let mut add = |signal| {
            let side = average.add(signal, -65.0);
            (average.dbm().unwrap(), side)
        };
        signals.into_iter().map(&mut add).collect()
    }

    #[test]
    fn the_average_takes_in_a_quarter_of_each_beacon() {
        assert_eq!(Average::default().dbm(), None);
        let averages: Vec<_> = course([-40, -60, -60, -60, -60]).iter().map(|(dbm, _)| *dbm).collect();
        // -40, -45, -48.75, -51.5625, -53.67; the fraction is cut off, as the kernel does.
        assert_eq!(averages, [-40, -45, -48, -51, -53]);
    }

    #[test]
    fn the_fourth_beacon_reports_the_side() {
        let sides = |signals| course(signals).iter().map(|(_, side)| *side).collect::<Vec<_>>();
        assert_eq!(sides([-60; 5]), [None, None, None, Some(Side::Above), None]);
        assert_eq!(sides([-66; 5]), [None, None, None, Some(Side::Below), None]);
        assert_eq!(sides([-65; 5]), [None; 5], "it is on neither side");
    }

    #[test]
    fn reports_are_more_than_the_hysteresis_apart() {
        // A slow fall, then a slow rise: a dB at every eighth beacon.
        let fall = (60..=80).flat_map(|dbm| [-dbm; 8]);
        let rise = (56..=80).rev().flat_map(|dbm| [-dbm; 8]);
        let reports: Vec<_> =
            course(fall.chain(rise)).into_iter().filter_map(|(dbm, side)| Some((dbm, side?))).collect();
        use Side::{Above, Below};
        let falls = [(-60, Above), (-66, Below), (-71, Below), (-76, Below)];
        assert_eq!(reports[..4], falls);
        assert_eq!(reports[4..], [(-64, Above), (-59, Above)]);
    }

    #[test]
    fn one_weak_beacon_reports_nothing() {
        let mut signals = [-55; 20];
        signals[10] = -80;
        assert_eq!(course(signals).iter().filter(|(_, side)| side.is_some()).count(), 1);
    }
}
