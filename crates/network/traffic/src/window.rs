//! Congestion windows of Reno (RFC 5681) and CUBIC (RFC 9438), the latter with HyStart++ (RFC 9406). Windows are in full segments.

use std::time::Duration;

use cotorra_graph::Timestamp;

/// Window at the beginning (RFC 6928).
pub(crate) const INITIAL: f64 = 10.0;
/// Least slow start threshold (RFC 5681, equation 4; RFC 9438, section 4.6).
const LEAST_THRESHOLD: f64 = 2.0;
/// Most segments by which one acknowledgement opens the window in slow start: those that a delayed one covers (RFC 3465, 2.3).
const MOST_PER_ACK: f64 = 2.0;
/// CUBIC's C, segments/s³ (RFC 9438, section 5).
const C: f64 = 0.4;
/// CUBIC's β, the share of the window that a loss leaves (RFC 9438, section 4.6).
const BETA: f64 = 0.7;
/// Growth of CUBIC's estimate of Reno, segments a round trip (RFC 9438, section 4.3).
const ALPHA: f64 = 3.0 * (1.0 - BETA) / (1.0 + BETA);

/// What an acknowledgement tells a window.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Acknowledgement {
    /// Segments that newly arrived.
    pub segments: f64,
    /// Segments under way before it.
    pub used: f64,
    /// Smoothed round trip.
    pub round_trip: Duration,
    /// The round trip that it measures.
    pub sample: Option<Duration>,
    /// Position up to which all arrived, and that of the next new byte.
    pub positions: [u64; 2],
}

/// A congestion window.
#[derive(Debug, Clone)]
pub(crate) struct Window {
    size: f64,
    threshold: f64,
    /// CUBIC's state; `None` of Reno.
    cubic: Option<Cubic>,
}

#[derive(Debug, Clone, Default)]
struct Cubic {
    /// W_max.
    origin: f64,
    /// cwnd_prior: the window before the last loss.
    prior: f64,
    /// Congestion avoidance since the last loss.
    epoch: Option<Epoch>,
    /// `None` once the first slow start is over.
    start: Option<HyStart>,
}

/// The first slow start, which ends when round trips grow (RFC 9406).
#[derive(Debug, Clone, Copy, Default)]
struct HyStart {
    /// Position whose acknowledgement ends the round.
    round_ends: u64,
    /// Least round trip of the last round, and of this one with the number of its samples.
    last: Option<Duration>,
    this: Option<Duration>,
    samples: u32,
    /// Conservative slow start: the round trip at its begin, and its rounds so far.
    conservative: Option<(Duration, u32)>,
}

impl HyStart {
    /// Samples that tell the round trip of a round (N_RTT_SAMPLE).
    const SAMPLES: u32 = 8;
    /// Least and most growth of the round trip that counts (MIN_RTT_THRESH, MAX_RTT_THRESH), and its share of the round trip.
    const GROWTH: [Duration; 2] = [Duration::from_millis(4), Duration::from_millis(16)];
    const GROWTH_DIVISOR: u32 = 8;
    /// By how much the window grows less in conservative slow start (CSS_GROWTH_DIVISOR), and its rounds (CSS_ROUNDS).
    const DIVISOR: f64 = 4.0;
    const ROUNDS: u32 = 5;

    /// Takes an acknowledgement. Returns whether slow start is over.
    fn acknowledged(&mut self, ack: &Acknowledgement) -> bool {
        if let Some(sample) = ack.sample {
            self.this = Some(self.this.map_or(sample, |this| this.min(sample)));
            self.samples += 1;
        }
        if let (Some(last), Some(this), Self::SAMPLES..) = (self.last, self.this, self.samples) {
            let [least, most] = Self::GROWTH;
            match self.conservative {
                None if this >= last + (last / Self::GROWTH_DIVISOR).clamp(least, most) => {
                    self.conservative = Some((this, 0));
                }
                Some((baseline, _)) if this < baseline => self.conservative = None,
                _ => {}
            }
        }
        let [arrived, next] = ack.positions;
        if arrived >= self.round_ends {
            (self.last, self.this, self.samples, self.round_ends) = (self.this, None, 0, next);
            if let Some((_, rounds)) = &mut self.conservative {
                *rounds += 1;
            }
        }
        self.conservative.is_some_and(|(_, rounds)| rounds > Self::ROUNDS)
    }
}

/// Stretch of congestion avoidance.
#[derive(Debug, Clone, Copy)]
struct Epoch {
    began: Timestamp,
    origin: f64,
    /// K, seconds.
    plateau: f64,
    /// W_est.
    reno: f64,
}

impl Epoch {
    fn new(began: Timestamp, window: f64, origin: f64) -> Self {
        let origin = origin.max(window);
        Self { began, origin, plateau: ((origin - window) / C).cbrt(), reno: window }
    }

    /// Returns W_cubic after so many seconds (RFC 9438, equation 1).
    fn window(&self, seconds: f64) -> f64 {
        C * (seconds - self.plateau).powi(3) + self.origin
    }
}

impl Window {
    pub(crate) fn reno() -> Self {
        Self { size: INITIAL, threshold: f64::INFINITY, cubic: None }
    }

    pub(crate) fn cubic() -> Self {
        Self { cubic: Some(Cubic { start: Some(HyStart::default()), ..Cubic::default() }), ..Self::reno() }
    }

    /// Size, segments.
    pub(crate) fn size(&self) -> f64 {
        self.size
    }

    /// Takes an acknowledgement outside of fast recovery. A window that the sender does not use does not grow (RFC 7661; the
    /// bounds are those of Linux's `tcp_is_cwnd_limited`).
    pub(crate) fn acknowledged(&mut self, now: Timestamp, ack: &Acknowledgement) {
        let Acknowledgement { segments: mut left, used, round_trip, .. } = *ack;
        let mut divisor = 1.0;
        if let Some(start) = self.cubic.as_mut().and_then(|cubic| cubic.start.as_mut()) {
            if start.acknowledged(ack) {
                self.threshold = self.size;
            }
            divisor = start.conservative.map_or(1.0, |_| HyStart::DIVISOR);
        }
        let is_slow_start = self.size < self.threshold;
        if let Some(cubic) = self.cubic.as_mut().filter(|_| !is_slow_start) {
            cubic.start = None;
        }
        let most = if is_slow_start { 2.0 * used } else { used + 2.0 };
        if self.size >= most {
            return;
        }
        if is_slow_start {
            let opened = (left.min(MOST_PER_ACK) / divisor).min(self.threshold - self.size);
            self.size += opened;
            left = if self.size < self.threshold { 0.0 } else { left - opened };
        }
        if left <= 0.0 {
            return;
        }
        let window = self.size;
        let Some(cubic) = &mut self.cubic else {
            self.size += left / window;
            return;
        };
        let origin = cubic.origin;
        let epoch = cubic.epoch.get_or_insert_with(|| Epoch::new(now, window, origin));
        let seconds = now.since(epoch.began).as_secs_f64();
        let alpha = if epoch.reno >= cubic.prior { 1.0 } else { ALPHA };
        epoch.reno += alpha * left / window;
        if epoch.window(seconds) < epoch.reno {
            self.size = window.max(epoch.reno);
        } else {
            let target = epoch.window(seconds + round_trip.as_secs_f64()).clamp(window, 1.5 * window);
            self.size += (target - window) / window * left;
        }
    }

    /// Closes the window because of loss, with so many segments outstanding.
    pub(crate) fn lost(&mut self, flight: f64) {
        self.threshold = self.closed(flight);
        self.size = self.threshold;
    }

    /// Closes the window because of a timeout. A repeated one leaves the threshold (RFC 5681, section 3.1).
    pub(crate) fn timed_out(&mut self, flight: f64, is_first: bool) {
        if is_first {
            self.threshold = self.closed(flight);
        }
        if let Some(cubic) = &mut self.cubic {
            // RFC 9438, section 4.8.
            (cubic.origin, cubic.epoch) = (0.0, None);
        }
        self.size = 1.0;
    }

    /// Returns the threshold after a loss. Segments beyond a gap are outstanding, though they have arrived: no more than the
    /// window was in the network (Linux takes the window itself, `tcp_reno_ssthresh`).
    fn closed(&mut self, flight: f64) -> f64 {
        let flight = flight.min(self.size);
        let Some(cubic) = &mut self.cubic else { return (flight / 2.0).max(LEAST_THRESHOLD) };
        // Fast convergence (RFC 9438, section 4.7).
        let shrinks = self.size < cubic.origin;
        cubic.origin = if shrinks { self.size * (1.0 + BETA) / 2.0 } else { self.size };
        (cubic.prior, cubic.epoch, cubic.start) = (self.size, None, None);
        (flight * BETA).max(LEAST_THRESHOLD)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ROUND_TRIP: Duration = Duration::from_millis(100);

    fn ack(segments: f64, used: f64) -> Acknowledgement {
        let positions = [0, 1];
        Acknowledgement { segments, used, round_trip: ROUND_TRIP, sample: Some(ROUND_TRIP), positions }
    }

    /// Lets a window pass round trips without loss, and returns its size after each.
    fn rounds(window: &mut Window, from: Timestamp, rounds: u32) -> Vec<f64> {
        let round = |at| {
            let now = from + ROUND_TRIP * at;
            let segments = window.size().floor() as u32;
            for i in 0..segments {
                let used = window.size();
                window.acknowledged(now + ROUND_TRIP * i / segments, &ack(1.0, used));
            }
            window.size()
        };
        (0..rounds).map(round).collect()
    }

    #[test]
    fn reno_doubles_in_slow_start_then_adds_a_segment_a_round_trip_and_halves_at_a_loss() {
        let mut window = Window::reno();
        assert_eq!(rounds(&mut window, Timestamp::ZERO, 3), [20.0, 40.0, 80.0]);
        window.lost(80.0);
        assert_eq!(window.size(), 40.0);
        let sizes = rounds(&mut window, Timestamp::ZERO, 5);
        // A little less than five (RFC 5681, section 3.1).
        assert!((44.8..45.0).contains(&sizes[4]), "{sizes:?}");
        window.timed_out(40.0, true);
        window.timed_out(1.0, false);
        assert_eq!((window.size(), window.threshold), (1.0, 20.0));
    }

    #[test]
    fn what_arrived_beyond_a_gap_does_not_open_the_window() {
        for mut window in [Window::reno(), Window::cubic()] {
            window.lost(400.0);
            assert!(window.size() <= BETA * INITIAL, "{window:?}");
        }
    }

    #[test]
    fn a_window_that_is_not_used_does_not_grow() {
        for mut window in [Window::reno(), Window::cubic()] {
            window.acknowledged(Timestamp::ZERO, &ack(1.0, 5.0));
            assert_eq!(window.size(), INITIAL);
            window.lost(10.0);
            let size = window.size();
            window.acknowledged(Timestamp::ZERO, &ack(1.0, size - 3.0));
            assert_eq!(window.size(), size);
        }
    }

    #[test]
    fn cubics_first_slow_start_ends_after_five_gentler_rounds_when_round_trips_grow() {
        let mut window = Window::cubic();
        let mut round = |number: u64, trip_ms: u64| {
            for i in 0..10 {
                let arrived = if i == 9 { number * 10 + 10 } else { number * 10 };
                let ack = Acknowledgement {
                    sample: Some(Duration::from_millis(trip_ms)),
                    positions: [arrived, number * 10 + 20],
                    ..ack(1.0, 1000.0)
                };
                window.acknowledged(Timestamp::ZERO, &ack);
            }
            window.size()
        };
        let same: Vec<_> = (0..3).map(|number| round(number, 100)).collect();
        assert_eq!(same, [20.0, 30.0, 40.0]);
        // An eighth more does not count before its eighth sample.
        let grown: Vec<_> = (3..9).map(|number| round(number, 113)).collect();
        assert!(grown[0] > 47.0 && grown[0] < 48.5, "{grown:?}");
        assert!(grown.windows(2).take(4).all(|pair| pair[1] - pair[0] == 2.5), "{grown:?}");
        let after = round(9, 113);
        assert!(after - grown[5] < 1.0, "congestion avoidance: {grown:?} {after}");
        assert!(window.threshold < f64::INFINITY);
    }

    #[test]
    fn cubic_follows_its_function_after_a_loss() {
        let mut window = Window::cubic();
        window.size = 1000.0;
        window.lost(1000.0);
        assert_eq!(window.size(), 700.0);
        let began = Timestamp::ZERO + Duration::from_secs(1);
        // K = (W_max · (1 - β) / C)^⅓ = 9.086 s.
        let plateau = (1000.0 * 0.3 / 0.4f64).cbrt();
        for (round, size) in rounds(&mut window, began, 120).into_iter().enumerate() {
            let seconds = (round + 1) as f64 * 0.1;
            let expected = 0.4 * (seconds - plateau).powi(3) + 1000.0;
            assert!((size - expected).abs() < 0.01 * expected, "{seconds} s: {size}, not {expected}");
        }
    }

    #[test]
    fn cubic_grows_as_reno_would_where_that_is_faster() {
        let mut window = Window::cubic();
        window.size = 20.0;
        window.lost(20.0);
        let sizes = rounds(&mut window, Timestamp::ZERO, 11);
        // 3 · 0.3 / 1.7 segments a round trip from 14 segments: the cubic function has 14.98 after 1.1 s.
        assert!((sizes[10] - (14.0 + 11.0 * ALPHA)).abs() < 0.4, "{sizes:?}");
    }

    #[test]
    fn a_second_loss_below_the_first_lets_others_have_more() {
        let mut window = Window::cubic();
        window.size = 100.0;
        window.lost(100.0);
        window.size = 80.0;
        window.lost(80.0);
        assert_eq!(window.cubic.as_ref().map(|cubic| cubic.origin), Some(80.0 * 0.85));
    }
}
