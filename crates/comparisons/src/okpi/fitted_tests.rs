use std::{env, path::Path, sync::Arc};

use cotorra_calibrate::FittedSetting;
use cotorra_testbed::{Altered, Unrecorded, simulate_unrecorded};
use cotorra_testbed_file::Setting;
use proptest::prelude::*;

use super::{
    fitted::{is_during, normal},
    times::Timed,
    *,
};

/// A walk of a minute past two radio units and back, with a scan each 2 to 3 s.
const SHORT: &str = "
name: short
wireless:
  lab:
    standard: n
    delay: 1 ms
    rate: 8 Mbit/s
    path_loss: { model: free_space }
    shadowing: { deviation: 0 dB }
    handover: { scan: 60 ms, authenticate: 5 ms, reassociate: 5 ms, variation: 10 % }
nodes:
  robot: { kind: robot, cpus: 1, memory: 1 GB, roaming: instructed }
  R1: { kind: radio_unit, position: [0, 1], channel: 1 }
  R2: { kind: radio_unit, position: [9, 1], channel: 6 }
  cloud: { kind: server, tier: cloud, cpus: 4, memory: 4 GB }
links:
  - { ends: [R1, cloud], delay: 4 ms }
  - { ends: [R2, cloud], delay: 8 ms }
services:
  navigation:
    robot: robot
    kpis: { service_time: 15 ms }
    vnfs:
      driver: { program: robot_driver, pinned_to: robot }
      navigation: { program: navigation, node: cloud, cpus: 1 }
walks:
  robot: { waypoints: [[0, 0], [9, 0]], and_back: true, speed_limit: 0.3 m/s, position_interval: 50 ms }
plugins:
  - { bundled: probing, settings: { interval: [2 s, 3 s] } }
";

/// Settings of the site that differ from the testbed file.
const SITE: [(&str, &str); 5] = [
    ("links.R1-cloud.forward.delay", "4.7 ms"),
    ("links.R1-cloud.forward.jitter", "{ deviation: 0.8 ms, distribution: normal }"),
    ("links.R2-cloud.backward.delay", "7.6 ms"),
    ("links.R2-cloud.backward.jitter", "{ deviation: 1.5 ms, distribution: normal }"),
    ("wireless.lab.handover.scan", "110 ms"),
];

fn parsed(settings: &[Setting]) -> Testbed {
    cotorra_testbed_file::parse_with("test.yaml", SHORT, Path::new(""), settings).unwrap()
}

fn walked(testbed: &Testbed, seed: u64) -> Report {
    let mut report = Report::new(testbed, seed);
    let run =
        Unrecorded { seed, until: None, altered: &Altered::default(), folder: Path::new(""), text: SHORT };
    simulate_unrecorded(Arc::new(testbed.clone()), &run, |event| report.absorb(event), || true).unwrap();
    report
}

fn beside<'a>(testbed: &'a Testbed, report: &'a Report, measured: &'a Measured) -> Walks<'a> {
    Walks { testbed, soa: report, okpi: report, measured: Some(measured), fitted: &[], seed: 1 }
}

fn measured_at_site(seed: u64) -> Measured {
    let site: Vec<_> = SITE.iter().map(|(path, value)| Setting::new(path, value).unwrap()).collect();
    let site = parsed(&site);
    let rows: Vec<_> = samples(&site, &walked(&site, seed))
        .map(|sample| {
            let ms = service_time_ms(&sample).map(|ms| format!("{ms:.3}")).unwrap_or_default();
            format!("{:.3},{ms}\n", sample.emitted.as_secs_f64())
        })
        .collect();
    Measured::parse(&rows.concat(), Contender::named("SoA")).unwrap()
}

/// Fits one walk. With `COTORRA_FULL`, it is 20 walks.
#[test]
fn intervals_of_a_fit_to_a_walk_hold_what_the_site_has() {
    let testbed = parsed(&[]);
    let unfitted = walked(&testbed, 1);
    // Of 100 intervals of 95 %, 13 or more miss with a probability of 0.2 %.
    let (sites, least) = if env::var_os("COTORRA_FULL").is_some() { (20, 88) } else { (1, 4) };
    let (mut held, mut all) = (0, 0);
    for seed in 2..2 + sites {
        let measured = measured_at_site(seed);
        let fit = fit(&beside(&testbed, &unfitted, &measured), &CONTENDERS[0]).unwrap();
        let [first, second] = &fit.regions[..] else { panic!("{fit:#?}") };
        let scan = fit.scan.as_ref().unwrap();
        for (name, found, of_site) in [
            ("first added", first.added_ms, 0.7),
            ("second added", second.added_ms, -0.4),
            ("first jitter", first.jitter_ms, 0.8),
            ("second jitter", second.jitter_ms, 1.5),
            ("scan", scan.scan_ms, 110.0),
        ] {
            (held, all) = (held + u32::from(found.covers(of_site)), all + 1);
            println!("site {seed}: {name} {of_site}: {found}");
        }
    }
    println!("{held} of {all} intervals hold the site's value");
    assert!(held >= least, "{held} of {all}");
}

#[test]
fn a_fit_to_half_of_a_walk_predicts_the_other_half() {
    let testbed = parsed(&[]);
    let unfitted = walked(&testbed, 1);
    let measured = measured_at_site(2);
    let walks = beside(&testbed, &unfitted, &measured);
    let [soa, okpi] = CONTENDERS;
    assert_eq!(fit(&walks, &okpi), None);
    let fit = fit(&walks, &soa).unwrap();
    let settings: Vec<_> = fit
        .settings
        .iter()
        .map(|FittedSetting { path, value, .. }| Setting::new(path, value).unwrap())
        .collect();
    let again = walked(&parsed(&settings), 1);
    let fitted = [FittedWalk { contender: soa, fit: &fit, report: &again }];
    let comparison = Comparison::of(&Walks { fitted: &fitted, ..walks });
    let [test] = &comparison.tests[..] else { panic!("{:#?}", comparison.tests) };
    let intervals = test.intervals.as_ref().unwrap();
    let intervals = [&intervals.p95_ms, &intervals.p99_ms, &intervals.above_40_ms];
    // How many of the predicted figures lie in the measured intervals.
    let within = |by| {
        let predicted = test.predictions.iter().find(|prediction| prediction.by == by).unwrap();
        let Distribution { p95_ms, p99_ms, above_40_ms, .. } = predicted.figures;
        let figures = [p95_ms, p99_ms, above_40_ms].into_iter().zip(intervals);
        figures.filter(|(figure, interval)| (interval.low..=interval.high).contains(figure)).count()
    };
    assert_eq!([Predictor::Fitted, Predictor::Unfitted].map(within), [3, 0], "{test:#?}");
    let text = comparison.to_markdown("in a test");
    for part in [
        "| SoA | R1 + cloud: added round trip, ms | 0.",
        "| SoA | duration of a scan, ms | 1",
        "| SoA | constant delay, normal jitter | ",
        "\n--set 'wireless.lab.handover.scan=1",
    ] {
        assert!(text.contains(part), "{part}\n{text}");
    }
    let csv = distribution::data(&comparison.distributions, &comparison.tests).to_csv();
    assert!(csv.contains("\nsecond half,SoA: fitted testbed,all,"), "{csv}");
}

#[test]
fn a_walk_that_determines_nothing_has_notes_and_baselines() {
    let testbed = parsed(&[]);
    let report = Report::new(&testbed, 1);
    let measured = Measured::parse("0,20\n1,20\n2,20\n3,20\n", None).unwrap();
    let walks = beside(&testbed, &report, &measured);
    let [soa, _] = CONTENDERS;
    let fit = fit(&walks, &soa).unwrap();
    assert!(fit.settings.is_empty() && fit.regions.is_empty() && fit.scan.is_none(), "{fit:#?}");
    let fitted = [FittedWalk { contender: soa, fit: &fit, report: &report }];
    let comparison = Comparison::of(&Walks { fitted: &fitted, ..walks });
    let by: Vec<_> = comparison.tests[0].predictions.iter().map(|prediction| prediction.by).collect();
    assert_eq!(by, [Predictor::Normal, Predictor::Replay]);
    let text = comparison.to_markdown("in a test");
    assert!(text.contains("Notes on the fit of SoA:\n\n- scans: "), "{text}");
}

#[test]
fn predictions_are_of_the_seconds_that_were_measured() {
    let second = [3.0, 4.0, 7.0].map(|at_s| Timed { at_s, ms: Some(1.0) });
    assert_eq!(
        [2.9, 3.0, 5.0, 7.0, 7.1].map(|at_s| is_during(&second, at_s)),
        [false, true, true, true, false]
    );
    assert!(!is_during(&[], 0.0));
}

fn timed(ms: &[Option<f64>]) -> Vec<Timed> {
    ms.iter().map(|ms| Timed { at_s: 0.0, ms: *ms }).collect()
}

#[test]
fn normal_jitter_has_the_moments_and_the_losses_of_the_samples() {
    let of = normal(&timed(&[Some(13.0), Some(17.0), None, Some(13.0), Some(17.0)])).unwrap();
    assert_eq!((of.samples, of.p50_ms), (5, 15.0));
    assert!((of.p95_ms - (15.0 + 2.0 * 1.644_854)).abs() < 1e-4, "{of:?}");
    assert!((of.above_15_ms - 0.6).abs() < 1e-9 && (of.above_40_ms - 0.2).abs() < 1e-9, "{of:?}");
    assert_eq!(normal(&timed(&[None])), None);
}

proptest! {
    #[test]
    fn figures_of_normal_jitter_are_shares_and_times(
        ms in prop::collection::vec(prop::option::of(0.001..60_000.0f64), 1..50),
        constant in 0.001..60_000.0f64,
    ) {
        if let Some(of) = normal(&timed(&ms)) {
            prop_assert!(0.0 <= of.above_40_ms && of.above_40_ms <= of.above_15_ms && of.above_15_ms <= 1.0);
            prop_assert!(0.0 <= of.p95_ms && of.p95_ms <= of.p99_ms);
        }
        let of = normal(&timed(&[Some(constant)])).unwrap();
        prop_assert_eq!((of.p95_ms, of.above_15_ms), (constant, f64::from(u8::from(constant > 15.0))));
    }
}
