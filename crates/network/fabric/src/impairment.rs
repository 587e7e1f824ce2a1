//! Random impairments of packets on wired and wireless links: loss, corruption, duplication, jitter and reordering. Each
//! link draws them from its own stream of random numbers.

use std::{f64::consts::FRAC_1_SQRT_2, time::Duration};

use cotorra_graph::{Conditions, Jitter, JitterDistribution, Loss, Probability, Timestamp};
use cotorra_numbers::Draws;

use crate::frame::Frame;

/// The random impairments of one direction of a link.
#[derive(Debug, Clone)]
pub(crate) struct Impairments {
    rng: Draws,
    loss: LossProcess,
    corruption: Probability,
    duplication: Probability,
    reordering: Probability,
    jitter: Option<Jitter>,
    /// Correlation of the normal scores of successive jitters.
    score_correlation: f64,
    /// Normal score of the last jitter that had a correlation.
    score: Option<f64>,
    /// Jitter as a process in time, with the time of its last score.
    process: Option<(Timestamp, Process)>,
}

/// A normal score and its rate of change, in units of its stationary deviation: the stationary solution of a critically damped
/// oscillator that white noise drives.
///
/// Scores at times t apart have the correlation (1 + t/θ)·exp(-t/θ), that of Matérn with smoothness 3/2 (Rasmussen and
/// Williams, Gaussian processes for machine learning, 2006, section 4.2.1); its integral over t is 2θ. Score and rate
/// together are Markov, so that the law at some times does not depend on which others are asked for. A path has a slope, unlike
/// that of an Ornstein-Uhlenbeck process: a queue's delay falls no faster than time passes, and a rough path would let
/// packets wait for those before them, more often with more packets.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Process {
    score: f64,
    rate: f64,
}

impl Process {
    /// Draws the stationary state.
    fn new(rng: &mut Draws) -> Self {
        Self { score: rng.normal(), rate: rng.normal() }
    }

    /// Moves on by `x` times θ.
    fn advance(&mut self, x: f64, rng: &mut Draws) {
        let Self { score, rate } = *self;
        let decay = (-x).exp();
        // The stationary covariance is the identity; what the decay leaves of it is missing in the noise.
        let missing = 1.0 - decay * decay * (1.0 - 2.0 * x + 2.0 * x * x);
        if missing <= 0.0 {
            return;
        }
        let common = 2.0 * x * x * decay * decay / missing.sqrt();
        let own = 1.0 - decay * decay * (1.0 + 2.0 * x + 2.0 * x * x) - common * common;
        let noise = rng.normal();
        self.rate = decay * ((1.0 - x) * rate - x * score) + missing.sqrt() * noise;
        self.score =
            decay * ((1.0 + x) * score + x * rate) + common * noise + own.max(0.0).sqrt() * rng.normal();
    }
}

/// The random process of losses.
#[derive(Debug, Clone, Copy, PartialEq)]
enum LossProcess {
    None,
    Independent {
        rate: Probability,
    },
    /// Gilbert's simple form of the Gilbert-Elliott model (Gilbert 1960): two states, of which the bad one loses every
    /// packet.
    Bursty {
        good_to_bad: f64,
        bad_to_good: f64,
        bad: bool,
    },
}

impl Impairments {
    /// Creates the impairments of these conditions.
    pub(crate) fn new(conditions: &Conditions, mut rng: Draws) -> Self {
        Self {
            loss: LossProcess::new(conditions.loss, &mut rng),
            rng,
            corruption: conditions.corruption,
            duplication: conditions.duplication,
            reordering: conditions.reordering,
            jitter: conditions.jitter,
            score_correlation: score_correlation(conditions),
            score: None,
            process: None,
        }
    }

    /// Changes the conditions. A current burst of losses continues, and the next jitter follows the last one.
    pub(crate) fn change(&mut self, conditions: &Conditions) {
        let mut loss = LossProcess::new(conditions.loss, &mut self.rng);
        if let (LossProcess::Bursty { bad, .. }, LossProcess::Bursty { bad: now, .. }) =
            (&mut loss, self.loss)
        {
            *bad = now;
        }
        self.loss = loss;
        self.corruption = conditions.corruption;
        self.duplication = conditions.duplication;
        self.reordering = conditions.reordering;
        self.jitter = conditions.jitter;
        self.score_correlation = score_correlation(conditions);
    }

    /// Whether the next packet is lost.
    pub(crate) fn loses(&mut self) -> bool {
        match &mut self.loss {
            LossProcess::None => false,
            LossProcess::Independent { rate } => happens(&mut self.rng, *rate),
            LossProcess::Bursty { good_to_bad, bad_to_good, bad } => {
                let leaves = if *bad { *bad_to_good } else { *good_to_bad };
                *bad ^= self.rng.unit() < leaves;
                *bad
            }
        }
    }

    /// Flips a bit of the packet at random. Returns whether it did.
    pub(crate) fn corrupts(&mut self, frame: &mut Frame) -> bool {
        happens(&mut self.rng, self.corruption) && frame.flip_bit(self.rng.bits())
    }

    /// Whether the packet arrives twice.
    pub(crate) fn duplicates(&mut self) -> bool {
        happens(&mut self.rng, self.duplication)
    }

    /// Whether the packet skips the delay and overtakes those before it.
    pub(crate) fn reorders(&mut self) -> bool {
        happens(&mut self.rng, self.reordering)
    }

    /// Returns the deviation of the delay of a packet that is sent at this time, in units of the jitter's deviation; 0 without
    /// jitter.
    pub(crate) fn deviate(&mut self, sent: Timestamp) -> f64 {
        let Some(jitter) = self.jitter else { return 0.0 };
        if let Some(over) = jitter.over {
            return of_score(jitter.distribution, self.score_at(sent, over.get()));
        }
        if !jitter.correlation.is_none() {
            return of_score(jitter.distribution, self.next_score());
        }
        match jitter.distribution {
            JitterDistribution::Uniform => 2.0 * self.rng.unit() - 1.0,
            JitterDistribution::Normal => self.rng.normal(),
            JitterDistribution::Pareto => pareto(1.0 - self.rng.unit()),
        }
    }

    /// Returns the normal score of jitter at a time; that of the last time for one before it.
    fn score_at(&mut self, now: Timestamp, over: Duration) -> f64 {
        let rng = &mut self.rng;
        let (at, process) = self.process.get_or_insert_with(|| (now, Process::new(rng)));
        // The correlation's integral over time is 2θ.
        process.advance(now.since(*at).as_secs_f64() / over.as_secs_f64() * 2.0, rng);
        *at = now.max(*at);
        process.score
    }

    /// Returns the normal score of the next jitter: an autoregression of first order in its stationary state.
    fn next_score(&mut self) -> f64 {
        let innovation = self.rng.normal();
        let correlation = self.score_correlation;
        let follow = |last| correlation * last + (1.0 - correlation * correlation).sqrt() * innovation;
        *self.score.insert(self.score.map_or(innovation, follow))
    }
}

impl LossProcess {
    /// Creates a process in its stationary state.
    fn new(loss: Loss, rng: &mut Draws) -> Self {
        match loss {
            Loss::None => Self::None,
            Loss::Independent { rate } => Self::Independent { rate },
            Loss::Bursty { rate, mean_burst } => {
                let bad_to_good = 1.0 / mean_burst;
                let good_to_bad = bad_to_good * rate.get() / (1.0 - rate.get());
                Self::Bursty { good_to_bad, bad_to_good, bad: happens(rng, rate) }
            }
        }
    }
}

/// Whether an event of probability `p` happens. Probabilities 0 and 1 take no random number.
fn happens(rng: &mut Draws, p: Probability) -> bool {
    p != Probability::ZERO && (p == Probability::ONE || rng.unit() < p.get())
}

fn score_correlation(conditions: &Conditions) -> f64 {
    conditions.jitter.map_or(0.0, |jitter| jitter.score_correlation())
}

/// Returns the quantile of a jitter at the probability of a normal score, in units of the jitter's deviation.
fn of_score(distribution: JitterDistribution, score: f64) -> f64 {
    match distribution {
        JitterDistribution::Uniform => libm::erf(score * FRAC_1_SQRT_2),
        JitterDistribution::Normal => score,
        JitterDistribution::Pareto => pareto(libm::erfc(score * FRAC_1_SQRT_2) / 2.0),
    }
}

/// Returns the value that a Pareto distribution with shape 3 exceeds with probability `u` in (0, 1]. The distribution is
/// moved and scaled to mean 0 and standard deviation 1.
fn pareto(u: f64) -> f64 {
    // With scale 1: mean 3/2, variance 3/4 (for shape α: α/(α-1) and α/((α-1)²(α-2))).
    (1.0 / u.cbrt() - 1.5) / 0.75f64.sqrt()
}

/// Adds a deviation to a delay. The result is never negative.
pub(crate) fn jittered(delay: Duration, deviate: f64, jitter: Option<Jitter>) -> Duration {
    let Some(jitter) = jitter else { return delay };
    let extra = deviate * jitter.deviation.as_nanos() as f64;
    Duration::from_nanos((delay.as_nanos() as f64 + extra).round() as u64)
}

#[cfg(test)]
mod tests {
    use cotorra_graph::{Correlation, CorrelationTime};

    use super::*;

    const PACKETS: usize = 1_000_000;

    fn impairments(conditions: &Conditions) -> Impairments {
        Impairments::new(conditions, Draws::new(7, "impairment"))
    }

    fn p(p: f64) -> Probability {
        Probability::new(p).unwrap()
    }

    fn losses(loss: Loss) -> Vec<bool> {
        let mut impairments = impairments(&Conditions { loss, ..Conditions::default() });
        (0..PACKETS).map(|_| impairments.loses()).collect()
    }

    /// Returns the lengths of the runs of lost packets.
    fn bursts(lost: &[bool]) -> Vec<usize> {
        lost.chunk_by(|a, b| a == b).filter(|run| run[0]).map(<[bool]>::len).collect()
    }

    fn share(lost: &[bool]) -> f64 {
        lost.iter().filter(|lost| **lost).count() as f64 / lost.len() as f64
    }

    #[test]
    fn independent_loss_is_within_its_binomial_interval() {
        for rate in [0.0001, 0.01, 0.05, 0.5, 0.9] {
            let lost = share(&losses(Loss::Independent { rate: p(rate) }));
            // Two-sided, 99 %.
            let bound = 2.576 * (rate * (1.0 - rate) / PACKETS as f64).sqrt();
            assert!((lost - rate).abs() <= bound, "{lost} for {rate} ± {bound}");
        }
    }

    #[test]
    fn never_and_always_are_exact() {
        assert_eq!(share(&losses(Loss::None)), 0.0);
        assert_eq!(share(&losses(Loss::Independent { rate: Probability::ZERO })), 0.0);
        assert_eq!(share(&losses(Loss::Independent { rate: Probability::ONE })), 1.0);
        assert_eq!(share(&losses(Loss::Bursty { rate: Probability::ZERO, mean_burst: 4.0 })), 0.0);
    }

    #[test]
    fn bursts_have_the_requested_share_and_mean_length() {
        for (rate, mean_burst) in [(0.01, 4.0), (0.001, 1.0), (0.1, 20.0), (0.5, 3.0)] {
            let lost = losses(Loss::Bursty { rate: p(rate), mean_burst });
            // Consecutive states have correlation 1 - p - r, which widens the interval of the share.
            let leave = 1.0 / mean_burst;
            let correlation = 1.0 - leave - leave * rate / (1.0 - rate);
            let widened = (1.0 + correlation) / (1.0 - correlation);
            let bound = 2.576 * (rate * (1.0 - rate) * widened / PACKETS as f64).sqrt();
            assert!((share(&lost) - rate).abs() <= bound, "{} for {rate} ± {bound}", share(&lost));
            let bursts = bursts(&lost);
            let mean = bursts.iter().sum::<usize>() as f64 / bursts.len() as f64;
            // Lengths are geometric, with variance (1 - r)/r².
            let bound = 2.576 * ((1.0 - leave).sqrt() / leave) / (bursts.len() as f64).sqrt() + 1e-9;
            assert!((mean - mean_burst).abs() <= bound, "{mean} for {mean_burst} ± {bound}");
        }
    }

    #[test]
    fn unchanged_conditions_leave_a_burst_as_it_is() {
        let conditions =
            Conditions { loss: Loss::Bursty { rate: p(0.5), mean_burst: 1e9 }, ..Conditions::default() };
        let mut impairments = impairments(&conditions);
        let state = impairments.loses();
        for _ in 0..1000 {
            impairments.change(&conditions);
            assert_eq!(impairments.loses(), state);
        }
    }

    /// Share of bursts of 1, 2, 3, 4 and 5 packets: (1 - r)^(k - 1)·r.
    #[test]
    fn burst_lengths_match_the_golden_table() {
        let mut table = String::new();
        for mean_burst in [1.5, 3.0, 8.0] {
            let bursts = bursts(&losses(Loss::Bursty { rate: p(0.05), mean_burst }));
            let of = |k| bursts.iter().filter(|b| **b == k).count() as f64 / bursts.len() as f64;
            let row: Vec<_> = (1..=5).map(|k| format!("{:.3}", of(k))).collect();
            table += &format!("{mean_burst}: {}\n", row.join(" "));
        }
        assert_eq!(table, GOLDEN_BURSTS);
        for (row, mean_burst) in GOLDEN_BURSTS.lines().zip([1.5f64, 3.0, 8.0]) {
            for (k, got) in row.split(' ').skip(1).enumerate() {
                let leave = 1.0 / mean_burst;
                let expected = (1.0 - leave).powi(k as i32) * leave;
                assert!((got.parse::<f64>().unwrap() - expected).abs() < 0.01);
            }
        }
    }

    const GOLDEN_BURSTS: &str = "\
1.5: 0.665 0.223 0.076 0.024 0.008
3: 0.331 0.223 0.150 0.102 0.064
8: 0.125 0.116 0.089 0.083 0.070
";

    const DISTRIBUTIONS: [JitterDistribution; 3] =
        [JitterDistribution::Uniform, JitterDistribution::Normal, JitterDistribution::Pareto];

    const DEVIATES: usize = 200_000;

    /// Returns the deviates of successive packets.
    fn series(distribution: JitterDistribution, correlation: f64) -> Vec<f64> {
        let correlation = Correlation::new(correlation).unwrap();
        let jitter =
            Some(Jitter { deviation: Duration::from_millis(1), distribution, correlation, over: None });
        let mut impairments = impairments(&Conditions { jitter, ..Conditions::default() });
        (0..DEVIATES).map(|_| impairments.deviate(Timestamp::ZERO)).collect()
    }

    /// Returns deviates, rising.
    fn deviates(distribution: JitterDistribution, correlation: f64) -> Vec<f64> {
        let mut deviates = series(distribution, correlation);
        deviates.sort_by(f64::total_cmp);
        deviates
    }

    #[test]
    fn jitter_has_mean_zero_and_the_requested_deviation() {
        for (distribution, deviation, tolerance) in DISTRIBUTIONS
            .into_iter()
            // The variance of a Pareto distribution with shape 3 converges slowly: its fourth moment is infinite.
            .zip([(1.0 / 3f64.sqrt(), 0.005), (1.0, 0.005), (1.0, 0.1)])
            .map(|(d, (s, t))| (d, s, t))
        {
            let deviates = deviates(distribution, 0.0);
            let mean = deviates.iter().sum::<f64>() / DEVIATES as f64;
            let variance = deviates.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / DEVIATES as f64;
            assert!(mean.abs() < 0.01, "{distribution:?}: {mean}");
            assert!((variance.sqrt() / deviation - 1.0).abs() < tolerance, "{distribution:?}: {variance}");
        }
    }

    /// Quantiles at 1, 5, 25, 50, 75, 95 and 99 %, in deviations.
    #[test]
    fn jitter_quantiles_match_the_golden_table() {
        let quantiles = [0.01f64, 0.05, 0.25, 0.5, 0.75, 0.95, 0.99];
        // Normal: Φ⁻¹(q). Pareto: (1 - q)^(-1/3) less its mean 3/2, over its deviation √3/2.
        let normal = [-2.326, -1.645, -0.674, 0.0, 0.674, 1.645, 2.326];
        let expected = |row: usize, i: usize| match row {
            0 => 2.0 * quantiles[i] - 1.0,
            1 => normal[i],
            _ => ((1.0 - quantiles[i]).powf(-1.0 / 3.0) - 1.5) / 0.75f64.sqrt(),
        };
        // With correlation, as many packets say less.
        for (correlation, golden, tolerance) in [(0.0, GOLDEN_JITTER, 0.03), (0.6, GOLDEN_CORRELATED, 0.1)] {
            let mut table = String::new();
            for distribution in DISTRIBUTIONS {
                let deviates = deviates(distribution, correlation);
                let row: Vec<_> =
                    quantiles.map(|q| format!("{:.2}", deviates[(q * DEVIATES as f64) as usize])).into();
                table += &format!("{distribution:?}: {}\n", row.join(" "));
            }
            assert_eq!(table, golden);
            for (r, row) in golden.lines().enumerate() {
                for (i, got) in row.split(' ').skip(1).enumerate() {
                    assert!((got.parse::<f64>().unwrap() - expected(r, i)).abs() < tolerance, "{row}");
                }
            }
        }
    }

    const GOLDEN_JITTER: &str = "\
Uniform: -0.98 -0.90 -0.50 -0.00 0.50 0.90 0.98
Normal: -2.32 -1.63 -0.67 0.00 0.68 1.65 2.34
Pareto: -0.57 -0.56 -0.46 -0.28 0.10 1.41 3.61
";

    const GOLDEN_CORRELATED: &str = "\
Uniform: -0.98 -0.90 -0.50 0.00 0.50 0.90 0.98
Normal: -2.30 -1.63 -0.67 0.01 0.68 1.65 2.35
Pareto: -0.57 -0.56 -0.46 -0.27 0.11 1.44 3.70
";

    /// Correlation of values so many packets apart.
    fn autocorrelation(series: &[f64], lag: usize) -> f64 {
        let mean = series.iter().sum::<f64>() / series.len() as f64;
        let pairs = series.iter().zip(&series[lag..]);
        let covariance = pairs.map(|(a, b)| (a - mean) * (b - mean)).sum::<f64>();
        covariance / series.iter().map(|d| (d - mean).powi(2)).sum::<f64>()
    }

    #[test]
    fn successive_jitters_have_the_requested_correlation() {
        for distribution in DISTRIBUTIONS {
            // The fourth moment of a Pareto distribution with shape 3 is infinite.
            let tolerance = if distribution == JitterDistribution::Pareto { 0.04 } else { 0.01 };
            for asked in [-0.2, 0.3, 0.9] {
                let series = series(distribution, asked);
                let got = autocorrelation(&series, 1);
                assert!((got - asked).abs() < tolerance, "{distribution:?}: {got} for {asked}");
                // The scores are an autoregression of first order.
                let of_scores = distribution.score_correlation(Correlation::new(asked).unwrap());
                let expected = distribution.correlation(of_scores.powi(2));
                let got = autocorrelation(&series, 2);
                assert!((got - expected).abs() < tolerance, "{distribution:?}: {got} for {expected}");
            }
            let got = autocorrelation(&series(distribution, 0.0), 1);
            assert!(got.abs() < 0.01, "{distribution:?}: {got}");
        }
    }

    /// Deviates at these times, ms, of a jitter that changes over 50 ms.
    fn over_time(distribution: JitterDistribution, times: impl Iterator<Item = f64>) -> Vec<f64> {
        let over = CorrelationTime::new(Duration::from_millis(50));
        let jitter =
            Some(Jitter { deviation: Duration::from_millis(1), distribution, over, ..Jitter::default() });
        let mut impairments = impairments(&Conditions { jitter, ..Conditions::default() });
        times.map(|ms| impairments.deviate(Timestamp::from_secs_f64(ms / 1e3))).collect()
    }

    #[test]
    fn jitter_over_time_keeps_its_distribution() {
        const TIMES: usize = 20_000;
        for distribution in DISTRIBUTIONS {
            // Single packets half a second apart, with others close before them.
            let times = (0..TIMES * 4).map(|i| 500.0 * (i / 4) as f64 + [0.0, 0.02, 3.0, 11.0][i % 4]);
            let mut deviates: Vec<_> =
                over_time(distribution, times).into_iter().skip(3).step_by(4).collect();
            deviates.sort_by(f64::total_cmp);
            let probability = |deviate: f64| match distribution {
                JitterDistribution::Uniform => (deviate + 1.0) / 2.0,
                JitterDistribution::Normal => libm::erfc(-deviate * FRAC_1_SQRT_2) / 2.0,
                JitterDistribution::Pareto => 1.0 - (deviate * 0.75f64.sqrt() + 1.5).powi(-3),
            };
            let off = |(i, deviate): (usize, &f64)| {
                let p = probability(*deviate);
                (p - i as f64 / TIMES as f64).max((i + 1) as f64 / TIMES as f64 - p)
            };
            let distance = deviates.iter().enumerate().map(off).fold(0.0, f64::max);
            // Kolmogorov and Smirnov's bound at 1 %.
            let bound = 1.628 / (TIMES as f64).sqrt();
            assert!(distance < bound, "{distribution:?}: {distance} of {bound}");
        }
    }

    #[test]
    fn jitter_over_time_has_its_correlation_however_many_packets_there_are() {
        for distribution in DISTRIBUTIONS {
            // The fourth moment of a Pareto distribution with shape 3 is infinite.
            let tolerance = if distribution == JitterDistribution::Pareto { 0.06 } else { 0.02 };
            for packets in [1, 10] {
                let step = 10.0 / packets as f64;
                let times = (0..DEVIATES * packets).map(|i| step * i as f64);
                let series: Vec<_> = over_time(distribution, times).into_iter().step_by(packets).collect();
                for lag in [1, 3, 5, 10] {
                    let x = 10.0 * lag as f64 / 25.0;
                    let expected = distribution.correlation((1.0 + x) * (-x).exp());
                    let got = autocorrelation(&series, lag);
                    let of = format!("{distribution:?}, {packets} packets, lag {lag}");
                    assert!((got - expected).abs() < tolerance, "{of}: {got} for {expected}");
                }
            }
        }
    }

    #[test]
    fn packets_of_one_time_have_one_jitter() {
        let deviates = over_time(JitterDistribution::Pareto, [7.0, 7.0, 7.0, 8.0, 7.0].into_iter());
        assert_eq!([deviates[1], deviates[2]], [deviates[0]; 2]);
        assert_ne!(deviates[3], deviates[0]);
        assert_eq!(deviates[4], deviates[3], "time does not go back");
    }

    #[test]
    fn changed_conditions_leave_the_correlation_as_it_is() {
        let correlation = Correlation::new(0.999_999).unwrap();
        let jitter = |distribution| Jitter {
            deviation: Duration::from_millis(1),
            distribution,
            correlation,
            over: None,
        };
        let conditions =
            |distribution| Conditions { jitter: Some(jitter(distribution)), ..Conditions::default() };
        let mut impairments = impairments(&conditions(JitterDistribution::Normal));
        let score = impairments.deviate(Timestamp::ZERO);
        impairments.change(&conditions(JitterDistribution::Uniform));
        let followed = impairments.deviate(Timestamp::ZERO);
        assert!((followed - libm::erf(score * FRAC_1_SQRT_2)).abs() < 0.02, "{followed} after {score}");
    }

    #[test]
    fn a_jittered_delay_is_never_below_zero() {
        let jitter = Some(Jitter { deviation: Duration::from_millis(10), ..Jitter::default() });
        let delay = Duration::from_millis(4);
        assert_eq!(jittered(delay, -1.0, jitter), Duration::ZERO);
        assert_eq!(jittered(delay, 0.5, jitter), Duration::from_millis(9));
        assert_eq!(jittered(delay, 5.0, None), delay);
    }
}
