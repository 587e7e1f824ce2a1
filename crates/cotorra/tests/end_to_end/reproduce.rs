//! Results that are made again from their folder alone.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{
    fs,
    path::{Path, PathBuf},
    process::{Command, Output},
};

use serde_json::{Value, json};
use tempfile::TempDir;

use crate::harness::{
    Run, between_two_units, corridor, corridor_ending_in, cotorra, project_file, stderr, stdout,
};

/// Simulates a testbed for some seconds. Returns the run's folder.
fn simulate(testbed: &Path, out: &Path, arguments: &[&str]) -> PathBuf {
    let mut command = cotorra(["run", "--simulate", "--headless", "--out"]);
    let done = command.arg(out).arg(testbed).args(arguments).current_dir("/").output().unwrap();
    assert!(done.status.success(), "{}", stderr(&done));
    fs::read_dir(out).unwrap().next().unwrap().unwrap().path()
}

/// Reproduces a folder from the root folder.
fn reproduce(folder: &Path, arguments: &[&str]) -> Output {
    cotorra(["reproduce"]).arg(folder).args(arguments).current_dir("/").output().unwrap()
}

/// Asserts that a folder is reproduced.
fn is_reproduced(folder: &Path) -> String {
    let done = reproduce(folder, &[]);
    assert_eq!(done.status.code(), Some(0), "{}{}", stdout(&done), stderr(&done));
    assert!(stdout(&done).ends_with("\nREPRODUCED\n"), "{}", stdout(&done));
    stdout(&done)
}

/// Asserts that a folder cannot be reproduced, and returns the reason on one line.
fn is_refused(folder: &Path) -> String {
    let done = reproduce(folder, &[]);
    assert_eq!(done.status.code(), Some(1), "{}", stdout(&done));
    // Long lines are wrapped, with a mark before each part.
    let lines =
        stderr(&done).lines().map(|line| line.trim_start_matches([' ', '│', '×'])).collect::<String>();
    lines.chars().filter(|c| !c.is_whitespace()).collect()
}

fn manifest(folder: &Path) -> Value {
    serde_json::from_str(&fs::read_to_string(folder.join("manifest.json")).unwrap()).unwrap()
}

/// Changes the manifest of a folder.
fn change(folder: &Path, change: impl FnOnce(&mut Value)) {
    let mut manifest = manifest(folder);
    change(&mut manifest);
    fs::write(folder.join("manifest.json"), manifest.to_string()).unwrap();
}

/// The module of a plug-in, and another one.
const RULES: &str = "HYSTERESIS_DB = 4.0\nSCAN_EVERY_S = 5.0\n";
const OTHER_RULES: &str = "HYSTERESIS_DB = 4.0\nSCAN_EVERY_S = 7.0\n";

/// Writes the corridor with a plug-in in Python that imports a module beside it.
fn corridor_with_module(folder: &Path) -> PathBuf {
    let plugin = fs::read_to_string(project_file("examples/strongest_signal.py")).unwrap();
    let own = "HYSTERESIS_DB = 4.0";
    assert!(plugin.contains(own));
    fs::write(folder.join("mine.py"), plugin.replace(own, "from rules import HYSTERESIS_DB, SCAN_EVERY_S"))
        .unwrap();
    fs::write(folder.join("rules.py"), RULES).unwrap();
    corridor_ending_in("plugins:\n  - id: mine\n    command: [python3, mine.py]\n", folder)
}

#[test]
fn a_run_is_reproduced_to_the_byte_from_a_moved_copy_of_its_folder() {
    let (place, elsewhere) = (TempDir::new().unwrap(), TempDir::new().unwrap());
    let testbed = corridor_with_module(place.path());
    let run = simulate(&testbed, &place.path().join("runs"), &["--until", "60s", "--seed", "7"]);
    let kept = elsewhere.path().join("kept");
    fs::rename(&run, &kept).unwrap();
    drop(place);

    let about = manifest(&kept);
    assert_eq!(
        (&about["seeds"], &about["until_s"], &about["time"]),
        (&json!([7]), &json!(60.0), &json!("virtual"))
    );
    assert_eq!(about["command"][1], "run");
    assert_eq!(about["version"], env!("CARGO_PKG_VERSION"));
    assert!(about["machine"]["cores"].as_u64() > Some(0) && about["commit"].is_string());
    for carried in ["testbed.yaml", "mine.py", "rules.py", "files/corridor.pgm"] {
        assert_eq!(about["carried"][carried].as_str().map(str::len), Some(64), "{carried}: {about}");
    }
    for produced in ["summary.json", "service_time.csv", "service_time.svg", "history.sqlite"] {
        assert!(about["produced"][produced].is_string(), "{produced}: {about}");
    }

    let plan = reproduce(&kept, &["--dry-run"]);
    assert!(stdout(&plan).contains("cotorra run testbed.yaml --simulate --until=60s\n"), "{}", stdout(&plan));
    assert!(is_reproduced(&kept).contains("all files are the same to the byte"));
    let before = fs::read_dir(elsewhere.path()).unwrap().count();
    let out = elsewhere.path().join("again");
    let done = reproduce(&kept, &["--out", out.to_str().unwrap()]);
    assert!(done.status.success(), "{}", stderr(&done));
    assert_eq!(fs::read_dir(elsewhere.path()).unwrap().count(), before + 1);
    let named = PathBuf::from(stdout(&done).lines().find_map(|line| line.strip_suffix('/')).unwrap());
    for name in ["history.sqlite", "rules.py"] {
        assert!(fs::read(named.join(name)).unwrap() == fs::read(kept.join(name)).unwrap(), "{name}");
    }
    assert_eq!(reproduce(&kept, &["--out", out.to_str().unwrap()]).status.code(), Some(1), "it exists");

    fs::write(kept.join("rules.py"), OTHER_RULES).unwrap();
    assert!(is_refused(&kept).contains("rules.pywaschanged"));
    // A repeat with the other module has other results.
    let sum = Command::new("sha256sum").arg(kept.join("rules.py")).output().unwrap();
    let digest = stdout(&sum).split(' ').next().unwrap().to_owned();
    change(&kept, |manifest| manifest["carried"]["rules.py"] = json!(digest));
    let done = reproduce(&kept, &[]);
    assert_eq!(done.status.code(), Some(3), "{}", stderr(&done));
    assert!(
        stdout(&done).contains("differ: ") && stdout(&done).contains("summary.json"),
        "{}",
        stdout(&done)
    );
    assert!(stdout(&done).ends_with("\nNOT REPRODUCED\n"));
    fs::remove_file(kept.join("rules.py")).unwrap();
    assert!(is_refused(&kept).contains("rules.pyismissing"));
}

#[test]
fn an_edited_trace_and_an_edited_result_are_noticed() {
    let place = TempDir::new().unwrap();
    fs::write(place.path().join("fast.trace"), "1\n").unwrap();
    let trace = format!("links.lan-fog.trace={}", place.path().join("fast.trace").display());
    let run = simulate(&corridor(), &place.path().join("runs"), &["--until", "5s", "--set", &trace]);
    is_reproduced(&run);

    fs::write(run.join("summary.json"), "{}").unwrap();
    let done = reproduce(&run, &[]);
    assert!(done.status.success() && stderr(&done).contains("summary.json was changed"), "{}", stderr(&done));
    change(&run, |manifest| manifest["version"] = json!("0.0.1"));
    assert!(stderr(&reproduce(&run, &["--dry-run"])).contains("cotorra 0.0.1"));
    fs::write(run.join("files/fast.trace"), "2\n").unwrap();
    let replay = ["replay", "--speed", "max", "--bundled", "okpi", "--api", "127.0.0.1:0"];
    let replayed = cotorra(replay).arg(&run).output().unwrap();
    assert!(stderr(&replayed).contains("fast.trace was changed after the run"), "{}", stderr(&replayed));
    assert!(is_refused(&run).contains("fast.tracewaschanged"));
}

#[test]
fn folders_that_say_too_little_are_refused() {
    let place = TempDir::new().unwrap();
    assert!(is_refused(place.path()).contains("hasnomanifest.json"));
    let run = simulate(&corridor(), &place.path().join("runs"), &["--until", "3s"]);
    change(&run, |manifest| manifest["repeat"] = json!({ "words": ["history", "prune", "latest"] }));
    assert!(is_refused(&run).contains("namesanothercommand:history"));
    change(&run, |manifest| manifest["repeat"] = json!({ "not": "it had keys" }));
    assert!(is_refused(&run).contains("ithadkeys"));
    change(&run, |manifest| manifest["produced"] = json!({}));
    change(&run, |manifest| manifest["repeat"] = json!({ "words": ["run"] }));
    assert!(is_refused(&run).contains("hasnoresults"));
}

#[test]
fn a_manifest_has_no_secrets() {
    let place = TempDir::new().unwrap();
    let mut command = cotorra(["run", "--simulate", "--headless", "--until", "3s", "--out"]);
    command.arg(place.path()).arg(corridor()).env("COTORRA_TOKEN", "secret-of-the-operator");
    command.env("COTORRA_DOMAIN_TOKENS", "domain-1=secret-of-the-domain");
    command.env("COTORRA_HISTORY_PASSWORD", "secret-of-the-history");
    assert!(command.output().unwrap().status.success());
    let run = fs::read_dir(place.path()).unwrap().next().unwrap().unwrap().path();
    let text = fs::read_to_string(run.join("manifest.json")).unwrap();
    assert!(!text.contains("secret"), "{text}");
}

/// Writes the lab and traces into a new folder.
fn lab() -> (TempDir, PathBuf) {
    let place = TempDir::new().unwrap();
    let bed = place.path().join("bed");
    fs::create_dir(&bed).unwrap();
    let walk = "{ waypoints: [[0, 0], [9, 0]], speed_limit: 0.5 m/s, position_interval: 50 ms }";
    fs::write(bed.join("lab.yaml"), between_two_units(walk)).unwrap();
    for (name, trace) in [("bed/fast.trace", "1\n"), ("bed/slow.trace", "9\n"), ("out.trace", "1\n")] {
        fs::write(place.path().join(name), trace).unwrap();
    }
    (place, bed)
}

/// Runs cotorra in a folder.
fn done_in(folder: &Path, line: &str) -> Output {
    let done = cotorra(line.split(' ')).current_dir(folder).output().unwrap();
    assert!(done.status.success(), "{line}: {}", stderr(&done));
    done
}

#[test]
fn a_sweep_is_reproduced_after_its_testbed_is_gone() {
    let (place, bed) = lab();
    let set = "--set links.lan-edge.trace=fast.trace,slow.trace --set links.lan-A.delay=1..2ms";
    done_in(&bed, &format!("sweep lab.yaml {set} --seeds 2 --headless --out ../sweep"));
    let parts = ["1/2", "2/2"]
        .map(|shard| format!("sweep lab.yaml {set} --seeds 2 --headless --out ../parts --shard {shard}"));
    parts.iter().for_each(|line| drop(done_in(&bed, line)));
    assert!(is_refused(&place.path().join("parts/shard-1-of-2")).contains("hasnoresults"));
    done_in(&bed, "sweep merge ../parts");
    done_in(&bed, "sweep lab.yaml --set links.lan-edge.trace=../out.trace --headless --out ../outside");
    fs::remove_dir_all(&bed).unwrap();
    for name in ["sweep", "parts"] {
        let folder = place.path().join(name);
        assert_eq!(manifest(&folder)["seeds"], json!([1, 2]), "{name}");
        assert!(is_reproduced(&folder).contains("all files are the same to the byte"), "{name}");
    }
    assert!(is_refused(&place.path().join("outside")).contains("leadsoutofthefolder"));
    fs::write(place.path().join("sweep/inputs/slow.trace"), "8\n").unwrap();
    assert!(is_refused(&place.path().join("sweep")).contains("slow.tracewaschanged"));
}

#[test]
fn margins_and_decisions_are_reproduced_after_their_testbed_is_gone() {
    let (place, bed) = lab();
    done_in(
        &bed,
        "margin lab.yaml --change delay --on lan-edge --resolution 10ms --singles --set links.lan-edge.trace=fast.trace \
         --headless --out ../margin",
    );
    done_in(&bed, "margin lab.yaml --decision all --set plugin=okpi --headless --out ../decisions");
    fs::remove_dir_all(&bed).unwrap();
    for name in ["margin", "decisions"] {
        is_reproduced(&place.path().join(name));
    }
}

#[test]
fn a_real_run_is_compared_by_distribution() {
    let mut run = Run::start(&corridor(), &["--until", "6s"]);
    run.wait_for_service();
    run.report();
    let done = reproduce(&run.folder, &[]);
    // On a busy machine, it may differ, or not be valid.
    assert!(matches!(done.status.code(), Some(0 | 3)), "{}", stderr(&done));
    let printed = stdout(&done);
    for told in ["median, ms", "p99, ms", "kept, %", "navigation of robot", "repeat", "REPRODUCED"] {
        assert!(printed.contains(told), "{told}: {printed}");
    }
    fs::write(run.folder.join("service_time.csv"), "").unwrap();
    assert!(is_refused(&run.folder).contains("service_time.csvwaschanged"));
}
