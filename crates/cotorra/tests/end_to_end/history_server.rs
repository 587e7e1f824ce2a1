//! Histories in a server: a plug-in that reads its delays there, a real run, and secrecy of the password.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{
    fs,
    path::{Path, PathBuf},
};

use cotorra_okpi::Okpi;
use cotorra_plugin::client;
use cotorra_testing::mariadb::MariaDb;
use serde_json::Value;
use tempfile::TempDir;

use crate::harness::{Run, corridor, cotorra, project_file, stderr, stdout, wait_until};

/// OKpi as a separate program, which the run of the test below starts.
#[test]
#[ignore = "is started by the test below"]
fn okpi_as_a_program() {
    let client = client::Client::from_env().unwrap();
    let okpi = Okpi::from_settings(&client::settings().unwrap()).unwrap().reading(client.clone());
    let mut okpi = okpi.for_testbed(&client.testbed().unwrap()).unwrap();
    client.run(&mut okpi).unwrap();
}

/// Writes the corridor with another block of plug-ins, in which `SETTINGS` stands for the settings of okpi.
fn corridor_with(plugin: &str, folder: &Path) -> PathBuf {
    let text = fs::read_to_string(corridor()).unwrap();
    let map = project_file("testbeds/maps/corridor.yaml");
    let (before, plugins) = text.split_once("\nplugins:").unwrap();
    let (_, settings) = plugins.split_once("    settings:\n").unwrap();
    let before = before.replace("maps/corridor.yaml", map.to_str().unwrap());
    let plugin = plugin.replace("SETTINGS", &format!("    settings:\n{settings}"));
    let file = folder.join("testbed.yaml");
    fs::write(&file, format!("{before}\nplugins:\n{plugin}")).unwrap();
    file
}

/// Simulates a testbed. Returns the summary, and the decisions with their times.
fn simulated(testbed: &Path, out: &Path, url: &str) -> (Value, Vec<Value>) {
    let mut command = cotorra(["run", "--simulate", "--headless", "--out"]);
    let done = command.arg(out).arg(testbed).env("COTORRA_HISTORY", url).output().unwrap();
    assert!(done.status.success(), "{}", stderr(&done));
    let folder = fs::read_dir(out).unwrap().next().unwrap().unwrap().path();
    let summary = fs::read_to_string(folder.join("summary.json")).unwrap();
    let mut events = cotorra(["history", "events", "--kinds", "decision", "--limit", "1000", "--json"]);
    let events = events.arg(&folder).env("COTORRA_HISTORY", url).output().unwrap();
    assert!(events.status.success(), "{}", stderr(&events));
    let decisions = stdout(&events).lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    (serde_json::from_str(&summary).unwrap(), decisions)
}

#[test]
fn okpi_reads_its_delays_from_mariadb_and_decides_as_published() {
    let Some(server) = MariaDb::start() else { return };
    let place = TempDir::new().unwrap();
    let url = server.fresh();
    let program = std::env::current_exe().unwrap();
    let name = "history_server::okpi_as_a_program";
    let command = format!("[{}, {name}, --exact, --ignored, --nocapture]", program.display());
    let bundled = "  - bundled: okpi\n".to_owned();
    let programmed = format!("  - id: okpi\n    command: {command}\n");
    let told = [("asked", &bundled), ("history", &bundled), ("history", &programmed)].map(|(delays, id)| {
        let folder = TempDir::new_in(place.path()).unwrap();
        let settings = format!("SETTINGS      delays: {delays}\n");
        let testbed = corridor_with(&(id.clone() + &settings), folder.path());
        simulated(&testbed, &folder.path().join("runs"), &url)
    });
    let [(as_asked, decided), others @ ..] = told;
    assert!(decided.len() >= 6, "it decides along the corridor: {decided:?}");
    for (of_history, decided_so) in others {
        assert_eq!(decided_so, decided, "what it reads from the history is what happened");
        assert_eq!(of_history["valid"], as_asked["valid"]);
        assert_eq!(of_history["services"], as_asked["services"]);
    }
    let mut command = cotorra(["history", "runs"]);
    let listed = command.env("COTORRA_HISTORY", &url).output().unwrap();
    assert_eq!(stdout(&listed).matches("in virtual time").count(), 3, "{}", stdout(&listed));
}

#[test]
fn a_real_run_is_kept_in_a_server_whose_password_its_programs_do_not_get() {
    let Some(server) = MariaDb::start() else { return };
    let place = TempDir::new().unwrap();
    let url = server.fresh();
    let (before, rest) = url.split_once("cotorra:").unwrap();
    let (password, after) = rest.split_once('@').unwrap();
    let without = format!("{before}cotorra@{after}");
    let environment = place.path().join("environment");
    let plugin =
        format!("  - id: mine\n    command: [sh, -c, 'env > {}; sleep 100']\n", environment.display());
    let testbed = corridor_with(&plugin, place.path());
    let change = |command: &mut std::process::Command| {
        command.env("COTORRA_HISTORY_PASSWORD", password).env("COTORRA_HISTORY", &without);
    };
    let mut run = Run::start_beside_with(&testbed, &[], change);
    run.wait_for_service();
    wait_until(|| environment.exists() && fs::read_to_string(&environment).unwrap().contains("COTORRA_API"));
    for pid in run.processes() {
        let its = fs::read(format!("/proc/{pid}/environ")).unwrap_or_default();
        let has = |name: &[u8]| its.windows(name.len()).any(|part| part == name);
        if has(b"COTORRA_VNF=") || has(b"COTORRA_PLUGIN=") {
            assert!(!has(b"COTORRA_HISTORY"), "process {pid} was told of the history");
        }
    }
    assert!(!fs::read_to_string(&environment).unwrap().contains("COTORRA_HISTORY"));
    run.signal("INT");
    let (summary, printed) = run.report();
    assert!(printed.contains("run 1 in mysql://"), "{printed}");
    let ask = |arguments: &[&str]| {
        let mut command = cotorra(["history"]);
        change(&mut command);
        let done = command.args(arguments).output().unwrap();
        assert!(done.status.success(), "{}", stderr(&done));
        stdout(&done)
    };
    let kept = ask(&["events", "1", "--kinds", "service_time", "--limit", "10000"]);
    assert!(kept.lines().count() as u64 >= summary["samples"].as_u64().unwrap().max(1), "{kept}");
    assert!(!ask(&["runs"]).contains("no end"));

    // A password on the command line is visible in the list of processes.
    let told = cotorra(["history", "runs", "--history", &url]).output().unwrap();
    assert!(stderr(&told).contains("COTORRA_HISTORY_PASSWORD"), "{}", stderr(&told));
    assert!(!stderr(&told).contains(password));
}

#[test]
fn old_samples_are_rolled_up_on_request() {
    let place = TempDir::new().unwrap();
    let file = place.path().join("testbed.yaml");
    let text = fs::read_to_string(corridor_with("  - probing\n", place.path())).unwrap();
    let kept = "\nhistory:\n  retention:\n    links: { raw: 5 s, step: 1 s }\n    robots: { raw: 5 s }\n";
    fs::write(&file, text + kept).unwrap();
    let run = |arguments: &[&str]| {
        let done = cotorra(arguments).current_dir(place.path()).output().unwrap();
        (done.status.success(), stdout(&done) + &stderr(&done))
    };
    let (well, told) =
        run(&["run", "--simulate", "--headless", "--until", "20s", "--out", "runs", "testbed.yaml"]);
    assert!(well, "{told}");
    let mean = || {
        let (_, csv) = run(&["history", "series", "latest", "robot", "--figure", "x", "--csv"]);
        let counts = csv.lines().skip(1).map(|line| line.split(',').nth(2).unwrap().parse::<u64>().unwrap());
        counts.sum::<u64>()
    };
    let before = mean();
    let (well, told) = run(&["history", "prune", "latest"]);
    assert!(well && told.contains("nothing was changed") && told.contains("link"), "{told}");
    assert_eq!(mean(), before);
    let (well, told) = run(&["history", "roll-up", "latest", "--yes"]);
    assert!(well && told.ends_with("done\n"), "{told}");
    assert_eq!(mean(), before);
    let (_, told) = run(&["history", "state", "latest", "--at", "3s"]);
    assert!(told.contains("samples of robot before 15.000 s were rolled up: there is one each 1s"), "{told}");
    let (_, told) = run(&["history", "series", "latest", "robot", "--figure", "x"]);
    assert!(told.contains("samples were rolled up"), "{told}");
    let (_, told) = run(&["history", "prune", "latest", "--yes"]);
    assert!(told.contains("no samples are that old"), "{told}");
    let (well, told) = run(&["history", "prune", "latest", "--raw", "1h", "--step", "7s"]);
    assert!(!well && told.contains("a minute must be a multiple of it"), "{told}");
    fs::write(&file, fs::read_to_string(&file).unwrap().replace("step: 1 s", "step: 7 s")).unwrap();
    let (well, told) = run(&["check", "testbed.yaml"]);
    assert!(!well && told.contains("a minute is not a multiple of this step"), "{told}");
}
