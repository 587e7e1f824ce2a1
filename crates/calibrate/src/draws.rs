//! Random numbers from a seed.

use cotorra_graph::seed;

/// A stream of random numbers. The same seed and label give the same numbers.
#[derive(Debug, Clone)]
pub struct Draws {
    uniform: cotorra_numbers::Draws,
    /// Second normal deviate of a pair.
    spare: Option<f64>,
}

impl Draws {
    /// Creates the stream of a label.
    pub fn new(seed: u64, label: &str) -> Self {
        Self { uniform: cotorra_numbers::Draws::new(seed::split(seed, label)), spare: None }
    }

    /// Returns a uniform number in 0..1 (1 excluded).
    pub fn unit(&mut self) -> f64 {
        self.uniform.unit()
    }

    /// Returns a whole number below `n`, which is above 0.
    pub fn below(&mut self, n: usize) -> usize {
        self.uniform.below(n)
    }

    /// Returns the uniform numbers alone.
    pub(crate) fn uniform(&mut self) -> &mut cotorra_numbers::Draws {
        &mut self.uniform
    }

    /// Returns a standard normal deviate (Box and Muller 1958).
    pub fn normal(&mut self) -> f64 {
        if let Some(spare) = self.spare.take() {
            return spare;
        }
        let radius = (-2.0 * (1.0 - self.unit()).ln()).sqrt();
        let (sin, cos) = (std::f64::consts::TAU * self.unit()).sin_cos();
        self.spare = Some(radius * sin);
        radius * cos
    }

    /// Returns a deviate of the gamma distribution with a shape above 0 and scale 1 (Marsaglia and Tsang, A simple method for
    /// generating gamma variables, 2000).
    pub fn gamma(&mut self, shape: f64) -> f64 {
        if shape < 1.0 {
            let power = (1.0 - self.unit()).powf(1.0 / shape);
            return self.gamma(shape + 1.0) * power;
        }
        let d = shape - 1.0 / 3.0;
        let c = 1.0 / (9.0 * d).sqrt();
        loop {
            let x = self.normal();
            let v = (1.0 + c * x).powi(3);
            if v > 0.0 && (1.0 - self.unit()).ln() < 0.5 * x * x + d - d * v + d * v.ln() {
                return d * v;
            }
        }
    }

    /// Returns a deviate of the beta distribution with two shapes above 0.
    pub fn beta(&mut self, a: f64, b: f64) -> f64 {
        let (x, y) = (self.gamma(a), self.gamma(b));
        x / (x + y)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn moments(mut draw: impl FnMut() -> f64) -> (f64, f64) {
        const N: usize = 50_000;
        let values: Vec<f64> = (0..N).map(|_| draw()).collect();
        let mean = values.iter().sum::<f64>() / N as f64;
        (mean, values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / N as f64)
    }

    #[test]
    fn deviates_have_the_moments_of_their_distributions() {
        let mut draws = Draws::new(1, "moments");
        for (a, b) in [(0.5, 20.0), (3.0, 2.0)] {
            let (mean, variance) = moments(|| draws.beta(a, b));
            assert!((mean / (a / (a + b)) - 1.0).abs() < 0.02, "{mean}");
            let expected = a * b / ((a + b).powi(2) * (a + b + 1.0));
            assert!((variance / expected - 1.0).abs() < 0.06, "{variance} {expected}");
        }
        let (mean, variance) = moments(|| draws.normal());
        assert!(mean.abs() < 0.02 && (variance - 1.0).abs() < 0.03, "{mean} {variance}");
        let (mean, variance) = moments(|| draws.gamma(2.5));
        assert!((mean - 2.5).abs() < 0.05 && (variance - 2.5).abs() < 0.15, "{mean} {variance}");
    }

    #[test]
    fn whole_numbers_fill_their_range() {
        let mut draws = Draws::new(2, "below");
        let mut seen = [0; 5];
        (0..5000).for_each(|_| seen[draws.below(5)] += 1);
        assert!(seen.iter().all(|n| (850..1150).contains(n)), "{seen:?}");
    }
}
