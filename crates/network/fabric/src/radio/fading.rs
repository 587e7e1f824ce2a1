//! Fast fading by interference of paths, as a random field over the floor and the time. A frame's signal rises and falls
//! within a fraction of the wavelength, as the robot or the surroundings move.

use std::f64::consts::TAU;

use cotorra_graph::{Fading, Position, Timestamp};
use cotorra_numbers::Draws;

/// Waves of a field.
const WAVES: usize = 32;

/// Ticks in one period of the highest Doppler shift by moving surroundings. Within a tick, the field is constant.
const TICKS: f64 = 100.0;

/// Speed of light, m/s.
const LIGHT: f64 = 299_792_458.0;

/// Place of a robot, and the tick of its surroundings. In the same moment, a link has the same fading.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Moment {
    pub(super) place: Position,
    pub(super) tick: u64,
}

/// Rayleigh or Rician fading of one link, in both directions.
///
/// The field is a sum of plane waves of equal power with random phases, which come to the robot from all directions of the
/// plane, and of the direct wave from the radio unit:
///
/// > h = √(K/(K+1))·e^(-j·κ·d) + √(1/(K+1))·√(1/M)·Σ e^(j·(κ·(x·cos α + y·sin α) + ω·t·cos β + φ))
///
/// with κ = 2π/λ and the distance d to the radio unit. A robot that moves crosses the field, and so sees the spectrum of
/// Clarke (A statistical theory of mobile-radio reception, Bell System Technical Journal 47(6), 1968): the autocorrelation of
/// the waves is J₀(κ·Δ) over a distance Δ. Surroundings that move with the speed v shift each wave by its own Doppler
/// frequency, ω·cos β with ω = κ·v, so that it is J₀(κ·v·τ) over a time τ, and the product of both when both move (Akki and
/// Haber, A statistical model of mobile-to-mobile land communication channel, IEEE Transactions on Vehicular Technology 35(1),
/// 1986). Directions are drawn in strata, which makes the statistics right with few waves (Xiao, Zheng and Beaulieu, Novel
/// sum-of-sinusoids simulation models for Rayleigh and Rician fading channels, IEEE Transactions on Wireless Communications
/// 5(12), 2006).
#[derive(Debug)]
pub(super) struct FadingField {
    /// κ, radians per metre.
    wave_number: f64,
    /// Amplitude of the direct wave.
    direct: f64,
    /// Amplitude of each other wave.
    scattered: f64,
    waves: Vec<Wave>,
    /// Ticks of the surroundings per second.
    ticks_per_second: f64,
}

#[derive(Debug)]
struct Wave {
    /// Wave vector, radians per metre.
    k: [f64; 2],
    /// Turn by moving surroundings, radians per tick.
    turn: f64,
    phase: f64,
}

impl FadingField {
    pub(super) fn new(fading: &Fading, frequency_mhz: u16, mut rng: Draws) -> Self {
        let wavelength_m = LIGHT / (f64::from(frequency_mhz) * 1e6);
        let wave_number = TAU / wavelength_m;
        let first = rng.unit();
        let wave = |i: usize| {
            let direction = TAU * (i as f64 + rng.unit()) / WAVES as f64;
            // The golden ratio spreads the directions of movement, independently of those of the waves.
            let movement = TAU * (i as f64 * 0.618_033_988_749_895 + first).fract();
            let (sin, cos) = direction.sin_cos();
            Wave {
                k: [wave_number * cos, wave_number * sin],
                turn: TAU / TICKS * movement.cos(),
                phase: TAU * rng.unit(),
            }
        };
        let waves = (0..WAVES).map(wave).collect();
        let k_factor = fading.k_factor_db.map_or(0.0, |db| 10f64.powf(db / 10.0));
        Self {
            wave_number,
            direct: (k_factor / (k_factor + 1.0)).sqrt(),
            scattered: (1.0 / ((k_factor + 1.0) * WAVES as f64)).sqrt(),
            waves,
            ticks_per_second: TICKS * fading.motion_mps / wavelength_m,
        }
    }

    /// Returns the tick of a time; always 0 if the surroundings stand still.
    pub(super) fn tick(&self, now: Timestamp) -> u64 {
        (now.as_secs_f64() * self.ticks_per_second) as u64
    }

    /// Returns the power over its mean, dB. `distance_m` is that of both antennas.
    pub(super) fn gain_db(&self, moment: Moment, distance_m: f64) -> f64 {
        let [re, im] = self.at(moment, distance_m);
        10.0 * (re * re + im * im).log10()
    }

    /// Returns h.
    fn at(&self, Moment { place, tick }: Moment, distance_m: f64) -> [f64; 2] {
        let (sin, cos) = (-self.wave_number * distance_m).sin_cos();
        let mut h = [self.direct * cos, self.direct * sin];
        for wave in &self.waves {
            let phase = wave.k[0] * place.x + wave.k[1] * place.y + wave.turn * tick as f64 + wave.phase;
            let (sin, cos) = phase.sin_cos();
            h[0] += self.scattered * cos;
            h[1] += self.scattered * sin;
        }
        h
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::*;

    const MHZ: u16 = 2437;
    const WAVELENGTH_M: f64 = LIGHT / (MHZ as f64 * 1e6);
    const RAYLEIGH: Fading = Fading { k_factor_db: None, motion_mps: 0.5 };
    const RICIAN: Fading = Fading { k_factor_db: Some(6.0), motion_mps: 0.5 };
    const K: f64 = 3.981_071_705_534_972;

    fn field(fading: Fading, seed: u64) -> FadingField {
        FadingField::new(&fading, MHZ, Draws::new(seed, "r~R"))
    }

    fn moment(x: f64, y: f64, tick: u64) -> Moment {
        Moment { place: Position::new(x, y), tick }
    }

    fn power([re, im]: [f64; 2]) -> f64 {
        re * re + im * im
    }

    fn mean(values: impl Iterator<Item = f64>) -> f64 {
        let (n, sum) = values.fold((0, 0.0), |(n, sum), v| (n + 1, sum + v));
        sum / f64::from(n)
    }

    /// Returns (1/π)·∫ f(cos θ) dθ over half a turn.
    fn over_directions(f: impl Fn(f64) -> f64) -> f64 {
        mean((0..500).map(|i| f((PI * (f64::from(i) + 0.5) / 500.0).cos())))
    }

    /// Bessel function of the first kind and order 0 (Abramowitz and Stegun, 9.1.18).
    fn j0(x: f64) -> f64 {
        over_directions(|cos| (x * cos).cos())
    }

    /// Returns powers at 30,000 independent places and times, sorted.
    fn powers(fading: Fading) -> Vec<f64> {
        let of_field = |seed| {
            let field = field(fading, seed);
            (0..10).map(move |i| {
                let (x, y) = (f64::from(i) * 3.7, f64::from(i * i) * 1.3);
                power(field.at(moment(x, y, 977 * i as u64), x.hypot(y)))
            })
        };
        let mut powers: Vec<f64> = (0..3000).flat_map(of_field).collect();
        powers.sort_by(f64::total_cmp);
        powers
    }

    /// Asserts a distribution by Kolmogorov and Smirnov's test, at a level of 0.1 %.
    fn assert_distribution(sorted: &[f64], below: impl Fn(f64) -> f64) {
        let n = sorted.len() as f64;
        let apart = |(i, value): (usize, &f64)| (below(*value) - (i as f64 + 0.5) / n).abs();
        let most = sorted.iter().enumerate().map(apart).fold(0.0, f64::max);
        assert!(most < 1.95 / n.sqrt(), "{most} apart, with {n} values");
    }

    /// Asserts the powers below which shares of all powers are, in dB, each with a tolerance.
    fn assert_quantiles(sorted: &[f64], expected: [(f64, f64, f64); 3]) {
        for (share, expected, tolerance) in expected {
            let measured = 10.0 * sorted[(share * sorted.len() as f64) as usize].log10();
            assert!((measured - expected).abs() < tolerance, "{share}: {measured} dB, not {expected} dB");
        }
    }

    #[test]
    fn powers_without_a_line_of_sight_are_exponential() {
        let powers = powers(RAYLEIGH);
        assert!((mean(powers.iter().copied()) - 1.0).abs() < 0.02);
        assert_distribution(&powers, |power| 1.0 - (-power).exp());
        // 10·log(-ln(1 - p)).
        assert_quantiles(&powers, [(0.5, -1.59, 0.1), (0.1, -9.77, 0.3), (0.01, -19.98, 0.8)]);
    }

    #[test]
    fn amplitudes_with_a_line_of_sight_are_rician() {
        let powers = powers(RICIAN);
        assert!((mean(powers.iter().copied()) - 1.0).abs() < 0.02);
        // Density of the power: (1+K)·e^(-K-(1+K)p)·I₀(2√(K(1+K)p)), summed up in steps (Rice, 1945).
        const STEP: f64 = 0.002;
        let density = |p: f64| {
            let x = 2.0 * (K * (1.0 + K) * p).sqrt();
            (1.0 + K) * over_directions(|cos| (x * cos - K - (1.0 + K) * p).exp())
        };
        let steps = (0..3000).map(|i| density((f64::from(i) + 0.5) * STEP) * STEP);
        let sums: Vec<f64> = std::iter::once(0.0)
            .chain(steps.scan(0.0, |sum, step| {
                *sum += step;
                Some(*sum)
            }))
            .collect();
        let below = |power: f64| {
            let (i, part) = ((power / STEP) as usize, (power / STEP).fract());
            if i + 1 < sums.len() { sums[i] + part * (sums[i + 1] - sums[i]) } else { 1.0 }
        };
        assert!((sums[sums.len() - 1] - 1.0).abs() < 1e-6);
        assert_distribution(&powers, below);
        assert_quantiles(&powers, [(0.5, -0.45, 0.1), (0.1, -5.02, 0.2), (0.01, -11.49, 0.8)]);
    }

    /// Counts upward crossings of an amplitude, and the steps below it.
    fn crossings(level: f64, amplitudes: &[Vec<f64>]) -> (f64, f64) {
        let up = |walk: &Vec<f64>| walk.windows(2).filter(|pair| pair[0] < level && pair[1] >= level).count();
        let under = |walk: &Vec<f64>| walk.iter().filter(|amplitude| **amplitude < level).count();
        let sum = |count: &dyn Fn(&Vec<f64>) -> usize| amplitudes.iter().map(count).sum::<usize>() as f64;
        (sum(&up), sum(&under))
    }

    /// Asserts the crossings and fades of walks with 100 steps per period of the highest Doppler shift, against N = √(2π)·ρ·
    /// e^(-ρ²) per period, and a mean fade of (e^(ρ²) - 1) / (√(2π)·ρ) periods (Rice, 1945; Clarke, 1968).
    fn assert_rice(walks: &[Vec<f64>]) {
        let periods = walks.iter().map(Vec::len).sum::<usize>() as f64 / 100.0;
        for level in [1.0, 0.5, 0.316_227_766, 0.1] {
            let (up, under) = crossings(level, walks);
            let rate = (2.0 * PI).sqrt() * level * (-level * level).exp();
            let fade = ((level * level).exp() - 1.0) / ((2.0 * PI).sqrt() * level);
            let (rates, fades) = (up / periods / rate, under / up / 100.0 / fade);
            assert!((rates - 1.0).abs() < 0.12, "{rates} of the crossings of {level}");
            assert!((fades - 1.0).abs() < 0.12, "{fades} of the fades below {level}");
        }
    }

    #[test]
    fn a_moving_robot_crosses_levels_as_rice_says() {
        let walk = |seed: u64| {
            let field = field(RAYLEIGH, seed);
            let (sin, cos) = (seed as f64).sin_cos();
            let step = move |i| f64::from(i) * WAVELENGTH_M / 100.0;
            (0..5000).map(|i| power(field.at(moment(cos * step(i), sin * step(i), 0), 9.0)).sqrt()).collect()
        };
        assert_rice(&(0..40).map(walk).collect::<Vec<_>>());
    }

    #[test]
    fn moving_surroundings_cross_levels_as_rice_says() {
        let walk = |seed| {
            let field = field(RAYLEIGH, seed);
            (0..5000).map(|tick| power(field.at(moment(4.0, 2.0, tick), 9.0)).sqrt()).collect()
        };
        assert_rice(&(100..140).map(walk).collect::<Vec<_>>());
    }

    #[test]
    fn autocorrelation_is_that_of_clarke_over_distance_and_time() {
        let fields: Vec<_> = (0..2000).map(|seed| field(RAYLEIGH, seed)).collect();
        let correlation = |angle: f64, wavelengths: f64, ticks: u64| {
            let (sin, cos) = angle.sin_cos();
            let apart = wavelengths * WAVELENGTH_M;
            let there = moment(3.0 + apart * cos, 4.0 + apart * sin, 50 + ticks);
            mean(fields.iter().map(|field| {
                let ([a, b], [c, d]) = (field.at(moment(3.0, 4.0, 50), 5.0), field.at(there, 5.0));
                a * c + b * d
            }))
        };
        for (angle, wavelengths, ticks) in [
            (0.0, 0.1, 0),
            (1.0, 0.25, 0),
            (2.0, 0.3827, 0),
            (0.5, 0.61, 0),
            (1.5, 1.1, 0),
            (0.0, 3.0, 0),
            (0.0, 0.0, 10),
            (0.0, 0.0, 38),
            (0.0, 0.0, 61),
            (0.0, 0.0, 300),
            (1.0, 0.2, 15),
        ] {
            let measured = correlation(angle, wavelengths, ticks);
            let expected = j0(TAU * wavelengths) * j0(TAU * ticks as f64 / TICKS);
            assert!(
                (measured - expected).abs() < 0.06,
                "{wavelengths} λ and {ticks} ticks: {measured:.3}, not {expected:.3}"
            );
        }
    }

    #[test]
    fn one_field_has_all_fades() {
        // The statistics hold for one robot's walk, not only on average over many fields.
        let field = field(RAYLEIGH, 9);
        let at = |i: i32| {
            let (x, y) = (f64::from(i % 211) * 0.31, f64::from(i / 211) * 0.31);
            power(field.at(moment(x, y, 0), 1.0))
        };
        let powers: Vec<f64> = (0..40_000).map(at).collect();
        let deep = powers.iter().filter(|power| **power < 0.1).count() as f64 / powers.len() as f64;
        assert!((mean(powers.iter().copied()) - 1.0).abs() < 0.05);
        assert!((deep - 0.095).abs() < 0.015, "{deep} of all places are 10 dB below the mean");
    }

    #[test]
    fn the_field_stands_still_without_motion() {
        let still = field(Fading { motion_mps: 0.0, ..RAYLEIGH }, 1);
        assert_eq!(still.tick(Timestamp::from_secs_f64(1e6)), 0);
        // A hundredth of the Doppler period: λ / v = 246 ms.
        let moving = field(RAYLEIGH, 1);
        let ticks = [0.0, 0.0024, 0.0026, 0.25, 24.7].map(|s| moving.tick(Timestamp::from_secs_f64(s)));
        assert_eq!(ticks, [0, 0, 1, 101, 10_039]);
    }

    #[test]
    fn values_depend_only_on_seed_place_and_tick() {
        let here = moment(3.0, -7.5, 42);
        let value = field(RICIAN, 1).gain_db(here, 8.0);
        assert_eq!(value, field(RICIAN, 1).gain_db(here, 8.0));
        assert_ne!(value, field(RICIAN, 2).gain_db(here, 8.0));
        assert_ne!(value, field(RICIAN, 1).gain_db(Moment { tick: 43, ..here }, 8.0));
    }

    #[test]
    fn an_overwhelming_line_of_sight_leaves_no_fading() {
        let field = field(Fading { k_factor_db: Some(200.0), motion_mps: 0.5 }, 1);
        for i in 0..100 {
            assert!(field.gain_db(moment(f64::from(i) * 0.1, 0.0, i as u64), f64::from(i)).abs() < 1e-8);
        }
    }
}
