//! Small-scale fading, fitted to signals of single frames at places near each other.

use cotorra_graph::Testbed;
use cotorra_numbers::{Draws, Resampler};
use serde::Serialize;

use super::{Reading, SurveyFit, likelihood::Sample, radio_unit, sample};
use crate::{error::CalibrateError, estimate::Estimate, matched::RESAMPLES};

/// Fewest pairs of readings.
const LEAST_PAIRS: usize = 100;
/// Readings of a pair are at most so far apart, metres, so that shadowing and path loss are nearly the same.
const FARTHEST_M: f64 = 0.5;
/// Bounds of the K-factor, dB. Below, fading is as good as Rayleigh; above, it is as good as none.
const BOUNDS_DB: [f64; 2] = [-20.0, 20.0];
/// Metres that light travels in a microsecond.
const METRES_PER_US: f64 = 299.792_458;

/// The fading of a wireless network, fitted to a survey whose readings are of single frames.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FadingFit {
    /// Number of pairs of readings that are near each other.
    pub pairs: usize,
    /// Standard deviation of single frames around the local mean, dB.
    pub deviation_db: Estimate,
    /// Power of the line of sight over that of all other paths, dB. At -20 dB, fading is Rayleigh's.
    pub k_factor_db: Estimate,
    /// Mean of signals in dB, less the mean power in dB. Fading has a mean power of 1, so that the reference loss changes by it.
    pub mean_db: f64,
}

impl FadingFit {
    /// Whether there is no line of sight.
    pub fn is_rayleigh(&self) -> bool {
        self.k_factor_db.value <= BOUNDS_DB[0]
    }
}

/// Fits the fading of a network. The seed decides resamples.
///
/// Half of the mean squared difference of two readings, one to a few wavelengths apart, is the variance of single frames, with
/// rounding and what shadowing changes over that distance. That of a Rician signal falls with its K-factor.
///
/// # Errors
/// [`CalibrateError::TooLittle`] with few pairs, or if the deviation is too small, and [`CalibrateError::Unsuited`] if it
/// is larger than that of Rayleigh fading.
pub fn fit_fading(
    testbed: &Testbed,
    network: &str,
    fit: &SurveyFit,
    readings: &[Reading],
    seed: u64,
) -> Result<FadingFit, CalibrateError> {
    let pairs = pairs(testbed, network, fit, readings)?;
    if pairs.len() < LEAST_PAIRS {
        return Err(CalibrateError::too_little(format!(
            "network `{network}` has {} pairs of readings of one radio unit, one after another, from a wavelength to {FARTHEST_M} m \
             apart: fading needs {LEAST_PAIRS} or more",
            pairs.len()
        )));
    }
    let draws = &mut Draws::new(seed, &format!("calibrate fading {network}"));
    let rounding = rounding(readings).powi(2) / 12.0;
    let variance = |sum: f64| (sum / pairs.len() as f64 - rounding).max(0.0);
    let differences: Vec<f64> = pairs.iter().map(|[difference, _]| *difference).collect();
    let resampler = Resampler::new(&differences);
    let mut drawn: Vec<f64> = (0..RESAMPLES)
        .map(|_| {
            let mut sum = 0.0;
            let roughness = fit.middle.draw_roughness(draws);
            resampler.resample(draws, |i| sum += pairs[i][0] - roughness * pairs[i][1]);
            variance(sum).sqrt()
        })
        .collect();
    let drawn = Estimate::around(
        variance(pairs.iter().map(|[difference, shadowing]| difference - shadowing).sum()).sqrt(),
        &mut drawn,
    );
    // The logarithm's errors are taken to be distributed as those of resamples (Davison and Hinkley, Bootstrap methods, 1997, 5.2):
    // squared differences have a long tail, of which resamples hold too little.
    let deviation = Estimate {
        value: drawn.value,
        low: drawn.value.powi(2) / drawn.high,
        high: drawn.value.powi(2) / drawn.low.max(drawn.value / 100.0),
    };
    let [most, least] = BOUNDS_DB.map(|k| Rice::new(k).deviation_db);
    if deviation.low > most {
        return Err(CalibrateError::unsuited(format!(
            "signals of network `{network}` vary by {deviation:.2} dB at places near each other, but Rayleigh fading by {most:.2} dB \
             only: something else changes them"
        )));
    }
    if deviation.value < least {
        return Err(CalibrateError::too_little(format!(
            "signals of network `{network}` vary by {:.2} dB at places near each other, which is too little to tell fading \
             from none: averaged signals hide it",
            deviation.value
        )));
    }
    let k_factor_db = Estimate {
        value: k_factor_db(deviation.value),
        low: k_factor_db(deviation.high),
        high: k_factor_db(deviation.low),
    };
    let mean_db = Rice::new(k_factor_db.value).mean_db;
    Ok(FadingFit { pairs: pairs.len(), deviation_db: deviation, k_factor_db, mean_db })
}

/// Returns half of the squared difference of each pair, and what shadowing adds to it on average, dB².
fn pairs(
    testbed: &Testbed,
    network: &str,
    fit: &SurveyFit,
    readings: &[Reading],
) -> Result<Vec<[f64; 2]>, CalibrateError> {
    let wireless = &testbed.graph.wireless[network];
    let mut units: Vec<&str> = readings.iter().map(|reading| reading.radio_unit.as_str()).collect();
    units.sort_unstable();
    units.dedup();
    let mut pairs = Vec::new();
    for name in units {
        let (unit, at) = radio_unit(testbed, name)?;
        let wavelength_m = METRES_PER_US / f64::from(wireless.standard.frequency_mhz(unit.channel));
        let mut own: Vec<&Reading> = readings.iter().filter(|reading| reading.radio_unit == name).collect();
        own.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
        let mut before: Option<Sample> = None;
        for reading in own {
            let now = sample(wireless, unit, at, testbed.map.as_ref(), reading);
            let Some(last) = before.replace(now) else { continue };
            let apart = last.distance(&now);
            if apart < wavelength_m {
                // Fading is nearly the same.
                before = Some(last);
            } else if apart <= FARTHEST_M {
                pairs.push([fit.middle.residual(&last, &now).powi(2) / 2.0, fit.middle.semivariance(apart)]);
            }
        }
    }
    Ok(pairs)
}

/// Returns the step to which all signals are rounded, dB; 0 if it is less than half.
fn rounding(readings: &[Reading]) -> f64 {
    let all = |step: f64| readings.iter().all(|reading| (reading.signal.0 / step).fract() == 0.0);
    [1.0, 0.5].into_iter().find(|step| all(*step)).unwrap_or_default()
}

/// Returns the K-factor of signals with this deviation, by bisection.
fn k_factor_db(deviation_db: f64) -> f64 {
    let [mut low, mut high] = BOUNDS_DB;
    if deviation_db >= Rice::new(low).deviation_db {
        return low;
    }
    while high - low > 1e-4 {
        let middle = f64::midpoint(low, high);
        if Rice::new(middle).deviation_db > deviation_db { low = middle } else { high = middle }
    }
    f64::midpoint(low, high)
}

/// Moments of a Rician signal in dB, around its mean power.
struct Rice {
    mean_db: f64,
    deviation_db: f64,
}

impl Rice {
    /// Computes the moments for a K-factor.
    ///
    /// The power is a noncentral chi-square variable: gamma with shape N + 1 and scale 1/(1 + K), for a Poisson N of mean K
    /// (Johnson, Kotz and Balakrishnan, Continuous univariate distributions, volume 2, 1995, chapter 29). The logarithm of a gamma
    /// variable has the mean ψ(N + 1) = H(N) - γ and the variance ψ'(N + 1) = π²/6 - Σ 1/j².
    fn new(k_factor_db: f64) -> Self {
        const GAMMA: f64 = 0.577_215_664_901_532_9;
        let k = 10f64.powf(k_factor_db / 10.0);
        let most = (k + 12.0 * k.sqrt() + 30.0) as usize;
        let (mut probability, mut harmonic, mut squares) = ((-k).exp(), 0.0, 0.0);
        let (mut mean, mut square, mut within) = (0.0, 0.0, 0.0);
        for n in 0..most {
            if n > 0 {
                let n = n as f64;
                probability *= k / n;
                harmonic += 1.0 / n;
                squares += 1.0 / (n * n);
            }
            mean += probability * harmonic;
            square += probability * harmonic * harmonic;
            within += probability * (std::f64::consts::PI.powi(2) / 6.0 - squares);
        }
        let db = 10.0 / std::f64::consts::LN_10;
        Self {
            mean_db: db * (mean - GAMMA - (1.0 + k).ln()),
            deviation_db: db * (within + square - mean * mean).max(0.0).sqrt(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rician_signals_have_the_moments_of_simulated_ones() {
        // Rayleigh: π/√6 · 10/ln 10, and -γ · 10/ln 10.
        let rayleigh = Rice::new(-60.0);
        assert!((rayleigh.deviation_db - 5.570).abs() < 1e-3 && (rayleigh.mean_db + 2.507).abs() < 1e-3);
        let mut draws = Draws::new(2, "rice");
        for k_factor_db in [-3.0, 6.0, 15.0] {
            let k = 10f64.powf(k_factor_db / 10.0);
            let signals: Vec<f64> = (0..100_000)
                .map(|_| {
                    let [a, b] = [0; 2].map(|_| draws.normal() / 2f64.sqrt());
                    10.0 * (((k.sqrt() + a).powi(2) + b * b) / (1.0 + k)).log10()
                })
                .collect();
            let mean = signals.iter().sum::<f64>() / 100_000.0;
            let deviation = (signals.iter().map(|s| (s - mean).powi(2)).sum::<f64>() / 100_000.0).sqrt();
            let rice = Rice::new(k_factor_db);
            assert!((rice.mean_db - mean).abs() < 0.06, "{mean} {}", rice.mean_db);
            assert!((rice.deviation_db / deviation - 1.0).abs() < 0.02, "{deviation} {}", rice.deviation_db);
        }
    }

    #[test]
    fn a_deviation_gives_its_k_factor_back() {
        for k in [-15.0, 0.0, 7.5, 19.0] {
            assert!((k_factor_db(Rice::new(k).deviation_db) - k).abs() < 1e-3);
        }
        assert_eq!(k_factor_db(6.0), BOUNDS_DB[0]);
    }
}
