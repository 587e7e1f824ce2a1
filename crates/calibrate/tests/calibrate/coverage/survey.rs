//! Surveys of halls with walls, along a walk.

use std::{collections::BTreeMap, path::Path};

use cotorra_calibrate::{Reading, SignalPredictor, compare_survey, fit_survey, split_survey};
use cotorra_graph::{Cell, Dbm, OccupancyGrid, PathLoss, Position, Testbed};
use cotorra_numbers::Draws;

use super::{Coverage, USUAL, between, sites};

/// Edges of the hall, metres.
const HALL: [f64; 2] = [40.0, 24.0];
const TESTBED: &str = "name: site
wireless: { hall: { standard: n } }
nodes:
  west: { kind: radio_unit, position: [3.2, 4.3], channel: 1, tx_power: 17 dBm }
  middle: { kind: radio_unit, position: [21.3, 19.8], channel: 6 }
  east: { kind: radio_unit, position: [36.4, 7.1], channel: 11 }
  lan: { kind: switch }
  edge: { kind: server, tier: edge, cpus: 1, memory: 1 GB }
links:
  - { ends: [lan, [west, middle, east, edge]] }
";

/// The values that a fit should find.
#[derive(Debug, Clone, Copy)]
struct Truth {
    reference_loss_db: f64,
    exponent: f64,
    wall_loss_db: f64,
    deviation_db: f64,
    correlation_m: f64,
    noise_db: f64,
}

impl Truth {
    fn draw(draws: &mut Draws) -> Self {
        Self {
            reference_loss_db: between(draws, [-2.0, 8.0]),
            exponent: between(draws, [1.7, 3.2]),
            wall_loss_db: between(draws, [1.0, 9.0]),
            deviation_db: between(draws, [2.0, 6.0]),
            correlation_m: between(draws, [1.5, 5.0]),
            noise_db: between(draws, [0.3, 2.5]),
        }
    }
}

/// A hall with three walls across it, each with a gap.
fn testbed() -> Testbed {
    let mut testbed = cotorra_testbed_file::parse("site", TESTBED, Path::new("")).unwrap();
    let (width, height) = (HALL[0] as usize * 2, HALL[1] as usize * 2);
    let wall = |column: usize, row: usize| match column {
        20 => row > 12,
        44 => row < 34,
        62 => !(18..26).contains(&row),
        _ => false,
    };
    let cells = (0..height).flat_map(|row| (0..width).map(move |column| (column, row)));
    let cells = cells.map(|(c, r)| if wall(c, r) { Cell::Occupied } else { Cell::Free }).collect();
    testbed.map = Some(OccupancyGrid::new(width, height, 0.5, Position::new(0.0, 0.0), cells).unwrap());
    testbed
}

/// Places of a walk up and down the hall: stops each 4 m or so, with two readings that are 0.7 m apart.
fn walk(draws: &mut Draws) -> Vec<Position> {
    let mut places = Vec::new();
    for lane in 0..4 {
        for step in 0..10 {
            let along = if lane % 2 == 0 { step } else { 9 - step };
            let x = 1.5 + 4.0 * f64::from(along) + between(draws, [-0.8, 0.8]);
            let y = 2.0 + 6.0 * f64::from(lane) + between(draws, [-0.8, 0.8]);
            places.extend([Position::new(x, y), Position::new(x + 0.7, y)]);
        }
    }
    places
}

/// A Gaussian field with exponential correlation at some places, by the Cholesky factor of its covariance.
fn field(places: &[Position], truth: Truth, draws: &mut Draws) -> Vec<f64> {
    let n = places.len();
    let mut factor = vec![vec![0.0; n]; n];
    for row in 0..n {
        for column in 0..=row {
            let correlation = (-places[row].distance(places[column]) / truth.correlation_m).exp();
            let sum: f64 = (0..column).map(|k| factor[row][k] * factor[column][k]).sum();
            let left: f64 = correlation - sum;
            factor[row][column] = if row == column { left.sqrt() } else { left / factor[column][column] };
        }
    }
    let deviates: Vec<f64> = (0..n).map(|_| draws.normal()).collect();
    factor
        .iter()
        .map(|row| truth.deviation_db * row.iter().zip(&deviates).map(|(f, d)| f * d).sum::<f64>())
        .collect()
}

/// Surveys a site: signals by the testbed's own path loss and walls, with shadowing and noise.
fn survey(testbed: &Testbed, truth: Truth, draws: &mut Draws) -> Vec<Reading> {
    let places = walk(draws);
    let map = testbed.map.as_ref().unwrap();
    let path_loss = PathLoss::LogDistance { exponent: truth.exponent };
    let mut readings = Vec::new();
    for (node, unit) in testbed.graph.radio_units() {
        let at = node.position.unwrap();
        let frequency = testbed.graph.wireless["hall"].standard.frequency_mhz(unit.channel);
        for (i, (place, shadow)) in places.iter().zip(field(&places, truth, draws)).enumerate() {
            let loss = path_loss.loss_db(at.distance(*place), frequency)
                + truth.reference_loss_db
                + truth.wall_loss_db * map.walls_between(at, *place) as f64
                + shadow;
            readings.push(Reading {
                time_s: i as f64,
                place: *place,
                radio_unit: node.id.to_string(),
                signal: Dbm(unit.tx_power.0 - loss + truth.noise_db * draws.normal()),
            });
        }
    }
    readings
}

#[test]
fn survey_intervals_hold_the_true_values() {
    let testbed = testbed();
    let mut coverage = Coverage::default();
    for seed in 0..sites() as u64 {
        let mut draws = Draws::new(seed, "site");
        let truth = Truth::draw(&mut draws);
        let readings = survey(&testbed, truth, &mut draws);
        let fit = &fit_survey(&testbed, &readings, seed).unwrap()["hall"];
        coverage.count("reference loss", fit.reference_loss_db, truth.reference_loss_db);
        coverage.count("exponent", fit.exponent, truth.exponent);
        coverage.count("wall loss", fit.wall_loss_db.unwrap(), truth.wall_loss_db);
        coverage.count("deviation", fit.deviation_db, truth.deviation_db);
        coverage.count("noise", fit.noise_db, truth.noise_db);
        if let Some(correlation) = fit.correlation_m {
            coverage.count("correlation distance", correlation, truth.correlation_m);
        }
    }
    coverage.check();
}

/// The signal of a reading without noise and shadowing, by the true values.
fn mean_signal(testbed: &Testbed, truth: Truth, reading: &Reading) -> f64 {
    let (node, unit) =
        testbed.graph.radio_units().find(|(node, _)| node.id.as_str() == reading.radio_unit).unwrap();
    let at = node.position.unwrap();
    let frequency = testbed.graph.wireless["hall"].standard.frequency_mhz(unit.channel);
    let walls = testbed.map.as_ref().unwrap().walls_between(at, reading.place) as f64;
    let loss =
        PathLoss::LogDistance { exponent: truth.exponent }.loss_db(at.distance(reading.place), frequency);
    unit.tx_power.0 - loss - truth.reference_loss_db - truth.wall_loss_db * walls
}

#[test]
fn fitted_radios_predict_the_rest_of_a_walk_better_than_baselines() {
    // A few sites are enough without `COTORRA_FULL`.
    let sites = if sites() == USUAL { USUAL / 5 } else { sites() };
    let testbed = testbed();
    let (mut median, mut within, mut square) = (0, 0, 0);
    let mut sums: BTreeMap<&str, [f64; 3]> = BTreeMap::new();
    for seed in 0..sites as u64 {
        let mut draws = Draws::new(seed, "signals");
        let truth = Truth::draw(&mut draws);
        let [fitted, test] = split_survey(&survey(&testbed, truth, &mut draws), 0.6);
        let fit = &fit_survey(&testbed, &fitted, seed).unwrap()["hall"];
        let compared = compare_survey(&testbed, "hall", fit, &fitted, &test, seed).unwrap();
        for prediction in &compared.predictions {
            let sums = sums.entry(prediction.by.name()).or_default();
            sums[0] += prediction.root_mean_square_db.value;
            sums[1] += prediction.within.value;
            sums[2] += prediction.wasserstein_db.value;
        }
        let by_fit = compared.predictions[0];
        assert_eq!(by_fit.by, SignalPredictor::Fitted);
        median += usize::from(by_fit.median_agrees);
        within += usize::from(by_fit.within_agrees);
        // The expected square of the error of the fitted mean, over all sites with this walk.
        let found = Truth {
            reference_loss_db: fit.reference_loss_db.value,
            exponent: fit.exponent.value,
            wall_loss_db: fit.wall_loss_db.unwrap().value,
            ..truth
        };
        let off = |reading: &Reading| {
            (mean_signal(&testbed, found, reading) - mean_signal(&testbed, truth, reading)).powi(2)
        };
        let bias = test.iter().map(off).sum::<f64>() / test.len() as f64;
        let expected = (bias + truth.deviation_db.powi(2) + truth.noise_db.powi(2)).sqrt();
        square += usize::from(by_fit.root_mean_square_db.covers(expected));
    }
    let share = |number: usize| number as f64 * 100.0 / sites as f64;
    println!(
        "median agrees: {:.1} %, share within: {:.1} %, root mean square held: {:.1} %",
        share(median),
        share(within),
        share(square)
    );
    for (by, [square, within, distance]) in &sums {
        let n = sites as f64;
        println!(
            "{by}: {:.2} dB, within {:.1} %, Wasserstein {:.2} dB",
            square / n,
            within / n * 100.0,
            distance / n
        );
    }
    let of = |predictor: SignalPredictor| sums[predictor.name()];
    let [fitted, nearby, mean, before] = SignalPredictor::ALL.map(of);
    assert!(fitted[0] < mean[0] && fitted[0] < before[0] && nearby[0] < mean[0]);
    assert!(share(median) > 85.0 && share(within) > 85.0, "{median} {within}");
}
