use std::path::Path;

use proptest::prelude::*;

use super::*;

const TESTBED: &str = "
name: two-regions
wireless:
  lab:
    standard: n
    delay: 1 ms
    path_loss: { model: free_space }
    handover: { scan: 100 ms, authenticate: 5 ms, reassociate: 5 ms, variation: 0 % }
nodes:
  robot: { kind: robot, cpus: 1, memory: 1 GB, roaming: instructed }
  R1: { kind: radio_unit, position: [0, 1], channel: 1 }
  R2: { kind: radio_unit, position: [9, 1], channel: 6 }
  cloud: { kind: server, tier: cloud, cpus: 4, memory: 4 GB }
links:
  - { ends: [R1, cloud], delay: 4 ms }
  - { ends: [R2, cloud], delay: 9 ms, jitter: 0.5 ms }
services:
  navigation:
    robot: robot
    kpis: { service_time: 15 ms }
    vnfs:
      driver: { program: robot_driver, pinned_to: robot }
      navigation: { program: navigation, node: cloud, cpus: 1 }
walks:
  robot: { waypoints: [[0, 0], [1, 0]], speed_limit: 0.3 m/s }
";

fn testbed(text: &str) -> Testbed {
    cotorra_testbed_file::parse("test.yaml", text, Path::new("")).unwrap()
}

fn region(unit: &str) -> Region {
    Region { radio_unit: unit.parse().unwrap(), server: "cloud".parse().unwrap() }
}

/// Delays of a walk of 200 s with 20 samples a second. It changes from R1 to R2 after 100 s.
#[derive(Clone, Copy)]
struct Site {
    usual_ms: [f64; 2],
    deviation_ms: [f64; 2],
    distribution: JitterDistribution,
    scan_every_ms: f64,
    /// Visits of each scan, with returns of 200 ms.
    visits: f64,
    /// Duration of each.
    scan_ms: f64,
}

/// As the testbed file has it.
const SIMULATED: Site = Site {
    usual_ms: [10.0, 20.0],
    deviation_ms: [0.0, 0.5],
    distribution: JitterDistribution::Normal,
    scan_every_ms: 5317.0,
    visits: 1.0,
    scan_ms: 100.0,
};

impl Site {
    fn walk(&self, seed: u64) -> Vec<SimulatedSample> {
        let draws = &mut Draws::new(seed, "site");
        (0..4000)
            .map(|i| {
                let at_s = f64::from(i) / 20.0;
                let in_second = usize::from(at_s >= 100.0);
                let usual = self.usual_ms[in_second];
                let jitter = self.deviation_ms[in_second] * jitter::draw(self.distribution, draws);
                let request_ms = self.held_ms(at_s * 1e3);
                // The air takes 1 ms in each direction.
                let answer_ms = || self.held_ms(at_s * 1e3 + usual - 2.0);
                let held = if request_ms > 0.0 { request_ms } else { answer_ms() };
                let ms = Some((usual + jitter + held).max(0.1));
                let region = Some(region(["R1", "R2"][in_second]));
                SimulatedSample { sample: WalkSample { at_s, ms }, region }
            })
            .collect()
    }

    /// Returns how long a frame is held that comes at this time, ms.
    fn held_ms(&self, at_ms: f64) -> f64 {
        let since = at_ms % self.scan_every_ms;
        let is_scanning = at_ms > self.scan_every_ms - 317.0 && since / (self.scan_ms + 200.0) < self.visits;
        let in_visit = since % (self.scan_ms + 200.0);
        if is_scanning { (self.scan_ms - in_visit).max(0.0) } else { 0.0 }
    }

    fn measured(&self, seed: u64) -> Vec<WalkSample> {
        self.walk(seed).into_iter().map(|simulated| simulated.sample).collect()
    }
}

fn fit(measured: &[WalkSample]) -> WalkFit {
    fit_to(&testbed(TESTBED), &SIMULATED.walk(1), measured)
}

fn fit_to(testbed: &Testbed, simulated: &[SimulatedSample], measured: &[WalkSample]) -> WalkFit {
    let robot = &"robot".parse().unwrap();
    fit_walk(&WalkData { testbed, robot, simulated, measured }, 1)
}

#[test]
fn delays_jitter_and_scans_of_a_site_are_found() {
    let site = Site {
        usual_ms: [11.5, 19.2],
        deviation_ms: [0.8, 1.3],
        distribution: JitterDistribution::Normal,
        scan_ms: 160.0,
        ..SIMULATED
    };
    let fits: Vec<_> = (2..10).map(|seed| fit(&site.measured(seed))).collect();
    // Of eight intervals of 95 %, one or two may miss.
    let held = |of: &dyn Fn(&WalkFit) -> bool| fits.iter().filter(|fit| of(fit)).count() >= 6;
    for (i, added, jitter) in [(0, 1.5, 0.8), (1, -0.8, 1.3)] {
        assert!(held(&|fit| fit.regions[i].added_ms.covers(added)), "{fits:#?}");
        assert!(held(&|fit| fit.regions[i].jitter_ms.covers(jitter)), "{fits:#?}");
    }
    assert!(held(&|fit| fit.scan.as_ref().is_some_and(|scan| scan.scan_ms.covers(160.0))), "{fits:#?}");
    let fit = &fits[0];
    let paths: Vec<_> = fit.settings.iter().map(|setting| setting.path.as_str()).collect();
    let expected = [
        "links.R1-cloud.forward.delay",
        "links.R1-cloud.backward.delay",
        "links.R1-cloud.forward.jitter",
        "links.R2-cloud.forward.delay",
        "links.R2-cloud.backward.delay",
        "links.R2-cloud.forward.jitter",
        "wireless.lab.handover.scan",
    ];
    assert_eq!(paths, expected);
    assert_eq!(fit.notes, Vec::<String>::new());
}

/// As Linux scans both bands: the truth is 24 visits of 111 ms each 22 s.
const DIVIDED: Site = Site {
    usual_ms: [10.0, 20.0],
    deviation_ms: [0.8, 1.3],
    distribution: JitterDistribution::Normal,
    scan_every_ms: 22_317.0,
    visits: 24.0,
    scan_ms: 111.0,
};

#[test]
fn visits_of_a_scan_are_counted_and_add_no_jitter() {
    for seed in 2..6 {
        let fit = fit(&DIVIDED.measured(seed));
        let scan = fit.scan.as_ref().unwrap();
        assert!((scan.scan_ms.value - 111.0).abs() < 5.0, "{scan:?}");
        assert!((21.0..27.0).contains(&scan.visits.unwrap().value), "{scan:?}");
        for (of, jitter) in fit.regions.iter().zip(DIVIDED.deviation_ms) {
            assert!((of.jitter_ms.value - jitter).abs() < 0.2, "{of:?}");
        }
        // The fitted testbed has these scans.
        let setting = fit.settings.iter().find(|its| its.path == "wireless.lab.handover.scan").unwrap();
        let setting = cotorra_testbed_file::Setting::new(&setting.path, &setting.value).unwrap();
        let fitted =
            cotorra_testbed_file::parse_with("test.yaml", TESTBED, Path::new(""), &[setting]).unwrap();
        let handover = fitted.graph.wireless["lab"].handover;
        let dwell_ms = handover.visits.unwrap().dwell.as_secs_f64() * 1e3;
        assert!((dwell_ms - scan.scan_ms.value).abs() < 0.01, "{handover:?}");
    }
}

#[test]
fn visits_are_counted_by_rare_samples_if_scans_are_as_frequent_as_simulated() {
    let simulated = Site { visits: 1.0, scan_ms: 100.0, ..DIVIDED }.walk(1);
    let measured: Vec<_> = DIVIDED.measured(2).into_iter().step_by(20).collect();
    let fit = fit_to(&testbed(TESTBED), &simulated, &measured);
    let scan = fit.scan.unwrap();
    assert!((15.0..33.0).contains(&scan.visits.unwrap().value), "{scan:?}");
}

/// The robot changes its radio unit after each scan, as with the plug-in `probing` where each scan finds a stronger one.
#[test]
fn scans_right_before_changes_of_region_count_by_rare_samples() {
    let site = Site { usual_ms: [10.0; 2], scan_every_ms: 20_317.0, ..DIVIDED };
    // A scan of one visit ends at its end, and one of 24 visits after 7.3 s.
    let changing = |site: Site, seed| {
        let mut walk = site.walk(seed);
        let lasts_s = (site.visits * (site.scan_ms + 200.0) - 200.0) / 1e3;
        for its in &mut walk {
            let scans = ((its.sample.at_s - lasts_s) * 1e3 / site.scan_every_ms).floor();
            its.region = Some(region(["R1", "R2"][usize::from(scans.max(0.0) % 2.0 > 0.0)]));
        }
        walk
    };
    let simulated = changing(Site { visits: 1.0, scan_ms: 100.0, ..site }, 1);
    let fits = (2..7).map(|seed| {
        let measured: Vec<_> = changing(site, seed).into_iter().map(|its| its.sample).collect();
        // Each 19th sample, so that they are at all times of the visits.
        let rare: Vec<_> = measured.into_iter().skip(seed as usize).step_by(19).collect();
        fit_to(&testbed(TESTBED), &simulated, &rare).scan.unwrap().visits.unwrap()
    });
    let visits: Vec<_> = fits.collect();
    let mean = visits.iter().map(|its| its.value).sum::<f64>() / visits.len() as f64;
    assert!((mean - 24.0).abs() < 4.0, "{visits:?}");
    assert!(visits.iter().filter(|its| its.covers(24.0)).count() >= 4, "{visits:?}");
}

#[test]
fn a_walk_like_the_simulated_one_changes_nothing() {
    let fit = fit(&SIMULATED.measured(2));
    for of in &fit.regions {
        assert!(of.added_ms.value.abs() < 0.05, "{of:?}");
    }
    assert!(fit.regions[0].jitter_ms.value == 0.0 && fit.regions[1].jitter_ms.covers(0.5), "{fit:#?}");
    let scan = fit.scan.unwrap();
    assert!((scan.scan_ms.value - 100.0).abs() < 3.0 && scan.share.covers(scan.simulated_share), "{scan:?}");
}

#[test]
fn intervals_are_wider_where_the_simulated_walk_varies() {
    let measured = Site { deviation_ms: [0.8, 0.8], ..SIMULATED }.measured(2);
    let width = |deviation: f64| {
        let simulated = Site { deviation_ms: [deviation; 2], ..SIMULATED }.walk(1);
        let added = fit_to(&testbed(TESTBED), &simulated, &measured).regions[0].added_ms;
        added.high - added.low
    };
    let (constant, varying) = (width(0.0), width(0.8));
    assert!((1.2..1.7).contains(&(varying / constant)), "{constant} {varying}");
}

#[test]
fn jitter_above_the_delay_of_its_link_is_noted() {
    let site = Site { deviation_ms: [3.5, 0.5], ..SIMULATED };
    let fit = fit(&site.measured(2));
    let value = |key: &str| {
        let path = format!("links.R1-cloud.{key}.delay");
        fit.settings.iter().find(|its| its.path == path).unwrap().value.as_str()
    };
    assert_eq!(value("backward"), "0.0000 ms", "{fit:#?}");
    assert!(
        fit.notes[0].starts_with("R1 + cloud: the delay of `R1-cloud` is shorter than its jitter"),
        "{fit:#?}"
    );
}

#[test]
fn the_distribution_of_the_jitter_is_found_with_many_samples_and_normal_with_few() {
    let site = Site { distribution: JitterDistribution::Pareto, deviation_ms: [1.0, 1.0], ..SIMULATED };
    let all = site.measured(3);
    let one_a_second: Vec<_> = all.iter().copied().step_by(20).collect();
    let distributions = |fit: &WalkFit| fit.regions.iter().map(|of| of.distribution).collect::<Vec<_>>();
    let (many, few) = (fit(&all), fit(&one_a_second));
    assert_eq!(distributions(&many), [JitterDistribution::Pareto; 2]);
    assert_eq!(distributions(&few), [JitterDistribution::Normal; 2]);
    // Fewer samples determine less.
    let width = |fit: &WalkFit| fit.regions[0].added_ms.high - fit.regions[0].added_ms.low;
    assert!(width(&few) > 2.0 * width(&many), "{} {}", width(&few), width(&many));
}

#[test]
fn few_samples_are_refused_and_named() {
    let few: Vec<_> = SIMULATED.measured(2).into_iter().filter(|s| s.at_s < 80.0 || s.at_s > 199.5).collect();
    let fit = fit(&few);
    assert_eq!(fit.regions.len(), 1);
    let note = "R2 + cloud: a fit needs 20 measured samples away from changes of region, and the walk has 9";
    assert!(fit.notes.iter().any(|found| found == note), "{:?}", fit.notes);
    let nothing = fit_to(&testbed(TESTBED), &SIMULATED.walk(1), &few[..3]);
    assert_eq!((nothing.regions, nothing.scan, nothing.settings), (Vec::new(), None, Vec::new()));
}

#[test]
fn spikes_are_refused_where_nothing_scans_or_visits_differ() {
    let still = Site { scan_ms: 0.0, ..SIMULATED };
    let measured = SIMULATED.measured(2);
    let refused = |fit: WalkFit| (fit.scan, fit.notes.last().cloned().unwrap_or_default());
    let (scan, note) = refused(fit_to(&testbed(TESTBED), &still.walk(1), &measured));
    assert_eq!(scan, None);
    assert!(note.ends_with("the simulated walk has 0"), "{note}");
    for (from, to, why) in [
        ("scan: 100 ms", "scan: { channels: 2, passive: 1 }", "visits of two durations"),
        ("delay: 1 ms\n", "delay: 1 ms\n    gap: drop\n", "`gap: drop` loses what comes during a scan"),
    ] {
        let (scan, note) =
            refused(fit_to(&testbed(&TESTBED.replace(from, to)), &SIMULATED.walk(1), &measured));
        assert_eq!(scan, None);
        assert!(note.contains(why), "{note}");
    }
}

#[test]
fn a_region_without_a_link_of_its_own_is_refused() {
    let shared = TESTBED.replace(
        "  - { ends: [R1, cloud], delay: 4 ms }\n  - { ends: [R2, cloud], delay: 9 ms, jitter: 0.5 ms }\n",
        "  - { ends: [R1, R2], delay: 1 ms }\n  - { ends: [R2, cloud], delay: 4 ms }\n",
    );
    let fit = fit_to(&testbed(&shared), &SIMULATED.walk(1), &SIMULATED.measured(2));
    let fitted: Vec<_> = fit.regions.iter().map(|of| (of.region.to_string(), of.link.as_str())).collect();
    assert_eq!(fitted, [("R1 + cloud".to_owned(), "R1-R2")]);
    assert!(
        fit.notes[0].starts_with("R2 + cloud: each of its wired links carries another region"),
        "{fit:#?}"
    );
}

#[test]
fn the_same_seed_gives_the_same_fit() {
    let measured = SIMULATED.measured(2);
    assert_eq!(fit(&measured), fit(&measured));
}

/// Series that a walk may have: constant, short, without answers, far above or below the simulated ones.
fn series() -> impl Strategy<Value = Vec<WalkSample>> {
    let ms = prop_oneof![
        Just(None),
        Just(Some(10.0)),
        (0.001..60_000.0f64).prop_map(Some),
        (9.0..21.0f64).prop_map(Some)
    ];
    let samples = prop::collection::vec((0.0..300.0f64, ms), 0..120);
    samples.prop_map(|mut samples| {
        samples.sort_by(|(a, _), (b, _)| a.total_cmp(b));
        samples.into_iter().map(|(at_s, ms)| WalkSample { at_s, ms }).collect()
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn any_series_gives_finite_values_that_the_testbed_file_accepts(measured in series()) {
        let simulated: Vec<_> = SIMULATED.walk(1).into_iter().step_by(10).collect();
        let fit = fit_to(&testbed(TESTBED), &simulated, &measured);
        for of in &fit.regions {
            let all = [of.added_ms, of.jitter_ms];
            prop_assert!(all.iter().all(|e| e.value.is_finite() && e.low <= e.high), "{:?}", of);
            prop_assert!(of.jitter_ms.low >= 0.0);
        }
        let settings = fit.settings.iter().map(|its| {
            cotorra_testbed_file::Setting::new(&its.path, &its.value).unwrap()
        });
        let settings: Vec<_> = settings.collect();
        let changed = cotorra_testbed_file::parse_with("test.yaml", TESTBED, Path::new(""), &settings);
        prop_assert!(changed.is_ok(), "{:?} {:?}", settings, changed.err());
    }

    #[test]
    fn a_constant_series_has_no_jitter_and_no_interval(ms in 15.0..60.0f64) {
        let constant = |at_s| WalkSample { at_s, ms: Some(ms) };
        let measured: Vec<_> = (0..90).map(|second| constant(f64::from(second))).collect();
        let fit = fit(&measured);
        let of = &fit.regions[0];
        prop_assert!((of.added_ms.value - (ms - 10.0)).abs() < 1e-6);
        prop_assert_eq!([of.added_ms.low, of.added_ms.high], [of.added_ms.value; 2]);
        prop_assert!(of.jitter_ms.high < 1e-6, "{:?}", of);
    }
}
