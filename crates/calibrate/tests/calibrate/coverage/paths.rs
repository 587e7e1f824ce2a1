//! Times of packets whose jitter and losses depend on those before.

use std::collections::BTreeSet;

use cotorra_calibrate::{PacketTimes, fit_path};
use cotorra_graph::JitterDistribution;
use cotorra_numbers::Draws;

use super::{Coverage, between, sites};

/// Packets of a site.
const PACKETS: usize = 1000;

/// The values that a fit should find.
#[derive(Debug, Clone, Copy)]
pub struct Truth {
    pub distribution: JitterDistribution,
    pub mean_ms: f64,
    pub deviation_ms: f64,
    /// Correlation of the normal scores.
    correlation: f64,
    pub loss: f64,
    mean_burst: f64,
}

impl Truth {
    pub fn draw(draws: &mut Draws) -> Self {
        let all = [JitterDistribution::Normal, JitterDistribution::Uniform, JitterDistribution::Pareto];
        Self {
            distribution: all[draws.below(3)],
            mean_ms: between(draws, [20.0, 60.0]),
            deviation_ms: between(draws, [0.5, 4.0]),
            correlation: between(draws, [0.0, 0.5]),
            loss: between(draws, [0.01, 0.1]),
            mean_burst: between(draws, [1.5, 4.0]),
        }
    }
}

/// The normal distribution function, by the integral of its density (Simpson's rule).
fn normal_share(x: f64) -> f64 {
    const STEPS: usize = 64;
    let density = |t: f64| (-0.5 * t * t).exp() / std::f64::consts::TAU.sqrt();
    let step = x / STEPS as f64;
    let weight = |i: usize| if i == 0 || i == STEPS { 1.0 } else { 2.0 + 2.0 * (i % 2) as f64 };
    0.5 + step / 3.0 * (0..=STEPS).map(|i| weight(i) * density(step * i as f64)).sum::<f64>()
}

/// Times of packets at a site. Jitter is an autoregression of first order with the marginal distribution of the site (a Gaussian
/// copula); losses are Gilbert's.
pub fn packet_times(truth: Truth, draws: &mut Draws) -> PacketTimes {
    let (mut state, mut lost) = (draws.normal(), draws.unit() < truth.loss);
    let leaves = 1.0 / truth.mean_burst;
    let enters = leaves * truth.loss / (1.0 - truth.loss);
    let innovation = (1.0 - truth.correlation.powi(2)).sqrt();
    let mut packet = || {
        state = truth.correlation * state + innovation * draws.normal();
        lost ^= draws.unit() < if lost { leaves } else { enters };
        let jitter = match truth.distribution {
            JitterDistribution::Normal => state,
            JitterDistribution::Uniform => 2.0 * normal_share(state) - 1.0,
            JitterDistribution::Pareto => (normal_share(-state).powf(-1.0 / 3.0) - 1.5) / 0.75f64.sqrt(),
        };
        (!lost).then_some(truth.mean_ms + truth.deviation_ms * jitter)
    };
    let times_ms = (0..PACKETS).map(|_| packet()).collect();
    PacketTimes {
        times_ms,
        duplicated: BTreeSet::new(),
        late: 0,
        counts_losses: true,
        interval: None,
        frame_bytes: [98; 2],
        notes: Vec::new(),
    }
}

#[test]
fn path_intervals_hold_the_true_values() {
    let mut coverage = Coverage::default();
    let mut found = 0;
    for seed in 0..sites() as u64 {
        let mut draws = Draws::new(seed, "path");
        let truth = Truth::draw(&mut draws);
        let fit = fit_path(&packet_times(truth, &mut draws), seed).unwrap();
        found += usize::from(fit.distribution == truth.distribution);
        coverage.count("mean", fit.mean_ms, truth.mean_ms);
        coverage.count("jitter", fit.deviation_ms, truth.deviation_ms);
        coverage.count("correlation", fit.correlation, truth.distribution.correlation(truth.correlation));
        let loss = fit.loss.unwrap();
        coverage.count("loss", loss.share, truth.loss);
        if let Some(burst) = loss.mean_burst {
            coverage.count("burst", burst, truth.mean_burst);
        }
    }
    assert!(found * 100 >= sites() * 98, "{found} of {} distributions", sites());
    coverage.check();
}
