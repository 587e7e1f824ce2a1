//! Slow fading by walls and furniture, as a random field over the floor. A robot that returns to a place finds the same
//! signal there, whatever its route.

use std::f64::consts::{PI, TAU};

use cotorra_graph::{Position, Shadowing};
use cotorra_numbers::Draws;

/// Waves of a field. A few tens suffice for values near to normal and a smooth correlation.
const WAVES: usize = 32;

/// Log-normal shadowing of one link: normal in dB, with mean zero and autocorrelation exp(-Δ/d) over the distance Δ
/// between two places (Gudmundson, Correlation model for shadow fading in mobile radio systems, Electronics Letters
/// 27(23), 1991).
///
/// The field is a sum of plane waves, σ·√(2/M)·Σ cos(k·x + φ), with wave vectors drawn from the spectral density
/// of that autocorrelation (Rahimi and Recht, Random features for large-scale kernel machines, 2007). In the plane
/// the spectrum of exp(-Δ/d) is the bivariate Cauchy density: all directions are equally likely, and |k| is below K
/// with probability 1 - 1/√(1 + (K·d)²).
#[derive(Debug)]
pub(super) struct ShadowingField {
    amplitude_db: f64,
    waves: Vec<Wave>,
}

#[derive(Debug)]
struct Wave {
    /// Wave vector, radians per metre.
    k: [f64; 2],
    phase: f64,
}

impl ShadowingField {
    pub(super) fn new(shadowing: Shadowing, mut rng: Draws) -> Self {
        let turn = rng.unit();
        let wave = |i: usize| {
            // Strata for the wave number and the golden ratio for the direction spread the few waves evenly.
            let u = (i as f64 + rng.unit()) / WAVES as f64;
            let k = ((1.0 - u).powi(-2) - 1.0).sqrt() / shadowing.correlation_m;
            let direction = PI * (i as f64 * 0.618_033_988_749_895 + turn).fract();
            let (sin, cos) = direction.sin_cos();
            Wave { k: [k * cos, k * sin], phase: TAU * rng.unit() }
        };
        let flat = shadowing.deviation_db == 0.0;
        Self {
            amplitude_db: shadowing.deviation_db * (2.0 / WAVES as f64).sqrt(),
            waves: if flat { Vec::new() } else { (0..WAVES).map(wave).collect() },
        }
    }

    /// Returns the attenuation by obstacles at a place, dB; negative where reflections add up.
    pub(super) fn at(&self, place: Position) -> f64 {
        let sum: f64 = self.waves.iter().map(|w| (w.k[0] * place.x + w.k[1] * place.y + w.phase).cos()).sum();
        self.amplitude_db * sum
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MODEL: Shadowing = Shadowing { deviation_db: 4.0, correlation_m: 5.0 };

    fn field(seed: u64) -> ShadowingField {
        ShadowingField::new(MODEL, Draws::new(seed, "r~R"))
    }

    fn mean(values: impl Iterator<Item = f64>) -> f64 {
        let (n, sum) = values.fold((0, 0.0), |(n, sum), v| (n + 1, sum + v));
        sum / f64::from(n)
    }

    #[test]
    fn values_depend_only_on_seed_and_place() {
        let place = Position::new(3.0, -7.5);
        let value = field(1).at(place);
        assert_eq!(value, field(1).at(place));
        assert_ne!(value, field(2).at(place));
    }

    #[test]
    fn zero_deviation_means_no_shadowing() {
        let field = ShadowingField::new(Shadowing { deviation_db: 0.0, ..MODEL }, Draws::new(3, "r~R"));
        assert_eq!(field.at(Position::new(1.0, 2.0)), 0.0);
    }

    #[test]
    fn fields_have_mean_zero_and_the_requested_deviation() {
        let fields: Vec<_> = (0..4000).map(field).collect();
        let place = Position::new(12.0, 4.0);
        let average = mean(fields.iter().map(|f| f.at(place)));
        let deviation = mean(fields.iter().map(|f| f.at(place).powi(2))).sqrt();
        let beyond_two = mean(fields.iter().map(|f| f64::from(u8::from(f.at(place).abs() > 8.0))));
        assert!(average.abs() < 0.2, "{average}");
        assert!((deviation - 4.0).abs() < 0.15, "{deviation}");
        assert!(
            (beyond_two - 0.0455).abs() < 0.012,
            "a normal has 4.55 % beyond two deviations, not {beyond_two}"
        );
    }

    #[test]
    fn autocorrelation_is_exponential_in_every_direction() {
        let fields: Vec<_> = (0..4000).map(field).collect();
        let here = Position::new(-3.0, 8.0);
        for angle in [0.0, 0.7, 1.6, 2.5] {
            for apart in [0.5, 1.0, 2.5, 5.0, 10.0, 20.0] {
                let (sin, cos) = f64::sin_cos(angle);
                let there = Position::new(here.x + apart * cos, here.y + apart * sin);
                let correlation = mean(fields.iter().map(|f| f.at(here) * f.at(there))) / 16.0;
                let expected = (-apart / MODEL.correlation_m).exp();
                assert!(
                    (correlation - expected).abs() < 0.06,
                    "{apart} m: {correlation:.3}, not {expected:.3}"
                );
            }
        }
    }

    #[test]
    fn a_single_field_has_the_whole_deviation() {
        // The model holds for one robot's long walk, not only on average over many fields.
        let field = field(9);
        let places = (0..100_000).map(|i| Position::new(f64::from(i % 317) * 3.1, f64::from(i / 317) * 3.1));
        let deviation = mean(places.map(|p| field.at(p).powi(2))).sqrt();
        assert!((deviation - 4.0).abs() < 0.4, "{deviation}");
    }
}
