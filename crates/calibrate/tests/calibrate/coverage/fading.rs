//! Rician signals along a straight walk.

use std::path::Path;

use cotorra_calibrate::{Reading, fit_fading, fit_survey};
use cotorra_graph::{Dbm, PathLoss, Position};
use cotorra_numbers::Draws;

use super::{Coverage, USUAL, between, sites};

const TESTBED: &str = "name: lab
wireless: { lab: {} }
nodes:
  R: { kind: radio_unit, position: [0, 0], channel: 1 }
";
/// Distance between two readings, metres.
const STEP_M: f64 = 0.2;

/// Signals in whole dBm: path loss, shadowing that is a Markov chain along the line, and Rician fading.
fn survey(k_factor_db: f64, draws: &mut Draws) -> Vec<Reading> {
    let path_loss = PathLoss::LogDistance { exponent: between(draws, [1.7, 3.2]) };
    let (deviation, correlation_m) = (between(draws, [2.0, 5.0]), between(draws, [2.0, 5.0]));
    let kept = (-STEP_M / correlation_m).exp();
    let k = 10f64.powf(k_factor_db / 10.0);
    let mut shadow = deviation * draws.normal();
    let mut reading = |i: u32| {
        let distance = 1.0 + STEP_M * f64::from(i);
        shadow = kept * shadow + (1.0 - kept * kept).sqrt() * deviation * draws.normal();
        let [a, b] = [0; 2].map(|_| draws.normal() / 2f64.sqrt());
        let fading = 10.0 * (((k.sqrt() + a).powi(2) + b * b) / (1.0 + k)).log10();
        Reading {
            time_s: f64::from(i),
            place: Position::new(distance, 0.0),
            radio_unit: "R".to_owned(),
            signal: Dbm((15.0 - path_loss.loss_db(distance, 2412) - shadow + fading).round()),
        }
    };
    (0..400).map(&mut reading).collect()
}

#[test]
fn fading_intervals_hold_the_true_values() {
    let parsed = cotorra_testbed_file::parse("lab", TESTBED, Path::new(""));
    let testbed = parsed.unwrap_or_else(|wrong| panic!("{wrong}"));
    let mut coverage = Coverage::default();
    // A few sites are enough without `COTORRA_FULL`.
    let sites = if sites() == USUAL { USUAL / 4 } else { sites() };
    for seed in 0..sites as u64 {
        let draws = &mut Draws::new(seed, "fading");
        let k_factor_db = between(draws, [-3.0, 12.0]);
        let readings = survey(k_factor_db, draws);
        let fit = &fit_survey(&testbed, &readings, seed).unwrap()["lab"];
        let fading = fit_fading(&testbed, "lab", fit, &readings, seed).unwrap();
        coverage.count("K-factor", fading.k_factor_db, k_factor_db);
    }
    coverage.check();
}
