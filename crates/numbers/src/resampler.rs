//! The stationary bootstrap of a series whose values depend on those before (Politis and Romano 1994), with an automatic
//! length of blocks (Politis and White 2004, as corrected by Patton, Politis and White 2009).

use crate::{
    bootstrap::{Blocks, resample},
    draws::Draws,
};

/// Returns the mean length of blocks for the stationary bootstrap of a series, 1 or more.
///
/// b = (2·G² / D)^(1/3) · n^(1/3), with G = Σ λ(k/M)·|k|·R(k) and D = 2·g(0)², g(0) = Σ λ(k/M)·R(k), over the autocovariances R
/// and the flat-top window λ. M is twice the lag from which on the autocorrelations are insignificant.
pub fn block_length(series: &[f64]) -> f64 {
    let n = series.len();
    if n < 4 {
        return 1.0;
    }
    let mean = series.iter().sum::<f64>() / n as f64;
    let covariance = |lag: usize| {
        let products = series.iter().zip(&series[lag..]).map(|(a, b)| (a - mean) * (b - mean));
        products.sum::<f64>() / n as f64
    };
    let variance = covariance(0);
    if variance <= 0.0 {
        return 1.0;
    }
    // The rule of Politis and White, section 3.2, with c = 2.
    let size = (n as f64).log10();
    let run = (size.sqrt().ceil() as usize).max(5);
    let most = (((n as f64).sqrt().ceil() as usize) + run).min(n - 1);
    let correlations: Vec<f64> = (0..=most).map(|lag| covariance(lag) / variance).collect();
    let bound = 2.0 * (size / n as f64).sqrt();
    let is_small = |lag: usize| correlations[lag].abs() < bound;
    let last = (0..most).find(|m| (m + 1..=(m + run).min(most)).all(is_small)).unwrap_or(most);
    let width = (2 * last.max(1)).min(most);
    let (mut weighted, mut sum) = (0.0, variance);
    for (lag, correlation) in correlations.iter().enumerate().take(width + 1).skip(1) {
        let window = (2.0 * (1.0 - lag as f64 / width as f64)).clamp(0.0, 1.0);
        weighted += 2.0 * window * lag as f64 * correlation * variance;
        sum += 2.0 * window * correlation * variance;
    }
    let length = (weighted * weighted / (sum * sum)).cbrt() * (n as f64).cbrt();
    let longest = (3.0 * (n as f64).sqrt()).min(n as f64 / 3.0).max(1.0);
    if length.is_finite() { length.clamp(1.0, longest) } else { longest }
}

/// Resamples of a series of `n` values, as indices. Blocks have random lengths with this mean, and wrap around the end.
#[derive(Debug)]
pub struct Resampler {
    n: usize,
    length: f64,
}

impl Resampler {
    /// Creates resamples of a series that is not empty.
    pub fn new(series: &[f64]) -> Self {
        Self::of_length(series.len(), block_length(series))
    }

    /// Creates resamples of `n` values, 1 or more, by blocks of a mean length.
    pub fn of_length(n: usize, length: f64) -> Self {
        Self { n, length }
    }

    /// Returns the mean length of blocks.
    pub fn length(&self) -> f64 {
        self.length
    }

    /// Calls `each` with each index of a resample.
    pub fn resample(&self, draws: &mut Draws, each: impl FnMut(usize)) {
        resample(self.n, Blocks::Stationary(self.length), draws, each);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn autoregressive(correlation: f64, n: usize) -> Vec<f64> {
        let mut draws = Draws::new(5, "series");
        let mut value = 0.0;
        let mut next = || {
            value = correlation * value + (1.0 - correlation * correlation).sqrt() * draws.normal();
            value
        };
        (0..n).map(|_| next()).collect()
    }

    #[test]
    fn blocks_are_as_long_as_the_formula_says_for_an_autoregression() {
        // R(k) = ρ^k: G = 2ρ/(1-ρ)², g(0) = (1+ρ)/(1-ρ), so b = (4ρ²/(1-ρ²)²)^(1/3) · n^(1/3).
        for (correlation, tolerance) in [(0.5f64, 0.35), (0.8, 0.35)] {
            let expected = (2.0 * correlation / (1.0 - correlation.powi(2))).powf(2.0 / 3.0) * 20.0;
            let length = block_length(&autoregressive(correlation, 8000));
            assert!((length / expected - 1.0).abs() < tolerance, "{length} {expected}");
        }
        assert!(block_length(&autoregressive(0.0, 8000)) < 6.0);
        assert_eq!(block_length(&[1.0; 50]), 1.0);
    }

    #[test]
    fn a_resample_has_as_many_values_and_keeps_neighbours_together() {
        let series = autoregressive(0.9, 2000);
        let resampler = Resampler::new(&series);
        let mut indices = Vec::new();
        resampler.resample(&mut Draws::new(1, "resample"), |i| indices.push(i));
        assert_eq!(indices.len(), 2000);
        let kept = indices.windows(2).filter(|pair| pair[1] == (pair[0] + 1) % 2000).count() as f64;
        let expected = 1999.0 * (1.0 - 1.0 / resampler.length);
        assert!((kept - expected).abs() < 60.0, "{kept} {expected}");
    }
}
