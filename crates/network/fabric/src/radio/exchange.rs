//! Handovers as frames on the air. A station and a radio unit exchange the management frames of a handover, and those of the
//! key handshake where there is one, at the lowest rate. They contend and fade as all others do, and are lost as all others
//! are. Between them, the station's kernel and that of the radio unit wait for their timers. With the first data after a handover,
//! both ends agree to aggregates.
//!
//! [`Station`](super::station::Station) says which frame comes next; here the frames are sent, by radios of their own at the
//! antennas of the robot and of the radio unit.

use std::collections::{BTreeMap, VecDeque};

use cotorra_graph::{Direction, Timestamp};

use super::{
    Path, PhyRate, Radio, RadioUnitIndex, StationIndex,
    edca::category::Category,
    emitter::Emitter,
    foreign::{Antenna, RateTries, Receiver, Report, Transmission},
};

/// Tries of a management frame: as many as Linux orders of its simulated radios.
const TRIES: u32 = 11;
/// Check sequence of a frame, bytes.
const FCS: u32 = 4;

/// A frame of a handover.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Message {
    /// The station's authentication.
    Authenticate,
    /// The radio unit's answer to it.
    Authenticated,
    /// The station's reassociation.
    Reassociate,
    /// The radio unit's answer to it.
    Reassociated,
    /// A message of the key handshake, from 1 to 4. The radio unit sends those of odd numbers.
    Key(u8),
    /// The request of who sends data in this direction to aggregate them (ADDBA).
    Agree(Direction),
    /// The answer to it.
    Agreed(Direction),
}

impl Message {
    /// Whether the station sends it.
    pub(super) fn is_from_station(self) -> bool {
        match self {
            Self::Authenticate | Self::Reassociate => true,
            Self::Authenticated | Self::Reassociated => false,
            Self::Key(number) => number % 2 == 0,
            Self::Agree(direction) => direction == Direction::Forward,
            Self::Agreed(direction) => direction == Direction::Backward,
        }
    }

    /// Returns the length of its PSDU: as Linux, hostapd and wpa_supplicant 2.10 send it for WPA2-PSK with CCMP at 2.4 GHz, with or
    /// without the elements of fast transition, and a network's name of eight letters.
    fn psdu_bytes(self, fast: bool) -> u32 {
        let without_check = match (self, fast) {
            (Self::Authenticate, true) => 182,
            (Self::Authenticated, true) => 190,
            (Self::Reassociate, true) => 304,
            (Self::Reassociated, true) => 378,
            (Self::Authenticate | Self::Authenticated, false) => 30,
            (Self::Reassociate, false) => 177,
            (Self::Reassociated, false) => 262,
            (Self::Key(1 | 4), _) => 133,
            (Self::Key(2), _) => 155,
            (Self::Key(_), _) => 213,
            // Protected (802.11w).
            (Self::Agree(_) | Self::Agreed(_), _) => 49,
        };
        without_check + FCS
    }
}

/// Fate of a frame of a handover.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Fate {
    /// Its receiver has it.
    Received,
    /// Its sender knows that, or that its last try failed.
    Settled { acknowledged: bool },
}

/// News of a frame.
#[derive(Debug, Clone, Copy)]
struct News {
    at: Timestamp,
    sent: Sent,
    fate: Fate,
}

/// A frame on its way.
#[derive(Debug, Clone, Copy)]
struct Sent {
    robot: StationIndex,
    unit: RadioUnitIndex,
    message: Message,
}

/// The radios and frames of handovers.
#[derive(Debug, Default)]
pub(super) struct Exchanges {
    robots: BTreeMap<StationIndex, Antenna>,
    units: BTreeMap<RadioUnitIndex, Antenna>,
    /// Frames sent so far.
    pub(super) count: u64,
    sent: BTreeMap<u64, Sent>,
    news: VecDeque<News>,
}

impl Radio {
    /// Sends a frame of a robot's handover to a radio unit.
    pub(super) fn send_message(
        &mut self,
        now: Timestamp,
        robot: StationIndex,
        unit: RadioUnitIndex,
        message: Message,
    ) {
        let fast = self.robots[robot].station.is_fast(self.is_one_mobility_domain(robot, Some(unit)));
        let [of_robot, of_unit] = [self.radio_of_robot(robot), self.radio_of_unit(now, unit)];
        let (from, to) = if message.is_from_station() { (of_robot, of_unit) } else { (of_unit, of_robot) };
        self.exchanges.count += 1;
        let id = self.exchanges.count;
        self.exchanges.sent.insert(id, Sent { robot, unit, message });
        // The lowest of the rates that stations must have: DSSS at 2.4 GHz, OFDM above.
        let hundreds_of_kbps = if self.units[unit].frequency_mhz < 3000 { 10 } else { 60 };
        let rate = PhyRate::legacy(hundreds_of_kbps, false).expect("the lowest rates are rates");
        let transmission = Transmission {
            id,
            frequency_mhz: self.units[unit].frequency_mhz,
            psdu_bytes: message.psdu_bytes(fast),
            category: Category::Voice,
            to: Receiver::One(to),
            packet_bytes: None,
            aggregates: false,
            rates: vec![RateTries { rate, tries: TRIES, rts: false }],
        };
        self.send_from(now, from, transmission);
    }

    /// Asks the receiver of data to agree to aggregates, if they are the first since the association. The data do not wait for
    /// that, but a request at the lowest rate is in their way.
    pub(super) fn agree(&mut self, now: Timestamp, Path { robot, unit, direction }: Path) {
        let spec = &self.networks[self.units[unit].network].spec;
        let aggregates = spec.access.edca().is_some_and(|edca| edca.aggregation);
        if aggregates && spec.handover.frames.is_some() && self.link(robot, unit).agrees(direction) {
            self.send_message(now, robot, unit, Message::Agree(direction));
        }
    }

    /// Records what became of a frame of a handover.
    pub(super) fn take_report(&mut self, report: &Report) {
        let (id, fate) = match report {
            Report::Received { id, .. } => (id, Fate::Received),
            Report::Settled { id, acknowledged, .. } => {
                (id, Fate::Settled { acknowledged: acknowledged.is_some() })
            }
        };
        let sent = self.exchanges.sent.get(id).copied();
        if matches!(fate, Fate::Settled { .. }) {
            self.exchanges.sent.remove(id);
        }
        self.exchanges.news.extend(sent.map(|sent| News { at: report.at(), sent, fate }));
    }

    /// Tells a station what became of a frame of its handover. Returns whether there was any news.
    pub(super) fn tell_station(&mut self) -> bool {
        let Some(News { at, sent: Sent { robot, unit, message }, fate }) = self.exchanges.news.pop_front()
        else {
            return false;
        };
        if let Message::Agree(direction) = message {
            if fate == Fate::Received && self.robots[robot].station.on_channel() == Some(unit) {
                self.send_message(at, robot, unit, Message::Agreed(direction));
            }
        } else if self.robots[robot].station.underway_to() == Some(unit) {
            let is_one_domain = self.is_one_mobility_domain(robot, Some(unit));
            let station = &mut self.robots[robot].station;
            station.hear(at, message, fate, is_one_domain);
            let deadline = station.deadline();
            self.timers.set(self.channels + robot, deadline);
        }
        true
    }

    fn radio_of_robot(&mut self, robot: StationIndex) -> Antenna {
        if let Some(antenna) = self.exchanges.robots.get(&robot) {
            return *antenna;
        }
        let label = format!("handover {}", self.robots[robot].id);
        let antenna = self.equip(&label, Emitter::Robot(robot));
        self.exchanges.robots.insert(robot, antenna);
        antenna
    }

    /// Returns the radio of a radio unit, which listens on its channel.
    fn radio_of_unit(&mut self, now: Timestamp, unit: RadioUnitIndex) -> Antenna {
        if let Some(antenna) = self.exchanges.units.get(&unit) {
            return *antenna;
        }
        let label = format!("handover {}", self.units[unit].id);
        let antenna = self.equip(&label, Emitter::Unit(unit));
        let (frequency_mhz, channel) = (self.units[unit].frequency_mhz, self.medium.channel(unit));
        self.edca().tune(now, antenna.0, frequency_mhz, channel);
        self.exchanges.units.insert(unit, antenna);
        antenna
    }

    /// Adds a radio of the fabric's own at an antenna.
    fn equip(&mut self, label: &str, place: Emitter) -> Antenna {
        let (seed, sifs) = (self.seed, self.networks[self.network_of(place)].phy.sifs());
        Antenna(self.edca().equip(seed, label, place, sifs, true))
    }
}
