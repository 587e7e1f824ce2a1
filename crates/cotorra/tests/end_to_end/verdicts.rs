//! PASS and FAIL of services, and the reasons of samples that missed their target, in virtual time.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{
    fs,
    path::{Path, PathBuf},
    process::Output,
};

use serde_json::Value;
use tempfile::TempDir;

use crate::harness::{cotorra, stderr, stdout};

/// Two robots, each beside a radio unit of its own, which lose packets in other places.
const TESTBED: &str = "
name: two-links
wireless: { lab: {} }
nodes:
  A: { kind: radio_unit, position: [0, 3], channel: 1 }
  B: { kind: radio_unit, position: [500, 3], channel: 6 }
  r1: { kind: robot }
  r2: { kind: robot }
  edge: { kind: server, tier: edge, cpus: 4, memory: 8 GB }
links:
  - { ends: [A, edge], delay: 1 ms }
  - { ends: [B, edge], delay: 1 ms }
services:
  n1:
    robot: r1
    kpis: { service_time: 50 ms KEPT1 }
    vnfs: { d1: { program: robot_driver, pinned_to: r1 }, v1: { program: navigation, node: edge } }
  n2:
    robot: r2
    kpis: { service_time: 50 ms KEPT2 }
    vnfs: { d2: { program: robot_driver, pinned_to: r2 }, v2: { program: navigation, node: edge } }
walks:
  r1: { waypoints: [[0, 0], [30, 0]], speed_limit: 0.1 m/s }
  r2: { waypoints: [[500, 0], [530, 0]], speed_limit: 0.1 m/s }
schedule:
  - { at: 1 s, links: A-edge, direction: forward, set: { loss: 5 % } }
  - { at: 1 s, links: B-edge, direction: backward, set: { loss: 30 % } }
";

struct Lab(TempDir);

impl Lab {
    /// Creates a folder with the testbed, whose services demand these shares.
    fn new(kept: [&str; 2]) -> Self {
        Self::with(
            kept.map(|share| if share.is_empty() { String::new() } else { format!(", kept: {share}") }),
        )
    }

    /// Creates a folder with the testbed, whose services have these further KPIs.
    fn with([first, second]: [String; 2]) -> Self {
        let folder = TempDir::new().unwrap();
        let text = TESTBED.replace(" KEPT1", &first).replace(" KEPT2", &second);
        fs::write(folder.path().join("testbed.yaml"), text).unwrap();
        Self(folder)
    }

    fn path(&self) -> &Path {
        self.0.path()
    }

    fn cotorra(&self, arguments: &[&str]) -> Output {
        cotorra(arguments).current_dir(self.path()).output().unwrap()
    }

    /// Runs the testbed for a minute.
    fn run(&self) -> Output {
        self.cotorra(&["run", "--simulate", "--headless", "--until", "60s", "testbed.yaml"])
    }

    /// Returns the folder of the only run.
    fn folder(&self) -> PathBuf {
        fs::read_dir(self.path().join("runs")).unwrap().next().unwrap().unwrap().path()
    }

    fn read(&self, file: &str) -> String {
        fs::read_to_string(self.folder().join(file)).unwrap()
    }

    fn summary(&self) -> Value {
        serde_json::from_str(&self.read("summary.json")).unwrap()
    }
}

/// Returns a text as one line, without the breaks that fit it to a terminal.
fn unwrapped(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

#[test]
fn each_robot_blames_its_own_link_for_samples_without_an_answer() {
    let lab = Lab::new(["", ""]);
    let run = lab.run();
    assert_eq!(run.status.code(), Some(0), "nothing is demanded: {}", stderr(&run));
    let summary = lab.summary();
    let expected = [("A-edge", false), ("B-edge", true)];
    for (parts, (link, back)) in summary["time_parts"].as_array().unwrap().iter().zip(expected) {
        let unanswered = parts["unanswered"].as_u64().unwrap();
        let [place] = &parts["lost_at"].as_array().unwrap()[..] else { panic!("{parts:#}") };
        assert_eq!(place["link"], link, "{place}");
        assert_eq!((&place["back"], &place["cause"]), (&back.into(), &"loss".into()));
        assert_eq!(place["samples"], unanswered);
    }
    let [first, second] = [0, 1].map(|place| summary["time_parts"][place]["unanswered"].as_u64().unwrap());
    assert!(first > 5 && second > 3 * first, "{first} and {second}");
    let printed = unwrapped(&stdout(&run));
    let sentence = format!("all {second} that missed it had no answer: {second} answers lost on B-edge.");
    assert!(printed.contains(&sentence), "{printed}");
    assert!(printed.contains(&format!(": {first} requests lost on A-edge.")), "{printed}");
    assert!(!printed.contains("PASS") && !printed.contains("FAIL"), "{printed}");

    // The history has the same.
    let run = lab.folder();
    let told = lab.cotorra(&["history", "series", run.to_str().unwrap(), "service"]);
    assert!(unwrapped(&stdout(&told)).contains(&sentence), "{}", stdout(&told));
}

#[test]
fn a_run_passes_or_fails_by_the_demanded_share() {
    let lab = Lab::new(["80 %", "80 %"]);
    let run = lab.run();
    assert_eq!(run.status.code(), Some(4), "{}", stdout(&run));
    let printed = unwrapped(&stdout(&run));
    assert!(
        printed.contains("PASS: r1 kept 50 ms in 9") && printed.contains("FAIL: r2 kept 50 ms in "),
        "{printed}"
    );
    assert!(printed.contains("(80 % demanded, 95 % interval "), "{printed}");
    let summary = lab.summary();
    assert_eq!(summary["verdict"], "FAIL");
    let verdicts = |of: &str| [0, 1].map(|place| summary[of][place]["verdict"].clone());
    assert_eq!(
        (verdicts("services"), verdicts("robots")),
        (["PASS", "FAIL"].map(Value::from), ["PASS", "FAIL"].map(Value::from))
    );
    let its = &summary["services"][1];
    let [kept, low, high, keep] =
        ["kept", "kept_low", "kept_high", "keep"].map(|name| its[name].as_f64().unwrap());
    assert!(low < kept && kept < high && high < keep && keep == 0.8, "{its:#}");
    assert_eq!(its["sure"], true);
    let table = lab.read("services.csv");
    assert!(table.lines().next().unwrap().ends_with(",kept,kept_low,kept_high,keep,verdict,sure"), "{table}");
    assert!(table.lines().nth(2).unwrap().ends_with(",0.8,FAIL,true"), "{table}");

    let run = lab.folder();
    let diff = lab.cotorra(&["history", "diff", run.to_str().unwrap(), run.to_str().unwrap()]);
    let diff = unwrapped(&stdout(&diff));
    let share = format!("{:.1} % FAIL {:.1} % FAIL", kept * 100.0, kept * 100.0);
    let unanswered = its["unanswered"].as_u64().unwrap();
    assert!(diff.contains(&format!("{unanswered} {unanswered} {share}")), "{diff}");
}

#[test]
fn each_bound_on_a_figure_is_judged_and_what_is_not_measured_fails() {
    let passing = ", require: [service_time p50 <= 50 ms, answered >= 80 %, queue:A-edge max <= 100 packets, cost <= 1], \
        reliability: 99 %, radio: n, area: [[0, 0], [5, 0], [5, 5]]";
    let lab =
        Lab::with([passing.to_owned(), ", require: [answered >= 99 %, service_time max <= 1 s]".to_owned()]);
    let run = lab.run();
    assert_eq!(run.status.code(), Some(4), "{}", stdout(&run));
    let summary = lab.summary();
    let kpis = |place: usize| {
        let all = summary["services"][place]["kpis"].as_array().unwrap().iter();
        let of = |kpi: &Value| {
            format!("{} {}", kpi["kpi"].as_str().unwrap(), kpi["verdict"].as_str().unwrap_or("-"))
        };
        all.map(of).collect::<Vec<_>>()
    };
    assert_eq!(
        kpis(0),
        [
            "reliability >= 99 % PASS",
            "service_time p50 <= 50 ms PASS",
            "answered >= 80 % PASS",
            "queue:A-edge max <= 100 packets PASS",
            "cost <= 1 PASS",
            "radio 802.11n PASS",
            "area -",
        ]
    );
    assert_eq!(kpis(1), ["answered >= 99 % FAIL", "service_time max <= 1 s FAIL"]);
    let verdicts = |of: &str| [0, 1].map(|place| summary[of][place]["verdict"].clone());
    let expected = ["PASS", "FAIL"].map(Value::from);
    assert_eq!((verdicts("services"), verdicts("robots")), (expected.clone(), expected));
    assert_eq!(summary["verdict"], "FAIL");
    let its = &summary["services"][0];
    // Samples without an answer are above the median, which is therefore at least that of the answers.
    let median = &its["kpis"][1];
    let answered = |statistic: &str| its["service_time_ms"][statistic].as_f64().unwrap();
    assert!(its["unanswered"].as_u64().unwrap() > 0 && median["unit"] == "ms", "{its:#}");
    assert!((answered("p50")..=answered("p95")).contains(&median["value"].as_f64().unwrap()), "{its:#}");
    let longest = &summary["services"][1]["kpis"][1];
    let reason = longest["reason"].as_str().unwrap_or_default();
    assert!(longest["value"].is_null() && reason.ends_with(" samples have no answer"), "{longest:#}");
    let answered = &summary["services"][1]["kpis"][0];
    assert!(answered["value"].as_f64().unwrap() < 0.9, "{answered:#}");
    let printed = unwrapped(&stdout(&run));
    assert!(printed.contains("FAIL: r2 has answered >= 99 %: "), "{printed}");
    assert!(printed.contains(&format!("FAIL: r2 has service_time max <= 1 s: {reason}.")), "{printed}");
    assert!(printed.contains("r1 has the KPI area, not judged: "), "{printed}");
    let run = lab.folder();
    let diff = lab.cotorra(&["history", "diff", run.to_str().unwrap(), run.to_str().unwrap()]);
    let diff = unwrapped(&stdout(&diff));
    let measured = answered["measured"].as_str().unwrap();
    assert!(diff.contains(&format!("n2 answered >= 99 % {measured} FAIL {measured} FAIL")), "{diff}");
    let series = |more: &[&str]| {
        let run = ["history", "series", run.to_str().unwrap(), "service"];
        unwrapped(&stdout(&lab.cotorra(&[&run, more].concat())))
    };
    let (whole, part) = (series(&[]), series(&["--from", "1s"]));
    assert!(whole.contains(&format!("FAIL: r2 has answered >= 99 %: {measured}.")), "{whole}");
    let unjudged = "r2 has the KPI answered >= 99 %, not judged: it is FAIL over the whole run.";
    assert!(part.contains(unjudged), "{part}");

    let lab = Lab::with([String::new(), ", require: [localization_error p95 <= 0.1 m]".to_owned()]);
    let run = lab.run();
    assert_eq!(run.status.code(), Some(4), "{}", stdout(&run));
    assert!(unwrapped(&stdout(&run)).contains("FAIL: r2 has localization_error p95 <= 0.1 m: not measured."));
    assert_eq!(lab.summary()["services"][1]["kpis"][0]["value"], Value::Null);
}

#[test]
fn a_run_that_keeps_what_is_demanded_ends_well() {
    let lab = Lab::new(["80 %", ""]);
    let run = lab.run();
    assert_eq!((run.status.code(), &lab.summary()["verdict"]), (Some(0), &"PASS".into()), "{}", stdout(&run));
}

#[test]
fn a_sweep_counts_the_runs_that_failed_and_fails_itself_if_that_is_required() {
    let lab = Lab::new(["80 %", ""]);
    let sweep = |more: &[&str]| {
        let arguments =
            ["sweep", "testbed.yaml", "--headless", "--until", "30s", "--seeds", "2", "--out", "swept"];
        lab.cotorra(&[&arguments[..], more].concat())
    };
    let axis = ["--set", "schedule.0.set.loss=5 %,40 %"];
    let explored = sweep(&axis);
    assert_eq!(explored.status.code(), Some(0), "{}", stderr(&explored));
    let printed = stdout(&explored);
    assert!(
        printed.contains("failed") && printed.contains("0 of 2") && printed.contains("2 of 2"),
        "{printed}"
    );
    let read = |file: &str| fs::read_to_string(lab.path().join("swept").join(file)).unwrap();
    let ends = |file: &str| -> Vec<String> {
        // `void` is the last column.
        let cells = |line: &str| line.rsplit(',').skip(1).take(2).map(str::to_owned).collect::<Vec<_>>();
        read(file).lines().map(|line| cells(line).join(",")).collect()
    };
    assert_eq!(ends("cells.csv"), ["failed_runs,judged_runs", "0,2", "2,2"]);
    let passed: Vec<_> =
        read("runs.csv").lines().map(|line| line.rsplit(',').nth(1).unwrap().to_owned()).collect();
    assert_eq!(passed, ["passed", "1", "1", "0", "0"]);
    assert!(read("unanswered.csv").contains(",n1,A-edge,request,loss,"), "{}", read("unanswered.csv"));
    assert!(read("unanswered.csv").contains(",n2,B-edge,answer,loss,"), "{}", read("unanswered.csv"));

    let required = sweep(&[&axis[..], &["--require-pass"]].concat());
    assert_eq!(required.status.code(), Some(4), "{}", stderr(&required));
    let nothing = Lab::new(["", ""]);
    let arguments = ["sweep", "testbed.yaml", "--headless", "--until", "5s", "--require-pass"];
    let nothing = nothing.cotorra(&arguments);
    assert!(
        !nothing.status.success() && stderr(&nothing).contains("no run can pass or fail"),
        "{}",
        stderr(&nothing)
    );
}
