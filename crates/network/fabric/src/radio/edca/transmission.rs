//! Puts frames on the air of a channel with contention, and decides who receives them.

use std::time::Duration;

use cotorra_graph::{Dbm, Timestamp};

use super::{
    Edca, Emitter,
    overlap::{self, Overlap, Overlapped},
    stream::{Batch, Limit, Settled},
};
use crate::{
    port::RadioUnitIndex,
    radio::{
        Path, Radio,
        medium::{Flow, Waiting},
        phy::{Exchange, Reception},
        phy_rate::PhyRate,
        rate_control::Attempt,
    },
};

/// Power from which a channel is busy whatever is on it: 20 dB above the least sensitivity (IEEE 802.11-2020, 17.3.10.6).
const ENERGY_DETECTION: Dbm = Dbm(-62.0);
/// Attempt of a group frame: once, at the lowest basic rate.
const GROUP: Attempt = Attempt { mode: 0, rts: false, alone: true, most: 1 };
/// A frame by itself.
const SINGLE: Batch = Batch { frames: 1, cost: 0 };
/// Frames of an A-MPDU of a foreign radio, at most (IEEE 802.11-2020, 10.12.2).
pub(super) const AGGREGATED_FRAMES: usize = 64;
/// Airtime of an A-MPDU, at most: aPPDUMaxTime, and what the length in L-SIG can say (IEEE 802.11-2020, table 21-28,
/// 19.3.9.3.5).
pub(super) const LONGEST_AGGREGATE: Duration = Duration::from_micros(5484);

/// A transmission, from its start to the end of its acknowledgement.
#[derive(Debug)]
pub(super) struct OnAir {
    pub(super) emitter: Emitter,
    pub(super) start: Timestamp,
    pub(super) data_ends: Timestamp,
    /// End of the acknowledgement, or of the time in which it would have come.
    pub(super) ends: Timestamp,
    /// Others on the air during its data.
    pub(super) overlaps: Vec<Overlap>,
    pub(super) load: Load,
}

/// A try on the air.
#[derive(Debug)]
pub(super) struct Try {
    pub(super) radio: usize,
    pub(super) category: usize,
    /// Frames in it.
    pub(super) frames: usize,
    pub(super) rate: PhyRate,
    /// End of the transmission opportunity.
    pub(super) until: Timestamp,
    /// The frames that follow an RTS.
    pub(super) protects: Option<Protected>,
}

/// Content of a transmission.
#[derive(Debug)]
pub(super) enum Load {
    Interference,
    Beacon,
    Frames(Content),
    Foreign(Try),
}

/// Frames of a transmission.
#[derive(Debug)]
pub(super) struct Content {
    flow: Flow,
    category: usize,
    /// Bytes of its frames.
    bytes: usize,
    /// Changes of the flow's receiver before it.
    epoch: u32,
    attempt: Attempt,
    /// Whether its receiver sends block acknowledgements.
    under_agreement: bool,
    /// End of the transmission opportunity.
    until: Timestamp,
    /// The frames that follow an RTS.
    protects: Option<Protected>,
}

/// Data that an RTS announces.
#[derive(Debug, Clone, Copy)]
pub(super) struct Protected {
    pub(super) start: Timestamp,
    pub(super) data_ends: Timestamp,
    pub(super) ends: Timestamp,
}

/// A sender whose backoff is over.
#[derive(Debug, Clone, Copy)]
pub(super) enum Sender {
    Station { emitter: Emitter, category: usize, flow: Flow },
    Interference { emitter: Emitter, airtime: Duration },
    Beacon(RadioUnitIndex),
    Foreign { radio: usize, category: usize },
}

impl OnAir {
    /// Creates a transmission that nobody answers.
    fn unanswered(emitter: Emitter, [start, ends]: [Timestamp; 2], load: Load) -> Self {
        Self { emitter, start, data_ends: ends, ends, overlaps: Vec::new(), load }
    }

    /// Returns what others did to its data.
    pub(super) fn overlapped(&self) -> Overlapped<'_> {
        let span = [self.start, self.data_ends];
        Overlapped { emitter: self.emitter, span, overlaps: &self.overlaps }
    }

    /// Returns the time in which others sent, too: all of it if they did at its start.
    fn disturbed(&self) -> Duration {
        let mut spans: Vec<_> = self.overlaps.iter().map(|overlap| overlap.span).collect();
        spans.sort_unstable();
        let (mut disturbed, mut until) = (Duration::ZERO, self.start);
        for [from, to] in spans {
            if from == self.start {
                return self.data_ends.since(self.start);
            }
            disturbed += to.since(from.max(until));
            until = until.max(to);
        }
        disturbed
    }
}

impl Edca {
    /// Removes a transmission whose data ended by `now`, in the order of their ends.
    fn take_ended(&mut self, channel: usize, now: Timestamp) -> Option<OnAir> {
        let on_air = &mut self.channels[channel].on_air;
        let first = (0..on_air.len()).min_by_key(|at| on_air[*at].data_ends)?;
        (on_air[first].data_ends <= now).then(|| on_air.remove(first))
    }

    /// Puts a transmission on the air. It disturbs those that are there, and they disturb it.
    fn put_on_air(&mut self, channel: usize, mut new: OnAir) {
        let channel = &mut self.channels[channel];
        let at_once = |other: &&mut OnAir| other.data_ends > new.start && other.start < new.data_ends;
        for other in channel.on_air.iter_mut().filter(at_once) {
            let span = [new.start.max(other.start), new.data_ends.min(other.data_ends)];
            other.overlaps.push(Overlap { emitter: new.emitter, span, began: new.start });
            new.overlaps.push(Overlap { emitter: other.emitter, span, began: other.start });
        }
        let counted = new.start.max(channel.busy_until);
        channel.busy.add(new.start, new.ends.since(counted));
        channel.busy_until = channel.busy_until.max(new.ends);
        channel.on_air.push(new);
    }
}

impl Radio {
    /// Does what is due on a channel with contention: ends transmissions, and begins those whose backoff is over.
    pub(in crate::radio) fn contend(&mut self, channel: usize, now: Timestamp) {
        while let Some(ended) = self.edca().take_ended(channel, now) {
            self.end_transmission(channel, ended);
        }
        self.edca().send_beacons(channel, now);
        let mut senders = self.edca().senders(channel, now);
        senders.retain(|sender| match sender {
            Sender::Beacon(unit) => self.units[*unit].serves.is_some(),
            _ => true,
        });
        let beginning: Vec<_> = senders.into_iter().map(|sender| self.compose(now, sender)).collect();
        for new in beginning {
            self.pause_listeners(channel, new.emitter, [new.start, new.ends]);
            self.edca().put_on_air(channel, new);
        }
        let wakes = self.edca().wakes(channel);
        self.timers.set(self.timer_of(channel), wakes);
    }

    pub(in crate::radio) fn edca(&mut self) -> &mut Edca {
        self.edca.as_mut().expect("a network with contention")
    }

    /// Makes a transmission of what a sender sends next.
    fn compose(&mut self, now: Timestamp, sender: Sender) -> OnAir {
        let (emitter, category, flow) = match sender {
            Sender::Interference { emitter, airtime } => {
                return OnAir::unanswered(emitter, [now, now + airtime], Load::Interference);
            }
            Sender::Beacon(unit) => {
                let airtime = self.beacon_airtime(unit);
                return OnAir::unanswered(Emitter::Unit(unit), [now, now + airtime], Load::Beacon);
            }
            Sender::Foreign { radio, category } => return self.compose_foreign(now, radio, category),
            Sender::Station { emitter, category, flow } => (emitter, category, flow),
        };
        let phy = self.phy_of(emitter);
        let path = self.edca().path(flow);
        let mut dropped = Vec::new();
        let mut drop = |waiting: Waiting| dropped.push(waiting);
        let stream = self.edca().stream(flow, category);
        let next_bytes = stream.next_bytes(now, &mut drop).unwrap_or_default();
        let attempt = path.map_or(GROUP, |path| {
            let reception = self.reception(now, path);
            self.lane(path).rates().attempt(now, phy, &reception, next_bytes)
        });
        let mode = attempt.mode;
        let aggregate = phy.aggregate_within(mode, LONGEST_AGGREGATE).filter(|_| self.aggregates(emitter));
        let batch = match aggregate {
            Some(bytes) if !attempt.alone => Batch { frames: phy.aggregated_frames(), cost: bytes },
            _ => SINGLE,
        };
        let edca = self.edca();
        let cost = |bytes| phy.subframe_bytes(bytes);
        let lengths = edca.stream(flow, category).send(now, batch, cost, &mut drop);
        let mut content = Content {
            flow,
            category,
            bytes: lengths.iter().sum(),
            epoch: edca.stream(flow, category).epoch(),
            attempt,
            under_agreement: aggregate.is_some(),
            until: edca.begin_opportunity(now, emitter, category),
            protects: None,
        };
        edca.see_frames(now, emitter);
        let (airtime, answer) = match lengths[..] {
            [bytes] => (phy.data_airtime(mode, bytes), phy.ack_airtime(mode)),
            _ => {
                let bytes = lengths.iter().map(|bytes| phy.subframe_bytes(*bytes)).sum();
                (phy.aggregate_airtime(mode, bytes), phy.block_ack_airtime(mode))
            }
        };
        let on_air = |data_ends, ends, content| OnAir {
            emitter,
            start: now,
            data_ends,
            ends,
            overlaps: Vec::new(),
            load: Load::Frames(content),
        };
        let Some(path) = path else { return on_air(now + airtime, now + airtime, content) };
        self.overflow(path, dropped);
        let lane = self.lane(path);
        let least = lengths.iter().map(|bytes| lane.least_airtime(*bytes)).sum();
        let (airtime, answer) = (airtime.max(least), phy.sifs() + answer);
        if !attempt.rts {
            return on_air(now + airtime, now + airtime + answer, content);
        }
        let [rts, cts] = phy.rts_cts_airtimes();
        let start = now + rts + phy.sifs() + cts + phy.sifs();
        let data_ends = start + airtime;
        content.protects = Some(Protected { start, data_ends, ends: data_ends + answer });
        on_air(now + rts, now + rts + phy.sifs() + cts, content)
    }

    /// Decides who received a transmission, and what its sender does next.
    fn end_transmission(&mut self, channel: usize, ended: OnAir) {
        let airtime = ended.data_ends.since(ended.start);
        self.count_sent(self.place_of(ended.emitter), airtime);
        let content = match &ended.load {
            Load::Interference => {
                return self.edca().end_interference(ended.emitter, ended.disturbed());
            }
            Load::Beacon => return,
            Load::Foreign(_) => return self.end_foreign(channel, ended),
            Load::Frames(content) => content,
        };
        match content.flow {
            Flow::Up(_) => {}
            Flow::Down(robot) => self.count_received(Emitter::Robot(robot), airtime),
            Flow::Group(unit) => self.count_group(unit, airtime),
        }
        match (self.edca().path(content.flow), content.protects) {
            (None, _) => self.end_group(&ended, content),
            (Some(path), Some(protected)) if self.clears(&ended, path) => {
                self.begin_protected(channel, ended, path.receiver(), protected);
            }
            (Some(path), _) => self.end_unicast(channel, &ended, content, path),
        }
    }

    /// Whether the receiver answers an RTS.
    fn clears(&mut self, rts: &OnAir, path: Path) -> bool {
        let parts = self.parts_of(rts.overlapped(), path);
        let lost = overlap::error_rate(&parts, [rts.start, rts.data_ends], Reception::rts_error_rate);
        self.lane(path).receives(lost)
    }

    /// Sends the data after RTS and CTS. Everyone who hears either end waits.
    pub(super) fn begin_protected(
        &mut self,
        channel: usize,
        rts: OnAir,
        receiver: Emitter,
        protected: Protected,
    ) {
        let Protected { start, data_ends, ends } = protected;
        for end in [rts.emitter, receiver] {
            self.pause_listeners(channel, end, [rts.data_ends, ends]);
        }
        let load = match rts.load {
            Load::Frames(content) => Load::Frames(Content { protects: None, ..content }),
            Load::Foreign(mut attempt) => {
                attempt.protects = None;
                Load::Foreign(attempt)
            }
            load @ (Load::Interference | Load::Beacon) => load,
        };
        let data = OnAir { start, data_ends, ends, overlaps: Vec::new(), load, ..rts };
        self.edca().put_on_air(channel, data);
    }

    fn end_unicast(&mut self, channel: usize, ended: &OnAir, content: &Content, path: Path) {
        let &Content { flow, category, bytes: all_bytes, epoch, attempt, under_agreement, until, protects } =
            content;
        let now = ended.data_ends;
        if self.edca().stream(flow, category).epoch() != epoch {
            // The station has left its channel.
            return self.edca().end_exchange(now, ended.emitter, category, false);
        }
        let parts = self.parts_of(ended.overlapped(), path);
        let data = ended.start + self.phy_of(ended.emitter).preamble();
        let time_of = |bytes: usize| now.since(data).mul_f64(bytes as f64 / all_bytes as f64);
        let mut edca = self.edca.take().expect("a network with contention");
        let last = edca.is_last(ended.emitter, category, attempt.most);
        let limit = if under_agreement { Limit::Rounds { last } } else { Limit::Attempts(attempt.most) };
        let lane = self.lane(path);
        let mut sent_bytes = 0;
        let outcome = edca.stream(flow, category).conclude([ended.start, now], limit, |bytes| {
            let span = [sent_bytes, sent_bytes + bytes].map(|bytes| data + time_of(bytes));
            sent_bytes += bytes;
            let lost =
                overlap::error_rate(&parts, span, |reception| reception.error_rate(attempt.mode, bytes));
            // Without CTS, the data is not sent.
            protects.is_none() && lane.receives(lost)
        });
        lane.rates().record(now, outcome.sent, outcome.received);
        let settled: Vec<_> = std::iter::from_fn(|| edca.stream(flow, category).settle()).collect();
        self.edca = Some(edca);
        self.settle(now, path, settled);
        let given_up = if under_agreement { last } else { outcome.given_up > 0 };
        let done = outcome.received > 0 || given_up;
        if let Flow::Down(_) = flow {
            self.edca().stream(flow, category).spend(ended.ends.since(ended.start));
        }
        self.edca().end_exchange(now, ended.emitter, category, done);
        if done {
            self.edca().take_turn(ended.emitter, category, flow);
        }
        if outcome.received > 0 || matches!(flow, Flow::Up(_)) {
            self.edca().stay_awake(now, path.robot);
        }
        if outcome.received > 0 {
            let receiver = path.receiver();
            self.pause_listeners(channel, receiver, [now, ended.ends]);
            let next = ended.ends + self.phy_of(ended.emitter).sifs();
            if next + ended.ends.since(ended.start) <= until {
                self.edca().continue_opportunity(ended.emitter, category, [next, until]);
            }
        }
    }

    /// Ends a group frame, which is not acknowledged.
    fn end_group(&mut self, ended: &OnAir, content: &Content) {
        let &Content { flow, category, .. } = content;
        let now = ended.data_ends;
        let stream = self.edca().stream(flow, category);
        stream.conclude([ended.start, now], Limit::Attempts(1), |_| true);
        let sent = stream.settle();
        self.edca().end_exchange(now, ended.emitter, category, true);
        self.edca().take_turn(ended.emitter, category, flow);
        let (Some(Settled { waiting, began, first, .. }), Flow::Group(unit)) = (sent, flow) else { return };
        let Waiting { frame, since, source, is_probe } = waiting;
        for path in self.group(unit, source).collect::<Vec<_>>() {
            let present = self.robots[path.robot].station.on_channel() == Some(unit);
            let bytes = frame.bytes().len();
            let received = present && {
                let parts = self.parts_of(ended.overlapped(), path);
                let span = [ended.start, now];
                let lost = overlap::error_rate(&parts, span, |part| part.group_error_rate(bytes));
                self.lane(path).receives(lost)
            };
            let copy = Waiting { frame: frame.clone(), since, source, is_probe };
            self.fly(began, path, copy, &Exchange { first, retries: Duration::ZERO, received });
        }
        self.lost.push(frame);
    }

    /// Passes on the frames that were received, and counts those that were given up.
    pub(in crate::radio) fn settle(&mut self, now: Timestamp, path: Path, settled: Vec<Settled>) {
        for Settled { waiting, began, first, received } in settled {
            let retries = now.since(began + first);
            self.fly(began, path, waiting, &Exchange { first, retries, received });
        }
    }

    /// Stops the backoffs of an emitter, and of everyone on the channel who hears it.
    pub(super) fn pause_listeners(&mut self, channel: usize, emitter: Emitter, [now, until]: [Timestamp; 2]) {
        for listener in self.edca().members(channel) {
            if listener == emitter || self.senses(listener, emitter) {
                self.edca().pause(listener, now, until);
            }
        }
    }

    /// Whether the channel is busy for one while another sends.
    fn senses(&self, listener: Emitter, emitter: Emitter) -> bool {
        let weakest = if self.is_wifi(emitter) {
            self.networks[self.network_of(listener)].sensitivity
        } else {
            ENERGY_DETECTION
        };
        self.power(emitter, listener) >= weakest
    }

    /// Returns the received power of an emitter at another one. Between a robot and a radio unit of its network, shadowing
    /// counts.
    pub(super) fn power(&self, from: Emitter, to: Emitter) -> Dbm {
        match (self.place_of(from), self.place_of(to)) {
            (Emitter::Robot(robot), Emitter::Unit(unit)) if self.is_one_network(robot, unit) => {
                self.signals(robot, unit)[0]
            }
            (Emitter::Unit(unit), Emitter::Robot(robot)) if self.is_one_network(robot, unit) => {
                self.signals(robot, unit)[1]
            }
            (sender, receiver) => {
                let spec = &self.networks[self.network_of(sender)].spec;
                let ((tx_power, a), (_, b)) = (self.antenna(sender), self.antenna(receiver));
                let path_loss = spec.path_loss.loss_db(a.distance(b), self.frequency_mhz(from));
                Dbm(tx_power.0 - path_loss - spec.wall_loss_db(a, b))
            }
        }
    }

    pub(super) fn is_one_network(&self, robot: usize, unit: RadioUnitIndex) -> bool {
        self.robots[robot].network == self.units[unit].network
    }
}
