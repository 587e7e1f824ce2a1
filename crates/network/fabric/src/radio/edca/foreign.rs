//! Frames of radios that are none of the fabric's, such as those of a kernel. They contend, collide and fade as all others do.
//! Their senders choose the rates and the number of tries; the air decides when each try is made and who receives it.

use std::{collections::VecDeque, time::Duration};

use cotorra_graph::{Dbm, NodeId, Timestamp};
use rand_xoshiro::Xoshiro256PlusPlus;

use super::{
    Category, Channel, Edca, Emitter, Node,
    transmission::{Load, OnAir, Protected, milliwatts},
};
use crate::{
    radio::{
        Radio,
        foreign::{Antenna, RateTries, Receiver, Report, Transmission},
        phy_rate::{self, PhyRate},
    },
    random::{stream, unit},
};

/// Frames of a radio that wait at most. Linux's simulated radios drop frames of which more than this many are not settled.
const MOST_WAITING: usize = 96;

/// A radio that is none of the fabric's, at the antenna of a robot or a radio unit.
#[derive(Debug)]
pub(super) struct Foreign {
    pub(super) node: Node,
    /// Whose antenna it has.
    pub(super) place: Emitter,
    /// Whether it is the fabric's after all, for the frames of handovers.
    is_own: bool,
    /// The channel on which it sends and listens; `None` before its first frame.
    tuned: Option<Tuned>,
    /// The first of each category is sent next, or is on the air.
    waiting: [VecDeque<Attempted>; 4],
    /// Category of its frame on the air.
    on_air: Option<usize>,
    /// Frames for other channels, from the first such frame on. They wait until all others are done.
    later: VecDeque<Transmission>,
    /// Random numbers for what it receives.
    rng: Xoshiro256PlusPlus,
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
    /// Tries of each rate.
    tries: Vec<u32>,
}

/// A try on the air.
#[derive(Debug)]
pub(super) struct Try {
    radio: usize,
    category: usize,
    rate: PhyRate,
    /// End of the transmission opportunity.
    until: Timestamp,
    /// What follows if this is an RTS.
    pub(super) protects: Option<Protected>,
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
        self.waiting[category].len() > usize::from(self.on_air == Some(category))
    }

    /// Returns how long its next try, or the RTS before that, takes at least. In each category, that is one of its first two
    /// frames, of which the first may be on the air.
    pub(super) fn least_airtime(&self) -> Duration {
        let next = self.waiting.iter().flat_map(|waiting| waiting.iter().take(2));
        let airtime = |Attempted { transmission, .. }: &Attempted| {
            let Transmission { frequency_mhz, psdu_bytes, ref rates, .. } = *transmission;
            let airtime = move |RateTries { rate, rts, .. }: &RateTries| {
                if *rts {
                    rate.rts_cts_airtimes(frequency_mhz)[0]
                } else {
                    rate.airtime(frequency_mhz, psdu_bytes.into())
                }
            };
            rates.iter().map(airtime).min()
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
            rng: stream(seed, label),
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

    /// Ends the try on the air. Returns the frame if it is settled.
    fn conclude(&mut self, radio: usize, category: usize, received: bool) -> Option<Attempted> {
        let Foreign { waiting, on_air, .. } = &mut self.foreign[radio];
        *on_air = None;
        let frame = waiting[category].front()?;
        if received || frame.stage().is_none() { waiting[category].pop_front() } else { None }
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
            let Transmission { id, .. } = transmission;
            let report = Report::Settled { at: now, id, tries: Vec::new(), acknowledged: None };
            return self.report_of(radio, report);
        }
        foreign.later.push_back(transmission);
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
        let Some(first) = foreign.later.front() else { return };
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
        while let Some(next) = later.pop_front_if(|next| next.frequency_mhz == frequency_mhz) {
            let tries = vec![0; next.rates.len()];
            waiting[next.category as usize].push_back(Attempted { transmission: next, tries });
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
        foreign.on_air = Some(category);
        let sent = foreign.waiting[category].front_mut().expect("a category that contends has a frame");
        let stage = sent.stage().expect("a frame that waits has tries left");
        sent.tries[stage] += 1;
        let RateTries { rate, rts, .. } = sent.transmission.rates[stage];
        let Transmission { frequency_mhz, psdu_bytes, to, .. } = sent.transmission;
        edca.see_frames(now, emitter);
        let airtime = rate.airtime(frequency_mhz, psdu_bytes.into());
        let sifs = phy_rate::sifs(frequency_mhz);
        let answer = if to.answers() { sifs + rate.ack_airtime(frequency_mhz) } else { Duration::ZERO };
        let on_air = |data_ends, ends, protects| OnAir {
            emitter,
            start: now,
            data_ends,
            ends,
            overlaps: Vec::new(),
            load: Load::Foreign(Try { radio, category, rate, until, protects }),
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
        let Load::Foreign(Try { radio, category, rate, until, protects }) = ended.load else { return };
        let now = ended.data_ends;
        let Some(sent) = self.edca().foreign[radio].waiting[category].front() else { return };
        let Transmission { id, psdu_bytes, to, .. } = sent.transmission;
        let bytes = u64::from(psdu_bytes);
        let lost = |snr_db: f64| match protects {
            Some(_) => rate.rts_error_rate(snr_db),
            None => rate.error_rate(snr_db, bytes),
        };
        let receivers = match to {
            Receiver::All => 0..self.edca().foreign.len(),
            Receiver::One(Antenna(to)) | Receiver::OneWithoutAnswer(Antenna(to)) => to..to + 1,
            Receiver::Nobody => 0..0,
        };
        let (to_one, answers) = (to != Receiver::All, to.answers());
        let mut answered = None;
        let is_own = self.edca().foreign[radio].is_own;
        for to in receivers.filter(|to| *to != radio) {
            if self.edca().foreign[to].is_own != is_own {
                continue;
            }
            // One that scans hears group frames of all channels in turn, and has sent on none of them.
            if to_one && !self.edca().foreign[to].is_on(channel) {
                continue;
            }
            let Some(signal) = self.receive_foreign(&ended, to, lost) else { continue };
            if protects.is_none() {
                self.report_of(radio, Report::Received { at: now, id, by: Antenna(to), signal, rate });
            }
            answered = Some(to).filter(|_| answers);
        }
        if let (Some(to), Some(protected)) = (answered, protects) {
            return self.begin_protected(channel, ended, Emitter::Foreign(to), protected);
        }
        let acknowledged =
            answered.map(|to| self.signal_foreign(ended.start, Emitter::Foreign(to), ended.emitter));
        let settled = self.edca().conclude(radio, category, acknowledged.is_some());
        let done = settled.is_some();
        if let Some(Attempted { tries, .. }) = settled {
            self.report_of(radio, Report::Settled { at: ended.ends, id, tries, acknowledged });
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
    fn report_of(&mut self, radio: usize, report: Report) {
        if self.edca().foreign[radio].is_own { self.take_report(&report) } else { self.report(report) }
    }

    /// Returns the power with which a radio receives a try; `None` if it does not. `lost` is the probability of that at a
    /// signal-to-noise ratio in dB.
    fn receive_foreign(&mut self, sent: &OnAir, to: usize, lost: impl Fn(f64) -> f64) -> Option<Dbm> {
        let receiver = Emitter::Foreign(to);
        if sent.overlaps.contains(&receiver) {
            return None;
        }
        let signal = self.signal_foreign(sent.start, sent.emitter, receiver);
        let noise_floor = self.networks[self.network_of(receiver)].spec.noise_floor;
        let disturbing: f64 =
            sent.overlaps.iter().map(|other| milliwatts(self.power(*other, receiver))).sum();
        let noise_db = 10.0 * (milliwatts(noise_floor) + disturbing).log10();
        let lost = lost(signal.0 - noise_db);
        (unit(&mut self.edca().foreign[to].rng) >= lost).then_some(signal)
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
