//! The wireless part of the fabric: positions of robots, the signals that they receive, their attachments to radio units,
//! and their frames on the air. The time is an argument of every call; all randomness comes from the seed.
//!
//! - Path loss, walls and [`shadowing`] give the signal at a place; [`fading`] varies it from frame to frame; [`phy`] turns
//!   it into rates, errors and airtime.
//! - [`medium`] shares each channel's airtime by turns, [`edca`] by contention; [`channel`] chooses. [`rate_control`] picks
//!   the rate of a frame, by [`minstrel`] as Linux does; [`link`] adds the conditions of emulation.
//! - [`hearing`] finds the radio units within a robot's reach; [`air`] carries frames.
//! - [`access`] switches vAPs on and off and admits robots; [`station`] is the state machine of an attachment; [`roaming`]
//!   decides from [`beacons`], [`supplicant`] as wpa_supplicant; [`attaching`] carries out handovers, [`exchange`] those that are
//!   frames on the air; [`elsewhere`] has the robots that are with other cores.
//! - [`foreign`] lends antennas to other radios; [`associations`] has what these radios are attached to.

mod access;
mod air;
mod airtime;
mod associations;
mod attaching;
mod beacons;
mod channel;
mod edca;
mod elsewhere;
mod emitter;
mod exchange;
mod fading;
mod foreign;
mod hearing;
mod link;
mod medium;
mod minstrel;
mod phy;
mod phy_rate;
mod rate_control;
mod roaming;
mod shadowing;
mod station;
mod supplicant;

#[cfg(test)]
mod tests;

use std::{
    cell::OnceCell,
    cmp::Reverse,
    collections::{BTreeMap, BTreeSet, BinaryHeap, VecDeque},
    time::Duration,
};

use cotorra_graph::{
    AccessPoint, Attachment, Band, ConditionChange, Dbm, Direction, DomainId, Event, GapPolicy,
    HardwareGraph, LinkContext, LinkCounters, LinkId, LostCause, NodeId, Position, Probed, QueueDiscipline,
    RadioContext, Stamped, StationContext, StationCounts, Timestamp, WirelessNetwork,
};
use cotorra_numbers::Draws;

pub use self::{
    airtime::Airtime,
    associations::Association,
    edca::Category,
    foreign::{Antenna, RateTries, Receiver, Report, Transmission},
    phy::sensitivity,
    phy_rate::{ChannelWidth, PhyRate},
};

use self::{
    edca::{Edca, Interference},
    emitter::Emitter,
    exchange::Exchanges,
    foreign::Lent,
    hearing::Heard,
    link::WirelessLink,
    medium::{Flow, Medium, QueueSettings, Waiting},
    phy::{Phy, Reception},
    roaming::{Beacons, Policy},
    shadowing::ShadowingField,
    station::{Purpose, Station},
};
use crate::{
    balance::Balance,
    error::GraphError,
    frame::Frame,
    pool::Pool,
    port::{PortId, RadioUnitIndex, StationIndex},
    settings::{Carries, FabricError, Settings},
    timers::Timers,
    trace::DirectedLink,
};

/// Interval of scans of a moving station without a radio unit.
const SEARCH_INTERVAL: Duration = Duration::from_secs(1);

/// A frame that has crossed the air.
#[derive(Debug)]
pub(crate) struct Arrival {
    /// Time of entering the radio.
    pub(crate) since: Timestamp,
    /// Time of arrival.
    pub(crate) due: Timestamp,
    /// Sender: the robot or the radio unit.
    pub(crate) from: PortId,
    /// Receiver.
    pub(crate) at: PortId,
    pub(crate) frame: Frame,
    /// The direction that it crossed.
    pub(crate) path: Path,
    pub(crate) is_probe: bool,
}

/// All robots' radios, all radio units and the air between them.
#[derive(Debug)]
pub(crate) struct Radio {
    seed: u64,
    networks: Vec<Network>,
    robots: Vec<RobotRadio>,
    units: Vec<Unit>,
    robot_by_name: BTreeMap<NodeId, StationIndex>,
    unit_by_name: BTreeMap<NodeId, RadioUnitIndex>,
    by_port: Vec<Option<Role>>,
    /// Links by robot, then radio unit; created at first use, as the fields are.
    links: Vec<Option<Box<WirelessLink>>>,
    fields: Vec<OnceCell<ShadowingField>>,
    medium: Medium,
    /// The channels with contention, if a network has any.
    edca: Option<Edca>,
    /// Timers of the channels, then those of the robots, then those of further channels of lent antennas.
    timers: Timers,
    channels: usize,
    /// Channels with contention.
    contention: BTreeSet<usize>,
    lent: Lent,
    exchanges: Exchanges,
    in_flight: BinaryHeap<Reverse<InFlight>>,
    sent: u64,
    events: VecDeque<Stamped>,
    /// Lost frames, kept for their buffers.
    lost: Vec<Frame>,
    /// Number of frames that no wireless link could carry.
    without_carrier: u64,
}

#[derive(Debug, Clone, Copy)]
enum Role {
    Robot(StationIndex),
    Unit(RadioUnitIndex),
}

#[derive(Debug)]
struct Network {
    ssid: String,
    spec: WirelessNetwork,
    phy: &'static Phy,
    /// Weakest signal that a receiver can decode.
    sensitivity: Dbm,
    settings: Settings,
    /// Mode of all data frames; `None` if a rate control chooses modes.
    fixed_mode: Option<usize>,
    units: Vec<RadioUnitIndex>,
}

#[derive(Debug)]
struct Unit {
    id: NodeId,
    port: PortId,
    network: usize,
    position: Position,
    tx_power: Dbm,
    channel_number: u8,
    frequency_mhz: u16,
    domain: DomainId,
    /// Its vAP; `None` while it is off.
    serves: Option<AccessPoint>,
    /// Attached robots, sorted.
    stations: Vec<StationIndex>,
    /// Random numbers for the backoff of group frames.
    rng: Draws,
}

#[derive(Debug)]
struct RobotRadio {
    id: NodeId,
    port: PortId,
    domain: DomainId,
    /// Credentials for radio units of other domains.
    access: BTreeMap<RadioUnitIndex, AccessPoint>,
    network: usize,
    position: Position,
    tx_power: Dbm,
    policy: Policy,
    station: Station,
    beacons: Beacons,
    /// Whether it has moved since its last beacon.
    moved: bool,
    /// Mobility domain of the radio unit elsewhere that it is attached to, which is none of this graph. Its radio is silent
    /// here then.
    elsewhere: Option<u16>,
    /// The radio unit that it is, or was last, attached to. Its frames count on that link.
    home: Option<RadioUnitIndex>,
    /// Signals of its last scan, updated by beacons, in the order of the network's radio units.
    heard: Vec<Option<Heard>>,
    airtime: Airtime,
}

/// A frame in flight.
#[derive(Debug)]
struct InFlight {
    due: Timestamp,
    /// Order of sending, which decides among frames due at the same time.
    order: u64,
    path: Path,
    /// Time of entering the radio.
    since: Timestamp,
    flight: link::Flight,
    frame: Frame,
    is_probe: bool,
}

/// One direction of one robot's link.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Path {
    pub(crate) robot: StationIndex,
    pub(crate) unit: RadioUnitIndex,
    pub(crate) direction: Direction,
}

impl From<Path> for DirectedLink {
    fn from(Path { robot, unit, direction }: Path) -> Self {
        Self::Air(robot, unit, direction)
    }
}

impl Radio {
    /// Creates the radios of a graph. Each station begins attached to the strongest radio unit within reach of its network.
    ///
    /// # Errors
    /// [`GraphError::Conditions`] for an impossible delay of a network, and for a fixed rate that it does not have.
    pub(crate) fn new(graph: &HardwareGraph, seed: u64) -> Result<Self, GraphError> {
        let mut networks = Vec::new();
        let mut network_by_ssid = BTreeMap::new();
        for (ssid, spec) in &graph.wireless {
            network_by_ssid.insert(ssid.as_str(), networks.len());
            let mut units = graph.radio_units().filter(|(_, unit)| unit.network == *ssid);
            // A network's radio units are in one band.
            let channel = units.next().map_or(1, |(_, unit)| unit.channel);
            let network = Network::new(ssid, spec, spec.standard.band(channel))
                .map_err(|error| GraphError::Conditions { link: ssid.clone(), error })?;
            networks.push(network);
        }
        let ports: BTreeMap<_, _> =
            graph.hosts().enumerate().map(|(i, node)| (&node.id, PortId(i))).collect();
        let mut by_port = vec![None; ports.len()];
        let mut units = Vec::new();
        for (node, unit) in graph.radio_units() {
            let Some(&network) = network_by_ssid.get(unit.network.as_str()) else { continue };
            let port = ports[&node.id];
            by_port[port.0] = Some(Role::Unit(units.len()));
            networks[network].units.push(units.len());
            units.push(Unit {
                id: node.id.clone(),
                port,
                network,
                position: node.position.unwrap_or_default(),
                tx_power: unit.tx_power,
                channel_number: unit.channel,
                domain: node.domain.clone(),
                serves: unit.serving.then(|| networks[network].access_point()),
                frequency_mhz: networks[network].spec.standard.frequency_mhz(unit.channel),
                stations: Vec::new(),
                rng: Draws::new(seed, &format!("group {}", node.id)),
            });
        }
        let mut robots = Vec::new();
        for (node, robot) in graph.robots() {
            let Some(&network) = network_by_ssid.get(robot.network.as_str()) else { continue };
            let Network { spec, units, .. } = &networks[network];
            let port = ports[&node.id];
            by_port[port.0] = Some(Role::Robot(robots.len()));
            robots.push(RobotRadio {
                port,
                domain: node.domain.clone(),
                access: BTreeMap::new(),
                network,
                position: node.position.unwrap_or_default(),
                tx_power: robot.tx_power,
                policy: Policy::new(robot.roaming, spec, seed, &node.id),
                station: Station::new(spec, Draws::new(seed, &format!("station {}", node.id))),
                beacons: Beacons::default(),
                moved: false,
                elsewhere: None,
                home: None,
                heard: vec![None; units.len()],
                airtime: Airtime::default(),
                id: node.id.clone(),
            });
        }
        let mut channels: Vec<_> = units.iter().map(|u| u.frequency_mhz).collect();
        channels.sort_unstable();
        channels.dedup();
        let channel = |unit: &Unit| channels.partition_point(|f| *f < unit.frequency_mhz);
        let edca = networks.iter().any(Network::contends).then(|| {
            let mut interference = Vec::new();
            for (index, network) in networks.iter().enumerate() {
                for source in network.spec.access.interference() {
                    let frequency_mhz = network.spec.standard.frequency_mhz(source.channel);
                    if let Ok(channel) = channels.binary_search(&frequency_mhz) {
                        let place = [index, channel];
                        let sifs = network.phy.sifs();
                        interference.push(Interference::new(source, place, frequency_mhz, sifs, seed));
                    }
                }
            }
            let units = units.iter().map(|unit| (channel(unit), networks[unit.network].phy.sifs()));
            let stations = robots.iter().map(|robot| {
                let Network { phy, spec, .. } = &networks[robot.network];
                (phy.sifs(), spec.access.edca().and_then(|edca| edca.power_save))
            });
            Edca::new(seed, units, stations, interference)
        });
        let contention = units.iter().filter(|unit| networks[unit.network].contends()).map(channel).collect();
        let pairs = robots.len() * units.len();
        let mut radio = Self {
            seed,
            robot_by_name: robots.iter().enumerate().map(|(i, r)| (r.id.clone(), i)).collect(),
            unit_by_name: units.iter().enumerate().map(|(i, u)| (u.id.clone(), i)).collect(),
            by_port,
            links: (0..pairs).map(|_| None).collect(),
            fields: (0..pairs).map(|_| OnceCell::new()).collect(),
            medium: Medium::new(units.iter().map(channel), robots.len()),
            timers: Timers::new(channels.len() + robots.len()),
            channels: channels.len(),
            contention,
            networks,
            robots,
            units,
            edca,
            lent: Lent::default(),
            exchanges: Exchanges::default(),
            in_flight: BinaryHeap::new(),
            sent: 0,
            events: VecDeque::new(),
            lost: Vec::new(),
            without_carrier: 0,
        };
        for robot in 0..radio.robots.len() {
            radio.listen(robot, Timestamp::ZERO);
            let strongest = radio.strongest(robot);
            // Before its first scan, a robot knows its own radio unit only.
            radio.forget(robot);
            if let Some(unit) = strongest {
                radio.robots[robot].station.begin_attached(unit);
                radio.associate(Timestamp::ZERO, robot, unit);
                radio.enter_channel(robot, unit, Timestamp::ZERO);
            }
            if radio.robots[robot].policy.supplicant().is_some() || radio.next_scan(robot).is_some() {
                radio.watch(robot, Timestamp::ZERO);
            }
        }
        Ok(radio)
    }

    /// Sends a frame from a robot to its radio unit. The frame is a single packet.
    pub(crate) fn push_up(&mut self, now: Timestamp, robot: PortId, frame: Frame) {
        self.advance(now);
        let station = match self.role(robot) {
            // A station that never had a radio unit has no carrier.
            Some(Role::Robot(robot)) => self.robots[robot].home.map(|unit| (robot, unit)),
            _ => None,
        };
        let Some((robot, unit)) = station else { return self.strand(frame) };
        self.enqueue(now, Path { robot, unit, direction: Direction::Forward }, frame, false);
    }

    /// Drops a frame that no wireless link can carry.
    fn strand(&mut self, mut frame: Frame) {
        frame.end(None, LostCause::NoAttachment);
        self.without_carrier += 1;
        self.lost.push(frame);
    }

    /// Sends a frame from a radio unit to a robot. A frame that comes after the robot has left is treated like those queued
    /// before: it moves on to the new radio unit or is lost, by the network's [`GapPolicy`].
    pub(crate) fn push_down(&mut self, now: Timestamp, unit: PortId, robot: PortId, frame: Frame) {
        self.advance(now);
        let (Some(Role::Unit(unit)), Some(Role::Robot(robot))) = (self.role(unit), self.role(robot)) else {
            return self.strand(frame);
        };
        let path = Path { robot, unit, direction: Direction::Backward };
        match (self.robots[robot].home, self.gap_policy(robot)) {
            (Some(home), GapPolicy::Hold) => self.enqueue(now, Path { unit: home, ..path }, frame, false),
            (Some(home), GapPolicy::Drop) if home == unit => self.enqueue(now, path, frame, false),
            _ => self.lose(path, frame, false),
        }
    }

    /// Returns the number of frames that wait from a robot, or for it.
    pub(crate) fn waiting(&self, robot: PortId, direction: Direction) -> u64 {
        match self.role(robot) {
            Some(Role::Robot(robot)) => self.queued(robot)[direction as usize],
            _ => 0,
        }
    }

    /// Returns the number of robots with a radio.
    pub(crate) fn stations(&self) -> usize {
        self.robots.len()
    }

    /// Returns the radio unit that a robot is, or was last, attached to.
    pub(crate) fn linked(&self, robot: StationIndex) -> Option<RadioUnitIndex> {
        self.robots[robot].home
    }

    /// Returns the airtime of one frame per robot of a robot's network, at the slowest rate and all on one channel.
    pub(crate) fn turns(&self, robot: StationIndex, bytes: usize) -> Duration {
        let network = self.robots[robot].network;
        let robots = self.robots.iter().filter(|other| other.network == network).count();
        self.networks[network].phy.group_airtime(bytes, true, 0.5) * robots as u32
    }

    /// Sends a probe over a robot's link.
    pub(crate) fn probe(&mut self, now: Timestamp, path: Path, frame: Frame) {
        self.advance(now);
        match self.robots[path.robot].home {
            Some(home) if home == path.unit => self.enqueue(now, path, frame, true),
            _ => self.lose(path, frame, true),
        }
    }

    /// Sends a group-addressed frame from a radio unit to all its stations but the source: once, at the lowest basic rate.
    /// A station that is off the channel misses it.
    pub(crate) fn push_group(&mut self, now: Timestamp, unit: PortId, source: PortId, frame: Frame) {
        self.advance(now);
        let Some(Role::Unit(unit)) = self.role(unit) else { return self.lost.push(frame) };
        if self.check_lent(&self.units[unit].id).is_ok() {
            // The radio there has got it at the port.
            return self.lost.push(frame);
        }
        let source = match self.role(source) {
            Some(Role::Robot(robot)) => Some(robot),
            _ => None,
        };
        if self.group(unit, source).next().is_none() {
            return self.lost.push(frame);
        }
        let waiting = Waiting { frame, since: now, source, is_probe: false };
        let network = self.units[unit].network;
        let dropped = self.push(now, network, Flow::Group(unit), waiting, QueueSettings::default());
        if dropped.is_empty() {
            return self.serve(self.medium.channel(unit), now);
        }
        for path in self.group(unit, source).collect::<Vec<_>>() {
            self.lane(path).meter().counters.overflowed += 1;
        }
        self.lost.extend(dropped.into_iter().map(|waiting| waiting.frame));
    }

    /// Returns the paths from a radio unit to all its stations but one.
    fn group(&self, unit: RadioUnitIndex, source: Option<StationIndex>) -> impl Iterator<Item = Path> {
        let others = self.units[unit].stations.iter().filter(move |robot| Some(**robot) != source);
        others.map(move |&robot| Path { robot, unit, direction: Direction::Backward })
    }

    /// Advances to `now`, appends arrived frames to `out` in order, and returns the next deadline. Buffers of lost frames
    /// go to the pool.
    pub(crate) fn poll(
        &mut self,
        now: Timestamp,
        pool: &mut Pool,
        out: &mut Vec<Arrival>,
    ) -> Option<Timestamp> {
        self.advance(now);
        self.discard_lost(pool);
        while self.in_flight.peek().is_some_and(|Reverse(f)| f.due <= now) {
            let Some(Reverse(InFlight { due, path, since, flight, mut frame, is_probe, .. })) =
                self.in_flight.pop()
            else {
                break;
            };
            if !is_probe {
                self.lane(path).meter().crossed(since, due, 1, frame.wire_bytes());
            }
            if let Some(trace) = frame.trace() {
                trace.crossed(path.into(), [since, flight.start(), due], flight.retries());
            }
            let (robot, unit) = (self.robots[path.robot].port, self.units[path.unit].port);
            let (from, at) = match path.direction {
                Direction::Forward => (robot, unit),
                Direction::Backward => (unit, robot),
            };
            out.push(Arrival { since, due, from, at, frame, path, is_probe });
        }
        self.deadline()
    }

    /// Gives lost frames to the pool.
    pub(crate) fn discard_lost(&mut self, pool: &mut Pool) {
        self.lost.drain(..).for_each(|frame| pool.discard(frame));
    }

    /// Returns when [`Self::poll`] is due.
    pub(crate) fn deadline(&self) -> Option<Timestamp> {
        let timer = self.timers.next().map(|(at, _)| at);
        timer.into_iter().chain(self.next_arrival()).min()
    }

    fn next_arrival(&self) -> Option<Timestamp> {
        self.in_flight.peek().map(|Reverse(f)| f.due)
    }

    /// Returns the next event: handovers, scans, lost radio units.
    pub(crate) fn next_event(&mut self) -> Option<Stamped> {
        self.events.pop_front()
    }

    /// Moves a robot.
    ///
    /// # Errors
    /// [`FabricError::UnknownRobot`].
    pub(crate) fn move_robot(
        &mut self,
        now: Timestamp,
        robot: &NodeId,
        to: Position,
    ) -> Result<(), FabricError> {
        self.advance(now);
        let index = self.robot(robot)?;
        let robot = &mut self.robots[index];
        if robot.position == to {
            return Ok(());
        }
        robot.position = to;
        let watching = std::mem::replace(&mut robot.moved, true);
        let listens = robot.elsewhere.is_none() && !self.is_lent(index);
        if !watching && listens && !self.robots[index].station.is_busy() {
            self.watch(index, now);
        }
        Ok(())
    }

    /// Makes a robot's radio leave its channel and scan all others. A robot without a radio unit joins the strongest. One
    /// with a supplicant joins what its supplicant decides for.
    ///
    /// # Errors
    /// [`FabricError::UnknownRobot`]; [`FabricError::Busy`] while it scans or changes its radio unit.
    pub(crate) fn scan(&mut self, now: Timestamp, robot: &NodeId) -> Result<(), FabricError> {
        self.advance(now);
        let index = self.robot(robot)?;
        self.check_not_lent(robot)?;
        if self.robots[index].elsewhere.is_some() {
            return Err(FabricError::Elsewhere(robot.clone()));
        }
        let RobotRadio { station, policy, .. } = &self.robots[index];
        let decides = station.attached().is_none() || policy.supplicant().is_some();
        let purpose = if decides { Purpose::Roam } else { Purpose::Look };
        self.begin_scan(index, now, purpose).map_err(|_| FabricError::Busy(robot.clone()))
    }

    /// Attaches a robot to a radio unit, after a current scan. Does nothing if it is attached there, or about to be.
    ///
    /// # Errors
    /// [`FabricError::UnknownRobot`], [`FabricError::UnknownRadioUnit`], [`FabricError::OtherNetwork`],
    /// [`FabricError::NotServing`], [`FabricError::NotAdmitted`], [`FabricError::OutOfReach`]; [`FabricError::Busy`] during
    /// a handover to another radio unit.
    pub(crate) fn attach(
        &mut self,
        now: Timestamp,
        robot: &NodeId,
        unit: &NodeId,
    ) -> Result<(), FabricError> {
        self.advance(now);
        let index = self.robot(robot)?;
        self.check_not_lent(robot)?;
        let to = self.unit(unit)?;
        self.check_not_lent(unit)?;
        if self.robots[index].network != self.units[to].network {
            return Err(FabricError::OtherNetwork { robot: robot.clone(), radio_unit: unit.clone() });
        }
        if self.robots[index].station.attached() != Some(to) {
            self.check_access(index, to)?;
            if self.hears(index, to).is_none() {
                return Err(FabricError::OutOfReach { robot: robot.clone(), radio_unit: unit.clone() });
            }
        }
        let station = &mut self.robots[index].station;
        let was_busy = station.is_busy();
        station.attach(now, to).map_err(|_| FabricError::Busy(robot.clone()))?;
        if !was_busy && station.is_busy() {
            if self.robots[index].elsewhere.is_some() {
                // Its frames wait for the radio unit that it comes to.
                self.robots[index].home = Some(to);
            }
            self.leave(index, now);
        }
        Ok(())
    }

    /// Returns the radio unit that a robot is attached to; during a handover, the former one, or the next one if the former
    /// is elsewhere.
    pub(crate) fn attached_to(&self, robot: PortId) -> Option<PortId> {
        let Some(Role::Robot(robot)) = self.role(robot) else { return None };
        let RobotRadio { station, elsewhere, .. } = &self.robots[robot];
        let comes_to = || elsewhere.and(station.underway_to());
        station.attached().or_else(comes_to).map(|unit| self.units[unit].port)
    }

    /// Returns φ(r,R) for every radio unit of the robot's network, with the last signal that the robot received; empty for
    /// an unknown robot.
    pub(crate) fn attachments(&self, now: Timestamp, robot: &NodeId) -> Vec<Attachment> {
        let Some(&index) = self.robot_by_name.get(robot) else { return Vec::new() };
        let RobotRadio { network, station, heard, .. } = &self.robots[index];
        let attachment = |(&unit, heard): (&RadioUnitIndex, &Option<Heard>)| {
            let attached = station.attached() == Some(unit);
            // A station on the channel hears its radio unit's beacons all the time.
            let fresh = station.on_channel() == Some(unit);
            let [_, present] = self.signals(index, unit);
            let heard = if fresh { Some(Heard { signal: present, at: now }) } else { *heard };
            Attachment {
                radio_unit: self.units[unit].id.clone(),
                attached,
                signal: heard.map(|heard| heard.signal),
                age: heard.map(|heard| now.since(heard.at)),
            }
        };
        self.networks[*network].units.iter().zip(heard).map(attachment).collect()
    }

    /// Returns ι(R) of every radio unit.
    pub(crate) fn contexts(&self, now: Timestamp) -> Vec<RadioContext> {
        let context = |(index, unit): (usize, &Unit)| RadioContext {
            radio_unit: unit.id.clone(),
            channel: unit.channel_number,
            load: Some(self.load(self.medium.channel(index), now)),
            stations: unit.stations.iter().map(|robot| self.station_context(*robot, index)).collect(),
        };
        self.units.iter().enumerate().map(context).collect()
    }

    fn station_context(&self, robot: StationIndex, unit: RadioUnitIndex) -> StationContext {
        let [signal, _] = self.signals(robot, unit);
        let link = self.links[self.pair(robot, unit)].as_deref();
        let [up, down] = self.receptions(robot, unit, 0.0);
        let chosen = self.lent.rates(robot, unit);
        let fixed_mode = self.networks[self.robots[robot].network].fixed_mode;
        let bps = |direction, reception: &Reception| {
            if let Some(rate) = chosen[direction as usize] {
                return rate.bits_per_second() as f64;
            }
            let first = || fixed_mode.map_or_else(|| reception.mbps(), |mode| reception.mbps_of(mode));
            1e6 * link.map_or_else(first, |link| link.mbps(direction, reception))
        };
        let [uplink_bps, downlink_bps] = [bps(Direction::Forward, &up), bps(Direction::Backward, &down)];
        let counted = StationCounts::default();
        StationContext { robot: self.robots[robot].id.clone(), signal, downlink_bps, uplink_bps, counted }
    }

    /// Returns the outcome of all frames that entered the radio, without those that only measure.
    pub(crate) fn balance(&self) -> Balance {
        let mut balance = Balance { stranded: self.without_carrier, ..Balance::default() };
        for (pair, link) in self.links.iter().enumerate() {
            // Packets of lent antennas have entered at ports, if they have arrived at all.
            if let Some(link) = link.as_deref().filter(|_| !self.is_lent(pair / self.units.len())) {
                balance += link.balance();
            }
        }
        let flying = self.in_flight.iter().filter(|Reverse(flying)| !flying.is_probe).count() as u64;
        let contending = self.edca.as_ref().map_or(0, Edca::unicast_waiting);
        balance.under_way = self.medium.unicast_waiting() + contending + flying;
        balance
    }

    /// Returns the contexts of both directions of every wireless link that was in use or changed. The others have only the
    /// defaults of their network.
    pub(crate) fn link_contexts(
        &self,
        now: Timestamp,
        probed: impl Fn(StationIndex, RadioUnitIndex) -> Option<[Probed; 2]>,
    ) -> Vec<LinkContext> {
        let both = |(pair, link): (usize, &WirelessLink)| {
            let (robot, unit) = (pair / self.units.len(), pair % self.units.len());
            let probed = probed(robot, unit);
            // Frames wait on the link on which they count.
            let waiting = match self.robots[robot].home {
                Some(home) if home == unit => self.queued(robot),
                _ => [0; 2],
            };
            [Direction::Forward, Direction::Backward].map(|direction| {
                let way = direction as usize;
                link.context(now, direction, waiting[way], probed.map(|both| both[way]))
            })
        };
        let links = self.links.iter().enumerate().filter_map(|(pair, link)| Some((pair, link.as_deref()?)));
        links.flat_map(both).collect()
    }

    /// Returns a link and the counters of one direction; `None` before its first use.
    pub(crate) fn counters(&self, path: Path) -> Option<(&LinkId, &LinkCounters)> {
        Some(self.links[self.pair(path.robot, path.unit)].as_deref()?.counters(path.direction))
    }

    /// Returns what one direction of a wireless link can carry; `None` for an unknown link.
    pub(crate) fn carries(&self, link: &LinkId, direction: Direction) -> Option<Carries> {
        let (robot, unit) = self.ends(link)?;
        let settings = match &self.links[self.pair(robot, unit)] {
            Some(link) => link.settings(direction),
            None => &self.networks[self.robots[robot].network].settings,
        };
        let is_there = self.robots[robot].station.attached() == Some(unit);
        Some(Carries { is_there, ..Carries::of(settings) })
    }

    /// Returns the ports of a wireless link's robot and radio unit; `None` for an unknown link.
    pub(crate) fn ends_of(&self, link: &LinkId) -> Option<[PortId; 2]> {
        let (robot, unit) = self.ends(link)?;
        Some([self.robots[robot].port, self.units[unit].port])
    }

    /// Whether a wireless link of this name exists.
    pub(crate) fn has_link(&self, link: &LinkId) -> bool {
        self.ends(link).is_some()
    }

    /// Changes the conditions of a wireless link, in one direction or both, for all frames that are not on the air yet.
    /// Frames on the air profit from a shorter delay.
    ///
    /// # Errors
    /// [`FabricError`] for an unknown link or impossible conditions. Nothing has changed then.
    pub(crate) fn change(
        &mut self,
        now: Timestamp,
        link: &LinkId,
        direction: Option<Direction>,
        change: &ConditionChange,
    ) -> Result<(), FabricError> {
        self.advance(now);
        let (robot, unit) = self.ends(link).ok_or_else(|| FabricError::UnknownLink(link.clone()))?;
        let can_queue = |discipline: QueueDiscipline| match discipline {
            QueueDiscipline::DropTail => true,
            QueueDiscipline::FqCodel(_) => self.networks[self.robots[robot].network].contends(),
            _ => false,
        };
        if !change.queue_discipline.is_none_or(can_queue) {
            return Err(FabricError::NotOnWireless("queue discipline"));
        }
        let both = [Direction::Forward, Direction::Backward];
        let directions = both.into_iter().filter(|d| direction.is_none_or(|wanted| wanted == *d));
        let paths: Vec<_> = directions.map(|direction| Path { robot, unit, direction }).collect();
        let settings = paths.iter().map(|p| self.lane(*p).changed(change)).collect::<Result<Vec<_>, _>>()?;
        for (path, settings) in paths.into_iter().zip(settings) {
            self.lane(path).set(settings);
            self.pull_forward(now, path);
        }
        Ok(())
    }

    /// Recomputes the arrival of the frames in flight on a path.
    fn pull_forward(&mut self, now: Timestamp, path: Path) {
        let mut in_flight = std::mem::take(&mut self.in_flight).into_vec();
        in_flight.sort_unstable_by_key(|Reverse(f)| f.key());
        let under_way = in_flight.iter_mut().filter(|Reverse(f)| f.path == path && f.due > now);
        self.lane(path).pull_forward(now, under_way.map(|Reverse(f)| (&f.flight, &mut f.due)));
        self.in_flight = in_flight.into();
    }

    /// Returns the robot and the radio unit of a wireless link. Their names may contain a `~`, too.
    fn ends(&self, link: &LinkId) -> Option<(StationIndex, RadioUnitIndex)> {
        let split = |(at, _): (usize, &str)| {
            let (robot, unit) = (&link.as_str()[..at], &link.as_str()[at + 1..]);
            Some((*self.robot_by_name.get(robot)?, *self.unit_by_name.get(unit)?))
        };
        let same_network = |(robot, unit): &(StationIndex, RadioUnitIndex)| {
            self.robots[*robot].network == self.units[*unit].network
        };
        link.as_str().match_indices('~').filter_map(split).find(same_network)
    }

    fn robot(&self, id: &NodeId) -> Result<StationIndex, FabricError> {
        self.robot_by_name.get(id).copied().ok_or_else(|| FabricError::UnknownRobot(id.clone()))
    }

    fn role(&self, port: PortId) -> Option<Role> {
        self.by_port.get(port.0).copied().flatten()
    }

    /// Returns what happens to frames of a robot off its channel. In a handover whose frames are on the air, they are lost: Linux
    /// has no carrier then, and the former radio unit does not pass frames on.
    fn gap_policy(&self, robot: StationIndex) -> GapPolicy {
        if self.robots[robot].station.is_exchanging() {
            return GapPolicy::Drop;
        }
        self.networks[self.robots[robot].network].spec.gap
    }

    fn pair(&self, robot: StationIndex, unit: RadioUnitIndex) -> usize {
        robot * self.units.len() + unit
    }

    fn link(&mut self, robot: StationIndex, unit: RadioUnitIndex) -> &mut WirelessLink {
        let pair = self.pair(robot, unit);
        self.links[pair].get_or_insert_with(|| {
            let RobotRadio { id, network, .. } = &self.robots[robot];
            let Unit { id: unit, frequency_mhz, .. } = &self.units[unit];
            let id = LinkId::wireless(id, unit);
            Box::new(WirelessLink::new(id, &self.networks[*network], *frequency_mhz, self.seed))
        })
    }

    fn lane(&mut self, path: Path) -> &mut link::Lane {
        self.link(path.robot, path.unit).lane(path.direction)
    }

    fn emit(&mut self, at: Timestamp, event: Event) {
        self.events.push_back(Stamped { at, event });
    }
}

impl Path {
    /// Returns who receives its frames.
    fn receiver(self) -> Emitter {
        match self.direction {
            Direction::Forward => Emitter::Unit(self.unit),
            Direction::Backward => Emitter::Robot(self.robot),
        }
    }
}

impl Network {
    /// Whether its stations contend for the channel; otherwise they take turns.
    fn contends(&self) -> bool {
        self.spec.access.contends()
    }

    /// Creates a network whose radio units are in a band.
    fn new(ssid: &str, spec: &WirelessNetwork, band: Band) -> Result<Self, FabricError> {
        let phy = Phy::of(spec, band);
        Ok(Self {
            phy,
            sensitivity: sensitivity(spec),
            settings: link::initial_settings(spec, phy)?,
            fixed_mode: rate_control::fixed_mode(spec)?,
            units: Vec::new(),
            ssid: ssid.to_owned(),
            spec: spec.clone(),
        })
    }

    /// The access point of a radio unit that serves from the start.
    fn access_point(&self) -> AccessPoint {
        AccessPoint {
            ssid: self.ssid.clone(),
            mobility_domain: self.spec.mobility_domain,
            key: None,
            core: None,
        }
    }
}

impl InFlight {
    fn key(&self) -> (Timestamp, u64) {
        (self.due, self.order)
    }
}

impl PartialEq for InFlight {
    fn eq(&self, other: &Self) -> bool {
        self.key() == other.key()
    }
}

impl Eq for InFlight {}

impl PartialOrd for InFlight {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for InFlight {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.key().cmp(&other.key())
    }
}
