//! A testbed that is fitted to round trips and a survey, and then runs.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{fmt::Write as _, fs};

use serde_json::Value;

use crate::harness::{output, stderr, stdout};

const LAB: &str = "name: lab
wireless: { w: { path_loss: { model: log_distance, exponent: 3.0 }, shadowing: { deviation: 0 dB } } }
nodes:
  robot: { kind: robot }
  A: { kind: radio_unit, position: [0, 0], channel: 1 }
  edge: { kind: server, tier: edge, cpus: 4, memory: 8 GB }
links:
  - { ends: [A, edge], delay: 1 ms } # nobody measured this
services:
  navigation:
    robot: robot
    kpis: { service_time: 25 ms }
    vnfs:
      driver: { program: robot_driver, pinned_to: robot }
      navigation: { program: navigation, node: edge }
walks:
  robot: { waypoints: [[1, 0], [4, 0]] }
";

/// Numbers from 0 to 1 that look random.
fn numbers() -> impl Iterator<Item = f64> {
    std::iter::successors(Some(1_u32), |x| Some(x.wrapping_mul(1_103_515_245).wrapping_add(12_345)))
        .map(|x| f64::from(x >> 8) / f64::from(1_u32 << 24))
}

/// Output of `ping -D` with round trips from 18 to 22 ms, of which one in fifty is lost.
fn ping() -> String {
    let mut text = "PING 10.0.0.2 (10.0.0.2) 56(84) bytes of data.\n".to_owned();
    for (i, number) in (1..=600).zip(numbers()).filter(|(i, _)| i % 50 != 0) {
        let (at, ms) = (1_700_000_000 + i, 18.0 + 4.0 * number);
        writeln!(text, "[{at}.000000] 64 bytes from 10.0.0.2: icmp_seq={i} ttl=64 time={ms:.2} ms").unwrap();
    }
    text
}

/// A survey along a line, of a path loss with the exponent 2.2 and independent deviations, as spreadsheets write it.
fn survey() -> String {
    let mut text = "\u{feff}\"time_s\",\"x\",\"y\",\"radio_unit\",\"signal_dbm\"\r\n".to_owned();
    for (i, number) in (0..120).zip(numbers()) {
        let distance = 1.5 + 0.5 * f64::from(i);
        let free_space_at_1_m = 20.0 * 2412_f64.log10() - 27.55;
        let signal = 15.0 - free_space_at_1_m - 22.0 * distance.log10() + 4.0 * (number - 0.5);
        write!(text, "{i},{distance},0,\"A\",\"{signal:.1}\"\r\n").unwrap();
    }
    text
}

#[test]
fn a_testbed_is_fitted_to_measurements_and_runs() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    fs::write(path("lab.yaml"), LAB).unwrap();
    fs::write(path("ping.txt"), ping()).unwrap();
    fs::write(path("survey.csv"), survey()).unwrap();
    let (file, pinged) = (path("lab.yaml"), format!("A-edge={}", path("ping.txt")));
    let (survey, out) = (path("survey.csv"), path("fitted"));
    let arguments =
        ["calibrate", &file, "--ping", &pinged, "--survey", &survey, "--target", "21ms", "--out", &out];
    let fitted = output(arguments);
    assert!(fitted.status.success(), "{}", stderr(&fitted));
    assert!(stdout(&fitted).contains("constant delay, normal jitter"), "{}", stdout(&fitted));

    let report: Value = serde_json::from_slice(&fs::read(path("fitted/report.json")).unwrap()).unwrap();
    let holds = |estimate: &Value, truth: f64| {
        let [low, high] = ["low", "high"].map(|end| estimate[end].as_f64().unwrap());
        assert!((low..=high).contains(&truth), "{estimate} holds {truth}");
    };
    holds(&report["links"]["A-edge"]["fit"]["mean_ms"], 20.0);
    holds(&report["networks"]["w"]["fit"]["exponent"], 2.2);
    assert_eq!(report["networks"]["w"]["comparison"]["test_readings"], 48);

    let testbed = path("fitted/testbed.yaml");
    let text = fs::read_to_string(&testbed).unwrap();
    assert!(text.starts_with(LAB), "the file keeps its comments");
    let run = output(["run", &testbed, "--simulate", "--until", "20s", "--out", &path("runs")]);
    assert!(run.status.success(), "{}", stderr(&run));

    let again = output(arguments);
    assert!(!again.status.success());
    assert!(stderr(&again).contains("exists already"), "{}", stderr(&again));
    assert!(output(arguments.iter().chain(&["--force"])).status.success());
    assert_eq!(fs::read_to_string(&testbed).unwrap(), text, "the same measurements give the same file");
}

#[test]
fn an_overwritten_calibration_has_the_files_as_they_are_now() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    fs::write(path("lab.yaml"), format!("{LAB}plugins: [{{ id: mine, command: [sh, mine.sh] }}]\n")).unwrap();
    fs::write(path("ping.txt"), ping()).unwrap();
    let pinged = format!("A-edge={}", path("ping.txt"));
    for version in ["echo one\n", "echo two\n"] {
        fs::write(path("mine.sh"), version).unwrap();
        let fitted =
            output(["calibrate", &path("lab.yaml"), "--ping", &pinged, "--force", "--out", &path("fitted")]);
        assert!(fitted.status.success(), "{}", stderr(&fitted));
        assert_eq!(fs::read_to_string(path("fitted/mine.sh")).unwrap(), version);
    }
}

#[test]
fn measurements_that_determine_nothing_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    fs::write(path("lab.yaml"), LAB).unwrap();
    fs::write(path("ping.txt"), "64 bytes from 10.0.0.2: icmp_seq=1 ttl=64 time=20.1 ms\n").unwrap();
    let pinged = format!("A-edge={}", path("ping.txt"));
    let refused = output(["calibrate", &path("lab.yaml"), "--ping", &pinged, "--out", &path("fitted")]);
    assert!(!refused.status.success());
    assert!(stderr(&refused).contains("A-edge"), "{}", stderr(&refused));
    assert!(!folder.path().join("fitted").exists(), "nothing is written");
}

/// A pcap file of UDP packets 10 ms apart between two hosts, each with a number. Times are in ms after an hour.
fn pcap(packets: &[(f64, u32, [u8; 2])]) -> Vec<u8> {
    let mut file = [0xa1b2_3c4d, 0x0004_0002, 0, 0, 65_535, 101_u32].map(u32::to_le_bytes).concat();
    for &(ms, number, [from, to]) in packets {
        let mut packet = vec![0x45, 0, 0, 48, 0, 0, 0, 0, 64, 17, 0, 0, 10, 0, 0, from, 10, 0, 0, to];
        packet.extend([7000_u16, 7001, 28, 0].map(u16::to_be_bytes).concat());
        packet.extend(number.to_be_bytes());
        packet.resize(48, 0);
        let ns = 3_600_000_000_000 + (ms * 1e6) as u64;
        let header = [(ns / 1_000_000_000) as u32, (ns % 1_000_000_000) as u32, 48, 48];
        file.extend(header.map(u32::to_le_bytes).concat());
        file.extend(packet);
    }
    file
}

#[test]
fn captures_at_both_ends_fit_each_direction() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    fs::write(path("lab.yaml"), LAB).unwrap();
    // The clock at the second end is 2 s behind. Forward takes 10 to 14 ms, and backward 10 to 11 ms.
    let (mut first, mut second) = (Vec::new(), Vec::new());
    for (i, number) in (0..800).zip(numbers()) {
        let sent = 2000.0 + 10.0 * f64::from(i);
        first.push((sent, i, [1, 2]));
        second.push((sent - 2000.0 + 10.0 + 4.0 * number, i, [1, 2]));
        second.push((sent - 2000.0, i, [2, 1]));
        first.push((sent + 11.0 - number, i, [2, 1]));
    }
    fs::write(path("first.pcap"), pcap(&first)).unwrap();
    fs::write(path("second.pcap"), pcap(&second)).unwrap();
    let captures = format!("A-edge={}:{}", path("first.pcap"), path("second.pcap"));
    let fitted = output(["calibrate", &path("lab.yaml"), "--pcap", &captures, "--out", &path("fitted")]);
    assert!(fitted.status.success(), "{}", stderr(&fitted));
    let report: Value = serde_json::from_slice(&fs::read(path("fitted/report.json")).unwrap()).unwrap();
    for (direction, jitter) in [("forward", 2.0), ("backward", 0.5)] {
        let found = report["links"]["A-edge"][direction]["fit"]["deviation_ms"]["value"].as_f64().unwrap();
        assert!((found / jitter - 1.0).abs() < 0.1, "{direction} {found}");
    }
    let testbed = path("fitted/testbed.yaml");
    let run = output(["run", &testbed, "--simulate", "--until", "5s", "--out", &path("runs")]);
    assert!(run.status.success(), "{}", stderr(&run));
}

#[test]
fn the_history_of_a_run_gives_its_radio_and_its_handovers() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let legs = ["[11, 0]", "[1, 0]"].repeat(14).join(", ");
    let hall = LAB
        .replace("shadowing: { deviation: 0 dB }", "shadowing: { deviation: 3 dB }")
        .replace("{ kind: robot }", "{ kind: robot, roaming: signal }")
        .replace("\n  edge:", "\n  B: { kind: radio_unit, position: [12, 0], channel: 6 }\n  edge:")
        .replace("\nservices:", "\n  - { ends: [B, edge], delay: 1 ms }\nservices:")
        .replace("[[1, 0], [4, 0]]", &format!("[[1, 0], {legs}], speed_limit: 0.6 m/s"));
    fs::write(path("hall.yaml"), hall).unwrap();
    let runs = path("runs");
    let run = output(["run", &path("hall.yaml"), "--simulate", "--until", "600s", "--out", &runs]);
    assert!(run.status.success(), "{}", stderr(&run));
    let file = path("hall.yaml");
    let out = path("fitted");
    let of_run = ["--survey-run", "latest", "--handover-run", "latest", "--runs", &runs, "--out", &out];
    let fitted = output(["calibrate", &file].iter().chain(&of_run));
    assert!(fitted.status.success(), "{}", stderr(&fitted));
    let report: Value = serde_json::from_slice(&fs::read(path("fitted/report.json")).unwrap()).unwrap();
    let near = |estimate: &Value, truth: f64, within: f64| {
        let value = estimate["value"].as_f64().unwrap();
        assert!((value - truth).abs() < within, "{estimate} {truth}");
    };
    // Authentication of 15 ms and reassociation of 20 ms, which vary by 30 %.
    near(&report["handovers"]["w"]["fast_ms"], 35.0, 4.0);
    near(&report["handovers"]["w"]["variation"], 0.3, 0.12);
    near(&report["networks"]["w"]["fit"]["exponent"], 3.0, 1.0);
}
