use cotorra_testbed::{Inputs, Made, Origin};

use super::*;

/// Writes a folder with results.
fn results(folder: &Path, time: Time, words: &[&str], files: &[(&str, String)]) {
    fs::create_dir_all(folder).unwrap();
    let repeat = Repeat::Words(words.iter().map(|word| (*word).to_owned()).collect());
    let origin = Origin { repeat, ..Origin::default() };
    let made = Made { time, inexact: None, seeds: vec![1], until: None };
    Manifest::begin(folder, &origin, &made, &Inputs::default()).unwrap();
    files.iter().for_each(|(name, text)| fs::write(folder.join(name), text).unwrap());
    Manifest::complete(folder).unwrap();
}

/// A run of one service with a target of 15 ms. Its times go up from `least_ms`; each tenth has no answer.
fn run(least_ms: f64) -> [(&'static str, String); 2] {
    let line = |i: u32| {
        let took = least_ms + f64::from(i) / 100.0;
        let took = if i % 10 == 9 { String::new() } else { format!("{took:.6}") };
        format!("{i},robot,navigation,{i},{took},R1,edge\n")
    };
    let head = "emitted_ns,robot,service,sequence,service_time_ms,attachment,server\n".to_owned();
    let summary = r#"{
        "services": [
            { "robot": "robot", "service": "navigation", "service_time_target_ms": 15.0 },
            { "robot": "robot", "service": "unused", "service_time_target_ms": 15.0 }
        ],
        "fidelity": { "valid": true, "lateness_us": { "p99": 120.0 } }
    }"#;
    [
        ("service_time.csv", head + &(0..1000).map(line).collect::<String>()),
        ("summary.json", summary.to_owned()),
    ]
}

fn different(outcome: &Outcome) -> Vec<&str> {
    let Outcome::Bytes { different, .. } = outcome else { panic!("{outcome:?}") };
    different.iter().map(|path| path.to_str().unwrap()).collect()
}

#[test]
fn virtual_time_is_compared_to_the_byte() {
    let place = tempfile::tempdir().unwrap();
    let at = |name: &str| place.path().join(name);
    let files = |last: &str| [("runs.csv", "a".to_owned()), ("cells.csv", last.to_owned())];
    for (name, last) in [("one", "b"), ("same", "b"), ("other", "c")] {
        results(&at(name), Time::Virtual, &["sweep"], &files(last));
    }
    let compared = compare(&at("one"), &at("same")).unwrap();
    assert_eq!(compared[0].outcome, Outcome::Bytes { same: 2, different: Vec::new() });
    assert!(compared[0].is_same(0.01));
    let compared = compare(&at("one"), &at("other")).unwrap();
    assert_eq!(different(&compared[0].outcome), ["cells.csv"]);
    assert!(!compared[0].is_same(0.01));
    fs::remove_file(at("same/runs.csv")).unwrap();
    assert_eq!(different(&compare(&at("one"), &at("same")).unwrap()[0].outcome), ["runs.csv"]);
}

#[test]
fn real_time_is_compared_by_distribution() {
    let place = tempfile::tempdir().unwrap();
    let at = |name: &str| place.path().join(name);
    for (name, least_ms) in [("one", 8.0), ("near", 8.1), ("far", 9.0)] {
        results(&at(name), Time::Real, &["run"], &run(least_ms));
    }
    let of = |other: &str| compare(&at("one"), &at(other)).unwrap().remove(0);
    let near = of("near");
    let Outcome::Distributions { services, tolerance_ms, valid } = &near.outcome else { panic!("{near:?}") };
    assert_eq!(
        (*tolerance_ms, *valid, services.len()),
        (0.12, [true, true], 1),
        "a service without samples is left out"
    );
    assert_eq!(services[0].two.samples, [1000, 1000]);
    assert!(near.is_same(0.01) && !of("far").is_same(0.01));

    // Runs without samples, and figures that are not valid, confirm nothing.
    let [(_, samples), (_, summary)] = run(8.0);
    let head = samples.lines().next().unwrap().to_owned();
    for name in ["none", "nothing"] {
        let files = [("service_time.csv", head.clone()), ("summary.json", summary.clone())];
        results(&at(name), Time::Real, &["run"], &files);
    }
    assert!(!compare(&at("none"), &at("nothing")).unwrap()[0].is_same(0.01));
    let invalid = summary.replace("\"valid\": true", "\"valid\": false");
    results(
        &at("invalid"),
        Time::Real,
        &["run"],
        &[("service_time.csv", samples), ("summary.json", invalid)],
    );
    assert!(!of("invalid").is_same(0.01));

    fs::write(at("one/service_time.csv"), "edited").unwrap();
    assert!(matches!(compare(&at("one"), &at("near")), Err(RepeatError::Changed(_))));
}

#[test]
fn each_run_of_an_experiment_is_compared_in_its_own_time() {
    let place = tempfile::tempdir().unwrap();
    let at = |name: &str| place.path().join(name);
    for name in ["one", "other"] {
        results(&at(name), Time::Real, &["experiment", "handover"], &[("handover.md", name.to_owned())]);
        results(&at(name).join("hwsim-1"), Time::Real, &["run"], &run(8.0));
        results(&at(name).join("model-1"), Time::Virtual, &["run"], &[("summary.json", "a".to_owned())]);
    }
    let compared = compare(&at("one"), &at("other")).unwrap();
    assert_eq!(
        compared.iter().map(|its| its.of.to_str().unwrap()).collect::<Vec<_>>(),
        ["hwsim-1", "model-1"]
    );
    assert!(compared.iter().all(|its| its.is_same(0.01)), "{compared:?}");
    fs::remove_dir_all(at("other/model-1")).unwrap();
    assert_eq!(compare(&at("one"), &at("other")).unwrap()[1].outcome, Outcome::Missing);
}
