//! Medium access as real stations have it: enhanced distributed channel access (EDCA, IEEE 802.11-2020, 10.23.2). Each
//! station senses the channel for itself, so that stations that do not hear each other send at the same time, and those whose
//! backoffs end together collide.
//!
//! - [`backoff`] is the contention of one access category; [`category`] has their parameters.
//! - [`mod@stream`] has the frames of one category for one receiver, with retries, aggregation and the receiver's order.
//! - [`emitter`] is what is known of whoever sends; [`interference`] is what other networks and other devices send.
//! - [`overlap`] is what frames that overlap do to each other; [`beacon`] takes the airtime of beacons.
//! - [`power_save`] lets stations sleep between beacons.
//! - [`transmission`] puts frames on the air and decides who gets them.

mod backoff;
mod beacon;
pub(super) mod category;
mod emitter;
mod foreign;
mod interference;
mod overlap;
mod power_save;
mod stream;
mod transmission;

use std::{collections::VecDeque, time::Duration};

use cotorra_graph::{Direction, PowerSave, Timestamp};
use cotorra_numbers::Draws;

pub use self::category::Category;
pub(super) use self::interference::Interference;

use self::{
    backoff::Backoff,
    beacon::Beacons,
    category::CATEGORIES,
    foreign::Foreign,
    power_save::Sleep,
    stream::{Settled, Stream},
    transmission::{OnAir, Sender},
};
use super::{
    Path,
    emitter::Emitter,
    medium::{BusyTime, Flow, QueueSettings, Waiting},
};
use crate::port::{RadioUnitIndex, StationIndex};

/// A station or a radio unit, with its four contentions.
#[derive(Debug)]
struct Node {
    contentions: [Contention; 4],
    /// An exchange that goes on after SIFS, within its transmission opportunity.
    burst: Option<Burst>,
}

#[derive(Debug)]
struct Contention {
    backoff: Backoff,
    /// Whether a frame is to be sent.
    ready: bool,
}

/// The rest of a transmission opportunity.
#[derive(Debug, Clone, Copy)]
struct Burst {
    category: usize,
    /// Start of the next exchange.
    next: Timestamp,
    until: Timestamp,
}

impl Node {
    fn new(seed: u64, label: &str, sifs: Duration, parameters: fn(Category) -> backoff::Parameters) -> Self {
        let contentions = CATEGORIES.map(|category| {
            let rng = Draws::new(seed, &format!("backoff {label} {category:?}"));
            Contention { backoff: Backoff::new(parameters(category), sifs, rng), ready: false }
        });
        Self { contentions, burst: None }
    }

    /// Returns when a category sends, if no other sends before; `None` if it has nothing to send.
    fn access(&self, category: usize) -> Option<Timestamp> {
        let contention = &self.contentions[category];
        match self.burst {
            _ if !contention.ready => None,
            Some(burst) if burst.category == category => Some(burst.next),
            _ => Some(contention.backoff.access()),
        }
    }

    fn next_access(&self) -> Option<Timestamp> {
        (0..CATEGORIES.len()).filter_map(|category| self.access(category)).min()
    }

    fn pause(&mut self, now: Timestamp, until: Timestamp) {
        self.contentions.iter_mut().for_each(|contention| contention.backoff.pause(now, until));
    }
}

/// A channel on which stations contend.
#[derive(Debug, Default)]
struct Channel {
    /// Senders that contend on it now.
    members: Vec<Emitter>,
    on_air: Vec<OnAir>,
    /// End of all transmissions so far.
    busy_until: Timestamp,
    busy: BusyTime,
}

#[derive(Debug)]
struct Peer {
    node: Node,
    /// Radio unit on whose channel the station is now.
    on: Option<RadioUnitIndex>,
    /// The radio unit on whose channel it was last.
    with: RadioUnitIndex,
    /// By direction and category.
    streams: [[Stream; 4]; 2],
    /// `None` if it never sleeps.
    sleep: Option<Sleep>,
}

#[derive(Debug)]
struct Unit {
    node: Node,
    channel: usize,
    /// Stations that are with it on its channel.
    present: Vec<StationIndex>,
    group: [Stream; 4],
    turns: [Turns; 4],
    beacons: Beacons,
    /// Its next beacon that wakes stations, if it keeps frames for some that sleep.
    beacon: Option<Timestamp>,
    /// Whether group frames are sent, after a DTIM, though stations sleep.
    delivers_groups: bool,
}

/// Flows of one category of a radio unit, by turns.
#[derive(Debug)]
struct Turns {
    /// The last served is behind all others. Of those that share airtime, it is once it has none left, and one that begins is
    /// before all others, as in Linux (`__ieee80211_schedule_txq`).
    flows: VecDeque<Flow>,
    /// Airtime that rounds gave to each flow that had none, µs.
    given_us: u64,
}

impl Turns {
    fn new(unit: RadioUnitIndex) -> Self {
        Self { flows: VecDeque::from([Flow::Group(unit)]), given_us: 0 }
    }

    /// Takes a flow out. Returns whether it was there.
    fn remove(&mut self, flow: Flow) -> bool {
        let at = self.flows.iter().position(|other| *other == flow);
        at.and_then(|at| self.flows.remove(at)).is_some()
    }

    /// Puts a flow before all others, or behind them, if it is there.
    fn put(&mut self, flow: Flow, first: bool) {
        if !self.remove(flow) {
            return;
        }
        if first { self.flows.push_front(flow) } else { self.flows.push_back(flow) }
    }
}

/// All channels with contention, and the frames that wait for them. Robots and radio units have the numbers of the radio's;
/// those of networks without contention stay unused.
#[derive(Debug)]
pub(super) struct Edca {
    seed: u64,
    channels: Vec<Channel>,
    peers: Vec<Peer>,
    units: Vec<Unit>,
    interference: Vec<Interference>,
    foreign: Vec<Foreign>,
}

impl Edca {
    /// Creates the channels of radio units, each with its channel and SIFS, and stations with their network's SIFS and
    /// sleep.
    pub(super) fn new(
        seed: u64,
        units: impl Iterator<Item = (usize, Duration)>,
        stations: impl Iterator<Item = (Duration, Option<PowerSave>)>,
        interference: Vec<Interference>,
    ) -> Self {
        let units: Vec<_> = units
            .enumerate()
            .map(|(index, (channel, sifs))| Unit {
                node: Node::new(seed, &format!("unit {index}"), sifs, Category::of_access_point),
                channel,
                present: Vec::new(),
                group: Default::default(),
                turns: std::array::from_fn(|_| Turns::new(index)),
                beacons: Beacons::new(seed, index, sifs),
                beacon: None,
                delivers_groups: false,
            })
            .collect();
        let peer = |(index, (sifs, power_save)): (usize, (Duration, Option<PowerSave>))| Peer {
            node: Node::new(seed, &format!("station {index}"), sifs, Category::of_station),
            on: None,
            with: 0,
            streams: Default::default(),
            sleep: power_save.map(Sleep::new),
        };
        let most = units.iter().map(|unit| unit.channel + 1).max().unwrap_or(0);
        let mut channels: Vec<Channel> = (0..most).map(|_| Channel::default()).collect();
        for (index, unit) in units.iter().enumerate() {
            channels[unit.channel].members.push(Emitter::Unit(index));
        }
        for (index, source) in interference.iter().enumerate() {
            if let Some(channel) = channels.get_mut(source.channel()) {
                channel.members.push(Emitter::Interference(index));
            }
        }
        Self {
            seed,
            channels,
            peers: stations.enumerate().map(peer).collect(),
            units,
            interference,
            foreign: Vec::new(),
        }
    }

    /// Puts a station on a radio unit's channel. Its waiting frames can be sent now.
    pub(super) fn enter(&mut self, now: Timestamp, station: StationIndex, unit: RadioUnitIndex) {
        debug_assert!(self.peers[station].on.is_none());
        (self.peers[station].on, self.peers[station].with) = (Some(unit), unit);
        let Unit { channel, present, turns, .. } = &mut self.units[unit];
        present.push(station);
        let streams = &mut self.peers[station].streams[Direction::Backward as usize];
        for (Turns { flows, given_us }, stream) in turns.iter_mut().zip(streams) {
            flows.push_back(Flow::Down(station));
            stream.share(*given_us);
        }
        let channel = &mut self.channels[*channel];
        channel.members.push(Emitter::Robot(station));
        // It listens first. What is on the air takes milliseconds at most.
        self.peers[station].node.pause(now, channel.busy_until.max(now));
        self.refresh(now, Emitter::Robot(station));
        self.refresh(now, Emitter::Unit(unit));
    }

    /// Takes a station off its channel. Returns the frames that either end has sent and the other one got, or never will,
    /// by direction. The others wait.
    pub(super) fn leave(&mut self, now: Timestamp, station: StationIndex) -> [Vec<Settled>; 2] {
        let Some(unit) = self.peers[station].on.take() else { return Default::default() };
        let Unit { channel, present, turns, .. } = &mut self.units[unit];
        present.retain(|other| *other != station);
        turns.iter_mut().for_each(|turns| _ = turns.remove(Flow::Down(station)));
        self.channels[*channel].members.retain(|member| *member != Emitter::Robot(station));
        self.peers[station].node.burst = None;
        let both = &mut self.peers[station].streams;
        let settled = both.each_mut().map(|streams| streams.iter_mut().flat_map(Stream::part).collect());
        self.refresh(now, Emitter::Robot(station));
        self.refresh(now, Emitter::Unit(unit));
        settled
    }

    /// Takes the frames that wait from and for a station off the channel.
    pub(super) fn clear(&mut self, station: StationIndex) -> [VecDeque<Waiting>; 2] {
        let both = &mut self.peers[station].streams;
        both.each_mut().map(|streams| streams.iter_mut().flat_map(Stream::clear).collect())
    }

    /// Queues a frame, by its category. Returns the frames that are dropped.
    pub(super) fn push(
        &mut self,
        now: Timestamp,
        flow: Flow,
        waiting: Waiting,
        queue: QueueSettings,
    ) -> Vec<Waiting> {
        let category = Category::of(waiting.frame.bytes()) as usize;
        let seed = self.seed;
        let rng = || Draws::new(seed, &format!("queue {flow:?} {category}"));
        let stream = self.stream(flow, category);
        let begins = !queue.discipline.is_drop_tail() && !stream.is_ready();
        let dropped = stream.push(now, waiting, queue, rng);
        let sender = match flow {
            Flow::Up(station) => Some(Emitter::Robot(station)),
            Flow::Down(station) => self.peers[station].on.map(Emitter::Unit),
            Flow::Group(unit) => Some(Emitter::Unit(unit)),
        };
        if let Some(Emitter::Unit(unit)) = sender
            && begins
        {
            self.units[unit].turns[category].put(flow, true);
        }
        if let Some(sender) = sender {
            self.refresh(now, sender);
        }
        dropped
    }

    /// Returns when something happens on a channel.
    pub(super) fn wakes(&self, channel: usize) -> Option<Timestamp> {
        self.next(channel, |foreign| foreign.node.next_access())
    }

    /// Returns when a caller can notice that something happens on a channel, at the earliest: a frame of a lent antenna is noticed
    /// at its end.
    pub(super) fn alarm(&self, channel: usize) -> Option<Timestamp> {
        self.next(channel, |foreign| Some(foreign.node.next_access()? + foreign.least_airtime()))
    }

    /// Returns when something happens on a channel, of which `foreign` says what a lent antenna does next.
    fn next(&self, channel: usize, foreign: impl Fn(&Foreign) -> Option<Timestamp>) -> Option<Timestamp> {
        let Channel { members, on_air, .. } = &self.channels[channel];
        let sends = members.iter().filter_map(|member| match member {
            Emitter::Robot(station) => self.peers[*station].node.next_access(),
            Emitter::Unit(unit) => {
                let Unit { node, beacons, beacon, .. } = &self.units[*unit];
                node.next_access().into_iter().chain(*beacon).chain([beacons.deadline()]).min()
            }
            Emitter::Interference(source) => Some(self.interference[*source].deadline()),
            Emitter::Foreign(radio) => foreign(&self.foreign[*radio]),
        });
        sends.chain(on_air.iter().map(|on_air| on_air.data_ends)).min()
    }

    /// Returns the number of frames that wait from a station, and for it.
    pub(super) fn queued(&self, station: StationIndex) -> [u64; 2] {
        self.peers[station].streams.each_ref().map(|all| all.iter().map(|stream| stream.len() as u64).sum())
    }

    /// Returns the number of waiting unicast frames, without those that only measure.
    pub(super) fn unicast_waiting(&self) -> u64 {
        let streams = self.peers.iter().flat_map(|peer| peer.streams.iter().flatten());
        streams.flat_map(Stream::frames).filter(|waiting| !waiting.is_probe).count() as u64
    }

    /// Returns the share of the last second in which anything was on the air of a channel.
    pub(super) fn load(&self, channel: usize, now: Timestamp) -> f64 {
        let Channel { busy, busy_until, .. } = &self.channels[channel];
        busy.share(now, busy_until.since(now))
    }

    fn stream(&mut self, flow: Flow, category: usize) -> &mut Stream {
        match flow {
            Flow::Up(station) => &mut self.peers[station].streams[Direction::Forward as usize][category],
            Flow::Down(station) => &mut self.peers[station].streams[Direction::Backward as usize][category],
            Flow::Group(unit) => &mut self.units[unit].group[category],
        }
    }

    /// Finds out which categories of a sender have frames to send, after some came. Those that had none begin to contend.
    fn refresh(&mut self, now: Timestamp, sender: Emitter) {
        for category in 0..CATEGORIES.len() {
            let ready = self.is_ready(now, sender, category);
            let Some(node) = self.node(sender) else { return };
            let contention = &mut node.contentions[category];
            if ready && !contention.ready {
                contention.backoff.wake(now);
            }
            contention.ready = ready;
        }
        if let Emitter::Unit(unit) = sender {
            self.announce(now, unit);
        }
    }

    /// Returns whose backoffs are over, with what they send. Where more than one category of a sender is due, the most urgent
    /// sends, and the others back off as after a collision (10.23.2.4). A beacon is the most urgent of all.
    fn senders(&mut self, channel: usize, now: Timestamp) -> Vec<Sender> {
        let mut senders = Vec::new();
        for emitter in self.members(channel) {
            if let Emitter::Interference(source) = emitter {
                let airtime = self.interference[source].sends(now);
                senders.extend(airtime.map(|airtime| Sender::Interference { emitter, airtime }));
                continue;
            }
            let mut sends = match emitter {
                Emitter::Unit(unit) if self.units[unit].beacons.sends(now) => {
                    senders.push(Sender::Beacon(unit));
                    true
                }
                _ => false,
            };
            for category in 0..CATEGORIES.len() {
                let flow = self.next_flow(now, emitter, category);
                let Some(node) = self.node(emitter) else { continue };
                if node.access(category).is_none_or(|access| access > now) {
                    continue;
                }
                let next = match (emitter, flow) {
                    (Emitter::Foreign(radio), _) => Some(Sender::Foreign { radio, category }),
                    (_, flow) => flow.map(|flow| Sender::Station { emitter, category, flow }),
                };
                match next {
                    // Its receivers have fallen asleep.
                    None => self.see_frames(now, emitter),
                    Some(_) if sends => node.contentions[category].backoff.double(),
                    Some(sender) => {
                        sends = true;
                        senders.push(sender);
                    }
                }
            }
        }
        senders
    }

    /// Returns who contends on a channel now.
    fn members(&self, channel: usize) -> Vec<Emitter> {
        self.channels[channel].members.clone()
    }

    /// Returns the path of a unicast flow, by the last radio unit of its station; `None` for group frames.
    fn path(&self, flow: Flow) -> Option<Path> {
        let (robot, direction) = match flow {
            Flow::Up(robot) => (robot, Direction::Forward),
            Flow::Down(robot) => (robot, Direction::Backward),
            Flow::Group(_) => return None,
        };
        Some(Path { robot, unit: self.peers[robot].with, direction })
    }

    /// Stops the backoffs of one that senses a transmission.
    fn pause(&mut self, listener: Emitter, now: Timestamp, until: Timestamp) {
        match listener {
            Emitter::Robot(station) => self.peers[station].node.pause(now, until),
            Emitter::Unit(unit) => {
                self.units[unit].node.pause(now, until);
                self.units[unit].beacons.pause(now, until);
            }
            Emitter::Interference(source) => self.interference[source].pause(now, until),
            Emitter::Foreign(radio) => self.foreign[radio].node.pause(now, until),
        }
    }

    /// Begins a transmission opportunity, or the next exchange of one. Returns its end.
    fn begin_opportunity(&mut self, now: Timestamp, emitter: Emitter, category: usize) -> Timestamp {
        let Some(node) = self.node(emitter) else { return now };
        let begun = node.burst.take().map(|burst| burst.until);
        begun.unwrap_or(now + node.contentions[category].backoff.txop())
    }

    /// Lets an emitter go on after SIFS, if it has more frames.
    fn continue_opportunity(&mut self, emitter: Emitter, category: usize, [next, until]: [Timestamp; 2]) {
        if let Some(node) = self.node(emitter) {
            node.burst = node.contentions[category].ready.then_some(Burst { category, next, until });
        }
    }

    /// Whether an attempt that fails now is the last of `most` in a row.
    fn is_last(&mut self, emitter: Emitter, category: usize, most: u32) -> bool {
        self.node(emitter).is_none_or(|node| node.contentions[category].backoff.is_last(most))
    }

    /// Begins the backoff after an exchange. `done` says whether its frames were acknowledged, or it was the last of them.
    fn end_exchange(&mut self, now: Timestamp, emitter: Emitter, category: usize, done: bool) {
        if let Some(node) = self.node(emitter) {
            let backoff = &mut node.contentions[category].backoff;
            if done { backoff.reset() } else { backoff.double() }
        }
        self.see_frames(now, emitter);
    }

    fn end_interference(&mut self, emitter: Emitter, disturbed: Duration) {
        if let Emitter::Interference(source) = emitter {
            self.interference[source].sent(disturbed);
        }
    }

    /// Ends a turn of a flow. If it has no airtime left, it goes behind all others of its radio unit.
    fn take_turn(&mut self, emitter: Emitter, category: usize, flow: Flow) {
        if let Emitter::Unit(unit) = emitter {
            let mut given_us = self.units[unit].turns[category].given_us;
            let is_over = self.stream(flow, category).pay(&mut given_us);
            let turns = &mut self.units[unit].turns[category];
            turns.given_us = given_us;
            turns.put(flow, !is_over);
            self.end_delivery(unit);
        }
    }

    /// Finds out which categories of a sender have frames to send, after it sent some.
    fn see_frames(&mut self, now: Timestamp, sender: Emitter) {
        for category in 0..CATEGORIES.len() {
            let ready = self.is_ready(now, sender, category);
            if let Some(node) = self.node(sender) {
                node.contentions[category].ready = ready;
            }
        }
        if let Emitter::Unit(unit) = sender {
            self.announce(now, unit);
        }
    }

    /// Returns the flow whose turn it is: of those of a radio unit that share airtime, the first one that has some, after as few
    /// rounds as possible. That is Linux's deficit round robin (`ieee80211_next_txq`).
    fn next_flow(&self, now: Timestamp, sender: Emitter, category: usize) -> Option<Flow> {
        let is_ready = |station: StationIndex, direction: Direction| {
            self.peers[station].streams[direction as usize][category].is_ready()
        };
        match sender {
            Emitter::Robot(station) => {
                let sends = self.peers[station].on.is_some() && is_ready(station, Direction::Forward);
                sends.then_some(Flow::Up(station))
            }
            Emitter::Unit(unit) => {
                let Unit { turns, group, .. } = &self.units[unit];
                let is_ready = |flow: &&Flow| match **flow {
                    Flow::Down(station) => is_ready(station, Direction::Backward),
                    Flow::Group(_) => group[category].is_ready(),
                    Flow::Up(_) => false,
                };
                let Turns { flows, given_us } = &turns[category];
                let rounds = |flow: &&Flow| match **flow {
                    Flow::Down(station) => {
                        self.peers[station].streams[Direction::Backward as usize][category].rounds(*given_us)
                    }
                    Flow::Group(_) | Flow::Up(_) => 0,
                };
                let ready = flows.iter().filter(is_ready);
                ready.filter(|flow| self.is_awake(now, **flow)).min_by_key(rounds).copied()
            }
            Emitter::Interference(_) | Emitter::Foreign(_) => None,
        }
    }

    /// Whether a sender has a frame of a category that it can send.
    fn is_ready(&self, now: Timestamp, sender: Emitter, category: usize) -> bool {
        match sender {
            Emitter::Foreign(radio) => self.foreign[radio].is_ready(category),
            _ => self.next_flow(now, sender, category).is_some(),
        }
    }

    fn node(&mut self, emitter: Emitter) -> Option<&mut Node> {
        match emitter {
            Emitter::Robot(station) => Some(&mut self.peers[station].node),
            Emitter::Unit(unit) => Some(&mut self.units[unit].node),
            Emitter::Foreign(radio) => Some(&mut self.foreign[radio].node),
            Emitter::Interference(_) => None,
        }
    }
}
