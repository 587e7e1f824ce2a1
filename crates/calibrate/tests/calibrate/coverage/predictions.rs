//! Predictions of the part of the round trips that was not fitted.

use std::{collections::BTreeMap, time::Duration};

use cotorra_calibrate::{Predictor, compare, fit_path};
use cotorra_graph::JitterDistribution;
use cotorra_numbers::Draws;

use super::{
    paths::{Truth, packet_times},
    sites,
};

#[test]
fn fitted_paths_predict_the_test_part_better_than_normal_jitter() {
    let mut held: BTreeMap<(&str, &str), usize> = BTreeMap::new();
    let (mut skewed, mut nearer) = (0, 0);
    for seed in 0..sites() as u64 {
        let mut draws = Draws::new(seed, "prediction");
        let truth = Truth::draw(&mut draws);
        let [fitted, test] = packet_times(truth, &mut draws).split(0.6);
        let fit = fit_path(&fitted, seed).unwrap();
        let target = Duration::from_secs_f64((truth.mean_ms + truth.deviation_ms * 0.8) / 1e3);
        let compared = compare(&fit, &fitted, &test, Some(target), seed).unwrap();
        for prediction in &compared.predictions {
            let agrees = &prediction.agrees;
            let figures = [
                ("p50", agrees.p50_ms),
                ("p95", agrees.p95_ms),
                ("p99", agrees.p99_ms),
                ("change", agrees.change_ms),
            ];
            for (figure, agrees) in figures.into_iter().chain([("above", agrees.above.unwrap())]) {
                *held.entry((prediction.by.name(), figure)).or_default() += usize::from(agrees);
            }
        }
        if truth.distribution == JitterDistribution::Pareto {
            skewed += 1;
            let [by_fit, normal, _] = &compared.predictions[..] else { panic!() };
            nearer += usize::from(by_fit.wasserstein_ms.value < normal.wasserstein_ms.value);
        }
    }
    for ((by, figure), held) in &held {
        println!("{by}, {figure}: {:.1} % of {}", *held as f64 / sites() as f64 * 100.0, sites());
    }
    println!("nearer than normal jitter: {nearer} of {skewed} sites with Pareto jitter");
    assert_eq!(nearer, skewed);
    for figure in ["p50", "p95", "p99", "change", "above"] {
        let held = held[&(Predictor::Fitted.name(), figure)];
        assert!(held * 100 >= sites() * 75, "{figure}: {held} of {}", sites());
    }
}
