//! Folders of runs that hold everything that their testbed files name.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{
    fs,
    path::{Path, PathBuf},
};

use tempfile::TempDir;

use crate::harness::{corridor, cotorra, project_file, stderr, stdout};

/// Simulates a testbed for some seconds, from the root folder. Returns the run's folder.
fn simulate(testbed: &Path, out: &Path, arguments: &[&str]) -> PathBuf {
    let mut command = cotorra(["run", "--simulate", "--headless", "--until", "8s", "--out"]);
    let done = command.arg(out).arg(testbed).args(arguments).current_dir("/").output().unwrap();
    assert!(done.status.success(), "{}", stderr(&done));
    let printed = stdout(&done);
    PathBuf::from(printed.lines().find_map(|line| line.strip_suffix('/')).expect("it names its folder"))
}

fn bytes(folder: &Path, name: &str) -> Vec<u8> {
    fs::read(folder.join(name)).unwrap()
}

#[test]
fn a_run_is_repeated_replayed_and_exported_from_its_folder_alone() {
    let (place, elsewhere) = (TempDir::new().unwrap(), TempDir::new().unwrap());
    let at = |name: &str| place.path().join(name);
    for folder in ["bed", "maps"] {
        fs::create_dir(at(folder)).unwrap();
    }
    for name in ["corridor.yaml", "corridor.pgm"] {
        fs::copy(project_file("testbeds/maps").join(name), at("maps").join(name)).unwrap();
    }
    // 12 Mbit/s, and 6 Mbit/s.
    for (name, trace) in [("fast.trace", "1\n"), ("slow.trace", "2\n")] {
        fs::write(at(name), trace).unwrap();
    }
    let earlier = simulate(
        &corridor(),
        &at("earlier"),
        &["--set", "schedule=[{ at: 2 s, links: lan-cloud, set: { delay: 9 ms } }]"],
    );
    let text = fs::read_to_string(corridor()).unwrap();
    let text = text.replace("map: maps/", "map: ../maps/").replace(
        "\nservices:",
        &format!("\nconditions: {{ replay: \"{}\" }} # as it was\n\nservices:", earlier.display()),
    );
    let testbed = at("bed/testbed.yaml");
    fs::write(&testbed, &text).unwrap();
    let slow = format!("links.lan-edge.trace={}", at("slow.trace").display());
    let arguments = ["--seed", "7", "--set", "links.lan-fog.trace=../fast.trace", "--set", &slow];
    let run = simulate(&testbed, &at("runs"), &arguments);

    let kept = elsewhere.path().join("kept");
    fs::rename(&run, &kept).unwrap();
    drop(place);
    let expected = text
        .replace("../maps/corridor.yaml", "files/corridor.yaml")
        .replace(earlier.to_str().unwrap(), &format!("files/{}", earlier.file_name().unwrap().display()));
    let settings = "# set: links.lan-fog.trace=files/fast.trace\n\
                    # set: links.lan-edge.trace=files/slow.trace\n# set: seed=7\n";
    assert_eq!(fs::read_to_string(kept.join("testbed.yaml")).unwrap(), expected + settings);

    let again = simulate(&kept.join("testbed.yaml"), &elsewhere.path().join("again"), &[]);
    for name in ["testbed.yaml", "history.sqlite", "summary.json", "files/corridor.pgm"] {
        assert!(bytes(&again, name) == bytes(&kept, name), "{name} is not the same");
    }
    let events = cotorra(["history", "events"]).arg(&again).args(["--kinds", "decision"]).output().unwrap();
    assert!(stdout(&events).contains("lan-cloud"), "{}", stdout(&events));

    let mcap = elsewhere.path().join("run.mcap");
    let mut export = cotorra(["history", "export", "--format", "mcap", "--out"]);
    let done = export.arg(&mcap).arg(&kept).current_dir("/").output().unwrap();
    assert!(done.status.success() && mcap.exists(), "{}", stderr(&done));
    let mut replay = cotorra(["replay", "--speed", "max", "--bundled", "okpi", "--api", "127.0.0.1:0"]);
    let done = replay.arg(&kept).current_dir("/").output().unwrap();
    assert!(done.status.success() && stderr(&done).contains("all was played"), "{}", stderr(&done));
}

#[test]
fn a_program_of_a_plugin_starts_in_the_folder_of_the_testbed_file() {
    let place = TempDir::new().unwrap();
    let bed = place.path().join("bed");
    fs::create_dir(&bed).unwrap();
    let text = fs::read_to_string(project_file("testbeds/two-hosts.yaml")).unwrap();
    fs::write(bed.join("told.sh"), "pwd\n").unwrap();
    let testbed = bed.join("testbed.yaml");
    fs::write(&testbed, text + "\nplugins: [{ id: told, command: [sh, told.sh], optional: true }]\n")
        .unwrap();
    let of = |run: &Path| fs::read_to_string(run.join("logs/plugins/told.log")).unwrap();

    let run = simulate(&testbed, &place.path().join("runs"), &[]);
    assert_eq!(of(&run), format!("{}\n", bed.canonicalize().unwrap().display()));
    fs::remove_dir_all(&bed).unwrap();
    let again = simulate(&run.join("testbed.yaml"), &place.path().join("runs"), &[]);
    assert_eq!(of(&again), format!("{}\n", run.display()));
}
