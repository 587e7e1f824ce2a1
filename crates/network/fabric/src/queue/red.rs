//! RED (Floyd and Jacobson, "Random Early Detection Gateways for Congestion Avoidance", IEEE/ACM Transactions on Networking,
//! 1993): drops arriving packets with a probability that rises with the average length of the queue. Above the upper
//! threshold it is gentle (Floyd, "Recommendation on using the gentle_ variant of RED", 2000).

use std::time::Duration;

use cotorra_graph::{Rate, Red as Parameters, RedThresholds, Timestamp};
use cotorra_numbers::Draws;

use super::{FULL_FRAME, Verdict, sending_time};

/// Bytes of a small packet. While the queue is idle, the average falls as if such packets were sent.
const SMALL_PACKET: u64 = 500;

/// State of RED.
#[derive(Debug)]
pub(super) struct Red {
    parameters: Parameters,
    /// Average length of the queue, in the unit of the thresholds.
    average: f64,
    /// Packets since the last one that was dropped or marked; `None` while the average is below the thresholds.
    count: Option<u32>,
    /// Since when nothing waits and nothing is sent.
    idle_since: Option<Timestamp>,
    /// Time to send a small packet.
    small_packet: Duration,
}

impl Red {
    pub fn new(parameters: Parameters, now: Timestamp, rate: &Rate) -> Self {
        let small_packet = sending_time(rate, SMALL_PACKET);
        Self { parameters, average: 0.0, count: None, idle_since: Some(now), small_packet }
    }

    /// Sets the rate at which packets leave.
    pub fn set_rate(&mut self, rate: &Rate) {
        self.small_packet = sending_time(rate, SMALL_PACKET);
    }

    /// Notes that nothing waits and nothing is sent from now on.
    pub fn idle(&mut self, now: Timestamp) {
        self.idle_since.get_or_insert(now);
    }

    /// Decides on a packet of so many bytes, while so many packets and bytes wait.
    pub fn decide(
        &mut self,
        now: Timestamp,
        [queued_packets, queued_bytes]: [u64; 2],
        bytes: u64,
        rng: &mut Draws,
    ) -> Verdict {
        let (queued, max, size) = match self.parameters.thresholds {
            RedThresholds::Packets { max, .. } => (queued_packets, f64::from(max), 1.0),
            RedThresholds::Bytes { max, .. } => (queued_bytes, max as f64, bytes as f64 / FULL_FRAME as f64),
        };
        self.observe(now, queued);
        let Some(probability) = self.probability() else {
            self.count = None;
            return Verdict::Admit;
        };
        // Spreads drops evenly, by p_a of the paper. In bytes, large packets are dropped more often.
        let count = self.count.map_or(0, |count| count.saturating_add(1));
        let probability = (probability * size).min(1.0);
        let left = 1.0 - f64::from(count) * probability;
        if left > 0.0 && rng.unit() >= probability / left {
            self.count = Some(count);
            return Verdict::Admit;
        }
        self.count = Some(0);
        if self.parameters.ecn && self.average < max { Verdict::Mark } else { Verdict::Drop }
    }

    /// Moves the average towards the length of the queue, or, after an idle time, to what it would be after as many small
    /// packets as could have been sent.
    fn observe(&mut self, now: Timestamp, queued: u64) {
        let weight = self.parameters.weight.get();
        match self.idle_since.take() {
            None => self.average += weight * (queued as f64 - self.average),
            Some(since) => {
                let small_packet = self.small_packet.max(Duration::from_nanos(1));
                let sent = now.since(since).div_duration_f64(small_packet);
                self.average *= (1.0 - weight).powf(sent);
            }
        }
    }

    /// Returns the probability that the average gives, p_b; `None` below the lower threshold.
    fn probability(&self) -> Option<f64> {
        let (min, max) = match self.parameters.thresholds {
            RedThresholds::Packets { min, max } => (f64::from(min), f64::from(max)),
            RedThresholds::Bytes { min, max } => (min as f64, max as f64),
        };
        let most = self.parameters.probability.get();
        if self.average < min {
            None
        } else if self.average < max {
            Some(most * (self.average - min) / (max - min))
        } else {
            Some((most + (1.0 - most) * (self.average - max) / max).min(1.0))
        }
    }
}

#[cfg(test)]
mod tests {
    use cotorra_graph::{BitRate, Probability};

    use super::*;
    use crate::queue::testing::ms;

    /// 8 Mbit/s: a small packet of 500 bytes takes half a millisecond.
    fn rate() -> Rate {
        Rate::Fixed { bits_per_second: BitRate::from_mbps(8.0).unwrap() }
    }

    fn red(parameters: Parameters) -> Red {
        Red::new(parameters, Timestamp::ZERO, &rate())
    }

    fn p(p: f64) -> Probability {
        Probability::new(p).unwrap()
    }

    /// RED whose average stays as it is.
    fn steady(average: f64, parameters: Parameters) -> Red {
        let weight = p(f64::MIN_POSITIVE);
        Red { average, idle_since: None, ..red(Parameters { weight, ..parameters }) }
    }

    fn verdicts(mut red: Red, bytes: u64) -> Vec<Verdict> {
        let mut rng = Draws::new(1, "red");
        (0..100_000).map(|_| red.decide(ms(1.0), [0; 2], bytes, &mut rng)).collect()
    }

    /// Returns the gaps between drops, the dropped packet included.
    fn gaps(verdicts: &[Verdict]) -> Vec<usize> {
        let places: Vec<_> =
            verdicts.iter().enumerate().filter(|(_, v)| **v == Verdict::Drop).map(|(i, _)| i).collect();
        places.windows(2).map(|pair| pair[1] - pair[0]).collect()
    }

    #[test]
    fn the_average_moves_by_its_weight() {
        let mut red = red(Parameters { weight: p(0.25), ..Parameters::default() });
        let mut rng = Draws::new(1, "red");
        let mut averages = Vec::new();
        for queued in [0, 4, 4, 0] {
            red.decide(Timestamp::ZERO, [queued, 0], 1000, &mut rng);
            averages.push(red.average);
        }
        assert_eq!(averages, [0.0, 1.0, 1.75, 1.3125]);
    }

    /// In 5 ms, ten small packets could have been sent: (1 - w)¹⁰.
    #[test]
    fn an_idle_time_counts_as_the_packets_that_it_could_have_sent() {
        let mut red = Red { average: 8.0, ..steady(8.0, Parameters::default()) };
        red.parameters.weight = p(0.25);
        red.idle(ms(2.0));
        red.idle(ms(3.0));
        red.observe(ms(7.0), 0);
        assert!((red.average - 8.0 * 0.75f64.powi(10)).abs() < 1e-12);
        red.observe(ms(9.0), 4);
        assert!((red.average - (8.0 * 0.75f64.powi(11) + 1.0)).abs() < 1e-12, "it is idle no more");
    }

    #[test]
    fn the_probability_rises_between_the_thresholds_and_gently_above() {
        for (average, expected) in [
            (4.99, None),
            (5.0, Some(0.0)),
            (10.0, Some(0.01)),
            (15.0, Some(0.02)),
            (22.5, Some(0.51)),
            (30.0, Some(1.0)),
            (90.0, Some(1.0)),
        ] {
            let got = steady(average, Parameters::default()).probability();
            assert_eq!(got.map(|p| (p * 1e9).round() / 1e9), expected, "at {average}");
        }
    }

    #[test]
    fn nothing_is_dropped_below_the_thresholds_and_all_above_twice() {
        let of = |average| verdicts(steady(average, Parameters::default()), 1000);
        assert!(of(4.9).iter().all(|verdict| *verdict == Verdict::Admit));
        assert!(of(30.0).iter().all(|verdict| *verdict == Verdict::Drop));
    }

    /// Gaps are uniform from 1 to 1/p_b, and (1/p_b + 1)/2 in the mean.
    #[test]
    fn drops_are_spread_evenly() {
        let gaps = gaps(&verdicts(steady(10.0, Parameters::default()), 1000));
        assert!(gaps.iter().all(|gap| (1..=101).contains(gap)));
        let mean = gaps.iter().sum::<usize>() as f64 / gaps.len() as f64;
        assert!((mean - 50.5).abs() < 3.0, "{mean}");
        assert!(gaps.iter().any(|gap| *gap < 10) && gaps.iter().any(|gap| *gap > 90));
    }

    #[test]
    fn thresholds_in_bytes_drop_large_packets_more_often() {
        let thresholds = RedThresholds::Bytes { min: 5000, max: 15_000 };
        let parameters = Parameters { thresholds, ..Parameters::default() };
        let drops = |bytes| gaps(&verdicts(steady(10_000.0, parameters), bytes)).len() as f64;
        let ratio = drops(FULL_FRAME) / drops(FULL_FRAME / 4);
        assert!((ratio - 4.0).abs() < 0.5, "{ratio}");
        let mut red = red(Parameters { weight: p(0.5), ..parameters });
        red.idle_since = None;
        red.observe(ms(1.0), 3000);
        assert_eq!(red.average, 1500.0);
    }

    #[test]
    fn capable_packets_are_marked_below_the_upper_threshold() {
        let ecn = Parameters { ecn: true, ..Parameters::default() };
        let of = |average, parameters| {
            let all = verdicts(steady(average, parameters), 1000);
            [Verdict::Mark, Verdict::Drop].map(|of| all.contains(&of))
        };
        assert_eq!(of(10.0, ecn), [true, false]);
        assert_eq!(of(16.0, ecn), [false, true]);
        assert_eq!(of(10.0, Parameters::default()), [false, true]);
    }
}
