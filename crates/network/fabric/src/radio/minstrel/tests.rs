//! Behaviour against the error rates of [`Reception`], in virtual time.

use cotorra_graph::{Band, WifiStandard, WirelessNetwork};

use super::{super::phy::Reception, *};

const BYTES: usize = 1200;
const STANDARDS: [WifiStandard; 4] = [WifiStandard::A, WifiStandard::G, WifiStandard::N, WifiStandard::Ac];

/// A sender that always has frames for one receiver.
struct Link {
    phy: &'static Phy,
    minstrel: Minstrel,
    reception: Reception,
    now: Timestamp,
    rng: Draws,
    aggregate: u32,
    /// Totals.
    acknowledged: u32,
    frames: u32,
    samples: u32,
}

impl Link {
    fn new(standard: WifiStandard, snr_db: f64, aggregate: u32, seed: u64) -> Self {
        Self::on(Phy::usual(standard), snr_db, aggregate, seed)
    }

    fn on(phy: &'static Phy, snr_db: f64, aggregate: u32, seed: u64) -> Self {
        Self {
            phy,
            minstrel: Minstrel::new(Timestamp::ZERO, phy, Draws::new(seed, "minstrel")),
            reception: Reception::new(phy, snr_db),
            now: Timestamp::ZERO,
            rng: Draws::new(seed, "errors"),
            aggregate,
            acknowledged: 0,
            frames: 0,
            samples: 0,
        }
    }

    /// Sends a frame or an aggregate, attempt by attempt until an acknowledgement.
    fn send(&mut self) {
        let chain = self.minstrel.chain(self.now);
        let mpdus = if chain.is_sample { 1 } else { self.aggregate };
        let mut outcome = Vec::new();
        'stages: for stage in chain.stages {
            let mode = stage.mode;
            let mut tried = Tried { mode, sent: 0, acknowledged: 0 };
            for _ in 0..stage.attempts {
                let us = self.phy.attempt_ns(&self.phy.modes()[mode], BYTES * mpdus as usize) / 1000;
                self.now = self.now + Duration::from_micros(us + 67);
                let error_rate = self.reception.error_rate(mode, BYTES);
                tried.sent += mpdus;
                tried.acknowledged = (0..mpdus).map(|_| u32::from(self.rng.unit() >= error_rate)).sum();
                if tried.acknowledged > 0 {
                    outcome.push(tried);
                    break 'stages;
                }
            }
            outcome.push(tried);
        }
        self.frames += 1;
        self.samples += u32::from(chain.is_sample);
        self.acknowledged += outcome.last().expect("a chain has entries").acknowledged;
        self.minstrel.record(self.now, mpdus, &outcome);
    }

    fn send_until(&mut self, second: f64) {
        while self.now.as_secs_f64() < second {
            self.send();
        }
    }

    /// Expected MPDUs/s in a mode.
    fn goodput(&self, mode: usize) -> f64 {
        let us = self.phy.attempt_ns(&self.phy.modes()[mode], BYTES * self.aggregate as usize) / 1000 + 67;
        1e6 * f64::from(self.aggregate) * (1.0 - self.reception.error_rate(mode, BYTES)) / us as f64
    }

    fn ideal(&self) -> usize {
        (0..self.phy.modes().len())
            .max_by(|a, b| self.goodput(*a).total_cmp(&self.goodput(*b)))
            .expect("modes")
    }

    /// Sends until the best mode has more than 90 % of the highest goodput. Returns the time and the frames that it took.
    fn adapt(&mut self) -> (f64, u32) {
        let (start, frames) = (self.now.as_secs_f64(), self.frames);
        let ideal = self.goodput(self.ideal());
        while self.goodput(self.minstrel.best()) <= 0.9 * ideal {
            self.send();
            assert!(self.now.as_secs_f64() < start + 10.0, "it does not adapt");
        }
        (self.now.as_secs_f64() - start, self.frames - frames)
    }

    fn change(&mut self, snr_db: f64) {
        self.reception = Reception::new(self.phy, snr_db);
    }
}

fn links(snr_db: f64, seeds: std::ops::Range<u64>) -> impl Iterator<Item = Link> {
    let kinds = STANDARDS.into_iter().flat_map(|standard| {
        let aggregates: &[u32] = if Phy::usual(standard).aggregates() { &[1, 16] } else { &[1] };
        aggregates.iter().map(move |aggregate| (standard, *aggregate))
    });
    kinds.flat_map(move |(standard, aggregate)| {
        seeds.clone().map(move |seed| Link::new(standard, snr_db, aggregate, seed))
    })
}

/// Returns the median and the longest time of adapting in 802.11n, s, over 40 seeds.
fn adaptation(aggregate: u32, from_db: Option<f64>, to_db: f64) -> [f64; 2] {
    let time = |seed| {
        let mut link = Link::new(WifiStandard::N, from_db.unwrap_or(to_db), aggregate, seed);
        if from_db.is_some() {
            link.send_until(1.5);
            link.change(to_db);
        }
        link.adapt().0
    };
    let mut times: Vec<f64> = (0..40).map(time).collect();
    times.sort_by(f64::total_cmp);
    [times[times.len() / 2], times[times.len() - 1]]
}

#[test]
fn a_station_with_two_streams_finds_the_best_mode_of_both_groups() {
    for standard in [WifiStandard::N, WifiStandard::Ac, WifiStandard::Ax] {
        let network = WirelessNetwork { standard, streams: 2, ..cotorra_graph_testing::wireless() };
        let phy = Phy::of(&network, Band::Ghz5);
        let group = phy.modes().len() / 2;
        for (snr_db, seed) in
            [2.0, 17.5, 45.0].into_iter().flat_map(|snr_db| (0..3).map(move |seed| (snr_db, seed)))
        {
            let mut link = Link::on(phy, snr_db, 16, seed);
            link.adapt();
            let has_two = link.minstrel.best() >= group;
            assert!(snr_db != 45.0 || has_two, "{standard:?}");
            assert!(snr_db != 2.0 || !has_two, "{standard:?}");
            // The last attempts have one stream.
            assert!(link.minstrel.table[STAGES - 1].mode < group || !has_two, "{standard:?}");
        }
    }
}

#[test]
fn a_new_station_finds_the_mode_with_the_highest_goodput() {
    // Each is the best mode's plateau, where it loses few frames.
    for snr_db in [4.5, 7.5, 10.5, 14.5, 17.5, 24.5, 30.0] {
        for mut link in links(snr_db, 0..3) {
            let standard = (link.phy.modes().len(), link.aggregate);
            let (_, frames) = link.adapt();
            assert!(frames < 700, "{standard:?} at {snr_db} dB: {frames} frames");
            // It stays there, and loses little by samples.
            let (begin, before) = (link.now.as_secs_f64(), link.acknowledged);
            link.send_until(begin + 1.0);
            let rate = f64::from(link.acknowledged - before) / (link.now.as_secs_f64() - begin);
            let share = rate / link.goodput(link.ideal());
            assert!(share > 0.9, "{standard:?} at {snr_db} dB: {share:.2} of the ideal goodput");
            assert_eq!(link.minstrel.best(), link.ideal(), "{standard:?} at {snr_db} dB");
        }
    }
}

#[test]
fn adaptation_takes_the_documented_time() {
    // SNR before and after, dB; median and longest time for single frames, and for aggregates of 16, s
    // (docs/reference/radio.md).
    let golden = [
        (None, 18.0, [0.30, 0.41], [0.23, 0.44]),
        (None, 30.0, [0.10, 0.20], [0.13, 0.29]),
        (Some(11.0), 30.0, [0.31, 0.41], [0.26, 0.47]),
        (Some(18.0), 24.0, [0.16, 0.16], [0.26, 0.32]),
        (Some(24.0), 18.0, [0.07, 0.12], [0.15, 0.16]),
        (Some(30.0), 11.0, [0.22, 0.23], [0.31, 0.37]),
    ];
    for (from, to, single, aggregates) in golden {
        for (aggregate, expected) in [(1, single), (16, aggregates)] {
            let measured = adaptation(aggregate, from, to);
            for (measured, expected) in measured.into_iter().zip(expected) {
                assert!(
                    (measured - expected).abs() < 0.01,
                    "from {from:?} to {to} dB with {aggregate}: {measured:.3} s, not {expected} s"
                );
            }
        }
    }
}

#[test]
fn samples_are_few() {
    // At most three between two updates, 50 ms apart, and none once the fastest mode is reliable.
    let mut link = Link::new(WifiStandard::N, 18.0, 1, 5);
    link.send_until(1.0);
    let (frames, samples) = (link.frames, link.samples);
    link.send_until(6.0);
    let per_second = f64::from(link.samples - samples) / 5.0;
    let share = f64::from(link.samples - samples) / f64::from(link.frames - frames);
    assert!((20.0..60.0).contains(&per_second), "{per_second} samples/s");
    assert!((0.015..0.02).contains(&share), "{share} of all frames");

    let mut fastest = Link::new(WifiStandard::N, 40.0, 1, 5);
    fastest.send_until(1.0);
    let samples = fastest.samples;
    fastest.send_until(3.0);
    assert_eq!(fastest.samples, samples);
}

#[test]
fn an_idle_station_does_not_catch_up_on_samples() {
    let mut link = Link::new(WifiStandard::N, 18.0, 1, 5);
    link.send_until(1.0);
    link.now = link.now + Duration::from_secs(60);
    let samples = link.samples;
    link.send_until(61.015);
    assert!(link.samples - samples <= 1, "{} samples in 15 ms", link.samples - samples);
}

#[test]
fn chains_fall_back_to_a_reliable_mode() {
    for mut link in links(17.5, 0..2) {
        link.send_until(1.0);
        for _ in 0..200 {
            let chain = link.minstrel.chain(link.now);
            let [first, .., last] = chain.stages;
            assert!(chain.stages.iter().all(|stage| (1..=7).contains(&stage.attempts)));
            assert!(chain.stages.iter().all(|stage| stage.mode < link.phy.modes().len()));
            assert_eq!(chain.stages.map(|stage| stage.rts), [false, true, true, true]);
            assert!(link.reception.error_rate(last.mode, BYTES) < 0.1);
            assert!(!chain.is_sample || first.attempts == 1);
            link.send();
        }
    }
}

#[test]
fn attempts_fit_into_six_milliseconds() {
    // By hand: half of each window in slots, 60 or 108 µs of overhead, 120 µs of RTS and CTS, and 1200 bytes.
    for (standard, mode, mpdus, expected) in [
        (WifiStandard::N, 0, 1, [3, 3]),
        (WifiStandard::N, 7, 1, [5, 5]),
        (WifiStandard::N, 7, 16, [2, 2]),
        (WifiStandard::N, 7, 8, [3, 3]),
        (WifiStandard::A, 0, 1, [3, 3]),
        (WifiStandard::A, 7, 1, [5, 5]),
    ] {
        let mut minstrel = Minstrel::new(Timestamp::ZERO, Phy::usual(standard), Draws::new(1, "order"));
        minstrel.modes[mode].probability = ONE;
        minstrel.mpdus_per_frame = mpdus << SCALE;
        let attempts = [minstrel.attempts(mode, false), minstrel.attempts(mode, true)];
        assert_eq!(attempts, expected, "{standard:?} mode {mode} with {mpdus}");
        minstrel.modes[mode].probability = ONE / 6;
        assert_eq!(minstrel.attempts(mode, false), 2, "of a mode that mostly fails");
    }
}

#[test]
fn throughput_counts_from_ten_to_ninety_percent() {
    let mut minstrel = Minstrel::new(Timestamp::ZERO, Phy::usual(WifiStandard::N), Draws::new(1, "order"));
    let mut at = |percent: i32, mpdus: i32| {
        minstrel.modes[7].probability = percent * ONE / 100;
        minstrel.mpdus_per_frame = mpdus << SCALE;
        minstrel.throughput(7)
    };
    assert_eq!(at(9, 1), 0);
    // 147.75 µs for 1200 bytes at 65 Mbit/s, and 108 µs of overhead, of which each packet has its share.
    assert_eq!(at(50, 1), 195);
    assert_eq!(at(50, 16), 323);
    assert_eq!(at(90, 1), at(100, 1));
    assert!(at(89, 1) < at(90, 1));
}

#[test]
fn the_filter_follows_a_step_within_three_updates() {
    // a = exp(-π√2/16), 2a·cos(√2·2π/16) and -a² (Linux's comment on MINSTREL_AVG_COEFF2 and 3).
    let a = (-std::f64::consts::PI * 2f64.sqrt() / 16.0).exp();
    let coefficients = [2.0 * a * (2f64.sqrt() * std::f64::consts::TAU / 16.0).cos(), -a * a];
    for (filter, exact) in FILTER[1..].iter().zip(coefficients) {
        assert!((f64::from(*filter) / f64::from(ONE) - exact).abs() < 0.01, "{filter} is not {exact}");
    }
    assert_eq!(FILTER.iter().sum::<i32>(), ONE);

    let mut minstrel = Minstrel::new(Timestamp::ZERO, Phy::usual(WifiStandard::N), Draws::new(1, "order"));
    let mode = &mut minstrel.modes[3];
    let mut after = |acknowledged| {
        (mode.sent, mode.acknowledged) = (10, acknowledged);
        mode.update();
        f64::from(mode.probability) / f64::from(ONE)
    };
    assert_eq!(after(10), 1.0, "the first share counts as it is");
    assert_eq!(after(10), 1.0);
    let falls: Vec<f64> = (0..4).map(|_| after(0)).collect();
    assert!((falls[0] - 0.71).abs() < 0.01 && falls[2] < 0.15, "{falls:?}");
    assert!(falls.is_sorted_by(|a, b| a >= b));
}

#[test]
fn a_run_repeats_by_its_seed() {
    let run = |seed| {
        let mut link = Link::new(WifiStandard::Ac, 18.0, 16, seed);
        link.send_until(0.5);
        (link.now, link.acknowledged, link.samples, link.minstrel.table)
    };
    assert_eq!(run(1), run(1));
    assert_ne!(run(1), run(2));
}
