//! External plug-ins: Python scripts that use only the API.

use std::{
    fs,
    path::{Path, PathBuf},
    process::{Command, Stdio},
};

use serde_json::Value;
use tempfile::TempDir;

use crate::harness::{Run, corridor, corridor_ending_in, cotorra, output, project_file, stderr, wait_until};

#[test]
fn the_python_example_runs_against_a_live_testbed() {
    let script = project_file("examples/strongest_signal.py");
    assert!(fs::read_to_string(&script).unwrap().lines().count() <= 60);
    let run = Run::start_beside(&corridor(), &["--until", "5min"]);
    run.wait_for_service();
    let mut python = Command::new("python3");
    python.arg(script).env("COTORRA_API", &run.api).env("COTORRA_PLUGIN", "strongest-signal");
    let mut python = python.stdout(Stdio::null()).spawn().unwrap();
    // Its scans are carried out.
    wait_until(|| {
        python.try_wait().unwrap().is_some()
            || run.get("/api/v1/robots/robot")["attachments"]
                .as_array()
                .unwrap()
                .iter()
                .filter(|attachment| attachment["signal_dbm"].is_number())
                .count()
                > 1
    });
    assert!(python.try_wait().unwrap().is_none(), "it ended by itself");
    // Marks, for which virtual time waits, have no effect in real time.
    assert_eq!(run.post("/api/v1/marks/1?wake_at_ns=5", "{}").0, 200);
    python.kill().unwrap();
    python.wait().unwrap();
}

/// Writes the corridor with a script as its only plug-in.
fn corridor_with(script: &str, folder: &Path) -> PathBuf {
    let script = project_file(script);
    let plugins = format!("plugins:\n  - id: mine\n    command: [python3, {}]\n", script.display());
    corridor_ending_in(&plugins, folder)
}

#[test]
fn virtual_time_waits_for_a_python_script_and_repeats_to_the_byte() {
    let out = TempDir::new().unwrap();
    for (script, until, servers) in [
        ("examples/strongest_signal.py", "50s", &["cloud"][..]),
        // On the way to R2 the cloud is too far; the other servers are near enough everywhere.
        ("examples/cheapest_in_time.py", "80s", &["cloud", "edge"]),
    ] {
        let testbed = corridor_with(script, out.path());
        let simulate = |name: &str| {
            let folder = out.path().join(Path::new(script).file_stem().unwrap()).join(name);
            let run = ["run", "--simulate", "--headless", "--until", until, "--out"].map(Path::new);
            let done = output(run.into_iter().chain([&*folder, &*testbed]));
            assert!(done.status.success(), "{}", stderr(&done));
            fs::read_dir(&folder).unwrap().next().unwrap().unwrap().path()
        };
        let (first, second) = (simulate("first"), simulate("second"));
        for name in ["summary.json", "service_time.csv", "service_time.svg", "history.sqlite"] {
            let read = |folder: &Path| fs::read(folder.join(name)).unwrap();
            assert!(read(&first) == read(&second), "{script}: {name} differs");
        }
        let summary: Value =
            serde_json::from_str(&fs::read_to_string(first.join("summary.json")).unwrap()).unwrap();
        assert_eq!(summary["plugin_faults"], serde_json::json!([]), "{script}");
        assert!(!summary["handovers"].as_array().unwrap().is_empty(), "{script}: {summary}");
        let regions = summary["regions"].as_array().unwrap().iter();
        let mut visited: Vec<_> = regions.map(|region| region["server"].as_str().unwrap()).collect();
        visited.dedup();
        assert_eq!(visited, servers, "{script}");
    }
}

#[test]
fn a_program_in_virtual_time_is_as_far_away_as_its_file_says() {
    let out = TempDir::new().unwrap();
    let testbed = corridor_with("examples/strongest_signal.py", out.path());
    let run = |name: &str, settings: &[&str]| {
        let folder = out.path().join(name);
        let run = ["run", "--simulate", "--headless", "--until", "50s", "--out"].map(Path::new);
        let settings = settings.iter().flat_map(|setting| ["--set", setting]).map(Path::new);
        let done = output(run.into_iter().chain([&*folder, &*testbed]).chain(settings));
        assert!(done.status.success(), "{}", stderr(&done));
        let summary = fs::read_dir(&folder).unwrap().next().unwrap().unwrap().path().join("summary.json");
        serde_json::from_str::<Value>(&fs::read_to_string(summary).unwrap()).unwrap()
    };
    assert_eq!(run("beside", &[])["plugins"][0].get("staleness"), None);
    let delayed = ["plugins.mine.control_delay=200 ms"];
    let on_nodes = ["core.node=edge", "plugins.mine.node=cloud", "links.*-cloud.delay=200 ms"];
    for (name, settings) in [("delayed", &delayed[..]), ("on-nodes", &on_nodes)] {
        let summary = run(name, settings);
        assert_eq!(summary["plugin_faults"], serde_json::json!([]), "{name}");
        let plugin = &summary["plugins"][0];
        assert!(plugin["applied"].as_u64().unwrap() > 1, "{name}: {plugin}");
        let ages = plugin["staleness"].as_array().unwrap();
        let robots = ages.iter().find(|ages| ages["kind"] == "robot").unwrap();
        let youngest = robots["youngest_ms"]["p50"].as_f64().unwrap();
        assert!((400.0..700.0).contains(&youngest), "{name}: {youngest} ms");
    }
}

#[test]
fn ctrl_c_ends_virtual_time_that_waits_for_a_program() {
    let out = TempDir::new().unwrap();
    let testbed = corridor_with("examples/strongest_signal.py", out.path());
    let text = fs::read_to_string(&testbed).unwrap();
    let (before, _) = text.split_once("command:").unwrap();
    fs::write(&testbed, format!("{before}command: [sleep, '1000']\n")).unwrap();
    let folder = out.path().join("runs");
    let mut command = cotorra(["run", "--simulate", "--headless", "--out"].map(Path::new));
    let mut child = command.arg(&folder).arg(&testbed).stdout(Stdio::null()).spawn().unwrap();
    // Virtual time waits once the plug-in's log exists.
    let started = || {
        let runs = fs::read_dir(&folder).into_iter().flatten().flatten();
        runs.map(|run| run.path().join("logs/plugins/mine.log")).any(|log| log.exists())
    };
    wait_until(started);
    assert!(Command::new("kill").args(["-s", "INT", &child.id().to_string()]).status().unwrap().success());
    child.wait().unwrap();
    let run = fs::read_dir(&folder).unwrap().next().unwrap().unwrap().path();
    let summary: Value =
        serde_json::from_str(&fs::read_to_string(run.join("summary.json")).unwrap()).unwrap();
    assert_eq!(summary["ended"], "it was stopped");
}

/// Uses every call of the client in `clients/python` while virtual time waits. A failed assertion ends it early.
const QUESTIONS: &str = r#"
import sys
from cotorra import Client, CotorraError, Refused

testbed = Client()
assert testbed.testbed()["name"] == "corridor"
asked = heard = 0
for event in testbed.stream("robot", "service_time", wake_every_s=0.35):
    heard += event["event"] == "service_time"
    if event["event"] != "wake" or event["at_ns"] < 5e9 or asked:
        continue
    asked, now_s = 1, event["at_ns"] / 1e9
    assert {r["robot"] for r in testbed.robots()} == {"robot"}
    assert testbed.node("cloud")["address"] and len(testbed.links()) > 30
    assert len(testbed.radio_units()) == 6 and len(testbed.placements()) == 4
    assert [run["this"] for run in testbed.runs()] == [True]
    assert testbed.state(at_ns=2 * 10**9)["at_ns"] == 2e9 and testbed.state()["at_ns"] > 4e9
    told = list(testbed.events("service_time", until_ns=int((now_s + 1) * 1e9)))
    assert len(told) == heard == len(list(testbed.service_times())), (len(told), heard)
    points = testbed.series("service_time", points=10, quantiles=[0.5, 0.99])["points"]
    assert sum(point["count"] for point in points) == heard and len(points[0]["quantiles"]) == 2
    assert list(testbed.gaps()) == []
    assert testbed.difference(1)["doubts"][0]["lost_events"] == 0
    testbed.instruct("to hear the others", instruction="scan", robot="robot")
    for failing, call in [
        (Refused, lambda: testbed.instruct(instruction="attach", robot="robot", radio_unit="R9")),
        (CotorraError, lambda: testbed.series("mood:robot")),
    ]:
        try:
            call()
            sys.exit(f"{failing} was not raised")
        except failing as error:
            print(type(error).__name__, error, flush=True)
assert asked and testbed.missed == 0
print("all asked", flush=True)
"#;

#[test]
fn the_python_client_asks_follows_and_instructs() {
    let out = TempDir::new().unwrap();
    let script = out.path().join("questions.py");
    fs::write(&script, QUESTIONS).unwrap();
    let testbed = corridor_with("examples/strongest_signal.py", out.path());
    let text = fs::read_to_string(&testbed).unwrap();
    let (before, _) = text.split_once("command:").unwrap();
    fs::write(&testbed, format!("{before}command: [python3, {}]\n", script.display())).unwrap();
    let folder = out.path().join("runs");
    let mut command = cotorra(["run", "--simulate", "--headless", "--until", "10s", "--out"].map(Path::new));
    command.env("PYTHONPATH", project_file("clients/python")).env("PYTHONDONTWRITEBYTECODE", "1");
    let done = command.arg(&folder).arg(&testbed).output().unwrap();
    let run = fs::read_dir(&folder).unwrap().next().unwrap().unwrap().path();
    let said = fs::read_to_string(run.join("logs/plugins/mine.log")).unwrap();
    assert!(done.status.success(), "{}", stderr(&done));
    assert!(said.contains("Refused") && said.contains("`mood:robot` is not a figure"), "{said}");
    let summary: Value =
        serde_json::from_str(&fs::read_to_string(run.join("summary.json")).unwrap()).unwrap();
    assert_eq!(summary["plugin_faults"], serde_json::json!([]), "{said}");
    let decisions = output([
        "history".as_ref(),
        "events".as_ref(),
        run.as_os_str(),
        "--kinds".as_ref(),
        "decision".as_ref(),
    ]);
    let decisions = String::from_utf8(decisions.stdout).unwrap();
    assert!(decisions.contains("mine: scan with robot: to hear the others"), "{decisions}");
    assert!(decisions.contains("; refused: "), "{decisions}");
}

/// Returns the number of processes with this word on their command line.
fn with_word(word: &str) -> usize {
    let has_word = |pid: &fs::DirEntry| {
        let words = fs::read(pid.path().join("cmdline")).unwrap_or_default();
        words.split(|byte| *byte == 0).any(|its| its == word.as_bytes())
    };
    fs::read_dir("/proc").into_iter().flatten().flatten().filter(has_word).count()
}

#[test]
fn children_of_a_plug_in_end_with_the_run_however_it_ends() {
    for (mode, signal, words) in [
        (None, "KILL", ["4500.1", "4600.1"]),
        (None, "INT", ["4500.2", "4600.2"]),
        (Some("--simulate"), "KILL", ["4500.3", "4600.3"]),
        (Some("--simulate"), "INT", ["4500.4", "4600.4"]),
    ] {
        let out = TempDir::new().unwrap();
        let testbed = corridor_with("examples/strongest_signal.py", out.path());
        let text = fs::read_to_string(&testbed).unwrap();
        let (before, _) = text.split_once("command:").unwrap();
        // One child leaves the session and is an orphan, and the program itself stays.
        let [child, own] = words;
        let script = format!("(setsid sleep {child} &); exec sleep {own}");
        fs::write(&testbed, format!("{before}command: [sh, -c, '{script}']\n")).unwrap();
        let mut command = cotorra(["run", "--headless", "--api", "127.0.0.1:0"].into_iter().chain(mode));
        command.arg("--out").arg(out.path().join("runs"));
        let mut core = command.arg(&testbed).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
        wait_until(|| words.iter().all(|word| with_word(word) == 1));
        let number = core.id().to_string();
        assert!(Command::new("kill").args(["-s", signal, &number]).status().unwrap().success());
        core.wait().unwrap();
        wait_until(|| words.iter().all(|word| with_word(word) == 0));
    }
}

#[test]
fn settings_that_plugins_reject_leave_no_folder() {
    let place = tempfile::tempdir().unwrap();
    let out = place.path().join("runs");
    let testbed = corridor().with_file_name("federation.yaml");
    let with_program =
        corridor_ending_in("plugins: [{ id: mine, command: [./no-such-program] }]", place.path());
    let refused = |words: &[&str], testbed: &Path, set: &str| {
        let output =
            cotorra(words).arg(testbed).arg("--out").arg(&out).args(["--set", set]).output().unwrap();
        assert_eq!(output.status.code(), Some(1), "{words:?} {set}: {}", stderr(&output));
        assert!(!out.exists(), "{words:?} {set} left something");
        stderr(&output).split_whitespace().filter(|word| *word != "│").collect::<Vec<_>>().join(" ")
    };
    let run = ["run", "--headless"];
    let simulated = ["run", "--headless", "--simulate"];
    for words in [&run[..], &simulated] {
        let errors = refused(words, &testbed, "plugins.orchestrator-1.settings.price=0");
        assert!(errors.contains("plug-in `orchestrator-1`: price: 0 is not a price"), "{errors}");
    }
    for words in [&run[..], &simulated] {
        let errors = refused(words, &with_program, "seed=2");
        assert!(errors.contains("cannot start `./no-such-program`"), "{errors}");
    }
    // `check` reports the same, and contacts no ledger.
    let check = |file: &Path| {
        let output = cotorra(["check"]).arg(file).output().unwrap();
        (output.status.success(), stderr(&output))
    };
    let text = fs::read_to_string(&testbed).unwrap();
    let wrong = place.path().join("wrong.yaml");
    for ledger in ["{ kind: modelled, block_period: 5 s }", "{ kind: anvil, program: ./no-such-program }"] {
        let of_ledger = text.replace("{ kind: modelled, block_period: 5 s }", ledger);
        let is_known = ledger.contains("modelled") || cfg!(feature = "ethereum");
        fs::write(&wrong, &of_ledger).unwrap();
        assert_eq!(check(&wrong).0, is_known, "{:?}", check(&wrong));
        fs::write(&wrong, of_ledger.replace("price: 140", "price: 0")).unwrap();
        let (right, errors) = check(&wrong);
        let told = "plug-in `orchestrator-3`: price: 0 is not a price";
        assert!(!right && (!is_known || errors.contains(told)), "{errors}");
    }
    let (right, errors) = check(&with_program);
    assert!(!right && errors.contains("cannot start `./no-such-program`"), "{errors}");

    if cfg!(not(feature = "ethereum")) {
        let errors = refused(&run, &testbed, "plugins.*.settings.ledger=anvil");
        assert!(errors.contains("`--features ethereum`"), "{errors}");
    }
}

#[test]
fn virtual_time_has_only_a_modelled_ledger() {
    let place = TempDir::new().unwrap();
    let mut run = cotorra(["run", "--simulate", "--headless", "--set", "plugins.*.settings.ledger=anvil"]);
    let testbed = corridor().with_file_name("federation.yaml");
    let real = run.arg(testbed).current_dir(place.path()).output().unwrap();
    assert!(stderr(&real).contains("virtual time has only a modelled ledger"), "{}", stderr(&real));
}
