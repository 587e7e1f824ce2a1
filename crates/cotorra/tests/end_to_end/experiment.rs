//! Published experiments, repeated.

use std::fs;

use serde_json::Value;

use crate::harness::{corridor, cotorra, stderr, stdout};

#[test]
fn okpi_and_the_state_of_the_art_are_compared_in_virtual_time() {
    let out = tempfile::tempdir().unwrap();
    let run = |extra: &[&str]| {
        let mut command = cotorra(["experiment", "okpi", "--headless", "--testbed"]);
        command.arg(corridor()).arg("--out").arg(out.path()).args(extra).output().unwrap()
    };
    let dry = run(&["--dry-run"]);
    assert!(stdout(&dry).contains("comparison.svg") && dry.status.success(), "{}", stderr(&dry));
    assert_eq!(fs::read_dir(out.path()).unwrap().count(), 0, "a dry run leaves nothing");

    let output = run(&[]);
    assert!(output.status.success(), "{}", stderr(&output));
    let folder = fs::read_dir(out.path()).unwrap().next().unwrap().unwrap().path();
    let read = |name: &str| fs::read_to_string(folder.join(name)).unwrap_or_else(|e| panic!("{name}: {e}"));
    assert!(stdout(&output).starts_with(&read("comparison.md")));
    assert!(read("comparison.svg").contains("OKpi-t"));
    assert!(read("samples.csv").lines().count() > 16_000);
    for walk in ["probing", "okpi"] {
        assert!(read(&format!("{walk}/testbed.yaml")).contains(&format!("# set: plugin={walk}")));
    }

    let comparison: Value = serde_json::from_str(&read("comparison.json")).unwrap();
    for part in comparison["parts"].as_array().unwrap() {
        let ms = |key: &str| part[key].as_f64().unwrap_or_else(|| panic!("{key} of {part}"));
        assert_eq!(ms("theory_ms"), ms("published_theory_ms"), "{part}");
        assert!((ms("okpi_ms") - ms("published_okpi_ms")).abs() <= 0.5, "{part}");
        assert!((ms("soa_ms") - ms("published_soa_ms")).abs() <= 0.65, "{part}");
    }
    let changes = comparison["changes"].as_array().unwrap();
    let decided: Vec<_> =
        changes.iter().map(|c| format!("{} {}", c["radio_unit"], c["server"]).replace('"', "")).collect();
    assert_eq!(decided, ["R3 cloud", "R2 edge", "R5 fog", "R2 edge", "R3 cloud", "R1 cloud"]);
    assert!(changes.iter().all(|c| c["off_published_m"].as_f64().unwrap() <= 0.5), "{changes:#?}");
    let okpi = &comparison["above_target"][1];
    assert_eq!(okpi["contender"], "OKpi");
    assert_eq!(okpi["away_from_handovers"], 0.0);
    assert!(comparison["above_target"][0]["of_all"].as_f64().unwrap() > 0.5);
}
