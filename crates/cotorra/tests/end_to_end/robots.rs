//! Several robots in one testbed: results of each robot and service by name, and of all together.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{collections::BTreeMap, fs, path::Path};

use serde_json::Value;
use tempfile::TempDir;

use crate::harness::{cotorra, output, stderr, stdout};

/// Runs a command in a folder, and returns what it prints.
fn done_in(folder: &Path, arguments: &[&str]) -> String {
    let done = cotorra(arguments).current_dir(folder).output().unwrap();
    assert!(done.status.success(), "{}{}", stdout(&done), stderr(&done));
    stdout(&done)
}

/// Makes a folder with a corridor and two rooms, and a testbed with three robots and four radio units there.
fn building() -> TempDir {
    let folder = TempDir::new().unwrap();
    let place = folder.path().join("building");
    let made = output(["new".as_ref(), "testbed".as_ref(), place.as_os_str()]);
    assert!(made.status.success(), "{}", stderr(&made));
    for file in ["map.yaml", "map.pgm"] {
        fs::rename(place.join(file), folder.path().join(file)).unwrap();
    }
    fs::write(folder.path().join("building.yaml"), include_str!("building.yaml")).unwrap();
    folder
}

/// Returns the rows of a table by the names of its columns.
fn rows(csv: &str) -> Vec<BTreeMap<&str, &str>> {
    let mut lines = csv.lines();
    let heads: Vec<_> = lines.next().unwrap().split(',').collect();
    lines.map(|line| heads.iter().copied().zip(line.split(',')).collect()).collect()
}

#[test]
fn a_run_says_of_each_robot_whether_it_kept_its_target() {
    let folder = building();
    let printed = done_in(folder.path(), &["run", "--simulate", "--headless", "building.yaml"]);
    let run = fs::read_dir(folder.path().join("runs")).unwrap().next().unwrap().unwrap().path();
    let read = |file: &str| fs::read_to_string(run.join(file)).unwrap();
    let summary: Value = serde_json::from_str(&read("summary.json")).unwrap();

    // The samples themselves say how many of them each robot has, and how many were in time.
    let samples = read("service_time.csv");
    let samples = rows(&samples);
    let (samples, scans): (Vec<_>, Vec<_>) =
        samples.into_iter().partition(|sample| sample["service"] != "localization-2");
    let count = |robot: &str, target_ms: f64| {
        let its = samples.iter().filter(|sample| sample["robot"] == robot);
        let (took, lost): (Vec<_>, Vec<_>) = its.map(|s| s["service_time_ms"]).partition(|ms| !ms.is_empty());
        let kept = took.iter().filter(|ms| ms.parse::<f64>().unwrap() <= target_ms).count();
        (took.len() + lost.len(), lost.len(), kept)
    };
    let mut above_all = 0;
    for (place, (robot, target_ms)) in [("r1", 15.0), ("r2", 8.0), ("r3", 15.0)].into_iter().enumerate() {
        let (of_robot, lost, kept) = count(robot, target_ms);
        let its = &summary["robots"][place];
        let above = 1.0 - kept as f64 / of_robot as f64;
        assert_eq!(its["robot"], robot);
        assert_eq!((&its["samples"], &its["unanswered"]), (&of_robot.into(), &lost.into()), "{its}");
        assert!((its["above_target"].as_f64().unwrap() - above).abs() < 1e-9, "{its}");
        above_all += of_robot - kept;
        if robot != "r2" {
            let share = kept as f64 / of_robot as f64 * 100.0;
            assert!(
                printed.contains(&format!("\n  {robot} kept 15 ms in {share:.1} % of {of_robot} samples; ")),
                "{printed}"
            );
        }
    }
    assert!(
        printed.lines().any(|line| line.starts_with("  r3 ") && line.contains("; lan-cloud added ")),
        "{printed}"
    );
    let whole = above_all as f64 / samples.len() as f64;
    assert_eq!(summary["samples"], samples.len());
    assert!((summary["above_target"].as_f64().unwrap() - whole).abs() < 1e-9, "{summary}");
    assert!(printed.contains("navigation-2 of r2 did not keep 8 ms"), "{printed}");
    assert!(
        printed.contains(&format!("localization-2 of r2 kept 200 ms in all of {} samples.", scans.len())),
        "{printed}"
    );
    assert!(scans.len() > 20 && scans.iter().all(|scan| !scan["service_time_ms"].is_empty()), "{scans:?}");
    assert!(printed.contains("navigation-2 of r2 kept its target least."), "{printed}");
    let by_robot = summary["robots"].as_array().unwrap().iter().map(|its| its["handovers"].as_u64().unwrap());
    assert_eq!(by_robot.sum::<u64>(), summary["handovers"].as_array().unwrap().len() as u64);

    let csv = read("services.csv");
    let services = rows(&csv);
    assert_eq!(services.len(), 4);
    for (service, of) in services.iter().zip(summary["services"].as_array().unwrap()) {
        assert_eq!(
            (service["robot"], service["service"]),
            (of["robot"].as_str().unwrap(), of["service"].as_str().unwrap())
        );
        assert_eq!(service["samples"], of["samples"].to_string());
        let median = service["service_time_p50_ms"].parse().ok();
        assert_eq!(median, of["service_time_ms"]["p50"].as_f64(), "{csv}");
    }
    assert_eq!(services[2]["samples"], scans.len().to_string());
    let apart: Vec<_> =
        summary["services"].as_array().unwrap().iter().map(|its| its["in_total"] == false).collect();
    assert_eq!(apart, [false, false, true, false]);
    let tex = read("services.tex");
    let localization = format!("r2 & localization-2 & 200 & {} & 0 & 100.00 & ", scans.len());
    assert!(tex.contains(&localization) && tex.contains("\nall but localization & "), "{tex}");
}

#[test]
fn a_recorded_run_tells_robots_apart() {
    let folder = building();
    let printed =
        done_in(folder.path(), &["run", "--simulate", "--headless", "--until", "20s", "building.yaml"]);
    let series =
        |arguments: &[&str]| done_in(folder.path(), &[&["history", "series", "latest"], arguments].concat());
    let drawn = series(&["service"]);
    let said = |text: &str| -> Vec<String> {
        let is_sentence = |line: &&str| line.starts_with("  ") && line.ends_with('.');
        text.lines().filter(is_sentence).map(str::to_owned).collect()
    };
    assert_eq!(said(&drawn), said(&printed), "the history tells what the run told");
    assert_eq!(said(&drawn).len(), 5);
    assert!(drawn.contains("localization-2 of r2 kept 200 ms in all of "), "{drawn}");
    let early = series(&["service", "--to", "100ms"]);
    assert!(early.contains("r1 kept 15 ms in all of ") && early.contains("r3 has no samples"), "{early}");

    let points = |of: &[&str]| {
        let csv = series(&[of, &["--points", "1", "--csv"]].concat());
        rows(&csv)[0]["count"].parse::<usize>().unwrap()
    };
    let of_robots = ["r1", "r2", "r3"].map(|robot| points(&[robot, "--figure", "service_time"]));
    assert!(of_robots.iter().all(|count| *count > 100), "{of_robots:?}");
    let localization = points(&["service_time:localization-2"]);
    assert!((10..100).contains(&localization), "{localization}");
    assert_eq!(of_robots.iter().sum::<usize>() + localization, points(&["service"]));
}

#[test]
fn a_sweep_gives_each_robot_its_own_intervals() {
    let folder = building();
    let sweep = ["sweep", "building.yaml", "--headless", "--until", "20s", "--seeds", "3", "--out", "swept"];
    let delays = ["--set", "links.lan-cloud.delay=4ms,5ms"];
    let printed = done_in(folder.path(), &[&sweep[..], &delays].concat());
    let read = |file: &str| fs::read_to_string(folder.path().join("swept").join(file)).unwrap();
    let (runs, cells) = (read("services.csv"), read("service_cells.csv"));
    let (runs, cells) = (rows(&runs), rows(&cells));
    assert_eq!((runs.len(), cells.len()), (2 * 3 * 4, 2 * 4));
    let number = |row: &BTreeMap<&str, &str>, name: &str| row[name].parse::<f64>().unwrap();
    let median = |delay: &str, robot: &str| {
        let is_its = |row: &&BTreeMap<&str, &str>| {
            row["links.lan-cloud.delay"] == delay
                && row["robot"] == robot
                && row["service"].starts_with("nav")
        };
        let cell = cells.iter().find(is_its).unwrap();
        let mean = number(cell, "service_time_p50_ms");
        let medians: Vec<_> =
            runs.iter().filter(is_its).map(|run| number(run, "service_time_p50_ms")).collect();
        assert_eq!((medians.len(), cell["runs"]), (3, "3"));
        assert!((medians.iter().sum::<f64>() / 3.0 - mean).abs() < 1e-5, "{medians:?} {mean}");
        let (low, high) = (number(cell, "service_time_p50_ms_low"), number(cell, "service_time_p50_ms_high"));
        assert!(low < mean && mean < high, "{low} {mean} {high}");
        mean
    };
    // Only r3 uses the cloud, there and back.
    assert!((median("5ms", "r3") - median("4ms", "r3") - 2.0).abs() < 0.1);
    assert!((median("5ms", "r1") - median("4ms", "r1")).abs() < 0.1);
    for cell in cells.iter().filter(|cell| cell["service"] == "localization-2") {
        assert_eq!((cell["runs"], cell["service_time_target_ms"], cell["above_target"]), ("3", "200", "0"));
        // 4.5 ms over the wire, there and back.
        assert!(number(cell, "service_time_p50_ms") > 9.0, "{cell:?}");
    }
    assert!(printed.contains("all but localization") && !printed.contains("without samples"), "{printed}");
    let rounded = format!("{:.2} ± ", median("5ms", "r3"));
    let row = printed.lines().find(|line| line.contains("5ms") && line.contains("navigation-3")).unwrap();
    assert!(row.contains(&rounded), "{row}");
    let tex = read("service_cells.tex");
    let row = tex.lines().find(|line| line.starts_with("5ms & r3 & navigation-3 & 3 & 15 & ")).unwrap();
    assert!(row.contains(&rounded.replace('±', "$\\pm$")), "{row}");
}
