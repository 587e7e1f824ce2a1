//! Medium access. Radio units on one channel and their stations share its airtime: one frame at a time is on the air, the
//! others wait with their senders, and senders take turns.

use std::{collections::VecDeque, time::Duration};

use cotorra_graph::{QueueDiscipline, QueueLimit, Timestamp};

use crate::frame::Frame;
use crate::port::{RadioUnitIndex, StationIndex};
use crate::queue::{Queued, packet};

/// A frame that waits for the channel.
#[derive(Debug)]
pub(super) struct Waiting {
    pub(super) frame: Frame,
    pub(super) since: Timestamp,
    /// The station that sent a group frame, which must not get it back.
    pub(super) source: Option<StationIndex>,
    /// Whether it only measures and is in no counter.
    pub(super) is_probe: bool,
}

impl Queued for Waiting {
    /// mac80211 leaves it at 0.
    const SPARED: u64 = 0;

    fn entered(&self) -> Timestamp {
        self.since
    }

    fn packets(&self) -> u32 {
        self.frame.wire_packets()
    }

    fn bytes(&self) -> u64 {
        self.frame.wire_bytes()
    }

    fn flow(&self) -> u64 {
        packet::flow(self.frame.bytes())
    }

    fn mark(&mut self) -> bool {
        packet::mark(self.frame.bytes_mut())
    }
}

/// Limit and discipline of a flow's queue.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct QueueSettings {
    pub(super) limit: QueueLimit,
    pub(super) discipline: QueueDiscipline,
}

/// A drop-tail queue.
#[derive(Debug, Default)]
pub(super) struct Queue {
    frames: VecDeque<Waiting>,
    bytes: u64,
}

impl Queue {
    pub(super) fn fits(&self, frame: &Frame, limit: QueueLimit) -> bool {
        match limit {
            QueueLimit::Packets(limit) => self.frames.len() < limit as usize,
            QueueLimit::Bytes(limit) => self.bytes + frame.wire_bytes() <= limit,
        }
    }

    pub(super) fn push(&mut self, waiting: Waiting) {
        self.bytes += waiting.frame.wire_bytes();
        self.frames.push_back(waiting);
    }

    /// Puts a frame before all others, whatever the limit.
    pub(super) fn push_front(&mut self, waiting: Waiting) {
        self.bytes += waiting.frame.wire_bytes();
        self.frames.push_front(waiting);
    }

    pub(super) fn front(&self) -> Option<&Waiting> {
        self.frames.front()
    }

    pub(super) fn iter(&self) -> impl Iterator<Item = &Waiting> {
        self.frames.iter()
    }

    pub(super) fn len(&self) -> usize {
        self.frames.len()
    }

    pub(super) fn is_empty(&self) -> bool {
        self.frames.is_empty()
    }

    pub(super) fn pop(&mut self) -> Option<Waiting> {
        let waiting = self.frames.pop_front()?;
        self.bytes -= waiting.frame.wire_bytes();
        Some(waiting)
    }

    pub(super) fn take(&mut self) -> VecDeque<Waiting> {
        self.bytes = 0;
        std::mem::take(&mut self.frames)
    }
}

/// A sender that takes turns on a channel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Sender {
    Station(StationIndex),
    RadioUnit(RadioUnitIndex),
}

/// A receiver that a radio unit sends to, in turns.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Receiver {
    Station(StationIndex),
    Group,
}

/// The sender and receiver of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Flow {
    /// From a station up to its radio unit.
    Up(StationIndex),
    /// From its radio unit down to a station.
    Down(StationIndex),
    /// From a radio unit to all its stations.
    Group(RadioUnitIndex),
}

/// A channel. `turns` holds each sender that can send, once.
#[derive(Debug, Default)]
struct Channel {
    turns: VecDeque<Sender>,
    busy_until: Timestamp,
    busy: BusyTime,
}

#[derive(Debug)]
struct Unit {
    channel: usize,
    /// Each receiver that it can send to, once.
    turns: VecDeque<Receiver>,
    group: Queue,
}

#[derive(Debug, Default)]
struct Peer {
    /// Radio unit on whose channel the station is now.
    on: Option<RadioUnitIndex>,
    up: Queue,
    down: Queue,
}

/// All channels and the frames that wait for them.
///
/// A station off the channel keeps its queues, and its radio unit keeps the frames for it. Neither takes turns for them.
#[derive(Debug)]
pub(super) struct Medium {
    channels: Vec<Channel>,
    units: Vec<Unit>,
    peers: Vec<Peer>,
}

impl Medium {
    /// Creates a medium with `stations` stations, and radio units on these channels, numbered from 0.
    pub(super) fn new(channel_of_unit: impl Iterator<Item = usize>, stations: usize) -> Self {
        let unit = |channel| Unit { channel, turns: VecDeque::new(), group: Queue::default() };
        let units: Vec<_> = channel_of_unit.map(unit).collect();
        let channels = units.iter().map(|u| u.channel + 1).max().unwrap_or(0);
        Self {
            channels: (0..channels).map(|_| Channel::default()).collect(),
            units,
            peers: (0..stations).map(|_| Peer::default()).collect(),
        }
    }

    /// Returns the channel of a radio unit.
    pub(super) fn channel(&self, unit: RadioUnitIndex) -> usize {
        self.units[unit].channel
    }

    /// Puts a station on a radio unit's channel. Its waiting frames can be sent now.
    pub(super) fn enter(&mut self, station: StationIndex, unit: RadioUnitIndex) {
        self.leave(station);
        let Peer { on, up, down } = &mut self.peers[station];
        *on = Some(unit);
        let (sends, receives) = (!up.frames.is_empty(), !down.frames.is_empty());
        if sends {
            self.channels[self.units[unit].channel].turns.push_back(Sender::Station(station));
        }
        if receives {
            self.enlist(unit, Receiver::Station(station));
        }
    }

    /// Takes a station off its channel.
    pub(super) fn leave(&mut self, station: StationIndex) {
        let Some(unit) = self.peers[station].on.take() else { return };
        let Unit { channel, turns, .. } = &mut self.units[unit];
        turns.retain(|r| *r != Receiver::Station(station));
        let unit_is_done = turns.is_empty();
        self.channels[*channel].turns.retain(|sender| match sender {
            Sender::Station(s) => *s != station,
            Sender::RadioUnit(u) => *u != unit || !unit_is_done,
        });
    }

    /// Removes the frames that wait from and for a station. The station must be off the channel, so that no turn is left
    /// without a frame.
    pub(super) fn clear(&mut self, station: StationIndex) -> [VecDeque<Waiting>; 2] {
        let Peer { on, up, down } = &mut self.peers[station];
        debug_assert!(on.is_none());
        [up.take(), down.take()]
    }

    /// Returns the number of waiting unicast frames, without those that only measure.
    pub(super) fn unicast_waiting(&self) -> u64 {
        let queues = self.peers.iter().flat_map(|peer| [&peer.up, &peer.down]);
        queues.flat_map(|queue| &queue.frames).filter(|waiting| !waiting.is_probe).count() as u64
    }

    /// Returns the number of frames that wait from a station, and for it.
    pub(super) fn queued(&self, station: StationIndex) -> [u64; 2] {
        let Peer { up, down, .. } = &self.peers[station];
        [up, down].map(|queue| queue.frames.len() as u64)
    }

    /// Queues a frame.
    ///
    /// # Errors
    /// The frame, if the queue is full.
    pub(super) fn push(&mut self, flow: Flow, waiting: Waiting, limit: QueueLimit) -> Result<(), Waiting> {
        let queue = self.queue(flow);
        if !queue.fits(&waiting.frame, limit) {
            return Err(waiting);
        }
        let first = queue.frames.is_empty();
        queue.push(waiting);
        if first {
            match flow {
                Flow::Group(unit) => self.enlist(unit, Receiver::Group),
                Flow::Up(station) => {
                    if let Some(unit) = self.peers[station].on {
                        self.channels[self.units[unit].channel].turns.push_back(Sender::Station(station));
                    }
                }
                Flow::Down(station) => {
                    if let Some(unit) = self.peers[station].on {
                        self.enlist(unit, Receiver::Station(station));
                    }
                }
            }
        }
        Ok(())
    }

    fn queue(&mut self, flow: Flow) -> &mut Queue {
        match flow {
            Flow::Up(s) => &mut self.peers[s].up,
            Flow::Down(s) => &mut self.peers[s].down,
            Flow::Group(r) => &mut self.units[r].group,
        }
    }

    fn enlist(&mut self, unit: RadioUnitIndex, receiver: Receiver) {
        let Unit { channel, turns, .. } = &mut self.units[unit];
        if turns.is_empty() {
            self.channels[*channel].turns.push_back(Sender::RadioUnit(unit));
        }
        turns.push_back(receiver);
    }

    /// Takes the next frame, if the channel is idle and a frame waits.
    pub(super) fn next(&mut self, channel: usize, now: Timestamp) -> Option<(Flow, Waiting)> {
        let Channel { turns, busy_until, .. } = &mut self.channels[channel];
        if *busy_until > now {
            return None;
        }
        let sender = turns.pop_front()?;
        let flow = match sender {
            Sender::Station(station) => Flow::Up(station),
            Sender::RadioUnit(unit) => {
                match self.units[unit].turns.pop_front().expect("each sender in turns has a frame") {
                    Receiver::Station(station) => Flow::Down(station),
                    Receiver::Group => Flow::Group(unit),
                }
            }
        };
        let queue = self.queue(flow);
        let waiting = queue.pop().expect("each sender in turns has a frame");
        let more = !queue.frames.is_empty();
        // The sender's next turn is behind all others.
        match (sender, flow) {
            (Sender::Station(_), _) if more => self.channels[channel].turns.push_back(sender),
            (Sender::Station(_), _) => {}
            (Sender::RadioUnit(unit), flow) => {
                let turns = &mut self.units[unit].turns;
                if more {
                    turns.push_back(match flow {
                        Flow::Down(station) => Receiver::Station(station),
                        Flow::Up(_) | Flow::Group(_) => Receiver::Group,
                    });
                }
                if !turns.is_empty() {
                    self.channels[channel].turns.push_back(sender);
                }
            }
        }
        Some((flow, waiting))
    }

    /// Returns when a channel falls idle, if any frame waits for it.
    pub(super) fn wakes(&self, channel: usize) -> Option<Timestamp> {
        let Channel { turns, busy_until, .. } = &self.channels[channel];
        (!turns.is_empty()).then_some(*busy_until)
    }

    /// Returns the time since the channel fell idle; zero while it is busy.
    pub(super) fn idle_for(&self, channel: usize, now: Timestamp) -> Duration {
        now.since(self.channels[channel].busy_until)
    }

    /// Occupies the channel for a frame.
    pub(super) fn occupy(&mut self, channel: usize, now: Timestamp, airtime: Duration) {
        let channel = &mut self.channels[channel];
        channel.busy_until = now + airtime;
        channel.busy.add(now, airtime);
    }

    /// Returns the share of the last second in which a channel was busy.
    pub(super) fn load(&self, channel: usize, now: Timestamp) -> f64 {
        let Channel { busy, busy_until, .. } = &self.channels[channel];
        busy.share(now, busy_until.since(now))
    }
}

/// Slices of the last second.
const SLICES: u64 = 20;
const SLICE_NS: u64 = 1_000_000_000 / SLICES;

/// Busy time of a channel, by slices.
#[derive(Debug, Default)]
pub(super) struct BusyTime {
    /// Number of the slice since the run began, and busy nanoseconds of frames that began in it.
    slices: [(u64, u64); SLICES as usize],
}

impl BusyTime {
    pub(super) fn add(&mut self, now: Timestamp, airtime: Duration) {
        let number = now.as_nanos() / SLICE_NS;
        let slice = &mut self.slices[(number % SLICES) as usize];
        if slice.0 != number {
            *slice = (number, 0);
        }
        slice.1 += airtime.as_nanos() as u64;
    }

    /// Returns the busy share of the last second. `ahead` has been added already but is still to come.
    pub(super) fn share(&self, now: Timestamp, ahead: Duration) -> f64 {
        let number = now.as_nanos() / SLICE_NS;
        let recent = self.slices.iter().filter(|(n, _)| *n <= number && number - n < SLICES);
        let busy = recent.map(|(_, busy)| busy).sum::<u64>().saturating_sub(ahead.as_nanos() as u64);
        // The current slice is not over, and a run may be younger than a second.
        let covered = now.as_nanos().min((SLICES - 1) * SLICE_NS + now.as_nanos() % SLICE_NS);
        (busy as f64 / covered.max(SLICE_NS) as f64).min(1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const AIRTIME: Duration = Duration::from_millis(1);
    const LIMIT: QueueLimit = QueueLimit::Packets(100);

    fn waiting() -> Waiting {
        Waiting { frame: Frame::new(vec![0; 100]), since: Timestamp::ZERO, source: None, is_probe: false }
    }

    /// Radio units 0 and 1 on channel 0, 2 on channel 1; stations 0 and 1 with unit 0, 2 with unit 1, 3 with unit 2.
    fn medium() -> Medium {
        let mut medium = Medium::new([0, 0, 1].into_iter(), 4);
        [0, 0, 1, 2].iter().enumerate().for_each(|(station, unit)| medium.enter(station, *unit));
        medium
    }

    fn fill(medium: &mut Medium, flow: Flow, frames: usize) {
        (0..frames).for_each(|_| medium.push(flow, waiting(), LIMIT).unwrap());
    }

    /// Returns the order in which senders use a channel.
    fn turns(medium: &mut Medium, channel: usize, most: usize) -> Vec<Flow> {
        let mut turns = Vec::new();
        while turns.len() < most {
            let now = medium.wakes(channel).unwrap_or(Timestamp::ZERO);
            let Some((flow, _)) = medium.next(channel, now) else { break };
            medium.occupy(channel, now, AIRTIME);
            turns.push(flow);
        }
        turns
    }

    #[test]
    fn one_frame_at_a_time_on_each_channel() {
        let mut medium = medium();
        fill(&mut medium, Flow::Up(0), 2);
        fill(&mut medium, Flow::Up(3), 1);
        assert!(medium.next(0, Timestamp::ZERO).is_some());
        medium.occupy(0, Timestamp::ZERO, AIRTIME);
        assert!(medium.next(0, Timestamp::from_nanos(999_999)).is_none());
        assert!(medium.next(1, Timestamp::from_nanos(999_999)).is_some(), "another channel is idle");
        assert_eq!(medium.wakes(0), Some(Timestamp::from_nanos(1_000_000)));
        assert!(medium.next(0, Timestamp::from_nanos(1_000_000)).is_some());
    }

    #[test]
    fn senders_take_turns_and_a_radio_unit_is_one_sender() {
        let mut medium = medium();
        fill(&mut medium, Flow::Up(0), 4);
        fill(&mut medium, Flow::Down(0), 2);
        fill(&mut medium, Flow::Down(1), 2);
        fill(&mut medium, Flow::Group(0), 1);
        fill(&mut medium, Flow::Up(2), 2);
        let (up, down) = (Flow::Up, Flow::Down);
        let expected = [up(0), down(0), up(2), up(0), down(1), up(2), up(0), Flow::Group(0)];
        assert_eq!(turns(&mut medium, 0, 8), expected);
        assert_eq!(turns(&mut medium, 0, 8), [up(0), down(0), down(1)]);
    }

    #[test]
    fn stations_off_the_channel_keep_their_frames_and_take_no_turns() {
        let mut medium = medium();
        fill(&mut medium, Flow::Up(0), 2);
        fill(&mut medium, Flow::Down(0), 1);
        medium.leave(0);
        fill(&mut medium, Flow::Up(0), 1);
        fill(&mut medium, Flow::Up(1), 1);
        assert_eq!(turns(&mut medium, 0, 9), [Flow::Up(1)]);
        // Its frames move with it to another radio unit, on another channel.
        medium.enter(0, 2);
        assert_eq!(turns(&mut medium, 1, 9), [Flow::Up(0), Flow::Down(0), Flow::Up(0), Flow::Up(0)]);
    }

    #[test]
    fn a_full_queue_returns_the_frame() {
        let mut medium = medium();
        for limit in [QueueLimit::Packets(2), QueueLimit::Bytes(200)] {
            let pushes = [(); 3].map(|()| medium.push(Flow::Up(0), waiting(), limit).is_ok());
            assert_eq!(pushes, [true, true, false]);
            medium.leave(0);
            assert_eq!(medium.clear(0)[0].len(), 2);
            medium.enter(0, 0);
        }
    }

    #[test]
    fn load_is_the_share_of_the_last_second_that_was_busy() {
        let mut medium = medium();
        for i in 0..2000 {
            medium.occupy(0, Timestamp::from_nanos(i * 4_000_000), AIRTIME);
        }
        let now = Timestamp::from_nanos(8_000_000_000);
        assert!((medium.load(0, now) - 0.25).abs() < 0.01, "{}", medium.load(0, now));
        assert_eq!(medium.load(1, now), 0.0);
        assert_eq!(medium.load(0, now + Duration::from_secs(2)), 0.0);
        // Only the elapsed part of a long frame counts.
        medium.occupy(1, now, Duration::from_secs(1));
        assert!((medium.load(1, now + Duration::from_millis(100)) - 0.1).abs() < 0.02);
    }
}
