//! Rate adaptation by Minstrel-HT, the default of Linux's mac80211. It knows only which of its own frames were
//! acknowledged.
//!
//! The algorithm is that of Linux 6.18 (net/mac80211/rc80211_minstrel_ht.c), with its integers. A group has the modes of one
//! number of spatial streams. Linux has further groups for narrower channels and other guard intervals, which stations do not
//! use here. It has none for 802.11ax, whose cards choose the rates themselves: the rules are the same here. Every 50 ms it
//! filters each mode's share of acknowledged MPDUs, estimates throughputs, and ranks the modes. In between, [`sampling`]
//! chooses a mode to try every 20 ms. Linux's switch to fewer streams after a series of losses has no counterpart here.

mod sampling;

#[cfg(test)]
mod tests;

use std::time::Duration;

use cotorra_graph::Timestamp;
use cotorra_numbers::Draws;

use self::sampling::Samples;
use super::phy::{Mode, Phy};

/// Entries of a chain: IEEE80211_TX_RATE_TABLE_SIZE, and the limit of most cards.
const STAGES: usize = 4;

/// Time between two updates of the statistics.
const UPDATE_INTERVAL: Duration = Duration::from_millis(50);
/// Least time between two samples.
const SAMPLE_INTERVAL: Duration = Duration::from_millis(20);

/// Probabilities and lengths are integers in units of 1/4096.
const SCALE: u32 = 12;
const ONE: i32 = 1 << SCALE;

/// Coefficients of the filter of probabilities, for the new share and the two former values: a low-pass of second order
/// with a period of 16 updates.
const FILTER: [i32; 3] = [ONE - 0x1499 + 0x92e, 0x1499, -0x92e];

/// Packet of the throughput estimate, bytes.
const PACKET_BYTES: u32 = 1200;
/// Packets over which Linux rounds up to symbols.
const ROUNDED_PACKETS: u32 = 16;
/// Preamble and an acknowledgement at 6 Mbit/s, for frames of HT and VHT, µs.
const HT_OVERHEAD_US: u32 = 48 + 60;
/// An acknowledgement at 6 Mbit/s, for frames of 802.11a and g, µs.
const LEGACY_OVERHEAD_US: u32 = 60;
/// RTS and CTS at 6 Mbit/s, µs.
const RTS_CTS_US: u32 = 2 * 60;
/// SIFS, signal extension, preamble and SIGNAL of 802.11a and g, µs.
const LEGACY_START_US: u32 = 16 + 16 + 4;

/// Longest time of one entry's attempts, µs.
const SEGMENT_US: u32 = 6000;
/// Most attempts of one entry.
const MAX_ATTEMPTS: usize = 7;
/// Slot of the contention that the attempts' time includes, µs.
const SLOT_US: u32 = 9;
const CW_MIN: u32 = 15;
const CW_MAX: u32 = 1023;

/// Modes to try in turn for a frame or an aggregate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Chain {
    /// The next entry is used after all attempts of the one before have failed. Entries may have the same mode.
    pub(super) stages: [Stage; STAGES],
    /// Whether the first entry samples a mode. Drivers send samples as single frames.
    pub(super) is_sample: bool,
}

/// An entry of a [`Chain`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Stage {
    /// Index of the mode, as in [`Phy::modes`].
    pub(super) mode: usize,
    /// Most attempts, from 1 to 7.
    pub(super) attempts: u32,
    /// Whether RTS and CTS precede each attempt.
    pub(super) rts: bool,
}

/// The outcome of all attempts in one mode.
#[derive(Debug, Clone, Copy)]
pub(super) struct Tried {
    /// Index of the mode, as in [`Phy::modes`].
    pub(super) mode: usize,
    /// MPDUs sent, counted anew in each attempt.
    pub(super) sent: u32,
    /// MPDUs acknowledged.
    pub(super) acknowledged: u32,
}

/// The rate control of one sender for one receiver.
#[derive(Debug)]
pub(super) struct Minstrel {
    modes: Vec<ModeStatistics>,
    /// Modes of one number of streams.
    group: usize,
    aggregates: bool,
    /// Frames and aggregates since the last update, and the MPDUs in them.
    frames: u32,
    mpdus: u32,
    /// Filtered mean of MPDUs per frame or aggregate, in units of 1/4096.
    mpdus_per_frame: i32,
    table: [Stage; STAGES],
    samples: Samples,
    updated: Timestamp,
    /// Earliest time of the next sample.
    sample_due: Timestamp,
}

/// Statistics of one mode.
#[derive(Debug)]
struct ModeStatistics {
    /// Airtime of an average packet in a long aggregate, ns.
    duration_ns: u32,
    /// MPDUs sent and acknowledged since the last update.
    sent: u32,
    acknowledged: u32,
    /// Whether it was used before the last update.
    was_used: bool,
    /// Filtered probability that an MPDU is acknowledged, and its former value, in units of 1/4096.
    probability: i32,
    former: i32,
}

impl Minstrel {
    /// Creates the rate control for a new receiver. It begins with the slowest mode. `rng` decides the order of samples.
    pub(super) fn new(now: Timestamp, phy: &Phy, rng: Draws) -> Self {
        let aggregates = phy.aggregates();
        let statistics = |mode: &Mode| ModeStatistics {
            duration_ns: duration_ns(aggregates, mode),
            sent: 0,
            acknowledged: 0,
            was_used: false,
            probability: 0,
            former: 0,
        };
        let mut minstrel = Self {
            modes: phy.modes().iter().map(statistics).collect(),
            group: phy.modes().len() / phy.streams(),
            aggregates,
            frames: 0,
            mpdus: 0,
            mpdus_per_frame: ONE,
            table: [Stage { mode: 0, attempts: 1, rts: false }; STAGES],
            samples: Samples::new(rng, phy.modes().len(), phy.streams()),
            updated: now,
            sample_due: now,
        };
        minstrel.rank();
        minstrel
    }

    /// Returns the modes to try for the next frame or aggregate.
    pub(super) fn chain(&mut self, now: Timestamp) -> Chain {
        let mut chain = Chain { stages: self.table, is_sample: false };
        if now < self.sample_due {
            return chain;
        }
        self.sample_due = now + SAMPLE_INTERVAL;
        if let Some(mode) = self.samples.next() {
            chain.stages[0] = Stage { mode, attempts: 1, rts: false };
            chain.is_sample = true;
        }
        chain
    }

    /// Records the outcome of a frame or an aggregate with so many MPDUs, by mode in the order of use.
    pub(super) fn record(&mut self, now: Timestamp, mpdus: u32, outcome: &[Tried]) {
        self.frames += 1;
        self.mpdus += mpdus;
        for tried in outcome {
            let mode = &mut self.modes[tried.mode];
            mode.sent += tried.sent;
            mode.acknowledged += tried.acknowledged;
        }
        if now.since(self.updated) > UPDATE_INTERVAL {
            self.rank();
            self.updated = now;
            self.sample_due = now;
        }
    }

    /// Returns the mode with the highest estimated throughput.
    pub(super) fn best(&self) -> usize {
        self.table[0].mode
    }

    /// Updates the statistics, and ranks the modes by them.
    fn rank(&mut self) {
        if let Some(mean) = (self.mpdus << SCALE).checked_div(self.frames) {
            self.mpdus_per_frame += 32 * (mean as i32 - self.mpdus_per_frame) / 128;
            (self.frames, self.mpdus) = (0, 0);
        }

        let mut best_by_throughput = [0; STAGES];
        let mut of_faster = 0;
        for i in (0..self.modes.len()).rev() {
            if (i + 1).is_multiple_of(self.group) {
                of_faster = 0;
            }
            let mode = &mut self.modes[i];
            mode.update();
            // An unused mode is as reliable as any faster one of its group.
            if mode.was_used {
                of_faster = of_faster.max(mode.probability);
            } else {
                mode.probability = mode.probability.max(of_faster);
            }
            if self.throughput(i) > 0 {
                self.insert(i, &mut best_by_throughput);
            }
        }
        let best = best_by_throughput[0];
        // The last attempts have fewer streams than the best mode, if any of those modes is of use.
        let fewer = (best >= self.group).then(|| self.most_reliable(best, self.group));
        let reliable = fewer.filter(|mode| self.throughput(*mode) > 0);
        let reliable = reliable.unwrap_or_else(|| self.most_reliable(best, self.modes.len()));

        let [first, second, third, _] = best_by_throughput;
        let stages = [(first, false), (second, true), (third, true), (reliable, true)];
        self.table = stages.map(|(mode, rts)| Stage { mode, attempts: self.attempts(mode, rts), rts });
        self.samples.refill(&self.modes, [first, second], reliable);
    }

    /// Inserts a mode into a list of modes, from the highest throughput to the lowest. Of equals, the more reliable one comes
    /// first.
    fn insert(&self, mode: usize, list: &mut [usize; STAGES]) {
        let key = |mode: usize| (self.throughput(mode), self.modes[mode].probability);
        let place = list.iter().rposition(|other| key(mode) <= key(*other)).map_or(0, |i| i + 1);
        if place < STAGES {
            list[place..].rotate_right(1);
            list[place] = mode;
        }
    }

    /// Returns the mode for the last attempts, of the first modes: the one with the highest throughput of those with more
    /// than 75 % probability, otherwise the most probable one.
    fn most_reliable(&self, best: usize, modes: usize) -> usize {
        let mut chosen = 0;
        for (i, mode) in self.modes[..modes].iter().enumerate() {
            let is_better = if i > best && mode.probability < self.modes[best].probability {
                false
            } else if mode.probability > 75 * ONE / 100 {
                self.throughput(i) > self.throughput(chosen)
            } else {
                mode.probability > self.modes[chosen].probability
            };
            if is_better {
                chosen = i;
            }
        }
        chosen
    }

    /// Returns a mode's estimated throughput, in 10 packets/s. Below 10 % probability it is none; above 90 % it grows no
    /// more, because collisions make such shares vary.
    fn throughput(&self, mode: usize) -> u32 {
        let ModeStatistics { probability, duration_ns, .. } = self.modes[mode];
        if probability < 10 * ONE / 100 {
            return 0;
        }
        let mpdus = if self.aggregates { self.mpdus_per_frame() } else { 1 };
        let ns = 1000 * self.overhead_us() / mpdus + duration_ns;
        (100 * (probability.min(90 * ONE / 100) as u32 * 1_000_000 / ns)) >> SCALE
    }

    /// Returns how often a mode may be tried, so that all attempts with their contention take at most 6 ms; at least twice,
    /// at most seven times.
    fn attempts(&self, mode: usize, rts: bool) -> u32 {
        if self.modes[mode].probability < 20 * ONE / 100 {
            return 2;
        }
        let rts_cts = if rts { RTS_CTS_US } else { 0 };
        let data_us = self.modes[mode].duration_ns * self.mpdus_per_frame() / 1000;
        let attempt_us = self.overhead_us() + rts_cts + data_us;
        let windows = std::iter::successors(Some(CW_MIN), |cw| Some((2 * cw + 1).min(CW_MAX)));
        let ends = windows.scan(0, |us, cw| {
            *us += SLOT_US * cw / 2 + attempt_us;
            Some(*us)
        });
        (ends.take(MAX_ATTEMPTS).take_while(|us| *us < SEGMENT_US).count() as u32).max(2)
    }

    fn mpdus_per_frame(&self) -> u32 {
        (self.mpdus_per_frame >> SCALE) as u32
    }

    fn overhead_us(&self) -> u32 {
        if self.aggregates { HT_OVERHEAD_US } else { LEGACY_OVERHEAD_US }
    }
}

impl ModeStatistics {
    /// Filters the share of acknowledged MPDUs since the last update.
    fn update(&mut self) {
        if self.sent == 0 {
            return;
        }
        let share = ((self.acknowledged << SCALE) / self.sent).max(1) as i32;
        let next = if self.probability == 0 {
            self.former = share;
            share
        } else {
            let [a, b, c] = FILTER;
            let next = (a * share + b * self.probability + c * self.former) >> SCALE;
            self.former = self.probability;
            // A probability of 0 starts the filter anew, but not if it fell below.
            if next < 0 { 1 } else { next.min(ONE) }
        };
        self.probability = next;
        self.was_used = true;
        (self.sent, self.acknowledged) = (0, 0);
    }
}

/// Returns the airtime of an average packet, ns: in an aggregate for HT and VHT, else with preamble and SIFS.
fn duration_ns(aggregates: bool, mode: &Mode) -> u32 {
    let bits_per_symbol = mode.bits_per_symbol();
    if aggregates {
        let bits = 8 * PACKET_BYTES * ROUNDED_PACKETS;
        mode.symbol_ns() * bits.div_ceil(bits_per_symbol) / ROUNDED_PACKETS
    } else {
        // Linux counts service bits and tail as a tenth, and rounds down.
        let tenths = 16 + 80 * (PACKET_BYTES + 4) + 6;
        1000 * (LEGACY_START_US + 4 * (tenths / (10 * bits_per_symbol)))
    }
}
