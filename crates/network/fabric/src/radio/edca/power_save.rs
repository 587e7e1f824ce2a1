//! Sleep of stations between beacons (IEEE 802.11-2020, 11.2.3). A station that had no frames for a while sleeps, and wakes
//! when it has one to send, or when a beacon announces frames for it. Meanwhile its radio unit keeps them; group frames wait
//! for a beacon with a delivery traffic indication map (DTIM).

use cotorra_graph::{Direction, PowerSave, Timestamp};

use super::{CATEGORIES, Edca, Emitter, Unit, stream::Stream};
use crate::{
    port::{RadioUnitIndex, StationIndex},
    radio::{
        medium::Flow,
        roaming::{beacon_number, next_beacon},
    },
};

/// The sleep of a station.
#[derive(Debug)]
pub(super) struct Sleep {
    settings: PowerSave,
    awake_until: Timestamp,
}

impl Sleep {
    /// Creates a station that has just been active.
    pub(super) fn new(settings: PowerSave) -> Self {
        Self { settings, awake_until: Timestamp::ZERO + settings.idle }
    }
}

impl Edca {
    /// Whether a flow's receivers are awake to get its frames.
    pub(super) fn is_awake(&self, now: Timestamp, flow: Flow) -> bool {
        match flow {
            Flow::Up(_) => true,
            Flow::Down(station) => self.is_station_awake(now, station),
            Flow::Group(unit) => {
                let unit = &self.units[unit];
                unit.delivers_groups
                    || unit.present.iter().all(|station| self.is_station_awake(now, *station))
            }
        }
    }

    fn is_station_awake(&self, now: Timestamp, station: StationIndex) -> bool {
        self.peers[station].sleep.as_ref().is_none_or(|sleep| now < sleep.awake_until)
    }

    /// Records that a station sends or receives. Its radio unit sends what it kept.
    pub(super) fn stay_awake(&mut self, now: Timestamp, station: StationIndex) {
        let Some(sleep) = &mut self.peers[station].sleep else { return };
        let was_awake = now < sleep.awake_until;
        sleep.awake_until = now + sleep.settings.idle;
        if !was_awake && let Some(unit) = self.peers[station].on {
            self.refresh(now, Emitter::Unit(unit));
        }
    }

    /// Sets the time of the next beacon of a radio unit, if it keeps frames for stations that sleep.
    pub(super) fn announce(&mut self, now: Timestamp, unit: RadioUnitIndex) {
        let keeps = |flow: &Flow, category: usize| {
            let waits = match flow {
                Flow::Down(station) => {
                    self.peers[*station].streams[Direction::Backward as usize][category].is_ready()
                }
                Flow::Group(unit) => self.units[*unit].group[category].is_ready(),
                Flow::Up(_) => false,
            };
            waits && !self.is_awake(now, *flow)
        };
        let turns = &self.units[unit].turns;
        let kept = (0..CATEGORIES.len())
            .any(|category| turns[category].flows.iter().any(|flow| keeps(flow, category)));
        let beacon = &mut self.units[unit].beacon;
        *beacon = if kept { beacon.or(Some(next_beacon(now))) } else { None };
    }

    /// Sends the beacons that are due on a channel: stations wake if frames are kept for them.
    pub(super) fn send_beacons(&mut self, channel: usize, now: Timestamp) {
        for member in self.members(channel) {
            let Emitter::Unit(unit) = member else { continue };
            let Some(at) = self.units[unit].beacon.filter(|at| *at <= now) else { continue };
            self.units[unit].beacon = None;
            for station in self.units[unit].present.clone() {
                let peer = &mut self.peers[station];
                let kept = peer.streams[Direction::Backward as usize].iter().any(Stream::is_ready);
                let Some(sleep) = &mut peer.sleep else { continue };
                if kept {
                    sleep.awake_until = sleep.awake_until.max(at + sleep.settings.idle);
                }
                if beacon_number(at).is_multiple_of(u64::from(sleep.settings.dtim_period)) {
                    self.units[unit].delivers_groups = true;
                }
            }
            self.refresh(now, member);
        }
    }

    /// Ends the delivery of group frames after a DTIM, once none is left.
    pub(super) fn end_delivery(&mut self, unit: RadioUnitIndex) {
        let Unit { group, delivers_groups, .. } = &mut self.units[unit];
        *delivers_groups &= group.iter().any(Stream::is_ready);
    }
}
