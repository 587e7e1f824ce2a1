//! Demands of an instance's requests.

use std::time::Duration;

use cotorra_graph::{Computing, Demand, MeasuredTimes, WarmUp};
use cotorra_numbers::{Distribution, Draws};

/// Standard normal deviate of the 95th percentile.
const NORMAL_P95: f64 = 1.644_853_626_951_472_2;
/// Longest demand of a request, seconds.
const LONGEST_S: f64 = 1e6;

/// Demands of an instance's requests, in order, from a seed.
#[derive(Debug, Clone)]
pub struct Demands {
    source: Source,
    per_kb: Duration,
    /// Requests that cost more, and by which factor.
    warm_up: Option<WarmUp>,
    drawn: u64,
    draws: Draws,
}

#[derive(Debug, Clone)]
enum Source {
    /// Seconds.
    Drawn(Distribution),
    Measured(MeasuredTimes),
}

impl Demands {
    /// Creates the demands of an instance. `label` names it: other labels give other demands. `None` if the distribution's
    /// parameters are no such parameters, which a testbed file's never are.
    pub fn new(computing: &Computing, seed: u64, label: &str) -> Option<Self> {
        let seconds = |time: &Duration| time.as_secs_f64();
        let source = match &computing.demand {
            Demand::Constant { time } => Source::Drawn(Distribution::constant(seconds(time))?),
            Demand::Exponential { mean } => Source::Drawn(Distribution::exponential(seconds(mean))?),
            Demand::Lognormal { median, p95 } => {
                let sigma = (seconds(p95) / seconds(median)).ln() / NORMAL_P95;
                let mean = seconds(median) * (0.5 * sigma * sigma).exp();
                Source::Drawn(Distribution::lognormal(mean, sigma)?)
            }
            Demand::Uniform { least, greatest } => {
                Source::Drawn(Distribution::uniform(seconds(least), seconds(greatest))?)
            }
            Demand::Samples { samples } => Source::Measured(samples.clone()),
        };
        let draws = Draws::new(seed, &format!("computing {label}"));
        Some(Self { source, per_kb: computing.per_kb, warm_up: computing.warm_up, drawn: 0, draws })
    }

    /// Returns the demand of the next request, which has so many bytes.
    pub fn next(&mut self, bytes: usize) -> Duration {
        let own = match &self.source {
            Source::Drawn(distribution) => distribution.sample(&mut self.draws),
            Source::Measured(samples) => {
                let times = samples.times();
                times[self.draws.below(times.len())].as_secs_f64()
            }
        };
        let by_size = self.per_kb.as_secs_f64() * bytes as f64 / 1000.0;
        let warm_up = self.warm_up.filter(|warm_up| self.drawn < u64::from(warm_up.requests));
        self.drawn += 1;
        let seconds = (own + by_size) * warm_up.map_or(1.0, |warm_up| warm_up.factor);
        Duration::from_nanos((seconds.clamp(0.0, LONGEST_S) * 1e9).round() as u64)
    }
}

#[cfg(test)]
mod tests {
    use cotorra_graph::Scheduling;

    use super::*;

    fn computing(demand: Demand) -> Computing {
        Computing {
            demand,
            per_kb: Duration::ZERO,
            scheduling: Scheduling::default(),
            backlog: Computing::BACKLOG,
            warm_up: None,
        }
    }

    fn ms(ms: f64) -> Duration {
        Duration::from_nanos((ms * 1e6) as u64)
    }

    fn drawn(computing: &Computing, label: &str, count: usize) -> Vec<f64> {
        let mut demands = Demands::new(computing, 7, label).unwrap();
        (0..count).map(|_| demands.next(500).as_secs_f64() * 1e3).collect()
    }

    #[test]
    fn demands_have_the_quantiles_of_their_distribution() {
        let samples = MeasuredTimes::new(vec![ms(1.0), ms(2.0), ms(6.0)]).unwrap();
        for (demand, mean, p95) in [
            (Demand::Constant { time: ms(3.0) }, 3.0, 3.0),
            (Demand::Exponential { mean: ms(3.0) }, 3.0, 3.0 * 20_f64.ln()),
            (Demand::Lognormal { median: ms(3.0), p95: ms(8.0) }, 3.583, 8.0),
            (Demand::Uniform { least: ms(1.0), greatest: ms(4.0) }, 2.5, 3.85),
            (Demand::Samples { samples }, 3.0, 6.0),
        ] {
            let mut all = drawn(&computing(demand.clone()), "a", 40_000);
            all.sort_by(f64::total_cmp);
            let found = all.iter().sum::<f64>() / all.len() as f64;
            assert!((found / mean - 1.0).abs() < 0.02, "{demand:?}: {found}");
            let found = cotorra_numbers::quantile(&all, 0.95).unwrap();
            assert!((found / p95 - 1.0).abs() < 0.03, "{demand:?}: {found}");
        }
    }

    #[test]
    fn first_requests_and_large_ones_cost_more() {
        let warm_up = Some(WarmUp { requests: 2, factor: 3.0 });
        let computing =
            Computing { per_kb: ms(2.0), warm_up, ..computing(Demand::Constant { time: ms(3.0) }) };
        assert_eq!(drawn(&computing, "a", 4), [12.0, 12.0, 4.0, 4.0]);
    }

    #[test]
    fn instances_have_demands_of_their_own_which_repeat() {
        let computing = computing(Demand::Exponential { mean: ms(3.0) });
        assert_eq!(drawn(&computing, "a", 9), drawn(&computing, "a", 9));
        assert_ne!(drawn(&computing, "a", 9), drawn(&computing, "b", 9));
    }

    #[test]
    fn impossible_parameters_are_rejected() {
        for demand in [
            Demand::Exponential { mean: Duration::ZERO },
            Demand::Lognormal { median: ms(3.0), p95: ms(2.0) },
            Demand::Uniform { least: ms(3.0), greatest: ms(2.0) },
        ] {
            assert!(Demands::new(&computing(demand.clone()), 1, "a").is_none(), "{demand:?}");
        }
    }
}
