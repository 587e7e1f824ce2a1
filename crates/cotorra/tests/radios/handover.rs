//! `cotorra experiment handover` on both kinds of radio.

use std::{env, fs};

use serde_json::Value;

use crate::{
    harness::{cotorra, stderr, stdout},
    rig::FLOOR,
};

#[test]
fn gaps_of_the_model_are_beside_those_of_real_software() {
    if env::var_os("COTORRA_RADIOS").is_none() {
        eprintln!("skipped: COTORRA_RADIOS promises no radios");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let testbed = folder.path().join("testbed.yaml");
    fs::write(&testbed, FLOOR).unwrap();
    let out = folder.path().join("runs");
    let mut command =
        cotorra(["experiment", "handover", "--headless", "--save-power", "--until", "12s", "--testbed"]);
    let output = command.arg(&testbed).arg("--out").arg(&out).output().unwrap();
    assert!(output.status.success(), "{}{}", stdout(&output), stderr(&output));
    println!("{}", stdout(&output));
    let folder = fs::read_dir(&out).unwrap().next().unwrap().unwrap().path();
    let comparison = fs::read_to_string(folder.join("handover.json")).unwrap();
    let comparison: Value = serde_json::from_str(&comparison).unwrap();
    let rows = comparison["rows"].as_array().unwrap();
    let of = |kind: &str| rows.iter().find(|row| row["kind"] == kind && row["walk"] == "sent").unwrap();
    for kind in ["model", "hwsim"] {
        let row = of(kind);
        assert!(row["roams"].as_u64().unwrap() >= 3, "{row}");
        // The frames alone take 14.2 ms, and waits for ticks up to 4 ms more. Nobody else sends much.
        let gap = row["gap_p50_ms"].as_f64().unwrap();
        assert!((14.0..21.0).contains(&gap), "{row}");
        // Two or three channels of 65 to 70 ms, with 200 ms between them.
        let scan = row["scan_p50_ms"].as_f64().unwrap();
        assert!((320.0..620.0).contains(&scan), "{row}");
    }
    let figures =
        comparison["verdicts"].as_array().unwrap().iter().map(|verdict| verdict["figure"].as_str().unwrap());
    assert_eq!(
        figures.collect::<Vec<_>>(),
        ["gap p50", "gap p95", "gap by packets p50", "gap by packets p95"]
    );
}
