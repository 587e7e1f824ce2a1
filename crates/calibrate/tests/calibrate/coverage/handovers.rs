//! Handovers whose phases vary uniformly.

use cotorra_calibrate::{HandoverTime, fit_handovers};
use cotorra_numbers::Draws;

use super::{Coverage, between, sites};

const TESTBED: &str = "name: lab
wireless: { lab: { handover: { authenticate: 15 ms, reassociate: 20 ms, handshake: 60 ms } } }
nodes:
  robot: { kind: robot, position: [1, 0] }
  R: { kind: radio_unit, position: [0, 0], channel: 1 }
";

#[test]
fn handover_intervals_hold_the_true_values() {
    let parsed = cotorra_testbed_file::parse("lab", TESTBED, std::path::Path::new(""));
    let testbed = parsed.unwrap_or_else(|wrong| panic!("{wrong}"));
    let mut coverage = Coverage::default();
    for seed in 0..sites() as u64 {
        let draws = &mut Draws::new(seed, "handover");
        let (scale, variation) = (between(draws, [0.5, 3.0]), between(draws, [0.05, 0.6]));
        let mut phase = |ms: f64| scale * ms * (1.0 + variation * (2.0 * draws.unit() - 1.0));
        let mut handover = |i: usize| {
            let fast = i.is_multiple_of(2);
            let join_ms = phase(15.0) + phase(20.0) + if fast { 0.0 } else { phase(60.0) };
            HandoverTime { radio_unit: "R".to_owned(), fast, scan_ms: Some(phase(100.0)), join_ms }
        };
        let handovers: Vec<_> = (0..30).map(&mut handover).collect();
        let fit = &fit_handovers(&testbed, &handovers, seed).unwrap()["lab"];
        coverage.count("scan", fit.scan_ms.unwrap(), scale * 100.0);
        coverage.count("fast transition", fit.fast_ms.unwrap(), scale * 35.0);
        coverage.count("full handover", fit.full_ms.unwrap(), scale * 95.0);
        coverage.count("variation", fit.variation, variation);
    }
    coverage.check();
}
