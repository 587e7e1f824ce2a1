//! When what repeats on a robot is due.

use std::time::Duration;

use cotorra_graph::{Phase, RobotClock, Timestamp};
use cotorra_numbers::{Distribution, Draws};

/// Returns when something of this interval is due first, and how long it takes from one time to the next by its clock.
pub(crate) fn beat(clock: &RobotClock, interval: Duration, mut draws: Draws) -> (Timestamp, Duration) {
    let (phase, error) = (draws.unit(), 2.0 * draws.unit() - 1.0);
    let first = match clock.phase {
        Phase::Random => interval.mul_f64(phase),
        Phase::Aligned => Duration::ZERO,
    };
    (Timestamp::ZERO + first, interval.mul_f64(1.0 + clock.drift_ppm * 1e-6 * error))
}

/// Times at which packets of a robot are due: at equal intervals of its clock, or at random ones.
#[derive(Debug, Clone)]
pub(crate) struct Beat {
    next: Timestamp,
    gaps: Gaps,
}

/// Times from one packet to the next.
#[derive(Debug, Clone)]
enum Gaps {
    Equal(Duration),
    /// Seconds, at least [`Beat::LEAST_GAP`], and the time behind the next packet.
    Random(Distribution, Box<Draws>, Duration),
}

impl Beat {
    /// Shortest time from one packet to the next.
    pub const LEAST_GAP: Duration = Duration::from_millis(1);

    /// Creates packets at this interval. `label` names their random stream.
    pub fn equal(clock: &RobotClock, interval: Duration, seed: u64, label: &str) -> Self {
        let (next, interval) = beat(clock, interval.max(Self::LEAST_GAP), Draws::new(seed, label));
        Self { next, gaps: Gaps::Equal(interval) }
    }

    /// Creates packets with gaps of this distribution, in seconds, the first one behind such a gap.
    pub fn random(distribution: Distribution, seed: u64, label: &str) -> Self {
        let mut draws = Draws::new(seed, label);
        let first = draw(&distribution, &mut draws);
        let gap = draw(&distribution, &mut draws);
        Self { next: Timestamp::ZERO + first, gaps: Gaps::Random(distribution, Box::new(draws), gap) }
    }

    /// Returns when the next packet is due.
    pub fn next(&self) -> Timestamp {
        self.next
    }

    /// Passes the next packet.
    pub fn step(&mut self) {
        self.next = self.following();
        if let Gaps::Random(distribution, draws, gap) = &mut self.gaps {
            *gap = draw(distribution, draws);
        }
    }

    /// Passes all packets before the last one that is due at `now`. Gives `passed` their times.
    pub fn catch_up(&mut self, now: Timestamp, mut passed: impl FnMut(Timestamp)) {
        while self.following() <= now {
            passed(self.next);
            self.step();
        }
    }

    /// Returns when the packet behind the next one is due.
    fn following(&self) -> Timestamp {
        let (Gaps::Equal(gap) | Gaps::Random(_, _, gap)) = &self.gaps;
        self.next + *gap
    }
}

fn draw(distribution: &Distribution, draws: &mut Draws) -> Duration {
    Duration::from_secs_f64(distribution.sample(draws)).max(Beat::LEAST_GAP)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(ms: u64) -> Timestamp {
        Timestamp::from_nanos(ms * 1_000_000)
    }

    #[test]
    fn catching_up_stops_at_the_last_packet_that_is_due() {
        let clock = RobotClock { phase: Phase::Aligned, drift_ppm: 0.0 };
        let mut beat = Beat::equal(&clock, Duration::from_millis(50), 1, "r/phase");
        let mut passed = Vec::new();
        beat.catch_up(at(149), |due| passed.push(due));
        assert_eq!((passed, beat.next()), (vec![at(0), at(50)], at(100)));
        beat.catch_up(at(149), |_| panic!("none is left"));
        beat.step();
        assert_eq!(beat.next(), at(150));
    }

    #[test]
    fn random_packets_are_a_poisson_process_and_catch_up_as_others() {
        let exponential = Distribution::exponential(0.05).unwrap();
        let times = |seed: u64| {
            let mut beat = Beat::random(exponential, seed, "r/arrivals");
            let mut times = Vec::new();
            beat.catch_up(at(1_000_000), |due| times.push(due));
            times
        };
        let all = times(7);
        // Counts in windows of one second are Poisson: mean and variance are 20, less what the shortest gap takes.
        let mut counts = vec![0.0; 1000];
        all.iter().for_each(|due| counts[(due.as_nanos() / 1_000_000_000) as usize] += 1.0);
        let mean = counts.iter().sum::<f64>() / 1000.0;
        let variance = counts.iter().map(|count| (count - mean) * (count - mean)).sum::<f64>() / 999.0;
        assert!((mean - 20.0).abs() < 3.0 * (20.0_f64 / 1000.0).sqrt(), "{mean}");
        assert!((variance / mean - 1.0).abs() < 3.0 * (2.0_f64 / 999.0).sqrt(), "{variance}");
        assert!(all.windows(2).all(|pair| pair[1].since(pair[0]) >= Beat::LEAST_GAP));
        assert_eq!(all, times(7));
        assert_ne!(all, times(8));
    }
}
