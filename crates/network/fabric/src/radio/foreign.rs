//! Radios that are not the fabric's, such as those of a kernel, at the antennas of robots and radio units. Their frames
//! cross the same air as all others: they [contend](super::edca), fade, collide and interfere. What is in them, which rates
//! they are tried with, and who is attached to whom, is their senders' business.

use std::collections::{BTreeMap, BTreeSet};

use cotorra_graph::{Dbm, Direction, NodeId, Timestamp};

use super::{Path, PhyRate, Radio, RadioUnitIndex, StationIndex, edca::category::Category, emitter::Emitter};
use crate::settings::FabricError;

/// An antenna that is lent to a radio that is not the fabric's.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Antenna(pub(super) usize);

/// A frame that such a radio sends.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Transmission {
    /// The sender's number for it, which its [`Report`]s have.
    pub id: u64,
    /// Centre of its channel, or of the primary one.
    pub frequency_mhz: u16,
    /// Length of its PSDU: MAC header, body and check sequence.
    pub psdu_bytes: u32,
    /// Its access category.
    pub category: Category,
    /// Its receiver.
    pub to: Receiver,
    /// Length of the packet that it carries, as an Ethernet frame without check sequence; `None` if it carries none. Packets
    /// between a robot and a radio unit of its network count on their wireless link.
    pub packet_bytes: Option<u32>,
    /// Whether it may go in one A-MPDU with frames behind it: its receiver has agreed to block acknowledgements, and puts them in
    /// order.
    pub aggregates: bool,
    /// Rates to try, in this order, until it is acknowledged. A frame without acknowledgement is tried once.
    pub rates: Vec<RateTries>,
}

/// A rate of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RateTries {
    /// The rate.
    pub rate: PhyRate,
    /// Tries with it; 0 counts as 1.
    pub tries: u32,
    /// Whether RTS and CTS come first.
    pub rts: bool,
}

/// Receiver of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Receiver {
    /// All other radios. It is not acknowledged.
    All,
    /// One radio, which acknowledges it.
    One(Antenna),
    /// One radio, which does not acknowledge it.
    OneWithoutAnswer(Antenna),
    /// An absent radio: the sender waits in vain for an acknowledgement.
    Nobody,
}

impl Receiver {
    /// Whether its sender waits for an acknowledgement.
    pub(super) fn answers(self) -> bool {
        matches!(self, Self::One(_) | Self::Nobody)
    }
}

/// Fate of a frame.
#[derive(Debug, Clone, PartialEq)]
pub enum Report {
    /// A radio received it. Whether the radio listens on that channel is for the caller to know, if it was for
    /// [all](Receiver::All).
    Received {
        /// End of the frame.
        at: Timestamp,
        /// The number of the transmission.
        id: u64,
        /// The receiver's antenna.
        by: Antenna,
        /// Received power.
        signal: Dbm,
        /// The rate.
        rate: PhyRate,
    },
    /// Its last try is over. If its sender has more frames waiting, and it carried a packet, the report may come with the next
    /// one.
    Settled {
        /// End of the acknowledgement, or of the time in which it would have come.
        at: Timestamp,
        /// The number of the transmission.
        id: u64,
        /// Tries of each rate; none if it did not fit the queue.
        tries: Vec<u32>,
        /// Received power of the acknowledgement, if one came.
        acknowledged: Option<Dbm>,
    },
}

impl Report {
    pub(super) fn at(&self) -> Timestamp {
        match self {
            Self::Received { at, .. } | Self::Settled { at, .. } => *at,
        }
    }
}

/// Reports by time, those of one time in the order in which they came.
#[derive(Debug, Default)]
pub(super) struct Reports {
    queue: BTreeMap<(Timestamp, u64), (Report, Urgency)>,
    count: u64,
}

/// Whether a report is worth a poll of its own.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Urgency {
    AtOnce,
    /// It waits for the next poll.
    CanWait,
}

impl Reports {
    fn push(&mut self, report: Report, urgency: Urgency) {
        self.count += 1;
        self.queue.insert((report.at(), self.count), (report, urgency));
    }

    fn pop(&mut self, now: Timestamp) -> Option<Report> {
        let first = self.queue.first_entry().filter(|first| first.key().0 <= now);
        first.map(|first| first.remove().0)
    }

    fn deadline(&self) -> Option<Timestamp> {
        let urgent = self.queue.iter().find(|(_, (_, urgency))| *urgency == Urgency::AtOnce);
        urgent.map(|((at, _), _)| *at)
    }
}

/// Channels that only such radios use, by their frequency, and antennas that are lent.
#[derive(Debug, Default)]
pub(super) struct Lent {
    /// Frequencies of further channels, MHz.
    pub(super) frequencies: Vec<u16>,
    antennas: BTreeSet<NodeId>,
    reports: Reports,
    /// Rates of the last acknowledged packets of a robot and a radio unit, in each direction.
    rates: BTreeMap<(StationIndex, RadioUnitIndex), [Option<PhyRate>; 2]>,
}

impl Lent {
    pub(super) fn keep_rate(&mut self, Path { robot, unit, direction }: Path, rate: PhyRate) {
        self.rates.entry((robot, unit)).or_default()[direction as usize] = Some(rate);
    }

    /// Returns the rates that the owners of lent antennas chose last, in each direction.
    pub(super) fn rates(&self, robot: StationIndex, unit: RadioUnitIndex) -> [Option<PhyRate>; 2] {
        self.rates.get(&(robot, unit)).copied().unwrap_or_default()
    }
}

impl Radio {
    /// Lends the antenna of a robot or a radio unit. The fabric's own radio there is silent from then on.
    ///
    /// # Errors
    /// [`FabricError::NoAntenna`], [`FabricError::Lent`] or [`FabricError::NoContention`].
    pub(crate) fn lend(&mut self, now: Timestamp, node: &NodeId) -> Result<Antenna, FabricError> {
        self.advance(now);
        let place = match (self.robot_by_name.get(node), self.unit_by_name.get(node)) {
            (Some(robot), _) => Emitter::Robot(*robot),
            (None, Some(unit)) => Emitter::Unit(*unit),
            (None, None) => return Err(FabricError::NoAntenna(node.clone())),
        };
        self.check_not_lent(node)?;
        let network = &self.networks[self.network_of(place)];
        if !network.contends() {
            return Err(FabricError::NoContention(node.clone()));
        }
        let sifs = network.phy.sifs();
        self.lent.antennas.insert(node.clone());
        match place {
            Emitter::Robot(robot) => self.vacate(robot, now),
            Emitter::Unit(unit) => self.desert(now, unit),
            Emitter::Interference(_) | Emitter::Foreign(_) => {}
        }
        let seed = self.seed;
        Ok(Antenna(self.edca().lend(seed, node, place, sifs)))
    }

    /// Checks that an antenna is the fabric's own.
    ///
    /// # Errors
    /// [`FabricError::Lent`].
    pub(super) fn check_not_lent(&self, node: &NodeId) -> Result<(), FabricError> {
        if self.lent.antennas.contains(node) { Err(FabricError::Lent(node.clone())) } else { Ok(()) }
    }

    /// Checks that an antenna is lent.
    ///
    /// # Errors
    /// [`FabricError::NotLent`].
    pub(super) fn check_lent(&self, node: &NodeId) -> Result<(), FabricError> {
        if self.lent.antennas.contains(node) { Ok(()) } else { Err(FabricError::NotLent(node.clone())) }
    }

    /// Whether a robot's antenna is lent.
    pub(super) fn is_lent(&self, robot: StationIndex) -> bool {
        !self.lent.antennas.is_empty() && self.lent.antennas.contains(&self.robots[robot].id)
    }

    /// Silences a robot's radio. Its queued frames are lost.
    pub(super) fn vacate(&mut self, robot: StationIndex, now: Timestamp) {
        self.leave_channel(robot, now);
        let queued = self.take_queued(robot);
        if let Some(unit) = self.robots[robot].home.take() {
            for (direction, queue) in [Direction::Forward, Direction::Backward].into_iter().zip(queued) {
                for waiting in queue {
                    self.lose(Path { robot, unit, direction }, waiting.frame, waiting.is_probe);
                }
            }
        }
        if let Some(unit) = self.robots[robot].station.silence() {
            self.units[unit].stations.retain(|other| *other != robot);
        }
        self.robots[robot].beacons.reset();
        self.timers.set(self.channels + robot, None);
    }

    /// Returns the channel of a frequency. One that no radio unit has is added.
    pub(super) fn channel_at(&mut self, frequency_mhz: u16) -> usize {
        if let Some(unit) = self.units.iter().position(|unit| unit.frequency_mhz == frequency_mhz) {
            return self.medium.channel(unit);
        }
        let known = self.lent.frequencies.iter().position(|known| *known == frequency_mhz);
        let place = known.unwrap_or_else(|| {
            self.lent.frequencies.push(frequency_mhz);
            self.timers.add();
            self.contention.insert(self.channels + self.lent.frequencies.len() - 1);
            self.lent.frequencies.len() - 1
        });
        self.channels + place
    }

    /// Returns the timer of a channel: further channels have theirs behind those of the robots.
    pub(super) fn timer_of(&self, channel: usize) -> usize {
        if channel < self.channels { channel } else { channel + self.robots.len() }
    }

    /// Returns the channel whose timer this is.
    fn channel_of_timer(&self, owner: usize) -> Option<usize> {
        let further = owner.checked_sub(self.robots.len()).filter(|channel| *channel >= self.channels);
        further.or_else(|| (owner < self.channels).then_some(owner))
    }

    /// Returns when a caller can notice anything: when [`Self::poll`] is due, or later. Nobody notices a frame of a lent antenna
    /// before its end, and a late poll changes nothing.
    pub(crate) fn alarm(&self) -> Option<Timestamp> {
        let Some(edca) = self.edca.as_ref().filter(|_| !self.lent.antennas.is_empty()) else {
            return self.deadline();
        };
        let noticed = |(at, owner): (Timestamp, usize)| {
            let channel = self.channel_of_timer(owner).filter(|channel| self.contends(*channel));
            channel.and_then(|channel| edca.alarm(channel)).map_or(at, |alarm| alarm.max(at))
        };
        self.timers.all().map(noticed).chain(self.next_arrival()).min()
    }

    pub(super) fn report(&mut self, report: Report, urgency: Urgency) {
        self.lent.reports.push(report, urgency);
    }

    /// Returns when the next report is due.
    pub(crate) fn report_deadline(&self) -> Option<Timestamp> {
        self.lent.reports.deadline()
    }

    /// Returns the next report up to `now`.
    pub(crate) fn next_report(&mut self, now: Timestamp) -> Option<Report> {
        self.lent.reports.pop(now)
    }
}
