use std::{path::Path, sync::Arc, time::Duration};

use cotorra_graph::{Event, Stamped, Timestamp};
use cotorra_graph_testing as base;
use cotorra_numbers::Interval;
use cotorra_testbed::{Altered, Unrecorded, simulate_unrecorded};

use super::*;

pub(super) const TESTBED: &str = "
name: small
wireless: { lab: { standard: n, delay: 1 ms, path_loss: { model: free_space } } }
nodes:
  robot: { kind: robot, cpus: 1, memory: 1 GB, roaming: instructed }
  R1: { kind: radio_unit, position: [0, 1], channel: 1 }
  cloud: { kind: server, tier: cloud, cpus: 4, memory: 4 GB }
links:
  - { ends: [R1, cloud], delay: 1 ms }
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

fn testbed() -> Testbed {
    cotorra_testbed_file::parse("test.yaml", TESTBED, Path::new("")).unwrap()
}

/// A walk of 100 s with ten samples a second: each 25 s one of `spike` ms, and one without an answer.
fn walk(testbed: &Testbed, usual: f64, spike: f64) -> Report {
    let mut report = Report::new(testbed, 1);
    for i in 0..1000_u32 {
        let ms = match i % 250 {
            5 => Some(spike),
            6 => None,
            _ => Some(usual + f64::from(i % 7) / 10.0),
        };
        report.absorb(&sample(i, f64::from(i) / 10.0, "R1", ms));
    }
    report
}

fn sample(sequence: u32, seconds: f64, attachment: &str, ms: Option<f64>) -> Stamped {
    let emitted = Timestamp::from_secs_f64(seconds);
    let event = Event::ServiceTime(ServiceTime {
        sequence,
        attachment: Some(attachment.parse().unwrap()),
        ..base::service_time("cloud", emitted, ms.map(|ms| Duration::from_secs_f64(ms / 1e3)))
    });
    Stamped { at: emitted, event }
}

/// A measured walk with one sample a second: 11 ms, and from 50 s on 45 ms.
fn measured(contender: Option<Contender>) -> Measured {
    let rows: String = (0..100).map(|i| format!("{i},{}\n", if i < 50 { 11 } else { 45 })).collect();
    Measured::parse(&rows, contender).unwrap()
}

fn with<T>(measured: Option<&Measured>, then: impl FnOnce(&Walks<'_>) -> T) -> T {
    let testbed = testbed();
    let (soa, okpi) = (walk(&testbed, 20.0, 150.0), walk(&testbed, 11.0, 60.0));
    then(&Walks { testbed: &testbed, soa: &soa, okpi: &okpi, measured, fitted: &[], seed: 1 })
}

#[test]
fn all_samples_and_one_a_second_are_told_apart() {
    with(None, |walks| {
        let comparison = Comparison::of(walks);
        let rows: Vec<_> = comparison.distributions.iter().collect();
        let names: Vec<_> = rows.iter().map(|of| (of.walk, of.sampling, of.distribution.samples)).collect();
        use Sampling::*;
        assert_eq!(
            names,
            [("SoA", All, 1000), ("SoA", OneASecond, 100), ("OKpi", All, 1000), ("OKpi", OneASecond, 100)]
        );
        // The spikes lie between the samples of whole seconds.
        let above_40: Vec<_> = rows.iter().map(|of| of.distribution.above_40_ms).collect();
        assert_eq!(above_40, [0.008, 0.0, 0.008, 0.0]);
        assert_eq!(rows[0].distribution.above_15_ms, 1.0);
        assert!(rows.iter().all(|of| of.intervals.is_none()));
    });
}

#[test]
fn walks_with_prices_and_powers_are_compared_by_what_they_spent() {
    let text = format!("currency: EUR\n{TESTBED}").replace(
        "cloud: { kind: server, tier: cloud,",
        "cloud: { kind: server, cost: 0, power: { idle: 100 W, full: 200 W, cost: 0.3 }, tier: cloud,",
    );
    let folder = tempfile::tempdir().unwrap();
    let summaries = [1, 2].map(|seconds| {
        let testbed = cotorra_testbed_file::parse("test.yaml", &text, Path::new("")).unwrap();
        let run = Unrecorded {
            seed: 1,
            until: Some(Duration::from_secs(seconds)),
            altered: &Altered::default(),
            folder: folder.path(),
            text: &text,
        };
        simulate_unrecorded(Arc::new(testbed), &run, |_| {}, || true).unwrap().unwrap().summary
    });
    with(None, |walks| {
        let comparison = Comparison::of(walks);
        assert!(!serde_json::to_string(&comparison).unwrap().contains("spent"), "nothing has a price there");
        let text = comparison.with_spent([&summaries[0], &summaries[1]]).to_markdown("in a test");
        // A tenth of a kWh in each hour.
        assert!(text.contains("| price of everything | 0.03 EUR | 0.03 EUR |"), "{text}");
        assert!(text.contains("| mean power of server cloud | 100.00 W | 100.00 W |"), "{text}");
    });
}

#[test]
fn a_measured_walk_and_its_halves_stand_beside_the_simulated() {
    let measured = measured(None);
    with(Some(&measured), |walks| {
        let comparison = Comparison::of(walks);
        let of = |span| comparison.distributions.iter().filter(move |of| of.span == span);
        let found = |span| of(span).find(|of| of.walk == "measured").unwrap();
        let above_40 =
            [Span::Whole, Span::FirstHalf, Span::SecondHalf].map(|span| found(span).distribution.above_40_ms);
        assert_eq!(above_40, [0.5, 0.0, 1.0]);
        let intervals = found(Span::Whole).intervals.unwrap();
        assert!(intervals.above_40_ms.low < 0.5 && intervals.above_40_ms.high > 0.5, "{intervals:?}");
        assert_eq!(found(Span::FirstHalf).intervals.unwrap().p95_ms, Interval { low: 11.0, high: 11.0 });
        assert_eq!((of(Span::Whole).count(), of(Span::FirstHalf).count()), (5, 3));
        let text = comparison.to_markdown("in a test");
        assert!(text.contains("| second half | measured | 45.00 (45.00 to 45.00) |"), "{text}");
        assert!(text.contains("| second half | OKpi | "), "{text}");
        let csv = distribution::data(&comparison.distributions, &[]).to_csv();
        assert_eq!(csv.lines().count(), 12);
        assert!(csv.contains("\nfirst half,measured,all,50,11,11,11,0,0,11,11,11,11,0,0,0,0\n"), "{csv}");
    });
}

#[test]
fn a_walk_of_one_contender_is_drawn_beside_it_alone() {
    let measured = measured(Contender::named("OKpi"));
    with(Some(&measured), |walks| {
        let figure = drawn::figure(walks);
        let is_drawn =
            |panel: usize| figure.panels[panel].series.iter().any(|series| series.name == "measured");
        assert_eq!([0, 1, 2].map(is_drawn), [false, true, true]);
    });
}

#[test]
fn the_figure_has_both_walks_over_time_and_their_distributions() {
    for measured in [None, Some(measured(None))] {
        with(measured.as_ref(), |walks| {
            let figure = drawn::figure(walks);
            assert_eq!(figure.draw().collisions(), Vec::<String>::new());
            let [soa, okpi, distributions] = &figure.panels[..] else { panic!("three panels") };
            assert_eq!((&soa.x, &soa.y), (&okpi.x, &okpi.y));
            let names = |panel: &cotorra_figure::Panel| -> Vec<String> {
                panel
                    .series
                    .iter()
                    .map(|series| series.name.clone())
                    .filter(|name| name != "measured")
                    .collect()
            };
            let published = "published medians (arXiv 2101.07676)";
            assert_eq!(names(soa), ["all samples", "one a second", published]);
            assert_eq!(names(okpi), ["all samples", "one a second", "OKpi-t", published]);
            assert_eq!(
                names(distributions),
                ["SoA, all", "SoA, one a second", "OKpi, all", "OKpi, one a second"]
            );
            assert_eq!(distributions.upright.as_ref().map(|level| level.at), Some(15.0));
            // The same thing has the same look everywhere.
            let looks = |panel: &cotorra_figure::Panel, name: &str| {
                panel.series.iter().find(|series| series.name == name).map(|series| series.look)
            };
            assert_eq!(looks(soa, "one a second"), looks(distributions, "SoA, one a second"));
            assert_eq!(looks(okpi, "one a second"), looks(distributions, "OKpi, one a second"));
            assert_eq!(looks(soa, "measured"), looks(distributions, "measured"));
            assert_eq!(looks(soa, "measured").is_some(), measured.is_some());
        });
    }
}

#[test]
fn published_medians_stand_over_the_time_in_their_part_of_the_walk() {
    let testbed = testbed();
    let along = ["R1", "R3", "R4", "R5", "R6", "R2", "elsewhere", "R1"];
    let mut report = Report::new(&testbed, 1);
    for second in 0..80_u32 {
        report.absorb(&sample(second, f64::from(second), along[second as usize / 10], Some(20.0)));
    }
    let walks =
        Walks { testbed: &testbed, soa: &report, okpi: &report, measured: None, fitted: &[], seed: 1 };
    let figure = drawn::figure(&walks);
    assert_eq!(figure.draw().collisions(), Vec::<String>::new());
    let drawn = |panel: usize| -> Vec<(f64, f64, f64)> {
        let name = "published medians (arXiv 2101.07676)";
        let series = figure.panels[panel].series.iter().find(|series| series.name == name).unwrap();
        let stretch = |part: &Vec<_>| -> (f64, f64, f64) {
            let [from, to]: &[cotorra_figure::Sample; 2] = part.as_slice().try_into().unwrap();
            assert_eq!(from.y, to.y);
            (from.x, to.x, to.y)
        };
        series.parts.iter().map(stretch).collect()
    };
    let stretches = [(0.0, 19.0), (20.0, 29.0), (30.0, 49.0), (50.0, 59.0), (70.0, 79.0)];
    let medians = |of: fn(&Part) -> f64| -> Vec<(f64, f64, f64)> {
        let comparison = Comparison::of(&walks);
        stretches.iter().zip(&comparison.parts).map(|((from, to), part)| (*from, *to, of(part))).collect()
    };
    assert_eq!(drawn(0), medians(|part| part.published_soa_ms));
    assert_eq!(drawn(1), medians(|part| part.published_okpi_ms));
}

#[test]
fn walks_without_answers_have_no_distribution() {
    let testbed = testbed();
    let report = Report::new(&testbed, 1);
    let walks =
        Walks { testbed: &testbed, soa: &report, okpi: &report, measured: None, fitted: &[], seed: 1 };
    assert_eq!(Comparison::of(&walks).distributions, []);
    let figure = drawn::figure(&walks);
    assert_eq!((figure.panels.len(), figure.draw().collisions()), (2, Vec::new()));
}

#[test]
fn every_file_is_written() {
    let folder = tempfile::tempdir().unwrap();
    with(None, |walks| {
        Comparison::of(walks).write(folder.path(), "in a test", walks).unwrap();
    });
    let mut written: Vec<_> = std::fs::read_dir(folder.path())
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    written.sort();
    let mut expected = FILES.map(str::to_owned);
    expected.sort();
    assert_eq!(written, expected);
}
