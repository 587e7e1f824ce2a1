//! Testbeds and plug-ins from templates: they check, compile and run unchanged.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{
    fs,
    path::{Path, PathBuf},
    process::{Command, Output},
};

use serde_json::Value;
use tempfile::TempDir;

use crate::harness::{cotorra, output, project_file, stderr, stdout};

/// Runs `cotorra` in a folder.
fn cotorra_in<const N: usize>(folder: &Path, arguments: [&str; N]) -> Output {
    cotorra(arguments).current_dir(folder).output().unwrap()
}

/// Runs `cotorra` in a folder, which must succeed. Returns its standard output.
fn done_in<const N: usize>(folder: &Path, arguments: [&str; N]) -> String {
    let done = cotorra_in(folder, arguments);
    assert!(done.status.success(), "{arguments:?}: {}", stderr(&done));
    stdout(&done)
}

/// Returns the summary of the only run in a folder.
fn summary(folder: &Path) -> Value {
    let mut runs = fs::read_dir(folder.join("runs")).unwrap().map(|run| run.unwrap().path());
    let run = runs.find(|run| run.join("summary.json").exists()).unwrap();
    serde_json::from_str(&fs::read_to_string(run.join("summary.json")).unwrap()).unwrap()
}

fn floor_plan() -> PathBuf {
    project_file("docs/images/floor-plan.png")
}

#[test]
fn new_testbeds_check_and_run_unchanged() {
    let out = TempDir::new().unwrap();
    let plan = floor_plan();
    let plan = plan.to_str().unwrap();
    let building = done_in(out.path(), ["new", "testbed", "building"]);
    assert!(building.contains("map: 24.0 m × 12.0 m"), "{building}");
    let office = done_in(out.path(), ["new", "testbed", "office", "--floor-plan", plan, "--scale", "2.5cm"]);
    // Floor outside the walls does not count.
    assert!(office.contains("map: 30.0 m × 19.0 m; robots can reach"), "{office}");
    assert!(!office.contains("note:"), "{office}");

    for name in ["building", "office"] {
        let folder = out.path().join(name);
        let checked = done_in(&folder, ["check", "testbed.yaml"]);
        assert!(checked.contains("3 robots, 4 radio units, 1 switch, 3 servers"), "{checked}");
        done_in(&folder, ["run", "--simulate", "--headless", "testbed.yaml"]);
        let summary = summary(&folder);
        assert_eq!(summary["fidelity"]["valid"], true, "{name}: {summary}");
        assert_eq!(summary["ended"], "every walk is done", "{name}: {summary}");
        let services = summary["services"].as_array().unwrap();
        assert_eq!(services.len(), 3, "{name}: {summary}");
        assert!(services.iter().all(|s| s["samples"].as_u64().unwrap() > 100), "{name}: {summary}");
    }
}

#[test]
fn the_width_of_a_floor_plan_gives_the_same_testbed_as_its_scale() {
    let out = TempDir::new().unwrap();
    let plan = floor_plan();
    let make = |parent: &str, size: [&str; 2]| {
        let folder = out.path().join(parent).join("office");
        let new = ["new", "testbed", folder.to_str().unwrap(), "--floor-plan", plan.to_str().unwrap()];
        let made = output(new.into_iter().chain(size));
        assert!(made.status.success(), "{}", stderr(&made));
        ["testbed.yaml", "map.yaml", "map.pgm"].map(|file| fs::read(folder.join(file)).unwrap())
    };
    let by_scale = make("scale", ["--scale", "2.5cm"]);
    assert!(by_scale == make("width", ["--width", "30m"]));
    assert!(by_scale != make("other", ["--width", "20m"]));
}

#[test]
fn a_new_python_plugin_runs_unchanged_and_moves_navigation() {
    let out = TempDir::new().unwrap();
    done_in(out.path(), ["new", "plugin", "nearer", "--python"]);
    moves_navigation(&out.path().join("nearer"));
}

#[test]
fn a_new_rust_plugin_compiles_and_runs_unchanged_and_moves_navigation() {
    let out = TempDir::new().unwrap();
    done_in(out.path(), ["new", "plugin", "nearer", "--rust", "sub/folder"]);
    let folder = out.path().join("sub/folder");
    // The versions that this project has, because a test has no network. Cargo removes what is not used.
    fs::copy(project_file("Cargo.lock"), folder.join("Cargo.lock")).unwrap();
    let mut cargo = Command::new("cargo");
    cargo.args(["build", "--release", "--offline"]).current_dir(&folder).env_remove("CARGO_TARGET_DIR");
    cargo.env("CARGO_PROFILE_RELEASE_OPT_LEVEL", "0");
    let built = cargo.env("RUSTFLAGS", "-D warnings").output().unwrap();
    assert!(built.status.success(), "{}", stderr(&built));
    moves_navigation(&folder);
}

/// Runs a new plug-in's testbed. Answers from the cloud are late, and those from the edge are not.
fn moves_navigation(folder: &Path) {
    let checked = done_in(folder, ["check", "testbed.yaml"]);
    assert!(checked.contains("plug-ins: nearer"), "{checked}");
    done_in(folder, ["run", "--simulate", "--headless", "--until", "5s", "testbed.yaml"]);
    let summary = summary(folder);
    assert_eq!(summary["plugin_faults"], serde_json::json!([]), "{summary}");
    assert_eq!(summary["fidelity"]["valid"], true, "{summary}");
    let decisions = done_in(folder, ["history", "events", "latest", "--kinds", "decision"]);
    for n in 1..=3 {
        let place = format!("nearer: place navigation-{n} on edge: 6 answers in a row were late");
        assert_eq!(decisions.matches(&place).count(), 1, "{decisions}");
    }
}

#[test]
fn nothing_is_overwritten_and_a_dry_run_writes_nothing() {
    let out = TempDir::new().unwrap();
    for template in [&["testbed", "demo"][..], &["plugin", "demo", "--rust"], &["plugin", "demo", "--python"]]
    {
        let new = ["new"].iter().chain(template).chain(&["--dry-run"]);
        let planned = cotorra(new).current_dir(out.path()).output().unwrap();
        assert!(planned.status.success(), "{}", stderr(&planned));
        assert!(stdout(&planned).contains("demo/testbed.yaml"), "{}", stdout(&planned));
    }
    assert_eq!(fs::read_dir(out.path()).unwrap().count(), 0);

    fs::create_dir(out.path().join("demo")).unwrap();
    fs::write(out.path().join("demo/map.pgm"), "mine").unwrap();
    for arguments in [&["new", "testbed", "demo"][..], &["new", "testbed", "demo", "--dry-run"]] {
        let refused = cotorra(arguments).current_dir(out.path()).output().unwrap();
        assert_eq!(refused.status.code(), Some(1));
        assert!(stderr(&refused).contains("demo/map.pgm exists already"), "{}", stderr(&refused));
    }
    let files: Vec<_> = fs::read_dir(out.path().join("demo")).unwrap().collect();
    assert_eq!(files.len(), 1, "{files:?}");
    assert_eq!(fs::read(out.path().join("demo/map.pgm")).unwrap(), b"mine");
}

#[test]
fn unusable_floor_plans_say_what_to_do() {
    let out = TempDir::new().unwrap();
    let refused = |name: &str, bytes: &[u8], size: &str| {
        fs::write(out.path().join(name), bytes).unwrap();
        let new = ["new", "testbed", "office", "--floor-plan", name, "--scale", size];
        let refused = cotorra_in(out.path(), new);
        assert_eq!(refused.status.code(), Some(1), "{name}");
        assert!(!out.path().join("office").exists(), "{name}");
        // Lines are wrapped anywhere between words.
        stderr(&refused).split_whitespace().filter(|word| *word != "│").collect::<Vec<_>>().join(" ")
    };
    let jpeg = refused("plan.jpg", b"\xff\xd8\xff\xe0", "5cm");
    assert!(jpeg.contains("neither a PNG nor a PGM picture; convert it"), "{jpeg}");
    let png = fs::read(floor_plan()).unwrap();
    let cut = refused("cut.png", &png[..png.len() / 2], "5cm");
    assert!(cut.contains("floor plan cut.png: the PNG picture is cut off"), "{cut}");
    let walls = refused("walls.pgm", b"P2 3 3 1 0 0 0 0 1 0 0 0 0", "30cm");
    assert!(walls.contains("0.0 m² of connected floor") && walls.contains("doors must be gaps"), "{walls}");

    let no_size = cotorra_in(out.path(), ["new", "testbed", "office", "--floor-plan", "cut.png"]);
    assert_eq!(no_size.status.code(), Some(2));
    assert!(stderr(&no_size).contains("--scale <LENGTH>"), "{}", stderr(&no_size));
    let no_language = cotorra_in(out.path(), ["new", "plugin", "nearer"]);
    assert_eq!(no_language.status.code(), Some(2));
    assert!(stderr(&no_language).contains("--rust|--python"), "{}", stderr(&no_language));
}

/// Returns the words of a command, which may be quoted.
fn words(command: &str) -> Vec<&str> {
    let parts = command.split('\'').enumerate();
    let words =
        parts.map(|(i, part)| if i % 2 == 0 { part.split_whitespace().collect() } else { vec![part] });
    words.flatten().collect()
}

/// Compares an output with the lines that a document shows. `…` stands for any lines.
fn shows(command: &str, output: &str, shown: &[&str]) {
    let mut lines = output.lines().map(str::trim_end);
    let mut any = false;
    for line in shown {
        if *line == "…" {
            any = true;
        } else if any {
            assert!(lines.any(|found| found == *line), "{command}: `{line}` is missing in\n{output}");
            any = false;
        } else {
            assert_eq!(lines.next(), Some(*line), "{command} printed\n{output}");
        }
    }
    assert!(any || lines.next().is_none(), "{command} printed more:\n{output}");
}

#[test]
fn the_tutorial_shows_what_its_commands_print() {
    let text = fs::read_to_string(project_file("docs/start/tutorial.md")).unwrap();
    let out = TempDir::new().unwrap();
    fs::copy(floor_plan(), out.path().join("floor-plan.png")).unwrap();
    let mut folder = out.path().to_owned();
    let mut commands = 0;
    let blocks = text.split("```console\n").skip(1).map(|rest| rest.split_once("```").unwrap().0);
    for step in blocks.flat_map(|block| block.split("$ ").skip(1)) {
        let mut shown = step.lines();
        let command = shown.next().unwrap();
        let shown: Vec<_> = shown.collect();
        match words(command).split_first() {
            Some((&"cd", target)) => folder.push(target[0]),
            Some((&"cotorra", arguments)) => {
                let done = cotorra(arguments).current_dir(&folder).output().unwrap();
                assert!(done.status.success(), "{command}: {}", stderr(&done));
                shows(command, &stdout(&done), &shown);
                commands += 1;
            }
            other => panic!("{other:?} is no command of the tutorial"),
        }
    }
    assert!(commands >= 6, "{commands}");
}
