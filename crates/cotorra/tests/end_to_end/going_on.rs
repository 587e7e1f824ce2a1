//! Runs that continue after one that was killed.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{fs, path::Path};

use serde_json::Value;

use crate::harness::{Run, corridor, cotorra, output, stderr, stdout, wait_until};

/// Returns the place and the next waypoint in a robot's context.
fn place(robot: &Value) -> (f64, f64, u64) {
    let pose = &robot["sensors"]["pose"];
    (pose["x"].as_f64().unwrap(), pose["y"].as_f64().unwrap(), robot["waypoint"].as_u64().unwrap())
}

/// Returns the first place of the robot in a run's history.
fn first(run: &Path) -> (f64, f64, u64) {
    let run = run.to_str().unwrap();
    let events = output(["history", "events", run, "--kinds", "robot", "--json", "--limit", "1"]);
    place(&serde_json::from_str(&stdout(&events)).unwrap())
}

/// Returns the last place of the robot in a run's history.
fn last(run: &Path) -> (f64, f64, u64) {
    let state = output(["history", "state", run.to_str().unwrap(), "--json"]);
    let state: Value = serde_json::from_str(&stdout(&state)).unwrap();
    place(&state["robots"][0])
}

#[test]
fn after_a_kill_robots_continue_where_the_history_says_they_stood() {
    let mut killed = Run::start(&corridor(), &[]);
    let start = killed.get("/api/v1/testbed")["walks"][0]["waypoints"][0].clone();
    let begun = (start["x"].as_f64().unwrap(), start["y"].as_f64().unwrap(), 0);
    let walked = |from: (f64, f64, u64), to: (f64, f64, u64)| (to.0 - from.0).hypot(to.1 - from.1);
    killed.wait_for_service();
    wait_until(|| walked(begun, last(&killed.folder)) > 1.0);
    killed.signal("KILL");
    killed.wait();
    let stood = last(&killed.folder);

    // In virtual time, and then with real packets.
    let out = tempfile::tempdir().unwrap();
    let mut command = cotorra(["run", "--simulate", "--headless", "--until", "5s", "--out"]);
    let after = killed.folder.to_str().unwrap().to_owned();
    let done = command.arg(out.path()).arg(corridor()).args(["--after", &after]).output().unwrap();
    assert!(done.status.success(), "{}", stderr(&done));
    let simulated = fs::read_dir(out.path()).unwrap().next().unwrap().unwrap().path();
    let (start, end) = (first(&simulated), last(&simulated));
    assert!(walked(stood, start) < 0.01 && start.2 == stood.2, "{stood:?} {start:?}");
    assert!(walked(begun, end) > walked(begun, stood) + 0.5, "it does not walk on: {stood:?} {end:?}");

    let mut run = killed.another(&corridor(), &["--after", &after]);
    run.wait_for_service();
    run.signal("INT");
    run.wait();
    let (start, end) = (first(&run.folder), last(&run.folder));
    assert!(walked(stood, start) < 0.5 && end.2 >= stood.2, "{stood:?} {start:?} {end:?}");
}

#[test]
fn a_run_continues_only_after_one_of_the_same_testbed_and_ledger() {
    let place = tempfile::tempdir().unwrap();
    let federation = corridor().with_file_name("federation.yaml");
    let simulated = |testbed: &Path, name: &str| {
        let out = place.path().join(name);
        let mut command = cotorra(["run", "--simulate", "--headless", "--until", "1s", "--out"]);
        assert!(command.arg(&out).arg(testbed).output().unwrap().status.success());
        fs::read_dir(out).unwrap().next().unwrap().unwrap().path()
    };
    let (of_corridor, modelled) = (simulated(&corridor(), "one"), simulated(&federation, "two"));
    let out = place.path().join("runs");
    let refused = |after: &str, more: &[&str]| {
        let mut command = cotorra(["run", "--headless", "--after", after, "--out"]);
        let output = command.arg(&out).arg(&federation).args(more).output().unwrap();
        assert!(!output.status.success() && !out.exists(), "{after} left something");
        stderr(&output).split_whitespace().filter(|word| *word != "│").collect::<Vec<_>>().join(" ")
    };
    let on_a_network = "plugins.*.settings.ledger={kind: ethereum, url: 'ws://127.0.0.1:9', chain_id: 1, contract: '0x00', key_store: k}";
    for (after, more, told) in [
        ("nowhere", &[][..], "there is no folder nowhere"),
        ("7", &[], "run 7 is a number, but no history is named"),
        (of_corridor.to_str().unwrap(), &[], "it was a run of the testbed `corridor`"),
        (modelled.to_str().unwrap(), &["--set", on_a_network], "that run had another ledger"),
    ] {
        let said = refused(after, more);
        assert!(said.contains(told), "{after} {more:?}: {said}");
    }
}

#[cfg(feature = "ethereum")]
mod on_a_ledger {
    use std::{collections::BTreeSet, path::Path};

    use serde_json::Value;

    use crate::{
        chain::{Chain, STEPS},
        harness::{Run, events, project_file, wait_until},
    };

    /// A note: plug-in, service, step, reason, and time in seconds of the run, negative before it.
    type Note = (String, String, String, Option<String>, f64);

    /// Returns the notes in the history of a run, in their order.
    fn notes(folder: &Path) -> Vec<Note> {
        let note = |event: Value| {
            let text = |value: &Value| value.as_str().map(str::to_owned);
            let (decision, note) = (&event, &event["instruction"]);
            let process = text(&note["process"])?;
            let ago_s = note["ago_ms"].as_f64().unwrap_or_default() / 1e3;
            let at_s = event["at_ns"].as_f64().unwrap() / 1e9 - ago_s;
            Some((text(&decision["plugin"])?, process, text(&note["step"])?, text(&decision["reason"]), at_s))
        };
        events(folder, "decision").into_iter().filter_map(note).collect()
    }

    #[test]
    fn a_killed_core_continues_after_its_run() {
        let Some(chain) = Chain::start() else { return };
        // From here the robot leaves coverage within 20 s, so that the service is announced at once.
        let mut arguments = vec!["--set", "walks.robot.waypoints=[[18.5, 0], [34, 0]]"];
        arguments.extend([
            "--set",
            "walks.robot.and_back=false",
            "--set",
            "plugins.orchestrator-1.settings.collect=2 s",
        ]);
        let ledgers = chain.settings(0);
        ledgers.iter().for_each(|ledger| arguments.extend(["--set", ledger]));
        let has = |run: &Run, step: &str| {
            let events = run.get("/api/v1/measurements/events?kinds=decision&limit=1000");
            let notes = events["items"].as_array().unwrap().iter();
            notes.map(|event| &event["instruction"]["step"]).any(|noted| noted == step)
        };

        let testbed = project_file("testbeds/federation.yaml");
        let mut killed = Run::start(&testbed, &arguments);
        wait_until(|| has(&killed, "winner chosen"));
        killed.signal("KILL");
        killed.wait();
        let before = notes(&killed.folder);

        let folder = killed.folder.to_str().unwrap().to_owned();
        arguments.extend(["--after", &folder]);
        let mut run = killed.another(&testbed, &arguments);
        wait_until(|| has(&run, "in use"));
        run.signal("INT");
        run.report();

        let timeline = notes(&run.folder);
        let told = format!("{before:#?}\n{timeline:#?}");
        let ago = |(plugin, process, step, why, at): &Note| {
            let was =
                before.iter().find(|was| (&was.0, &was.1, &was.2, &was.3) == (plugin, process, step, why));
            was.map(|was| was.4 - at)
        };
        // All notes of the killed run are there, shifted by the time between the starts of the runs.
        let (kept, new) = timeline.split_at(before.len());
        let apart: Vec<f64> =
            kept.iter().map(|note| ago(note).unwrap_or_else(|| panic!("{note:?}: {told}"))).collect();
        assert!(apart.iter().all(|seconds| (seconds - apart[0]).abs() < 1e-3), "{apart:?}: {told}");
        assert!(kept.iter().all(|note| note.4 < 0.0) && new.iter().all(|note| note.4 >= 0.0), "{told}");
        let once: BTreeSet<_> = timeline.iter().map(|note| (&note.0, &note.1, &note.2, &note.3)).collect();
        assert_eq!(once.len(), timeline.len(), "{told}");
        assert_eq!(timeline.iter().map(|note| &note.1).collect::<BTreeSet<_>>().len(), 1, "{told}");
        let first = |step: &str| {
            let noted = timeline.iter().filter(|note| note.2 == step).map(|note| note.4);
            noted.reduce(f64::min).unwrap_or_else(|| panic!("{step} is missing: {told}"))
        };
        assert!(STEPS.map(first).is_sorted(), "{told}");
        assert!(first("winner chosen") < 0.0 && first("attached") > 0.0, "{told}");
    }
}
