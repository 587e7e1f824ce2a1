//! One run has one figure, wherever it is read.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{collections::BTreeMap, fs, path::Path};

use serde_json::Value;

use crate::harness::{cotorra, project_file, stderr, stdout};

fn json(path: &Path) -> Value {
    serde_json::from_str(&fs::read_to_string(path).unwrap()).unwrap()
}

/// Reads a table, each row by its heads.
fn rows(text: &str) -> Vec<BTreeMap<&str, &str>> {
    let mut lines = text.lines();
    let heads: Vec<_> = lines.next().unwrap().split(',').collect();
    lines.map(|line| heads.iter().copied().zip(line.split(',')).collect()).collect()
}

fn of_service<'a>(services: &'a Value, name: &str) -> &'a Value {
    let found =
        services.as_array().unwrap().iter().find(|of| of["service"] == name || of["of"]["service"] == name);
    found.unwrap_or_else(|| panic!("{name}: {services}"))
}

fn succeed(command: &[&str], folder: &Path) -> String {
    let done = cotorra(command).current_dir(folder).output().unwrap();
    assert!(done.status.success(), "{command:?}: {}", stderr(&done));
    stdout(&done)
}

#[test]
fn a_run_has_the_same_figures_in_every_command() {
    let place = tempfile::tempdir().unwrap();
    let file = project_file("testbeds/corridor-wifi.yaml").display().to_string();
    let seed = ["--seed", "3", "--until", "60s", "--headless"];
    let run = [&["run", "--simulate", "--out", "runs", &file], &seed[..]].concat();
    let printed = succeed(&run, place.path());
    let folder = printed.lines().find_map(|line| line.strip_suffix('/')).unwrap().to_owned();
    let folder = Path::new(&folder);
    let summary = json(&folder.join("summary.json"));
    let services = fs::read_to_string(folder.join("services.csv")).unwrap();
    let name = folder.to_str().unwrap();

    let diff = succeed(&["history", "diff", name, name, "--json"], place.path());
    let diff: Value = serde_json::from_str(&diff).unwrap();
    let read = succeed(&["history", "diff", name, name], place.path());
    for service in ["navigation", "localization"] {
        let of = of_service(&summary["services"], service);
        let figures =
            ["p50", "p95", "p99", "max"].map(|figure| of["service_time_ms"][figure].as_f64().unwrap());
        let row = rows(&services).into_iter().find(|row| row["service"] == service).unwrap();
        let table = ["p50", "p95", "p99", "max"]
            .map(|figure| row[&*format!("service_time_{figure}_ms")].parse::<f64>().unwrap());
        assert_eq!(table, figures, "services.csv, {service}");

        let compared = &of_service(&diff["services"], service)["runs"];
        for run in [0, 1] {
            let values = &compared[run]["service_time_ms"];
            let [p50, p95, p99, max] = figures;
            assert_eq!(values["quantiles"], serde_json::json!([p50, p95, p99]), "history diff, {service}");
            assert_eq!((values["max"].as_f64(), &values["quantiles_within"]), (Some(max), &Value::Null));
            let samples = values["count"].as_u64().unwrap() + compared[run]["unanswered"].as_u64().unwrap();
            assert_eq!(Some(samples), of["samples"].as_u64(), "history diff, {service}");
            assert_eq!(compared[run]["unanswered"], of["unanswered"], "history diff, {service}");
        }
        // The terminal shows four digits, in the table of times.
        let beginning = format!("{service} of robot ");
        let lines: Vec<_> = read.lines().filter(|line| line.trim_start().starts_with(&beginning)).collect();
        let shows = |line: &&str| {
            [figures[0], figures[2]].into_iter().all(|figure| {
                let digits = if figure < 10.0 { 3 } else { 2 };
                line.matches(&format!(" {figure:.digits$}")).count() == 2
            })
        };
        assert!(lines.iter().any(shows), "{figures:?}: {lines:?}");

        let figure = format!("service_time:{service}");
        let series = ["history", "series", name, &figure, "--csv", "--points", "1"];
        let series = succeed(&series, place.path());
        let row = rows(&series).remove(0);
        let curve = ["p50", "p95", "p99", "max"].map(|figure| row[figure].parse::<f64>().unwrap());
        assert_eq!(curve, figures, "history series, {service}");
    }

    let sweep = ["sweep", &file, "--set", "seed=3", "--until", "60s", "--headless", "--out", "sweep"];
    succeed(&sweep, place.path());
    let swept = fs::read_to_string(place.path().join("sweep/services.csv")).unwrap();
    let margin = ["margin", &file, "--keep", "0.01", "--change", "down", "--on", "R6", "--out", "margin"];
    succeed(&[&margin, &seed[..]].concat(), place.path());
    let unchanged = json(&place.path().join("margin/margins.json"))["unchanged"].clone();
    let of = of_service(&summary["services"], "navigation");
    let row = rows(&swept).into_iter().find(|row| row["service"] == "navigation").unwrap();
    for figure in ["p50", "p95", "p99", "max"] {
        let swept: f64 = row[&*format!("service_time_{figure}_ms")].parse().unwrap();
        // A sweep's tables have nanoseconds.
        assert!((swept - of["service_time_ms"][figure].as_f64().unwrap()).abs() < 1e-6, "sweep, {figure}");
    }
    assert_eq!(row["samples"].parse().ok(), of["samples"].as_u64(), "sweep");
    let kept = of_service(&unchanged, "navigation");
    assert_eq!(kept["samples"], of["samples"], "margin");
    let above = of["above_target"].as_f64().unwrap();
    assert!((kept["kept"].as_f64().unwrap() - (1.0 - above)).abs() < 1e-12, "margin: {kept} {above}");
}
