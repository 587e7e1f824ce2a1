//! BBR, version 1: Cardwell et al., "BBR: Congestion-Based Congestion Control" (ACM Queue 14(5), 2016), and
//! draft-cardwell-iccrg-bbr-congestion-control-00, whose sections are named.

use std::{collections::VecDeque, time::Duration};

use cotorra_graph::Timestamp;
use cotorra_numbers::Draws;

use crate::{segment::MSS, window::INITIAL};

/// Gain of the start, 2 / ln 2 (4.3.2.1).
const HIGH_GAIN: f64 = 2.0 / std::f64::consts::LN_2;
/// Gains of pacing, a round trip each (4.3.4.2).
const CYCLE: [f64; 8] = [1.25, 0.75, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0];
/// Round trips over which the bottleneck's rate is the highest (4.1.1.3).
const BANDWIDTH_ROUNDS: u64 = 10;
/// Age from which the least round trip is measured anew (4.1.2.1).
const ROUND_TRIP_AGE: Duration = Duration::from_secs(10);
/// Time for which the queue is left empty to measure it (4.3.5).
const PROBE_ROUND_TRIP: Duration = Duration::from_millis(200);
/// Least window: four segments (4.2.3.2).
const LEAST: f64 = 4.0 * MSS as f64;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Phase {
    Startup,
    Drain,
    ProbeBandwidth,
    ProbeRoundTrip,
}

/// What an acknowledgement told.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Delivery {
    /// Bytes that it newly told of.
    pub bytes: f64,
    /// Bytes that were found lost with it.
    pub lost: f64,
    /// Bytes under way now.
    pub in_flight: f64,
    /// Bytes delivered so far.
    pub delivered: u64,
    /// Bytes that had been delivered when the latest of the acknowledged segments was sent.
    pub delivered_before: u64,
    /// Rate of delivery, bytes/s, and whether something else than the path limited it.
    pub rate: Option<(f64, bool)>,
    /// Round trip of a segment that was sent once.
    pub round_trip: Option<Duration>,
}

/// State of BBR.
#[derive(Debug, Clone)]
pub(crate) struct Bbr {
    phase: Phase,
    /// Bytes.
    window: f64,
    /// Window before a loss or before the queue was left empty.
    prior_window: f64,
    /// Pacing, bytes/s.
    rate: f64,
    /// Highest rates by round, falling.
    bandwidths: VecDeque<(u64, f64)>,
    least_trip: Option<(Timestamp, Duration)>,
    round: u64,
    round_ends: u64,
    round_began: bool,
    is_full: bool,
    full_bandwidth: f64,
    full_rounds: u32,
    cycle: usize,
    cycle_began: Timestamp,
    probe_ends: Option<Timestamp>,
    probe_round_is_done: bool,
    /// Round at whose end packets are no longer conserved, in recovery.
    conserves_until: Option<u64>,
    recovers: bool,
    draws: Draws,
}

impl Bbr {
    pub(crate) fn new(draws: Draws) -> Self {
        let window = INITIAL * MSS as f64;
        Self {
            phase: Phase::Startup,
            window,
            prior_window: 0.0,
            // A round trip of 1 ms until one is known (4.2.1).
            rate: HIGH_GAIN * window / 1e-3,
            bandwidths: VecDeque::new(),
            least_trip: None,
            round: 0,
            round_ends: 0,
            round_began: false,
            is_full: false,
            full_bandwidth: 0.0,
            full_rounds: 0,
            cycle: 0,
            cycle_began: Timestamp::ZERO,
            probe_ends: None,
            probe_round_is_done: false,
            conserves_until: None,
            recovers: false,
            draws,
        }
    }

    /// Window, bytes.
    pub(crate) fn window(&self) -> f64 {
        self.window
    }

    /// Rate of pacing, bytes/s.
    pub(crate) fn rate(&self) -> f64 {
        self.rate
    }

    /// Whether few packets are under way on purpose, so that their rate tells nothing of the path (4.3.5).
    pub(crate) fn leaves_queue_empty(&self) -> bool {
        self.phase == Phase::ProbeRoundTrip
    }

    fn bandwidth(&self) -> f64 {
        self.bandwidths.front().map_or(0.0, |&(_, rate)| rate)
    }

    fn pacing_gain(&self) -> f64 {
        match self.phase {
            Phase::Startup => HIGH_GAIN,
            Phase::Drain => 1.0 / HIGH_GAIN,
            Phase::ProbeBandwidth => CYCLE[self.cycle],
            Phase::ProbeRoundTrip => 1.0,
        }
    }

    fn window_gain(&self) -> f64 {
        match self.phase {
            Phase::Startup | Phase::Drain => HIGH_GAIN,
            Phase::ProbeBandwidth => 2.0,
            Phase::ProbeRoundTrip => 1.0,
        }
    }

    /// Returns the bytes that keep the path full, times a gain (4.2.3.1).
    fn inflight(&self, gain: f64) -> f64 {
        let Some((_, least)) = self.least_trip else { return INITIAL * MSS as f64 };
        // Three bursts of the sender.
        let bursts = 3.0 * self.burst();
        gain * self.bandwidth() * least.as_secs_f64() + bursts
    }

    /// Bytes of a burst (4.2.2).
    fn burst(&self) -> f64 {
        match self.rate * 8.0 {
            ..1.2e6 => MSS as f64,
            ..24e6 => 2.0 * MSS as f64,
            _ => (self.rate * 1e-3).min(65_536.0),
        }
    }

    /// Takes an acknowledgement (4.1 to 4.3).
    pub(crate) fn acknowledged(&mut self, now: Timestamp, delivery: &Delivery) {
        self.count_rounds(delivery);
        self.measure_bandwidth(delivery);
        self.advance_cycle(now, delivery);
        self.check_full(delivery);
        if self.phase == Phase::Startup && self.is_full {
            self.phase = Phase::Drain;
        }
        if self.phase == Phase::Drain && delivery.in_flight <= self.inflight(1.0) {
            self.probe_bandwidth(now);
        }
        self.measure_round_trip(now, delivery);
        self.pace();
        self.set_window(delivery);
    }

    fn count_rounds(&mut self, delivery: &Delivery) {
        self.round_began = delivery.delivered_before >= self.round_ends;
        if self.round_began {
            self.round_ends = delivery.delivered;
            self.round += 1;
        }
        if self.conserves_until.is_some_and(|until| self.round > until) {
            self.conserves_until = None;
        }
    }

    fn measure_bandwidth(&mut self, delivery: &Delivery) {
        let Some((rate, is_limited)) = delivery.rate else { return };
        if is_limited && rate < self.bandwidth() {
            return;
        }
        while self.bandwidths.back().is_some_and(|&(_, its)| its <= rate) {
            self.bandwidths.pop_back();
        }
        self.bandwidths.push_back((self.round, rate));
        while self.bandwidths.front().is_some_and(|&(round, _)| round + BANDWIDTH_ROUNDS <= self.round) {
            self.bandwidths.pop_front();
        }
    }

    fn advance_cycle(&mut self, now: Timestamp, delivery: &Delivery) {
        let Some((_, least)) = self.least_trip else { return };
        if self.phase != Phase::ProbeBandwidth {
            return;
        }
        let is_over = now.since(self.cycle_began) > least;
        // In flight before this acknowledgement.
        let before = delivery.in_flight + delivery.bytes + delivery.lost;
        let gain = self.pacing_gain();
        let is_next = if gain > 1.0 {
            is_over && (delivery.lost > 0.0 || before >= self.inflight(gain))
        } else if gain < 1.0 {
            is_over || before <= self.inflight(1.0)
        } else {
            is_over
        };
        if is_next {
            (self.cycle, self.cycle_began) = ((self.cycle + 1) % CYCLE.len(), now);
        }
    }

    fn probe_bandwidth(&mut self, now: Timestamp) {
        self.phase = Phase::ProbeBandwidth;
        // Any phase but the one that drains (4.3.4.2).
        self.cycle = match self.draws.below(CYCLE.len() - 1) {
            0 => 0,
            later => later + 1,
        };
        self.cycle_began = now;
    }

    fn check_full(&mut self, delivery: &Delivery) {
        if self.is_full || !self.round_began || delivery.rate.is_none_or(|(_, is_limited)| is_limited) {
            return;
        }
        if self.bandwidth() >= self.full_bandwidth * 1.25 {
            (self.full_bandwidth, self.full_rounds) = (self.bandwidth(), 0);
            return;
        }
        self.full_rounds += 1;
        self.is_full = self.full_rounds >= 3;
    }

    fn measure_round_trip(&mut self, now: Timestamp, delivery: &Delivery) {
        let has_expired = self.least_trip.is_some_and(|(at, _)| now.since(at) > ROUND_TRIP_AGE);
        if let Some(sample) = delivery.round_trip
            && (has_expired || self.least_trip.is_none_or(|(_, least)| sample <= least))
        {
            self.least_trip = Some((now, sample));
        }
        if has_expired && self.phase != Phase::ProbeRoundTrip {
            self.phase = Phase::ProbeRoundTrip;
            self.save_window();
            self.probe_ends = None;
        }
        if self.phase != Phase::ProbeRoundTrip {
            return;
        }
        match self.probe_ends {
            None if delivery.in_flight <= LEAST => {
                self.probe_ends = Some(now + PROBE_ROUND_TRIP);
                self.probe_round_is_done = false;
                self.round_ends = delivery.delivered;
            }
            None => {}
            Some(ends) => {
                self.probe_round_is_done |= self.round_began;
                if self.probe_round_is_done && now > ends {
                    self.least_trip = self.least_trip.map(|(_, least)| (now, least));
                    self.restore_window();
                    match self.is_full {
                        true => self.probe_bandwidth(now),
                        false => self.phase = Phase::Startup,
                    }
                }
            }
        }
    }

    fn save_window(&mut self) {
        let keeps = self.recovers || self.phase == Phase::ProbeRoundTrip;
        self.prior_window = if keeps { self.prior_window.max(self.window) } else { self.window };
    }

    fn restore_window(&mut self) {
        self.window = self.window.max(self.prior_window);
    }

    /// Sets the rate of pacing (4.2.1).
    fn pace(&mut self) {
        let bandwidth = match self.bandwidth() {
            known if known > 0.0 => known,
            _ => match self.least_trip {
                Some((_, least)) => INITIAL * MSS as f64 / least.as_secs_f64().max(1e-6),
                None => return,
            },
        };
        let rate = self.pacing_gain() * bandwidth;
        if self.is_full || rate > self.rate || self.bandwidths.is_empty() {
            self.rate = rate;
        }
    }

    fn set_window(&mut self, delivery: &Delivery) {
        let target = self.inflight(self.window_gain());
        // 4.2.3.4: what is lost is not replaced at once, and a round trip conserves packets.
        if delivery.lost > 0.0 {
            self.window = (self.window - delivery.lost).max(MSS as f64);
        }
        if self.conserves_until.is_some() {
            self.window = self.window.max(delivery.in_flight + delivery.bytes);
        } else if self.is_full {
            self.window = (self.window + delivery.bytes).min(target);
        } else if self.window < target || delivery.delivered < (INITIAL * MSS as f64) as u64 {
            self.window += delivery.bytes;
        }
        self.window = self.window.max(if self.conserves_until.is_some() { MSS as f64 } else { LEAST });
        if self.phase == Phase::ProbeRoundTrip {
            self.window = self.window.min(LEAST);
        }
    }

    /// Begins to recover from a loss.
    pub(crate) fn lost(&mut self, in_flight: f64) {
        self.save_window();
        self.recovers = true;
        self.window = in_flight + MSS as f64;
        self.conserves_until = Some(self.round);
    }

    /// Begins to recover from a timeout.
    pub(crate) fn timed_out(&mut self) {
        self.save_window();
        self.recovers = true;
        self.window = MSS as f64;
        self.conserves_until = None;
    }

    /// Ends to recover.
    pub(crate) fn recovered(&mut self) {
        self.recovers = false;
        self.conserves_until = None;
        self.restore_window();
    }
}
