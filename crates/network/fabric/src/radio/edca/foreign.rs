//! Frames of radios that are not the fabric's, such as those of a kernel. They contend, collide and fade as all others
//! do. Their senders choose the rates and the number of tries; the air decides when each try is made and who receives it.

use std::{collections::VecDeque, time::Duration};

use cotorra_graph::{Dbm, Direction, NodeId, Timestamp};
use cotorra_numbers::Draws;

use super::{
    Category, Channel, Edca, Emitter, Node,
    overlap::{self, Part},
    transmission::{AGGREGATED_FRAMES, LONGEST_AGGREGATE, Load, OnAir, Protected, Try},
};
use crate::radio::{
    Path, Radio,
    foreign::{Antenna, RateTries, Receiver, Report, Transmission, Urgency},
    phy_rate::{self, PhyRate},
};

/// Frames of a radio that wait at most. Linux's simulated radios drop frames of which more than this many are not settled.
const MOST_WAITING: usize = 96;

/// Bytes of the delimiter before a frame of an A-MPDU (IEEE 802.11-2020, 9.7.1). Frames are padded to a multiple of four.
const DELIMITER: u64 = 4;

/// A radio that is not the fabric's, at the antenna of a robot or a radio unit.
#[derive(Debug)]
pub(super) struct Foreign {
    pub(super) node: Node,
    /// The owner of its antenna.
    pub(super) place: Emitter,
    /// Whether it is the fabric's after all, for the frames of handovers.
    is_own: bool,
    /// The channel on which it sends and listens; `None` before its first frame.
    tuned: Option<Tuned>,
    /// The first of each category are sent next, or are on the air.
    waiting: [VecDeque<Attempted>; 4],
    /// Category and number of its frames on the air.
    on_air: Option<(usize, usize)>,
    /// Frames for other channels, from the first such frame on, with their times of entry. They wait until all others are
    /// done.
    later: VecDeque<(Timestamp, Transmission)>,
    /// Random numbers for what it receives.
    rng: Draws,
}

#[derive(Debug, Clone, Copy)]
struct Tuned {
    frequency_mhz: u16,
    channel: usize,
    listens: bool,
}

/// A frame with the tries so far.
#[derive(Debug)]
struct Attempted {
    transmission: Transmission,
    /// When it entered the radio.
    since: Timestamp,
    /// Tries of each rate.
    tries: Vec<u32>,
}

/// A frame of a try.
#[derive(Debug, Clone, Copy)]
struct Sent {
    id: u64,
    since: Timestamp,
    psdu_bytes: u64,
    packet_bytes: Option<u32>,
    to_all: bool,
}

impl Sent {
    fn of(Attempted { transmission, since, .. }: &Attempted) -> Self {
        let Transmission { id, psdu_bytes, packet_bytes, to, .. } = *transmission;
        let (psdu_bytes, to_all) = (psdu_bytes.into(), to == Receiver::All);
        Self { id, since: *since, psdu_bytes, packet_bytes, to_all }
    }
}

impl Foreign {
    fn is_on(&self, channel: usize) -> bool {
        self.tuned.is_some_and(|tuned| tuned.listens && tuned.channel == channel)
    }

    fn is_idle(&self) -> bool {
        self.waiting.iter().all(VecDeque::is_empty)
    }

    /// Whether a frame of a category can be sent.
    pub(super) fn is_ready(&self, category: usize) -> bool {
        self.waiting[category].len() > self.on_air(category)
    }

    /// Returns the number of frames of a category on the air.
    fn on_air(&self, category: usize) -> usize {
        self.on_air.filter(|(of, _)| *of == category).map_or(0, |(_, frames)| frames)
    }

    /// Returns how long its next try, or the RTS before that, takes at least. In each category, it begins with one of the frames
    /// on the air, or with the one behind them.
    pub(super) fn least_airtime(&self) -> Duration {
        let categories = self.waiting.iter().enumerate();
        let next = categories.flat_map(|(category, waiting)| waiting.iter().take(self.on_air(category) + 1));
        let airtime = |next: &Attempted| {
            let Transmission { frequency_mhz, psdu_bytes, ref rates, .. } = next.transmission;
            let RateTries { rate, rts, .. } = rates[next.stage()?];
            let [first, _] = rate.rts_cts_airtimes(frequency_mhz);
            Some(if rts { first } else { rate.airtime(frequency_mhz, psdu_bytes.into()) })
        };
        next.filter_map(airtime).min().unwrap_or_default()
    }

    /// Returns the centre of the channel that it is tuned to.
    pub(super) fn frequency_mhz(&self) -> u16 {
        self.tuned.map_or(0, |tuned| tuned.frequency_mhz)
    }

    fn len(&self) -> usize {
        self.later.len() + self.waiting.iter().map(VecDeque::len).sum::<usize>()
    }
}

impl Attempted {
    /// Returns the place of the rate of the next try.
    fn stage(&self) -> Option<usize> {
        let Transmission { rates, to, .. } = &self.transmission;
        if !to.answers() {
            return (self.tries[0] == 0).then_some(0);
        }
        rates.iter().zip(&self.tries).position(|(rate, tries)| *tries < rate.tries.max(1))
    }

    /// Returns the rate of the next try.
    fn next_rate(&self) -> Option<RateTries> {
        self.stage().map(|stage| self.transmission.rates[stage])
    }

    fn count_try(&mut self) {
        if let Some(stage) = self.stage() {
            self.tries[stage] += 1;
        }
    }
}

/// Returns how many of the frames that wait go in the next transmission, and the length of its PSDU.
fn aggregate(waiting: &VecDeque<Attempted>) -> Option<(usize, u64)> {
    let first = waiting.front()?;
    let RateTries { rate, .. } = first.next_rate()?;
    let Transmission { to, frequency_mhz, psdu_bytes, .. } = first.transmission;
    let Some(most) = rate.most_aggregated() else { return Some((1, psdu_bytes.into())) };
    let goes_along = |next: &&Attempted| {
        let same = next.transmission.aggregates && next.transmission.to == to;
        same && next.next_rate().is_some_and(|next| next.rate == rate)
    };
    let (mut frames, mut bytes) = (0, 0);
    for next in waiting.iter().take_while(goes_along).take(AGGREGATED_FRAMES) {
        let more = bytes + DELIMITER + u64::from(next.transmission.psdu_bytes).next_multiple_of(4);
        if more > most || rate.airtime(frequency_mhz, more) > LONGEST_AGGREGATE {
            break;
        }
        (frames, bytes) = (frames + 1, more);
    }
    Some(if frames > 1 { (frames, bytes) } else { (1, psdu_bytes.into()) })
}

impl Edca {
    /// Lends the antenna of a robot or a radio unit. Returns the number of the radio that has it.
    pub(in crate::radio) fn lend(
        &mut self,
        seed: u64,
        node: &NodeId,
        place: Emitter,
        sifs: Duration,
    ) -> usize {
        self.channels.iter_mut().for_each(|channel| channel.members.retain(|member| *member != place));
        self.equip(seed, &format!("foreign {node}"), place, sifs, false)
    }

    /// Adds a radio at the antenna of a robot or a radio unit. Returns its number.
    pub(in crate::radio) fn equip(
        &mut self,
        seed: u64,
        label: &str,
        place: Emitter,
        sifs: Duration,
        is_own: bool,
    ) -> usize {
        let parameters = match place {
            Emitter::Unit(_) => Category::of_access_point,
            _ => Category::of_station,
        };
        self.foreign.push(Foreign {
            node: Node::new(seed, label, sifs, parameters),
            place,
            is_own,
            tuned: None,
            waiting: Default::default(),
            on_air: None,
            later: VecDeque::new(),
            rng: Draws::new(seed, label),
        });
        self.foreign.len() - 1
    }

    /// Tunes a radio to a channel. It listens there before it sends.
    pub(in crate::radio) fn tune(
        &mut self,
        now: Timestamp,
        radio: usize,
        frequency_mhz: u16,
        channel: usize,
    ) {
        while self.channels.len() <= channel {
            self.channels.push(Default::default());
        }
        let emitter = Emitter::Foreign(radio);
        let foreign = &mut self.foreign[radio];
        if let Some(before) = foreign.tuned {
            self.channels[before.channel].members.retain(|member| *member != emitter);
        }
        foreign.tuned = Some(Tuned { frequency_mhz, channel, listens: true });
        foreign.node.burst = None;
        let Channel { members, busy_until, .. } = &mut self.channels[channel];
        members.push(emitter);
        foreign.node.pause(now, (*busy_until).max(now));
    }

    /// Ends the try on the air, of whose frames these were received. Returns those that are settled, and whether they were.
    fn conclude(&mut self, radio: usize, category: usize, received: &[bool]) -> Vec<(Attempted, bool)> {
        let Foreign { waiting, on_air, .. } = &mut self.foreign[radio];
        *on_air = None;
        let waiting = &mut waiting[category];
        let tried: Vec<_> = waiting.drain(..received.len().min(waiting.len())).zip(received).collect();
        let (mut settled, mut again) = (Vec::new(), Vec::new());
        for (frame, received) in tried {
            if *received || frame.stage().is_none() {
                settled.push((frame, *received));
            } else {
                again.push(frame);
            }
        }
        again.into_iter().rev().for_each(|frame| waiting.push_front(frame));
        settled
    }
}

impl Radio {
    /// Sends a frame from a lent antenna.
    pub(crate) fn transmit(&mut self, now: Timestamp, antenna: Antenna, transmission: Transmission) {
        self.advance(now);
        self.send_from(now, antenna, transmission);
    }

    /// Does the same once everything else that is due is done.
    pub(in crate::radio) fn send_from(
        &mut self,
        now: Timestamp,
        Antenna(radio): Antenna,
        transmission: Transmission,
    ) {
        let foreign = &mut self.edca().foreign[radio];
        if transmission.rates.is_empty() || foreign.len() >= MOST_WAITING {
            if let Some(path) = self.link_of(radio, transmission.to, transmission.packet_bytes) {
                self.lane(path).meter().counters.overflowed += 1;
            }
            let Transmission { id, .. } = transmission;
            let settled = Report::Settled { at: now, id, tries: Vec::new(), acknowledged: None };
            return self.report_of(radio, settled, Urgency::AtOnce);
        }
        foreign.later.push_back((now, transmission));
        self.admit(now, radio);
    }

    /// Records that a lent antenna does not listen on its channel.
    pub(crate) fn stop_listening(&mut self, now: Timestamp, Antenna(radio): Antenna) {
        self.advance(now);
        if let Some(tuned) = &mut self.edca().foreign[radio].tuned {
            tuned.listens = false;
        }
    }

    /// Queues the frames that the channel of a radio can take now, after it has tuned to that of the first.
    fn admit(&mut self, now: Timestamp, radio: usize) {
        let foreign = &self.edca().foreign[radio];
        let Some((_, first)) = foreign.later.front() else { return };
        let frequency_mhz = first.frequency_mhz;
        if foreign.tuned.is_none_or(|tuned| tuned.frequency_mhz != frequency_mhz) {
            if !foreign.is_idle() {
                return;
            }
            let channel = self.channel_at(frequency_mhz);
            self.edca().tune(now, radio, frequency_mhz, channel);
        }
        let edca = self.edca();
        let Foreign { later, waiting, tuned, .. } = &mut edca.foreign[radio];
        while let Some((since, next)) = later.pop_front_if(|(_, next)| next.frequency_mhz == frequency_mhz) {
            let tries = vec![0; next.rates.len()];
            waiting[next.category as usize].push_back(Attempted { transmission: next, since, tries });
        }
        let Some(tuned) = tuned else { return };
        tuned.listens = true;
        let channel = tuned.channel;
        edca.refresh(now, Emitter::Foreign(radio));
        self.serve(channel, now);
    }

    /// Puts a try of a frame on the air.
    pub(super) fn compose_foreign(&mut self, now: Timestamp, radio: usize, category: usize) -> OnAir {
        let edca = self.edca();
        let emitter = Emitter::Foreign(radio);
        let until = edca.begin_opportunity(now, emitter, category);
        let foreign = &mut edca.foreign[radio];
        let waiting = &mut foreign.waiting[category];
        let (frames, psdu_bytes) = aggregate(waiting).expect("a category that contends has a frame");
        let first = &waiting[0];
        let RateTries { rate, rts, .. } = first.next_rate().expect("a frame that waits has tries left");
        let Transmission { frequency_mhz, to, .. } = first.transmission;
        let tried = waiting.iter().take(frames);
        let packets: Vec<_> = tried.filter_map(|frame| frame.transmission.packet_bytes).collect();
        waiting.iter_mut().take(frames).for_each(Attempted::count_try);
        foreign.on_air = Some((category, frames));
        edca.see_frames(now, emitter);
        let path = self.link_of(radio, to, packets.first().copied());
        let least = path.map(|path| {
            let lane = self.lane(path);
            packets.iter().map(|bytes| lane.least_airtime(*bytes as usize)).sum()
        });
        let airtime = rate.airtime(frequency_mhz, psdu_bytes).max(least.unwrap_or_default());
        let sifs = phy_rate::sifs(frequency_mhz);
        let answer = match frames {
            _ if !to.answers() => Duration::ZERO,
            1 => sifs + rate.ack_airtime(frequency_mhz),
            _ => sifs + rate.block_ack_airtime(frequency_mhz),
        };
        let on_air = |data_ends, ends, protects| OnAir {
            emitter,
            start: now,
            data_ends,
            ends,
            overlaps: Vec::new(),
            load: Load::Foreign(Try { radio, category, frames, rate, until, protects }),
        };
        if !rts || !to.answers() {
            return on_air(now + airtime, now + airtime + answer, None);
        }
        let [rts, cts] = rate.rts_cts_airtimes(frequency_mhz);
        let start = now + rts + sifs + cts + sifs;
        let data_ends = start + airtime;
        let protected = Protected { start, data_ends, ends: data_ends + answer };
        on_air(now + rts, now + rts + sifs + cts, Some(protected))
    }

    /// Decides who received a try, and what its sender does next.
    pub(super) fn end_foreign(&mut self, channel: usize, ended: OnAir) {
        let Load::Foreign(Try { radio, category, frames, rate, until, protects }) = ended.load else {
            return;
        };
        let now = ended.data_ends;
        let waiting = &self.edca().foreign[radio].waiting[category];
        let sent: Vec<_> = waiting.iter().take(frames).map(Sent::of).collect();
        let Some(to) = waiting.front().map(|frame| frame.transmission.to) else { return };
        if let Receiver::One(Antenna(to)) | Receiver::OneWithoutAnswer(Antenna(to)) = to {
            let receiver = self.place_of(Emitter::Foreign(to));
            self.count_received(receiver, now.since(ended.start));
        }
        let receivers = match to {
            Receiver::All => 0..self.edca().foreign.len(),
            Receiver::One(Antenna(to)) | Receiver::OneWithoutAnswer(Antenna(to)) => to..to + 1,
            Receiver::Nobody => 0..0,
        };
        let (to_all, answers) = (to == Receiver::All, to.answers());
        let mut received = vec![false; sent.len()];
        let mut answered = None;
        let is_own = self.edca().foreign[radio].is_own;
        let all_bytes: u64 = sent.iter().map(|frame| frame.psdu_bytes).sum();
        let data = ended.start + rate.preamble();
        let time_of = |bytes: u64| now.since(data).mul_f64(bytes as f64 / all_bytes.max(1) as f64);
        for to in receivers.filter(|to| *to != radio) {
            if self.edca().foreign[to].is_own != is_own {
                continue;
            }
            // One that scans hears group frames of all channels in turn, and has sent on none of them.
            if !to_all && !self.edca().foreign[to].is_on(channel) {
                continue;
            }
            let signal = self.signal_foreign(ended.start, ended.emitter, Emitter::Foreign(to));
            let parts = self.parts_foreign(&ended, to, signal);
            if protects.is_some() {
                let span = [ended.start, now];
                let signal =
                    self.receive_foreign(to, signal, &parts, span, |snr_db| rate.rts_error_rate(snr_db));
                answered = signal.map(|_| to);
                continue;
            }
            let mut sent_bytes = 0;
            for (place, frame) in sent.iter().enumerate() {
                let lost = |snr_db| rate.error_rate(snr_db, frame.psdu_bytes);
                let span = [sent_bytes, sent_bytes + frame.psdu_bytes].map(|bytes| data + time_of(bytes));
                sent_bytes += frame.psdu_bytes;
                let signal = self.receive_foreign(to, signal, &parts, span, lost);
                self.land_foreign(now, [radio, to], frame, signal.map(|signal| (signal, rate)));
                if signal.is_some() && answers {
                    received[place] = true;
                    answered = Some(to);
                }
            }
        }
        if let (Some(to), Some(protected)) = (answered, protects) {
            return self.begin_protected(channel, ended, Emitter::Foreign(to), protected);
        }
        let answer = answered.map(|to| self.signal_foreign(ended.start, Emitter::Foreign(to), ended.emitter));
        let settled = self.edca().conclude(radio, category, &received);
        // Frames of an aggregate that are given up do not end the row of failures of those that go on.
        let done = answered.is_some() || settled.len() == frames;
        for (Attempted { transmission, tries, .. }, received) in settled {
            let Transmission { id, to, packet_bytes, .. } = transmission;
            match self.link_of(radio, to, packet_bytes) {
                Some(path) if received => self.lent.keep_rate(path, rate),
                Some(path) => self.count_lost(path),
                None => {}
            }
            // Its sender goes on without it, and rate control is content with it later.
            let goes_on = packet_bytes.is_some() && !self.edca().foreign[radio].is_idle();
            let urgency = if goes_on { Urgency::CanWait } else { Urgency::AtOnce };
            let acknowledged = answer.filter(|_| received);
            let report = Report::Settled { at: ended.ends, id, tries, acknowledged };
            self.report_of(radio, report, urgency);
        }
        self.edca().end_exchange(now, ended.emitter, category, done);
        if let Some(to) = answered {
            self.pause_listeners(channel, Emitter::Foreign(to), [now, ended.ends]);
            let next = ended.ends + self.phy_of(ended.emitter).sifs();
            if next + ended.ends.since(ended.start) <= until {
                self.edca().continue_opportunity(ended.emitter, category, [next, until]);
            }
        }
        self.admit(now, radio);
    }

    /// Reports what became of a frame of a radio.
    fn report_of(&mut self, radio: usize, report: Report, urgency: Urgency) {
        if self.edca().foreign[radio].is_own {
            self.take_report(&report);
        } else {
            self.report(report, urgency);
        }
    }

    /// Reports a frame that one radio received from another, with signal and rate, and counts its packet; or counts that of a group
    /// frame that it missed.
    fn land_foreign(
        &mut self,
        now: Timestamp,
        [from, to]: [usize; 2],
        sent: &Sent,
        received: Option<(Dbm, PhyRate)>,
    ) {
        let path = sent.packet_bytes.and_then(|_| self.link_between(from, to));
        let Some((signal, rate)) = received else {
            if let Some(path) = path.filter(|_| sent.to_all) {
                self.count_lost(path);
            }
            return;
        };
        // The conditions of emulation come behind the radios, which do not notice such a loss.
        if let Some(path) = path.filter(|path| self.lane(*path).loses()) {
            return self.count_lost(path);
        }
        let report = Report::Received { at: now, id: sent.id, by: Antenna(to), signal, rate };
        self.report_of(from, report, Urgency::AtOnce);
        if let (Some(path), Some(bytes)) = (path, sent.packet_bytes) {
            self.lane(path).meter().crossed(sent.since, now, 1, bytes.into());
        }
    }

    /// Returns the wireless link on which a frame's packet counts; `None` for one to all, which counts where it arrives or not.
    fn link_of(&self, from: usize, to: Receiver, packet_bytes: Option<u32>) -> Option<Path> {
        match (packet_bytes, to) {
            (Some(_), Receiver::One(Antenna(to)) | Receiver::OneWithoutAnswer(Antenna(to))) => {
                self.link_between(from, to)
            }
            _ => None,
        }
    }

    /// Returns the way from one radio to another over a wireless link: those of a robot and of the radio unit that it is
    /// associated with.
    fn link_between(&self, from: usize, to: usize) -> Option<Path> {
        let [from, to] = [from, to].map(|radio| self.place_of(Emitter::Foreign(radio)));
        let (robot, unit, direction) = match (from, to) {
            (Emitter::Robot(robot), Emitter::Unit(unit)) => (robot, unit, Direction::Forward),
            (Emitter::Unit(unit), Emitter::Robot(robot)) => (robot, unit, Direction::Backward),
            _ => return None,
        };
        let associated = self.robots[robot].station.attached() == Some(unit);
        associated.then_some(Path { robot, unit, direction })
    }

    fn count_lost(&mut self, path: Path) {
        self.lane(path).meter().counters.lost += 1;
    }

    /// Returns the parts of a try with their signal-to-noise ratios at a radio, dB. The header of one that is disturbed may be lost,
    /// and the try with it: then there is none.
    fn parts_foreign(&mut self, sent: &OnAir, to: usize, signal: Dbm) -> Vec<Part<f64>> {
        let span = [sent.start, sent.data_ends];
        let receiver = Emitter::Foreign(to);
        if sent.overlaps.is_empty() {
            let noise = self.networks[self.network_of(receiver)].spec.noise();
            let noise_db = 10.0 * noise.milliwatts().log10();
            return vec![Part { span, quality: Some(signal.0 - noise_db) }];
        }
        let Load::Foreign(Try { rate, .. }) = sent.load else { return Vec::new() };
        let parts = self.ratios(sent.overlapped(), receiver, signal);
        let header = [sent.start, (sent.start + rate.preamble()).min(sent.data_ends)];
        let lost = overlap::error_rate(&parts, header, |snr_db| rate.header_error_rate(*snr_db));
        let received = self.edca().foreign[to].rng.unit() >= lost;
        if received { parts } else { vec![Part { span, quality: None }] }
    }

    /// Returns the power with which a radio receives what was sent in a span of a try; `None` if it does not. `lost` is the
    /// probability of that at a signal-to-noise ratio in dB.
    fn receive_foreign(
        &mut self,
        to: usize,
        signal: Dbm,
        parts: &[Part<f64>],
        span: [Timestamp; 2],
        lost: impl Fn(f64) -> f64,
    ) -> Option<Dbm> {
        let lost = overlap::error_rate(parts, span, |snr_db| lost(*snr_db));
        (self.edca().foreign[to].rng.unit() >= lost).then_some(signal)
    }

    /// Returns the received power of one radio at another, with fading between a robot and a radio unit of its network.
    fn signal_foreign(&mut self, at: Timestamp, from: Emitter, to: Emitter) -> Dbm {
        let power = self.power(from, to);
        match (self.place_of(from), self.place_of(to)) {
            (Emitter::Robot(robot), Emitter::Unit(unit)) | (Emitter::Unit(unit), Emitter::Robot(robot))
                if self.is_one_network(robot, unit) =>
            {
                Dbm(power.0 + self.fading_now(at, robot, unit))
            }
            _ => power,
        }
    }
}
