//! Contention of one access category of one station: it senses the channel, counts down its backoff, and doubles its
//! window when no answer comes.

use std::time::Duration;

use cotorra_graph::Timestamp;
use cotorra_numbers::Draws;

use crate::radio::phy::SLOT;

/// Parameters of an access category.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Parameters {
    /// Idle time before the countdown, in slots after SIFS.
    pub(super) aifsn: u32,
    pub(super) cw_min: u32,
    pub(super) cw_max: u32,
    /// Longest time on the channel after one contention; zero for a single exchange.
    pub(super) txop: Duration,
}

/// The backoff of one access category (IEEE 802.11-2020, 10.23.2).
///
/// Slot boundaries begin AIFS after the channel fell idle. At each, the category sends if its counter is zero, or else
/// counts one down; so it also counts at the boundary at which another one begins to send (10.23.2.4).
#[derive(Debug)]
pub(super) struct Backoff {
    parameters: Parameters,
    aifs: Duration,
    window: u32,
    /// Attempts that failed since the window was smallest (QSRC).
    failures: u32,
    /// Slots to count after `idle_from` and AIFS.
    slots: u32,
    /// End of the last transmission that it sensed.
    idle_from: Timestamp,
    /// Time from which it has had a frame to send.
    ready: Timestamp,
    rng: Draws,
}

impl Backoff {
    pub(super) fn new(parameters: Parameters, sifs: Duration, rng: Draws) -> Self {
        Self {
            aifs: sifs + parameters.aifsn * SLOT,
            window: parameters.cw_min,
            failures: 0,
            slots: 0,
            idle_from: Timestamp::ZERO,
            ready: Timestamp::ZERO,
            parameters,
            rng,
        }
    }

    /// Longest time on the channel after one contention.
    pub(super) fn txop(&self) -> Duration {
        self.parameters.txop
    }

    /// Records that a first frame came. A category whose counter has expired sends at the next slot boundary if the channel
    /// has been idle for AIFS, and backs off if not.
    pub(super) fn wake(&mut self, now: Timestamp) {
        self.ready = now;
        if self.slots == 0 && now < self.idle_from + self.aifs {
            self.draw();
        }
    }

    /// Returns when it sends, if no other sends before.
    pub(super) fn access(&self) -> Timestamp {
        let begins = self.idle_from + self.aifs;
        let slots = self.ready.since(begins).as_nanos().div_ceil(SLOT.as_nanos()) as u64;
        begins + Duration::from_nanos(slots.max(u64::from(self.slots)).saturating_mul(SLOT.as_nanos() as u64))
    }

    /// Stops the countdown at `now`: the channel is busy up to `until`.
    pub(super) fn pause(&mut self, now: Timestamp, until: Timestamp) {
        let counts_from = self.idle_from + self.aifs;
        if now >= counts_from {
            let boundaries = now.since(counts_from).as_nanos() / SLOT.as_nanos() + 1;
            self.slots = self.slots.saturating_sub(u32::try_from(boundaries).unwrap_or(u32::MAX));
        }
        self.idle_from = self.idle_from.max(until);
    }

    /// Whether an attempt that fails now is the last of `most` in a row, after which the window is reset.
    pub(super) fn is_last(&self, most: u32) -> bool {
        self.failures + 1 >= most
    }

    /// Begins a new countdown after an acknowledged frame, or after the last failure in a row.
    pub(super) fn reset(&mut self) {
        (self.window, self.failures) = (self.parameters.cw_min, 0);
        self.draw();
    }

    /// Begins a new countdown with a doubled window, after a frame that was not acknowledged.
    pub(super) fn double(&mut self) {
        self.window = (2 * self.window + 1).min(self.parameters.cw_max);
        self.failures += 1;
        self.draw();
    }

    fn draw(&mut self) {
        self.slots = (self.rng.unit() * f64::from(self.window + 1)) as u32;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIFS: Duration = Duration::from_micros(16);
    const BEST_EFFORT: Parameters = Parameters { aifsn: 3, cw_min: 15, cw_max: 1023, txop: Duration::ZERO };

    fn backoff(parameters: Parameters, label: &str) -> Backoff {
        Backoff::new(parameters, SIFS, Draws::new(1, label))
    }

    fn us(us: u64) -> Timestamp {
        Timestamp::from_nanos(us * 1000)
    }

    /// The share of time with payload among `senders` that always have a frame, by Bianchi, Performance analysis of the
    /// IEEE 802.11 distributed coordination function, IEEE JSAC 18(3), 2000, equations 7, 9 and 13.
    ///
    /// The category sends in a slot with probability τ; p is the probability that another one does so, too.
    fn bianchi(
        senders: i32,
        parameters: Parameters,
        [success, collision]: [Duration; 2],
        payload: Duration,
    ) -> f64 {
        let window = f64::from(parameters.cw_min + 1);
        let stages = f64::from((parameters.cw_max + 1) / (parameters.cw_min + 1)).log2();
        let tau = |p: f64| {
            let doubled = (2.0 * p).powf(stages);
            2.0 * (1.0 - 2.0 * p) / ((1.0 - 2.0 * p) * (window + 1.0) + p * window * (1.0 - doubled))
        };
        let (mut low, mut high) = (0.0, 0.999_999);
        for _ in 0..100 {
            let p: f64 = 0.5 * (low + high);
            if 1.0 - (1.0 - tau(p)).powi(senders - 1) > p { low = p } else { high = p }
        }
        let tau = tau(low);
        let someone = 1.0 - (1.0 - tau).powi(senders);
        let one = f64::from(senders) * tau * (1.0 - tau).powi(senders - 1);
        let aifs = SIFS + parameters.aifsn * SLOT;
        let [success, collision] = [success, collision].map(|busy| (busy + aifs).as_secs_f64());
        let slot = (1.0 - someone) * SLOT.as_secs_f64() + one * success + (someone - one) * collision;
        one * payload.as_secs_f64() / slot
    }

    /// The same, measured among categories that hear each other.
    fn simulated(
        senders: i32,
        parameters: Parameters,
        [success, collision]: [Duration; 2],
        payload: Duration,
    ) -> f64 {
        let mut senders: Vec<_> = (0..senders).map(|i| backoff(parameters, &format!("{i}"))).collect();
        let (mut sent, mut now) = (0, Timestamp::ZERO);
        for _ in 0..30_000 {
            now = senders.iter().map(Backoff::access).min().unwrap();
            let winners: Vec<_> = (0..senders.len()).filter(|i| senders[*i].access() == now).collect();
            let busy = if winners.len() == 1 { success } else { collision };
            senders.iter_mut().for_each(|sender| sender.pause(now, now + busy));
            match winners[..] {
                [only] => {
                    sent += 1;
                    senders[only].reset();
                }
                _ => winners.iter().for_each(|winner| senders[*winner].double()),
            }
        }
        f64::from(sent) * payload.as_secs_f64() / now.as_secs_f64()
    }

    #[test]
    fn saturation_throughput_is_that_of_bianchi_within_2_percent() {
        let (busy, payload) = ([Duration::from_micros(330); 2], Duration::from_micros(200));
        let wide = Parameters { aifsn: 2, cw_min: 31, cw_max: 1023, txop: Duration::ZERO };
        for parameters in [BEST_EFFORT, wide] {
            for senders in [1, 2, 3, 5, 10, 20, 50] {
                let [model, measured] =
                    [bianchi, simulated].map(|share| share(senders, parameters, busy, payload));
                let ratio = measured / model;
                println!("{senders} senders: {measured:.4} of the time with payload, Bianchi {model:.4}");
                assert!((ratio - 1.0).abs() < 0.02, "{senders} senders: {measured:.4}, not {model:.4}");
            }
        }
    }

    #[test]
    fn saturation_throughput_is_what_ns_3_publishes_within_3_percent() {
        // Stations, and Mbit/s of packets of 1500 bytes at 54 Mbit/s of 802.11a: the calculated values in ns-3's
        // wifi-bianchi.cc. Their stations wait for DIFS, and after a collision for EIFS.
        let published = [(5, 29.2861), (10, 27.3763), (20, 25.3325), (30, 24.0944), (50, 22.4162)];
        let dcf = Parameters { aifsn: 2, ..BEST_EFFORT };
        // A PSDU of 1536 bytes has 20 µs and 57 symbols. SIFS and an acknowledgement follow, which takes 28 µs at
        // 24 Mbit/s, and 44 µs in EIFS.
        let busy = [248 + 16 + 28, 248 + 16 + 44].map(Duration::from_micros);
        for (senders, mbps) in published {
            // 12,000 bits, so that a share of time is bits over µs.
            let measured = simulated(senders, dcf, busy, Duration::from_micros(12_000));
            println!("{senders} senders: {measured:.2} Mbit/s, ns-3 {mbps:.2}");
            assert!((measured / mbps - 1.0).abs() < 0.03, "{senders} senders: {measured:.2}, not {mbps:.2}");
        }
    }

    #[test]
    fn a_frame_that_finds_the_channel_idle_goes_at_the_next_slot_boundary() {
        for (comes, goes) in [(143, 143), (144, 152), (1000, 1007)] {
            let mut sender = backoff(BEST_EFFORT, "a");
            sender.pause(us(0), us(100));
            sender.wake(us(comes));
            assert_eq!(sender.access(), us(goes));
        }
    }

    #[test]
    fn a_frame_that_finds_the_channel_busy_backs_off() {
        let slots: Vec<_> = (0..64)
            .map(|i| {
                let mut sender = backoff(BEST_EFFORT, &format!("{i}"));
                sender.pause(us(0), us(100));
                sender.wake(us(50));
                let waits = sender.access().since(us(100 + 16 + 27));
                assert_eq!(waits.as_micros() % 9, 0);
                waits.as_micros() / 9
            })
            .collect();
        assert_eq!(slots.iter().max(), Some(&15));
        assert_eq!(slots.iter().min(), Some(&0));
    }

    #[test]
    fn the_countdown_pauses_while_the_channel_is_busy_and_counts_its_first_slot() {
        let mut sender = backoff(BEST_EFFORT, "a");
        sender.slots = 5;
        // Boundaries at 43, 52 and 61 µs; another one sends at 61 µs.
        sender.pause(us(61), us(400));
        assert_eq!(sender.slots, 2);
        assert_eq!(sender.access(), us(400 + 43 + 18));
        // Short of AIFS, nothing counts.
        sender.pause(us(430), us(500));
        assert_eq!(sender.slots, 2);
    }

    #[test]
    fn the_window_doubles_up_to_its_limit_and_falls_back() {
        let mut sender = backoff(BEST_EFFORT, "a");
        let windows = [(); 8].map(|()| {
            sender.double();
            sender.window
        });
        assert_eq!(windows, [31, 63, 127, 255, 511, 1023, 1023, 1023]);
        sender.reset();
        assert_eq!(sender.window, 15);
    }
}
