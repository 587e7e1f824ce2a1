//! PIE (RFC 8033): drops arriving packets with a probability that a proportional integral controller derives from the delay
//! of the queue.
//!
//! The delay is the time that the last packet waited, which section 4.3 allows in place of an estimate. Besides the basic
//! algorithm of section 4 it has ECN (5.1), derandomization (5.4) and the cap on drop adjustment (5.5).

use std::time::Duration;

use cotorra_graph::{Pie as Parameters, Timestamp};
use cotorra_numbers::Draws;

use super::Verdict;

/// Weights of the distance to the target and of the trend, 1/s (RFC 8033, section 4.2).
const ALPHA: f64 = 0.125;
const BETA: f64 = 1.25;
/// Auto-tuning: divisors of a change while the probability is below a bound (RFC 8033, section 4.2).
const TUNING: [(f64, f64); 6] =
    [(1e-6, 2048.0), (1e-5, 512.0), (1e-4, 128.0), (1e-3, 32.0), (1e-2, 8.0), (0.1, 2.0)];
/// Largest rise of a probability of 10 % or more (RFC 8033, section 5.5).
const MOST_RISE: f64 = 0.02;
/// Decay of the probability with each update while the queue is empty (RFC 8033, section 4.2).
const DECAY: f64 = 0.98;
/// Probability from which on packets are no longer marked, but dropped (RFC 8033, section 5.1).
const MOST_MARKED: f64 = 0.1;
/// Sum of the probabilities since the last drop, below which no packet is dropped, and from which on the next one is
/// (RFC 8033, section 5.4).
const ACCUMULATED: [f64; 2] = [0.85, 8.5];
/// Bytes of two packets of a usual size. A queue up to them drops nothing (RFC 8033, section 4.1).
const SHORT_QUEUE: u64 = 2 * 1000;

/// State of PIE.
#[derive(Debug)]
pub(super) struct Pie {
    parameters: Parameters,
    probability: f64,
    /// Sum of the probabilities since the last drop.
    accumulated: f64,
    /// Rest of a burst that passes without drops.
    burst_left: Duration,
    /// Time that the last packet waited; zero while the queue is idle.
    delay: Duration,
    /// `delay` at the last update.
    delay_before: Duration,
    next_update: Timestamp,
}

impl Pie {
    pub fn new(parameters: Parameters, now: Timestamp) -> Self {
        Self {
            parameters,
            probability: 0.0,
            accumulated: 0.0,
            burst_left: parameters.burst,
            delay: Duration::ZERO,
            delay_before: Duration::ZERO,
            next_update: now + parameters.update,
        }
    }

    /// Decides on a packet that arrives while so many bytes wait.
    pub fn decide(&mut self, now: Timestamp, bytes: u64, rng: &mut Draws) -> Verdict {
        self.catch_up(now);
        let is_calm = self.delay_before < self.parameters.target / 2 && self.probability < 0.2;
        if !self.burst_left.is_zero() || is_calm || bytes <= SHORT_QUEUE {
            return Verdict::Admit;
        }
        if self.probability == 0.0 {
            self.accumulated = 0.0;
        }
        self.accumulated += self.probability;
        let [least, most] = ACCUMULATED;
        let drops = self.accumulated >= least && (self.accumulated >= most || rng.unit() < self.probability);
        if !drops {
            return Verdict::Admit;
        }
        self.accumulated = 0.0;
        if self.parameters.ecn && self.probability < MOST_MARKED { Verdict::Mark } else { Verdict::Drop }
    }

    /// Notes the time that a packet waited which leaves; zero if none did.
    pub fn left(&mut self, now: Timestamp, waited: Duration) {
        self.catch_up(now);
        self.delay = waited;
    }

    /// Makes up for the updates until now. Nothing changed between them, so that late ones give the same result.
    fn catch_up(&mut self, now: Timestamp) {
        while self.next_update <= now {
            if self.is_at_rest() {
                let update = self.parameters.update.as_nanos();
                let skipped = (now.since(self.next_update).as_nanos() / update + 1) * update;
                self.next_update = self.next_update + Duration::from_nanos(skipped as u64);
                return;
            }
            self.update();
            self.next_update = self.next_update + self.parameters.update;
        }
    }

    /// Whether an update changes nothing.
    fn is_at_rest(&self) -> bool {
        self.probability == 0.0
            && self.delay.is_zero()
            && self.delay_before.is_zero()
            && self.burst_left == self.parameters.burst
    }

    /// Updates the probability (RFC 8033, section 4.2) and the rest of the burst (4.4).
    fn update(&mut self) {
        let Parameters { target, update, burst, .. } = self.parameters;
        let [delay, before, aim] = [self.delay, self.delay_before, target].map(|time| time.as_secs_f64());
        let mut change = ALPHA * (delay - aim) + BETA * (delay - before);
        let divisor = TUNING.iter().find(|(below, _)| self.probability < *below);
        change /= divisor.map_or(1.0, |(_, divisor)| *divisor);
        if self.probability >= 0.1 {
            change = change.min(MOST_RISE);
        }
        self.probability += change;
        if self.delay.is_zero() && self.delay_before.is_zero() {
            self.probability *= DECAY;
        }
        self.probability = self.probability.clamp(0.0, 1.0);
        self.burst_left = self.burst_left.saturating_sub(update);
        if self.probability == 0.0 && self.delay < target / 2 && self.delay_before < target / 2 {
            self.burst_left = burst;
        }
        self.delay_before = self.delay;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::queue::testing::ms;

    fn pie(parameters: Parameters) -> Pie {
        Pie::new(parameters, Timestamp::ZERO)
    }

    /// PIE with a probability, while packets wait so long now and at the last update.
    fn at(probability: f64, [delay_ms, before_ms]: [u64; 2]) -> Pie {
        let [delay, delay_before] = [delay_ms, before_ms].map(Duration::from_millis);
        Pie { probability, delay, delay_before, ..pie(Parameters::default()) }
    }

    /// With α = 0.125 and β = 1.25, 20 ms after 19 ms change the probability by (0.000625 + 0.00125)/divisor.
    #[test]
    fn the_change_is_tuned_by_the_probability() {
        for (probability, divisor) in [
            (0.0, 2048.0),
            (9e-7, 2048.0),
            (1e-6, 512.0),
            (9e-6, 512.0),
            (1e-5, 128.0),
            (1e-4, 32.0),
            (1e-3, 8.0),
            (1e-2, 2.0),
            (0.099, 2.0),
            (0.1, 1.0),
            (0.5, 1.0),
        ] {
            let mut pie = at(probability, [20, 19]);
            pie.update();
            let change = (pie.probability - probability) * divisor;
            assert!((change - 0.001_875).abs() < 1e-9, "at {probability}: {change}");
        }
    }

    #[test]
    fn the_probability_falls_below_the_target_and_decays_in_an_empty_queue() {
        let mut falling = at(0.5, [5, 5]);
        falling.update();
        assert!((falling.probability - (0.5 - 0.125 * 0.010)).abs() < 1e-12);
        let mut empty = at(0.5, [0, 0]);
        empty.update();
        assert!((empty.probability - (0.5 - 0.125 * 0.015) * 0.98).abs() < 1e-12);
    }

    #[test]
    fn the_probability_stays_between_0_and_1_and_rises_by_two_percent_at_most() {
        let mut high = at(0.1, [900, 100]);
        high.update();
        assert!((high.probability - 0.12).abs() < 1e-12);
        let mut most = at(0.99, [900, 100]);
        most.update();
        assert_eq!(most.probability, 1.0);
        let mut least = at(1e-7, [1, 900]);
        least.update();
        assert_eq!(least.probability, 0.0);
    }

    #[test]
    fn a_burst_passes_and_a_lasting_queue_does_not() {
        let mut pie = pie(Parameters::default());
        let mut rng = Draws::new(1, "pie");
        pie.left(Timestamp::ZERO, Duration::from_secs(1));
        let mut decide = |at: f64| pie.decide(ms(at), 1_000_000, &mut rng);
        // After 149 ms there were nine updates, which leave 15 ms of the burst.
        assert!((0..1490).all(|i| decide(f64::from(i) / 10.0) == Verdict::Admit));
        assert!((1500..20_000).any(|i| decide(f64::from(i) / 10.0) == Verdict::Drop));
    }

    #[test]
    fn a_burst_is_allowed_again_after_calm() {
        let mut pie = Pie { burst_left: Duration::ZERO, ..at(1e-7, [1, 1]) };
        pie.update();
        assert_eq!(pie.burst_left, Duration::from_millis(150));
        let mut busy = Pie { burst_left: Duration::ZERO, ..at(0.0, [8, 1]) };
        busy.update();
        assert_eq!(busy.burst_left, Duration::ZERO);
    }

    #[test]
    fn short_and_calm_queues_drop_nothing() {
        let mut rng = Draws::new(1, "pie");
        let no_burst = |probability, delay| Pie {
            burst_left: Duration::ZERO,
            next_update: Timestamp::MAX,
            ..at(probability, delay)
        };
        let mut drops = |pie: Pie, bytes| {
            let mut pie = pie;
            (0..1000).filter(|_| pie.decide(ms(1.0), bytes, &mut rng) == Verdict::Drop).count()
        };
        assert_eq!(drops(no_burst(0.9, [20, 20]), SHORT_QUEUE), 0);
        assert!(drops(no_burst(0.9, [20, 20]), SHORT_QUEUE + 1) > 0);
        assert_eq!(drops(no_burst(0.19, [20, 7]), 1_000_000), 0);
        assert!(drops(no_burst(0.19, [20, 8]), 1_000_000) > 0);
        assert!(drops(no_burst(0.2, [20, 7]), 1_000_000) > 0);
    }

    /// RFC 8033, section 5.4: drops come neither in a row nor too late.
    #[test]
    fn drops_are_spread() {
        let mut pie = Pie { burst_left: Duration::ZERO, next_update: Timestamp::MAX, ..at(0.0625, [20, 20]) };
        let mut rng = Draws::new(1, "pie");
        let mut gaps = vec![0];
        for _ in 0..100_000 {
            match pie.decide(ms(1.0), 1_000_000, &mut rng) {
                Verdict::Drop => gaps.push(0),
                _ => *gaps.last_mut().unwrap() += 1,
            }
        }
        let complete = &gaps[..gaps.len() - 1];
        assert!(complete.len() > 1000);
        // The sum is 0.85 or more from the 14th packet on, and 8.5 at the 136th.
        let (least, most) = (complete.iter().min().unwrap(), complete.iter().max().unwrap());
        assert!(*least == 13 && *most <= 135, "{least} to {most}");
    }

    #[test]
    fn capable_packets_are_marked_below_ten_percent() {
        for (probability, ecn, expected) in
            [(0.099, true, Verdict::Mark), (0.1, true, Verdict::Drop), (0.099, false, Verdict::Drop)]
        {
            let parameters = Parameters { ecn, ..Parameters::default() };
            let calm = at(probability, [20, 20]);
            let mut pie = Pie { parameters, burst_left: Duration::ZERO, next_update: Timestamp::MAX, ..calm };
            let mut rng = Draws::new(1, "pie");
            let mut decisions = (0..1000).map(|_| pie.decide(ms(1.0), 1_000_000, &mut rng));
            assert_eq!(decisions.find(|verdict| *verdict != Verdict::Admit), Some(expected));
        }
    }

    #[test]
    fn late_updates_give_the_same_as_updates_in_time() {
        let [mut late, mut timely] = [0, 1].map(|_| at(0.3, [25, 25]));
        (1..=1000).for_each(|i| timely.catch_up(ms(f64::from(i))));
        late.catch_up(ms(1000.0));
        assert_eq!(late.probability, timely.probability);
        assert_eq!(late.next_update, timely.next_update);
    }

    #[test]
    fn a_queue_at_rest_skips_its_updates() {
        let mut pie = pie(Parameters::default());
        pie.left(ms(15.0 * 1e9 + 7.0), Duration::ZERO);
        assert_eq!(pie.next_update, ms(15.0 * 1e9 + 15.0));
        assert!(pie.is_at_rest());
    }
}
