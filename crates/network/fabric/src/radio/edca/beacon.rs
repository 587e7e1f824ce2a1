//! Beacons as frames that take airtime (IEEE 802.11-2020, 11.1.3.2). What stations learn of their radio units by beacons, they
//! learn elsewhere.

use std::time::Duration;

use cotorra_graph::Timestamp;
use cotorra_numbers::Draws;

use super::backoff::{Backoff, Parameters};
use crate::{
    port::RadioUnitIndex,
    radio::{PhyRate, Radio, roaming::BEACON_INTERVAL},
};

/// Length of a common beacon.
const BEACON_BYTES: u64 = 250;
/// Contention of beacons, as Linux's ath9k has it (`ath9k_beaconq_config`): they go as soon as the channel was idle for PIFS.
const CONTENTION: Parameters = Parameters { aifsn: 1, cw_min: 0, cw_max: 0, txop: Duration::ZERO };

/// The beacons of a radio unit.
#[derive(Debug)]
pub(super) struct Beacons {
    backoff: Backoff,
    /// When the next one is due, or was.
    due: Timestamp,
    waits: bool,
}

impl Beacons {
    /// Creates the beacons of a radio unit, which begin at a random time.
    pub(super) fn new(seed: u64, unit: RadioUnitIndex, sifs: Duration) -> Self {
        let mut rng = Draws::new(seed, &format!("beacons {unit}"));
        let due = Timestamp::ZERO + BEACON_INTERVAL.mul_f64(rng.unit());
        Self { backoff: Backoff::new(CONTENTION, sifs, rng), due, waits: false }
    }

    /// Returns when the next one is due, or sent.
    pub(super) fn deadline(&self) -> Timestamp {
        if self.waits { self.backoff.access() } else { self.due }
    }

    /// Advances to `now`. Whether one is sent now.
    pub(super) fn sends(&mut self, now: Timestamp) -> bool {
        if !self.waits && self.due <= now {
            self.waits = true;
            self.backoff.wake(self.due);
        }
        let sends = self.waits && self.backoff.access() <= now;
        if sends {
            self.waits = false;
            while self.due <= now {
                self.due = self.due + BEACON_INTERVAL;
            }
        }
        sends
    }

    /// Senses a transmission.
    pub(super) fn pause(&mut self, now: Timestamp, until: Timestamp) {
        self.backoff.pause(now, until);
    }
}

impl Radio {
    /// Returns the airtime of a radio unit's beacon, at the lowest rate that its stations must have.
    pub(super) fn beacon_airtime(&self, unit: RadioUnitIndex) -> Duration {
        let frequency_mhz = self.units[unit].frequency_mhz;
        let hundreds_of_kbps = if frequency_mhz < 3000 { 10 } else { 60 };
        let rate = PhyRate::legacy(hundreds_of_kbps, false).expect("the lowest rates are rates");
        rate.airtime(frequency_mhz, BEACON_BYTES)
    }
}
