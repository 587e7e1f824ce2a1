//! What old context costs: runs beside their twins, in the terminal, the summary, the history and a repeat.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{
    fs,
    path::{Path, PathBuf},
    process::Output,
};

use cotorra_testing::lab::Lab;
use serde_json::Value;

use crate::harness::{cotorra, output, stderr, stdout};

const NEEDS_TWIN: &str = "ages of contexts are above; what they cost needs the twin";
const DISTANCE: &str = "plugins.probing.control_delay=700 ms";

/// Writes a testbed in which `probing` attaches a robot to B. The way from A is too slow.
fn lab(folder: &Path) -> PathBuf {
    let lab = Lab {
        roaming: "instructed",
        b: Some(10),
        links: &[("A, edge", "10 ms"), ("B, edge", "1 ms")],
        walk: "{ waypoints: [[0, 0], [10, 0]], speed_limit: 0.7 m/s, position_interval: 50 ms }",
        rest: "plugins:\n  - { bundled: probing, settings: { interval: 2 s } }\n",
        ..Lab::default()
    };
    let file = folder.join("lab.yaml");
    fs::write(&file, lab.to_string()).unwrap();
    file
}

fn simulate(place: &Path, arguments: &[&str]) -> Output {
    let mut command = cotorra(["run", "--simulate", "--headless", "--out"]);
    command.arg(place.join("runs")).arg(lab(place)).args(arguments).output().unwrap()
}

/// Runs it. Returns the run's folder, and the output.
fn run(place: &Path, arguments: &[&str]) -> (PathBuf, String) {
    let done = simulate(place, arguments);
    assert!(done.status.success(), "{}", stderr(&done));
    let printed = stdout(&done);
    let folder = printed.lines().find_map(|line| line.strip_suffix('/')).expect("it names its folder");
    (PathBuf::from(folder), printed)
}

fn json(path: &Path) -> Value {
    serde_json::from_str(&fs::read_to_string(path).unwrap()).unwrap()
}

fn refusal(arguments: &[&Path]) -> String {
    let command = ["history", "regret"].iter().map(Path::new).chain(arguments.iter().copied());
    let answer = output(command);
    assert!(!answer.status.success(), "{}", stdout(&answer));
    words(&stderr(&answer))
}

/// Joins the words of a message, because the terminal breaks lines.
fn words(text: &str) -> String {
    text.split_whitespace().filter(|word| *word != "│").collect::<Vec<_>>().join(" ")
}

#[test]
fn a_run_beside_its_twin_says_what_old_context_cost() {
    let place = tempfile::tempdir().unwrap();
    let (folder, printed) = run(place.path(), &["--set", DISTANCE, "--twin"]);
    assert!(printed.contains("What old context cost (probing: control_delay 700 ms):"), "{printed}");
    assert!(!printed.contains(NEEDS_TWIN), "{printed}");
    let summary = json(&folder.join("summary.json"));
    let [regret] = &summary["staleness_regret"].as_array().unwrap()[..] else { panic!("{summary}") };
    assert_eq!((&regret["plugin"], &regret["twin"]), (&"probing".into(), &"twins/probing".into()));
    let service = &regret["services"][0];
    let above = |of: &str| service[of]["above_target"].as_f64().unwrap();
    let apart = &service["regret"]["above_target"];
    assert!((above("with") - above("without") - apart["difference"].as_f64().unwrap()).abs() < 1e-12);
    let [low, difference, high] = ["low", "difference", "high"].map(|name| apart[name].as_f64().unwrap());
    assert!(low < difference && difference < high && high < 1.0 && difference > 0.05, "{service}");

    // The run itself is as without its twin, and the twin is as a run without the distance.
    let (alone, printed) = run(place.path(), &["--set", DISTANCE]);
    assert!(printed.contains(NEEDS_TWIN) && !printed.contains("What old context cost"), "{printed}");
    let mut without = summary.clone();
    without.as_object_mut().unwrap().remove("staleness_regret");
    assert_eq!(json(&alone.join("summary.json")), without);
    let (beside, printed) = run(place.path(), &[]);
    assert!(!printed.contains(NEEDS_TWIN) && !printed.contains("old context"), "{printed}");
    let samples = |folder: &Path| fs::read(folder.join("service_time.csv")).unwrap();
    assert!(samples(&beside) == samples(&folder.join("twins/probing")));

    // The history has the same answer from two runs.
    let ask = |far: &Path, beside: &Path, more: &[&str]| {
        let mut command = cotorra(["history", "regret"]);
        let answer = command.arg(far).arg(beside).args(more).output().unwrap();
        assert!(answer.status.success(), "{}", stderr(&answer));
        stdout(&answer)
    };
    for (far, beside) in [(&folder, &folder.join("twins/probing")), (&alone, &beside)] {
        let found: Value = serde_json::from_str(&ask(far, beside, &["--json"])).unwrap();
        assert_eq!(
            (&found["services"], &found["plugins"][0]["plugin"]),
            (&regret["services"], &"probing".into())
        );
    }
    let told = ask(&alone, &beside, &[]);
    assert!(
        told.contains("navigation of robot  above 15 ms, %") && told.contains("blocks of time"),
        "{told}"
    );

    // Twins are part of a repeat.
    let repeat = output(["reproduce".as_ref(), folder.as_os_str()]);
    assert!(
        stdout(&repeat).contains("all files are the same to the byte"),
        "{}{}",
        stdout(&repeat),
        stderr(&repeat)
    );
}

#[test]
fn runs_that_differ_in_more_than_distances_are_rejected() {
    let place = tempfile::tempdir().unwrap();
    let short = |more: &[&str]| run(place.path(), &[&["--until", "3s"], more].concat()).0;
    let (far, beside) = (short(&["--set", DISTANCE]), short(&[]));
    let seed = refusal(&[&far, &short(&["--seed", "2"])]);
    assert!(seed.contains("more than the distances of plug-ins: the seed (1 and 2)"), "{seed}");
    let link = refusal(&[&far, &short(&["--set", "links.A-edge.delay=9 ms"])]);
    assert!(link.contains("more than the distances of plug-ins: `links`"), "{link}");
    let until = refusal(&[&far, &run(place.path(), &["--until", "2s"]).0]);
    assert!(until.contains("`--until` (3 s and 2 s)"), "{until}");
    assert!(refusal(&[&beside, &far]).contains("`probing` is not beside the core in the second run"));
    assert!(refusal(&[&far, &far]).contains("equally far from the core"));
}

#[test]
fn a_margin_says_what_a_plugin_decides_beside_the_core() {
    let place = tempfile::tempdir().unwrap();
    let margin = |more: &[&str]| {
        let mut command = cotorra(["margin", "--headless", "--decision", "all", "--set", DISTANCE, "--out"]);
        let done =
            command.arg(place.path().join("margin")).arg(lab(place.path())).args(more).output().unwrap();
        assert!(done.status.success(), "{}", stderr(&done));
        stdout(&done)
    };
    assert!(margin(&["--dry-run"]).contains("1 decision, 1 run with alternatives and 1 twin"));
    let told = margin(&[]);
    assert!(
        told.contains("What the distance of probing cost (control_delay 700 ms), over 1 seed:"),
        "{told}"
    );
    let row = told.lines().find(|line| line.contains("  same  ")).unwrap_or_else(|| panic!("{told}"));
    let earlier: f64 = row.split_whitespace().last().unwrap().parse().unwrap();
    let decisions = json(&place.path().join("margin/decisions.json"));
    let twin = &decisions["examined"][0]["twin"];
    assert_eq!(twin["gave"], "same");
    assert!((twin["earlier_ms"].as_f64().unwrap() - earlier).abs() < 0.01 && earlier > 700.0, "{row} {twin}");
    assert_eq!(decisions["distances"][0]["distance"]["way"]["delay"]["control_delay_ms"], 700.0);
    // Over several seeds, there are counts.
    let told = margin(&["--seeds", "2"]);
    assert!(told.contains("  same 2  ") && told.contains("over 2 seeds:"), "{told}");
}

#[test]
fn a_twin_needs_a_distance() {
    let place = tempfile::tempdir().unwrap();
    let refused = simulate(place.path(), &["--twin"]);
    assert!(!refused.status.success());
    let told = words(&stderr(&refused));
    assert!(told.contains("no plug-in is away from it"), "{told}");
    assert!(!place.path().join("runs").exists());
}

/// Burns 40 ms of CPU time for each decision, once a second. Prints how much it burned, and how much it used from before its last
/// mark until the core had the instruction: what is charged lies between, by the program's own clock.
const BURNING: &str = r#"
import json, os, time
from urllib import request

API = os.environ["COTORRA_API"] + "/api/v1"
HEADERS = {"Content-Type": "application/json", "Authorization": "Bearer " + os.environ["COTORRA_TOKEN"]}
http = request.build_opener(request.ProxyHandler({}))
post = lambda path, body: http.open(request.Request(f"{API}/{path}", body, HEADERS)).close()
marked, last = time.process_time_ns(), 0
with http.open(request.Request(f"{API}/events?kinds=robot", headers=HEADERS)) as stream:
    for line in stream:
        if line.startswith(b"id: "):
            marked = time.process_time_ns()
            post(f"marks/{int(line[4:])}", b"")
        elif line.startswith(b"data: {"):
            context = json.loads(line[6:])
            if context["at_ns"] - last < 10**9:
                continue
            last, began = context["at_ns"], time.process_time_ns()
            while time.process_time_ns() - began < 40_000_000:
                pass
            burned = time.process_time_ns() - began
            post("instructions", json.dumps({"instruction": {"instruction": "scan", "robot": context["robot"]}}).encode())
            told = {"at_ns": context["at_ns"], "least_ns": burned, "most_ns": time.process_time_ns() - marked}
            print(json.dumps(told), flush=True)
"#;

/// Writes a testbed whose plug-in burns CPU time.
fn burning(folder: &Path) -> PathBuf {
    fs::write(folder.join("mine.py"), BURNING).unwrap();
    let file = folder.join("burning.yaml");
    fs::write(&file, Lab::with_program()).unwrap();
    file
}

fn run_burning(place: &Path, decides_in: &str) -> PathBuf {
    let mut command = cotorra(["run", "--simulate", "--headless", "--set", decides_in, "--out"]);
    let done = command.arg(place.join("runs")).arg(burning(place)).output().unwrap();
    assert!(done.status.success(), "{}", stderr(&done));
    let printed = stdout(&done);
    PathBuf::from(printed.lines().find_map(|line| line.strip_suffix('/')).expect("it names its folder"))
}

#[test]
fn a_program_is_charged_the_cpu_time_that_it_used() {
    let place = tempfile::tempdir().unwrap();
    for (decides_in, factor) in [("cpu", 1.0), ("2.5x cpu", 2.5)] {
        let folder = run_burning(place.path(), &format!("plugins.mine.decides_in={decides_in}"));
        let log = fs::read_to_string(folder.join("logs/plugins/mine.log")).unwrap();
        let told: Vec<Value> = log.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
        let decided = crate::harness::events(&folder, "decision");
        assert!(told.len() >= 3 && decided.len() >= 3, "{log}");
        for (told, decided) in told.iter().zip(&decided) {
            let ns = |of: &Value, name: &str| of[name].as_u64().unwrap() as f64;
            let charged = ns(decided, "at_ns") - ns(told, "at_ns");
            let (least, most) = (factor * ns(told, "least_ns"), factor * ns(told, "most_ns"));
            assert!(least >= factor * 4e7, "{told}");
            // A nanosecond for rounding.
            assert!((least - 1.0..=most + 1.0).contains(&charged), "{least} {charged} {most}");
        }
    }
}

#[test]
fn a_run_with_measured_times_says_that_repeats_differ() {
    let place = tempfile::tempdir().unwrap();
    let folder = run_burning(place.path(), "plugins.mine.decides_in=cpu");
    let why = "times of decisions were measured (`decides_in: cpu` of `mine`): repeats differ";
    assert_eq!(json(&folder.join("manifest.json"))["inexact"], why);
    assert_eq!(json(&folder.join("summary.json"))["notices"], serde_json::json!([why]));
    let refused = output(["reproduce".as_ref(), folder.as_os_str()]);
    let told = words(&stderr(&refused));
    assert!(!refused.status.success() && told.contains(why), "{told}");

    let sweep = |axis: &str, name: &str| {
        let mut command = cotorra(["sweep", "--headless", "--until", "2s", "--set", axis, "--out"]);
        let swept = command.arg(place.path().join(name)).arg(burning(place.path())).output().unwrap();
        assert!(swept.status.success(), "{}", stderr(&swept));
        (json(&place.path().join(name).join("manifest.json")), stderr(&swept))
    };
    let (manifest, told) = sweep("plugins.mine.decides_in=0 ms,cpu", "measured");
    assert_eq!((&manifest["inexact"], &manifest["repeat"]["not"]), (&why.into(), &why.into()));
    assert!(told.contains(why), "{told}");
    let (manifest, told) = sweep("plugins.mine.decides_in=0 ms,5 ms", "exact");
    assert!(manifest.get("inexact").is_none() && manifest["repeat"].get("words").is_some(), "{manifest}");
    assert!(!told.contains("measured"), "{told}");
}
