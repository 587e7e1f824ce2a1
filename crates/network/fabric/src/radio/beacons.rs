//! Receives the beacons of a robot's radio unit, and probes a radio unit whose beacons were lost.

use cotorra_graph::{Dbm, Timestamp};

use super::{Radio, RadioUnitIndex, StationIndex, roaming::Policy};

/// Length of a beacon as an Ethernet frame. On the air, where frames are longer, it has the 250 bytes of a common one.
const BEACON_BYTES: usize = 212;
/// A null frame has no more than what every frame has on the air.
const NULL_FRAME_BYTES: usize = 0;
/// Null frames that probe a radio unit: the default of Linux's mac80211 (`max_nullfunc_tries`).
const PROBES: u32 = 2;
/// Attempts of each of them: the default of dot11ShortRetryLimit (IEEE 802.11-2020, 10.3.4.4).
const PROBE_ATTEMPTS: u32 = 7;

impl Radio {
    /// Returns the signal of a beacon of a robot's radio unit; `None` if it is lost. For a supplicant's station, it is lost
    /// at random, also in a fade, for others if it is too weak.
    pub(super) fn receive_beacon(
        &mut self,
        now: Timestamp,
        robot: StationIndex,
        unit: RadioUnitIndex,
    ) -> Option<Dbm> {
        let Policy::Supplicant(_, rng) = &mut self.robots[robot].policy else {
            return self.hears(robot, unit);
        };
        let luck = rng.unit();
        let fading_db = self.fading_now(now, robot, unit);
        let [_, reception] = self.receptions(robot, unit, fading_db);
        let [_, signal] = self.signals(robot, unit);
        let received = self.units[unit].serves.is_some() && luck >= reception.group_error_rate(BEACON_BYTES);
        received.then_some(Dbm(signal.0 + fading_db))
    }

    /// Whether a robot's radio unit acknowledges one of the null frames by which Linux probes it after lost beacons.
    pub(super) fn answers_probe(
        &mut self,
        now: Timestamp,
        robot: StationIndex,
        unit: RadioUnitIndex,
    ) -> bool {
        let [reception, _] = self.receptions_at(now, robot, unit);
        let Policy::Supplicant(_, rng) = &mut self.robots[robot].policy else { return false };
        let error_rate = reception.group_error_rate(NULL_FRAME_BYTES);
        (0..PROBES * PROBE_ATTEMPTS).any(|_| rng.unit() >= error_rate)
    }
}
