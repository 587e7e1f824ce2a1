//! `cotorra-lab experiment handover` on all kinds of radio.

use std::{env, fs, path::PathBuf};

use serde_json::Value;

use crate::{
    harness::{cotorra, stderr, stdout},
    rig::FLOOR,
};

/// [`FLOOR`] with machines for its radios, but without `C`.
const AT_AGENTS: &str = "\
name: agents
wireless:
  lab:
    security: { method: wpa2, passphrase: correct horse }
    path_loss: { model: log_distance, exponent: 3.0 }
    shadowing: { deviation: 0 dB }
nodes:
  r1: { kind: robot, roaming: instructed, agent: robot1, interface: wlan0 }
  A: { kind: radio_unit, position: [0, 0], channel: 1, agent: ap1, interface: wlan1, bridge: br0 }
  B: { kind: radio_unit, position: [12, 0], channel: 6, agent: ap2, interface: wlan2, bridge: br0 }
  lan: { kind: switch }
  fog: { kind: server, tier: fog, cpus: 4, memory: 8 GB }
links:
  - { ends: [lan, [A, B, fog]], delay: 1 ms, rate: 100 Mbit/s }
services:
  navigation:
    robot: r1
    kpis: { service_time: 50 ms }
    vnfs:
      driver: { program: robot_driver, pinned_to: r1 }
      navigation: { program: navigation, node: fog }
    virtual_links:
      - { from: driver, to: navigation, rate: 1 Mbit/s }
walks:
  r1: { waypoints: [[4, 0], [8, 0]], and_back: true, speed_limit: 0.2 m/s, position_interval: 50 ms }
";

/// Runs the experiment, with further arguments. Returns its `handover.json`.
fn compare(testbed: &str, arguments: &[&str]) -> Value {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("testbed.yaml");
    fs::write(&file, testbed).unwrap();
    let out = folder.path().join("runs");
    let program = PathBuf::from(cotorra([""; 0]).get_program()).with_file_name("cotorra-lab");
    let mut command = cotorra_testing::command(program);
    command.args(["experiment", "handover", "--headless", "--save-power", "--testbed"]);
    let output = command.arg(&file).arg("--out").arg(&out).args(arguments).output().unwrap();
    assert!(output.status.success(), "{}{}", stdout(&output), stderr(&output));
    println!("{}", stdout(&output));
    let folder = fs::read_dir(&out).unwrap().next().unwrap().unwrap().path();
    serde_json::from_str(&fs::read_to_string(folder.join("handover.json")).unwrap()).unwrap()
}

/// Returns the figures of the walk on which the robot is sent.
fn sent<'a>(comparison: &'a Value, kind: &str) -> &'a Value {
    let mut rows = comparison["rows"].as_array().unwrap().iter();
    rows.find(|row| row["kind"] == kind && row["walk"] == "sent").unwrap_or_else(|| panic!("{comparison}"))
}

#[test]
fn gaps_of_the_model_are_beside_those_of_real_software() {
    if !cotorra_testing::radios::are_promised() {
        return;
    }
    let comparison = compare(FLOOR, &["--until", "12s"]);
    for kind in ["model", "hwsim"] {
        let row = sent(&comparison, kind);
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

/// With `COTORRA_FULL` alone: other tests have each kind for itself.
#[test]
fn one_file_is_walked_on_all_three_kinds() {
    use cotorra_testing::radios::CORE;

    use crate::machines::{AUTHORITY, Machines};

    /// Most of a gap: IEEE 802.11r aims at 50 ms.
    const MOST_MS: f64 = 50.0;

    if env::var_os("COTORRA_RADIOS").is_none() || env::var_os("COTORRA_FULL").is_none() {
        eprintln!("skipped: it needs radios, which COTORRA_RADIOS promises, and COTORRA_FULL");
        return;
    }
    if !cotorra_testing::can_enroll_agents() {
        return;
    }
    let machines = Machines::start(true);
    let comparison = compare(AT_AGENTS, &["--until", "9s", "--agents", CORE, "--authority", AUTHORITY]);
    for kind in ["model", "hwsim", "hardware"] {
        let row = sent(&comparison, kind);
        assert!(row["roams"].as_u64().unwrap() >= 2 && row["roams"] == row["fast"], "{row}");
        let gap = row["gap_p50_ms"].as_f64().unwrap();
        assert!(gap > 0.0 && gap <= MOST_MS, "{row}");
        assert!(row["scans"].as_u64().unwrap() >= 2 && row["scan_p50_ms"].as_f64().unwrap() > 100.0, "{row}");
        let is_hardware = kind == "hardware";
        assert_eq!(row["packet_gap_p50_ms"].is_null(), is_hardware, "{row}");
        assert_eq!(row["frames_again"].is_number(), is_hardware, "{row}");
    }
    let verdicts = comparison["verdicts"].as_array().unwrap();
    let of_hardware = verdicts.iter().filter(|verdict| verdict["kind"] == "hardware");
    let figures: Vec<_> = of_hardware.map(|verdict| verdict["figure"].as_str().unwrap()).collect();
    assert_eq!(figures, ["gap p50", "gap p95"]);
    machines.become_home();
}
