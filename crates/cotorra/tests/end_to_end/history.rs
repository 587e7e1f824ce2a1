//! Queries of recorded runs in the terminal, in a folder's own history and in a shared one.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{
    ffi::OsStr,
    fs,
    io::{BufRead, BufReader},
    os::unix::fs::symlink,
    path::{Path, PathBuf},
    process::{Command, Output, Stdio},
};

use cotorra_graph::Timestamp;
use cotorra_measurements::{History, RunInfo};
use cotorra_testing::mariadb::MariaDb;
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::harness::{corridor, cotorra, output, project_file, stderr, stdout};

/// Two runs in virtual time: each with its own history, and again in a shared one.
struct Runs {
    place: TempDir,
    probing: PathBuf,
    okpi: PathBuf,
}

impl Runs {
    fn new() -> Self {
        let place = TempDir::new().unwrap();
        // The map of runs in the shared history, which have no folder with a copy.
        symlink(project_file("testbeds"), place.path().join("testbeds")).unwrap();
        let shared = place.path().join("shared.sqlite");
        let simulate = |plugin: &str, seed: &str, arguments: &[&OsStr]| {
            let plugin = format!("plugin={plugin}");
            let out = place.path().join("runs");
            let mut command =
                cotorra(["run", "--simulate", "--headless", "--until", "20s", "--set", &plugin]);
            command.args(["--seed", seed]).arg("--out").arg(&out).arg(corridor()).args(arguments);
            let done = command.output().unwrap();
            assert!(done.status.success(), "{}", stderr(&done));
            let printed = stdout(&done);
            let folder =
                printed.lines().find_map(|line| line.strip_suffix('/')).expect("it names its folder");
            (PathBuf::from(folder), printed)
        };
        let (probing, printed) = simulate("probing", "1", &[]);
        assert!(printed.contains("history.sqlite") && !printed.contains("Its history"), "{printed}");
        let (okpi, _) = simulate("okpi", "2", &[]);
        for (plugin, seed, run) in [("probing", "1", "run 1 in"), ("okpi", "2", "run 2 in")] {
            let (folder, printed) = simulate(plugin, seed, &["--history".as_ref(), shared.as_ref()]);
            assert!(printed.contains(run) && !folder.join("history.sqlite").exists(), "{printed}");
        }
        Self { place, probing, okpi }
    }

    /// Runs `cotorra history` in the folder of the runs.
    fn ask(&self, arguments: &[&str]) -> Output {
        cotorra(["history"]).args(arguments).current_dir(self.place.path()).output().unwrap()
    }

    fn answer(&self, arguments: &[&str]) -> String {
        let answer = self.ask(arguments);
        assert!(answer.status.success(), "{arguments:?}: {}", stderr(&answer));
        stdout(&answer)
    }

    fn refusal(&self, arguments: &[&str]) -> String {
        let answer = self.ask(arguments);
        assert!(!answer.status.success(), "{arguments:?}: {}", stdout(&answer));
        // Joined words, because the terminal breaks lines.
        stderr(&answer).split_whitespace().filter(|word| *word != "│").collect::<Vec<_>>().join(" ")
    }
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

#[test]
fn runs_are_found_by_folder_and_by_number() {
    let runs = &Runs::new();
    let listed = runs.answer(&["runs"]);
    assert_eq!(listed.lines().count(), 5, "{listed}");
    assert!(
        listed
            .lines()
            .skip(1)
            .all(|line| line.contains("corridor") && line.ends_with("0:20  exact by construction")),
        "{listed}"
    );
    let newest = runs.answer(&["runs", "--limit", "1"]);
    // Columns are as wide as their cells.
    let words = |line: Option<&str>| line.unwrap().split_whitespace().map(str::to_owned).collect::<Vec<_>>();
    assert_eq!(words(newest.lines().nth(1)), words(listed.lines().last()), "{newest}");
    assert!(newest.contains("3 older"), "{newest}");
    let numbered = runs.answer(&["runs", "--history", "shared.sqlite", "--limit", "1"]);
    assert!(numbered.contains("... more with --after 1"), "{numbered}");
    // Runs in the folder of an experiment are found, too.
    let listed = runs.answer(&["runs", "--runs", "."]);
    assert_eq!(listed.lines().count(), 5, "{listed}");
    assert!(runs.answer(&["runs", "--history", "shared.sqlite", "--after", "1"]).contains("\n2 "));

    let of = |run: &[&str]| runs.answer(&[&["state"], run, &["--at", "12.5s", "--json"]].concat());
    let own = of(&[text(&runs.okpi)]);
    assert!(own == of(&["2", "--history", "shared.sqlite"]), "a shared history answers as an own one");
    assert!(own == of(&["latest"]), "a folder leads to the history that its run shares");
    assert!(own != of(&[text(&runs.probing)]));
}

/// Records two readings of a server's machine into a history of its own.
fn with_machine(folder: &Path) -> String {
    let place = folder.join("machine.sqlite");
    let history = History::open(&place).unwrap();
    let info = RunInfo { name: "office".into(), seed: 1, started_at_unix_ns: 0, testbed: String::new() };
    let run = history.begin_run(&info).unwrap();
    let recorder = history.recorder(run).unwrap();
    for second in [1_u64, 2] {
        let traffic = |throughput_bps: f64| json!({ "packets": 1, "bytes": 2, "errors": 0, "dropped": 0, "throughput_bps": throughput_bps });
        let station = json!({
            "mac": "02:00:00:00:01:00", "signal_dbm": -60.0, "transmit_rate_bps": null, "receive_rate_bps": null,
            "retransmissions": 3, "transmissions_failed": null, "transmit_airtime_ms": 1.5,
            "receive_airtime_ms": null, "inactive_ms": 20.0,
        });
        let event = json!({
            "at_ns": second * 1_000_000_000, "event": "machine", "node": "edge",
            "reading": { "measured_ns": second * 999_000_000, "time_error_ms": 0.25 },
            "cpu": { "cpus": 4, "busy": second as f64 / 8.0 },
            "load_average": { "one_minute": 0.5, "five_minutes": 0.25, "fifteen_minutes": 0.125 },
            "memory": { "memory_bytes": 8_000_000_000_u64, "available_bytes": 2_500_000_000_u64 },
            "interfaces": [{
                "name": "eth0", "up": true, "carrier": true, "speed_bps": null, "mtu_bytes": 1500,
                "received": traffic(8e6), "sent": traffic(1e6),
            }],
            "interfaces_left_out": 0,
            "wifi": [{
                "interface": "wlan0", "role": "access_point", "ssid": "lab", "stations": [station],
                "stations_left_out": 0, "channels": [], "channels_left_out": 0,
            }],
            "wifi_left_out": 0,
        });
        recorder.record(serde_json::from_value(event).unwrap());
    }
    history.end_run(run, Timestamp::from_secs_f64(3.0)).unwrap();
    text(&place).to_owned()
}

#[test]
fn gaps_name_silent_services_and_say_when_losses_are_unknown() {
    let folder = TempDir::new().unwrap();
    let place = folder.path().join("gaps.sqlite");
    let history = History::open(&place).unwrap();
    let info = RunInfo { name: "office".into(), seed: 1, started_at_unix_ns: 0, testbed: String::new() };
    let record = |ended: Option<f64>| {
        let run = history.begin_run(&info).unwrap();
        let recorder = history.recorder(run).unwrap();
        for ms in (0..8000_u64).step_by(100).filter(|ms| !(1000..7200).contains(ms)) {
            let event = json!({
                "at_ns": ms * 1_000_000, "event": "service_time", "service": "navigation", "robot": "r1",
                "sequence": 0, "emitted_ns": ms * 1_000_000, "service_time_ms": 12.5, "attachment": null,
                "server": "edge",
            });
            recorder.record(serde_json::from_value(event).unwrap());
        }
        recorder.flush().unwrap();
        if let Some(ended) = ended {
            history.end_run(run, Timestamp::from_secs_f64(ended)).unwrap();
        }
    };
    record(Some(8.0));
    record(None);
    let gaps = |run: &str, arguments: &[&str]| {
        let done = cotorra(["history", "gaps", run, "--history", text(&place)]).args(arguments).output();
        stdout(&done.unwrap())
    };
    let ended = gaps("1", &[]);
    assert!(ended.starts_with("no events were lost in that time\n"), "{ended}");
    assert!(ended.contains("\n  0.900  7.200  navigation of r1\n"), "{ended}");
    let begin = gaps("1", &["--to", "1s"]);
    assert!(begin.contains("\nno service stopped sampling in that time\n"), "{begin}");
    let killed = gaps("2", &[]);
    assert!(killed.starts_with("no events were lost up to 7.900 s\n"), "{killed}");
    assert!(killed.contains("how many were lost after 7.900 s is unknown: the run has no end"), "{killed}");
    assert!(gaps("2", &["--to", "7s"]).starts_with("no events were lost in that time\n"));
    let differ = cotorra(["history", "diff", "1", "2", "--history", text(&place)]).output().unwrap();
    let lost = stdout(&differ).lines().find(|line| line.contains("events lost")).map(str::to_owned).unwrap();
    assert_eq!(lost.split_whitespace().collect::<Vec<_>>(), ["events", "lost", "0", "at", "least", "0"]);
}

#[test]
fn machines_are_shown_and_drawn_and_exported() {
    let folder = TempDir::new().unwrap();
    let place = with_machine(folder.path());
    let answer = |arguments: &[&str]| {
        let answer = cotorra(["history"]).args(arguments).args(["--history", &place]).output().unwrap();
        assert!(answer.status.success(), "{arguments:?}: {}", stderr(&answer));
        stdout(&answer)
    };
    let events = answer(&["events", "1", "--kinds", "machine"]);
    let line = "machine        edge: 4 CPUs 25.0 % busy, load 0.50, 2.50 of 8.00 GB available, \
                eth0 8.000 Mbit/s in, 1.000 Mbit/s out, wlan0 with 1 station, read at 1.998 s ± 0.250 ms";
    assert!(events.lines().nth(1).unwrap().ends_with(line), "{events}");
    let state = answer(&["state", "1", "--at", "1.5s"]);
    let words: Vec<_> = state.lines().last().unwrap().split_whitespace().collect();
    assert_eq!(words, ["edge", "1.000", "4", "12.5", "%", "0.50", "8.00", "2.50", "1", "1"], "{state}");
    assert!(answer(&["series", "1", "edge"]).starts_with("cpu:edge\n"));
    let memory = answer(&["series", "1", "edge", "--figure", "available_memory", "--points", "1", "--csv"]);
    assert!(memory.lines().nth(1).unwrap().contains(",2,2500000000,2500000000,"), "{memory}");

    let out = folder.path().join("exported");
    answer(&["export", "1", "--out", text(&out)]);
    let table = fs::read_to_string(out.join("machine_interface.csv")).unwrap();
    assert!(table.lines().nth(1).unwrap().starts_with("0,0,eth0,1,1,,1500,1,2,0,0,8000000,"), "{table}");
    let table = fs::read_to_string(out.join("machine.csv")).unwrap();
    assert!(table.lines().nth(1).unwrap().ends_with(",999000000,0.25"), "{table}");
    answer(&["import", text(&out)]);
    assert_eq!(answer(&["events", "2", "--json"]), answer(&["events", "1", "--json"]));
}

#[test]
fn state_series_and_events_are_shown() {
    let runs = &Runs::new();
    let okpi = text(&runs.okpi);
    let state = runs.answer(&["state", okpi, "--at", "12.5s"]);
    for part in ["Robots", "R1-cloud   backward   12.000", "navigation    cloud"] {
        assert!(state.contains(part), "{part} is not in {state}");
    }
    let json: Value = serde_json::from_str(&runs.answer(&["state", okpi, "--json"])).unwrap();
    assert_eq!(json["links"].as_array().unwrap().len(), 46);

    let drawn = runs.answer(&["series", okpi, "service"]);
    assert!(drawn.starts_with("service_time:navigation, ms\n") && drawn.contains("median"), "{drawn}");
    let folder = tempfile::tempdir().unwrap();
    for (ending, begin) in [("svg", &b"<svg"[..]), ("pdf", b"%PDF-1.4"), ("png", b"\x89PNG")] {
        let file = folder.path().join("delay").with_extension(ending);
        runs.answer(&["series", okpi, "R1-cloud", "-o", text(&file)]);
        assert!(std::fs::read(&file).unwrap().starts_with(begin), "{ending}");
    }
    let table =
        runs.answer(&["series", okpi, "R1-cloud", "--from", "2s", "--to", "12s", "--points", "5", "--csv"]);
    assert_eq!(table.lines().count(), 6, "{table}");
    assert!(
        table.starts_with("from_ns,until_ns,count,min,mean,p50,p95,p99,max,last,gap,rolled_up,p50_low,")
            && table.contains("\n2000000000,4"),
        "{table}"
    );
    let signal = |figure: &[&str]| {
        runs.answer(&[&["series", okpi, "robot:R1", "--points", "1", "--csv"], figure].concat())
    };
    assert!(signal(&[]).contains(",-4"));
    assert_eq!(signal(&[]), signal(&["--figure", "signal"]));

    let printed = runs.ask(&["events", okpi, "--kinds", "handover,decision"]);
    assert!(stdout(&printed).contains("handover       robot from R1 to R3: "), "{}", stdout(&printed));
    let page = runs.ask(&["events", okpi, "--limit", "3", "--json"]);
    let lines: Vec<Value> = stdout(&page).lines().map(|l| serde_json::from_str(l).unwrap()).collect();
    assert_eq!(lines.len(), 3);
    let errors = stderr(&page);
    let cursor = errors.trim().strip_prefix("... more with --after ").unwrap();
    let next = runs.answer(&["events", okpi, "--limit", "1", "--json", "--after", cursor]);
    let first_four = runs.answer(&["events", okpi, "--limit", "4", "--json"]);
    assert!(first_four.ends_with(&next), "pages join without a seam");
    let gaps = "no events were lost in that time\nno service stopped sampling in that time\n";
    assert_eq!(runs.answer(&["gaps", okpi]), gaps);
}

#[test]
fn two_runs_are_compared_across_histories() {
    let runs = &Runs::new();
    let (probing, okpi) = (text(&runs.probing), text(&runs.okpi));
    let printed = runs.answer(&["diff", probing, okpi]);
    for part in ["okpi: attach", "robot from R1 to R3", "navigation on cloud", "median differs"] {
        assert!(printed.contains(part), "{part} is not in {printed}");
    }
    assert!(
        printed.contains("R1-cloud forward") && !printed.contains("R1-fog"),
        "links that nothing crossed are left out"
    );
    let json = |arguments: &[&str]| -> Value {
        let mut json: Value = serde_json::from_str(&runs.answer(arguments)).unwrap();
        json.as_object_mut().unwrap().remove("runs");
        json
    };
    let apart = json(&["diff", probing, okpi, "--json"]);
    assert_eq!(apart, json(&["diff", "1", "2", "--history", "shared.sqlite", "--json"]));
    assert_ne!(apart, json(&["diff", okpi, okpi, "--json"]));
}

#[test]
fn unknown_names_list_the_known_ones() {
    let runs = &Runs::new();
    let okpi = text(&runs.okpi);
    for (arguments, parts) in [
        (&["state", "nowhere"][..], ["there is no folder nowhere", "cotorra history runs"]),
        (&["state", "7"], ["run 7 is a number, but no history is named", "COTORRA_HISTORY"]),
        (&["state", "7", "--history", "shared.sqlite"], ["there is no run 7 in this history", "×"]),
        (&["state", "7", "--history", "none.sqlite"], ["there is no history none.sqlite", "cotorra run"]),
        (&["state", "."], ["it is not the folder of a run", "cotorra history runs"]),
        (&["state", "latest", "--runs", "nowhere"], ["there is no run in nowhere", "--runs"]),
        (&["series", okpi, "R9"], ["no link, robot, radio unit or machine `R9`", "robots: robot"]),
        (&["series", okpi, "R9", "--figure", "load"], ["no samples of load:R9", "radio units: R1, R2"]),
        (&["series", okpi, "robot", "--figure", "mood"], ["`mood:robot` is not a figure", "--help"]),
        (&["events", okpi, "--kinds", "weather"], ["`weather` is not a kind of event", "handover"]),
        (&["events", okpi, "--from", "12"], ["it has no unit", "12s"]),
        (&["events", okpi, "--after", "12"], ["`12` is not a cursor", "--after"]),
    ] {
        let errors = runs.refusal(arguments);
        assert!(parts.iter().all(|part| errors.contains(part)), "{arguments:?}: {errors}");
    }
    assert!(!runs.place.path().join("none.sqlite").exists(), "a question makes no history");
}

#[test]
fn a_server_keeps_histories_and_no_output_shows_its_password() {
    let Some(server) = MariaDb::start() else { return };
    let place = TempDir::new().unwrap();
    let url = server.fresh();
    let with_server = |arguments: &[&str]| {
        let mut command = cotorra(arguments);
        command.env("COTORRA_HISTORY", &url).current_dir(place.path()).output().unwrap()
    };
    let file = corridor();
    let run = ["run", "--simulate", "--headless", "--until", "5s", "-vv", text(&file)];
    let (first, second) = (with_server(&run), with_server(&run));
    assert!(first.status.success(), "{}", stderr(&first));
    assert!(stdout(&second).contains("run 2 in mysql://127.0.0.1:"), "{}", stdout(&second));
    let events = with_server(&["history", "events", "2", "--limit", "5"]);
    let of_folder = with_server(&["history", "events", "latest", "--limit", "5"]);
    assert!(events.status.success() && stdout(&events) == stdout(&of_folder), "{}", stderr(&of_folder));
    let dry = with_server(&[&run[..], &["--dry-run"]].concat());
    assert!(stdout(&dry).contains("mysql://127.0.0.1:"), "{}", stdout(&dry));
    let without = cotorra(["history", "state", "latest"]).current_dir(place.path()).output().unwrap();
    assert!(stderr(&without).contains("was recorded in mysql://127.0.0.1:"), "{}", stderr(&without));
    let wrong = format!("{}/more", url.split('?').next().unwrap());
    let wrong = output(["run", "--history", &wrong, "--simulate", text(&file)]);
    assert!(stderr(&wrong).contains("a server's URL ends with"), "{}", stderr(&wrong));

    let (_, password) = url.split_once("cotorra:").unwrap();
    let (password, _) = password.split_once('@').unwrap();
    for printed in [&first, &second, &events, &of_folder, &dry, &without, &wrong] {
        assert!(!(stdout(printed) + &stderr(printed)).contains(password));
    }
    let mut folders = vec![place.path().to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()) {
            if entry.is_dir() {
                folders.push(entry);
            } else {
                let bytes = fs::read(&entry).unwrap();
                let found = bytes.windows(password.len()).any(|part| part == password.as_bytes());
                assert!(!found, "{} has the password", entry.display());
            }
        }
    }
}

#[test]
fn an_exported_run_is_imported_with_the_same_answers() {
    let runs = &Runs::new();
    let okpi = text(&runs.okpi);
    let events = |run: &[&str]| {
        let printed = runs.ask(&[&["events"], run, &["--json", "--limit", "10000"]].concat());
        assert!(printed.status.success() && stderr(&printed).is_empty(), "{}", stderr(&printed));
        stdout(&printed)
    };
    let formats = [("csv", "1"), ("parquet", "2"), ("arrow", "3")];
    let (built, others) = formats.split_at(if cfg!(feature = "databases") { 3 } else { 1 });
    for (format, number) in built {
        let printed = runs.answer(&["export", okpi, "--format", format, "--out", format]);
        assert!(printed.contains(" events in "), "{printed}");
        let robots = runs.place.path().join(format!("{format}/robot.{format}"));
        assert!(fs::metadata(robots).unwrap().len() > 1000);
        let printed = runs.answer(&["import", format, "--history", "imported.sqlite"]);
        assert!(printed.contains(&format!("are run {number} in imported.sqlite")), "{printed}");
        let imported = [*number, "--history", "imported.sqlite"];
        assert!(events(&[okpi]) == events(&imported), "{format}");
        assert!(runs.refusal(&["export", okpi, "--out", format]).contains("exists already"));
    }
    for (format, _) in others {
        let errors = runs.refusal(&["export", okpi, "--format", format, "--out", format]);
        assert!(errors.contains("--features databases"), "{errors}");
    }
    let csv = fs::read_to_string(runs.place.path().join("csv/handover.csv")).unwrap();
    assert!(csv.starts_with("n,at_ns,robot,from_radio_unit,to_radio_unit,fast,gap_ms\n"), "{csv}");
    for (table, column, names) in
        [("link", 3, &["forward", "backward"][..]), ("robot", 16, &["simulator", "localization"])]
    {
        let csv = fs::read_to_string(runs.place.path().join(format!("csv/{table}.csv"))).unwrap();
        let found = csv.lines().nth(1).unwrap().split(',').nth(column).unwrap();
        assert!(names.contains(&found), "{found} in {table}.csv");
    }
    let listed = runs.answer(&["runs", "--history", "imported.sqlite"]);
    assert!(
        listed.lines().skip(1).all(|line| line.contains("corridor") && line.ends_with("0:20")),
        "{listed}"
    );
    assert!(runs.refusal(&["import", "csv"]).contains("--history"));
    assert!(runs.refusal(&["import", ".", "--history", "imported.sqlite"]).contains("it has no run.json"));
}

/// Follows the stream and prints its events. At a handover, it queries the history and requests a scan.
const LISTENER: &str = r#"
import json, sys
from cotorra import Client, Refused

testbed = Client(api=sys.argv[1], plugin="listener")
scans = 0
for event in testbed.stream("robot", "handover", "decision", wake_every_s=2.5):
    print(json.dumps(event, ensure_ascii=False, separators=(",", ":")))
    if event["event"] == "handover":
        past = testbed.series("service_time", points=1)["points"][0]
        assert past["until_ns"] <= event["at_ns"] + 1 and testbed.state(at_ns=10**12)["at_ns"] <= event["at_ns"]
        try:
            testbed.instruct("it moved", instruction="scan", robot=event["robot"])
        except Refused as refused:
            scans += "this is a replay" in str(refused)
assert scans == 1, scans
"#;

#[test]
fn a_replay_sends_a_plugin_the_same_events_each_time() {
    let runs = &Runs::new();
    let (okpi, script) = (text(&runs.okpi), runs.place.path().join("listener.py"));
    fs::write(&script, LISTENER).unwrap();
    let events = || runs.answer(&["events", okpi, "--json", "--limit", "10000"]);
    let recorded = events();
    let base = corridor();
    let base = text(base.parent().unwrap());
    let replay = |arguments: &[&str]| {
        let mut command = cotorra(["replay", okpi, "--base", base, "--api", "127.0.0.1:0"]);
        let mut child =
            command.args(arguments).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        let mut errors = BufReader::new(child.stderr.take().unwrap());
        let mut line = String::new();
        errors.read_line(&mut line).unwrap();
        let api = line
            .strip_prefix("API on ")
            .and_then(|l| l.split_once(", replay of "))
            .expect(&line)
            .0
            .to_owned();
        // Kept open, because the replay writes to it at its end.
        (child, api, errors)
    };
    let play = || {
        let (child, api, _said) = replay(&["--speed", "max"]);
        let mut python = Command::new("python3");
        python.arg(&script).arg(&api).env("PYTHONPATH", project_file("clients/python"));
        let listened = python.env("PYTHONDONTWRITEBYTECODE", "1").output().unwrap();
        assert!(listened.status.success(), "{}", stderr(&listened));
        let played = child.wait_with_output().unwrap();
        assert!(played.status.success(), "{played:?}");
        (stdout(&listened), stdout(&played))
    };
    let (heard, asked) = play();
    assert!((heard.clone(), asked.clone()) == play(), "each time is the same");
    let read =
        |lines: &str| -> Vec<Value> { lines.lines().map(|l| serde_json::from_str(l).unwrap()).collect() };
    let (wakes, printed): (Vec<_>, Vec<_>) =
        read(&heard).into_iter().partition(|event| event["event"] == "wake");
    let wanted =
        |event: &Value| ["robot", "handover", "decision"].contains(&event["event"].as_str().unwrap());
    let was: Vec<_> = read(&recorded).into_iter().filter(wanted).collect();
    assert!(printed == was, "what is heard is what was: {} and {}", printed.len(), was.len());
    assert!(wakes.len() > 8);
    let decisions = read(&asked);
    assert_eq!(decisions.len(), 1, "{asked}");
    assert_eq!((&decisions[0]["plugin"], &decisions[0]["reason"]), (&"listener".into(), &"it moved".into()));
    assert!(recorded == events(), "the history is as it was");

    let (child, _, _said) = replay(&["--speed", "1000x", "--from", "5s", "--to", "15s"]);
    assert!(child.wait_with_output().unwrap().status.success());
}

#[test]
fn a_bundled_plugin_decides_in_a_replay_what_it_decided_in_the_run() {
    let runs = &Runs::new();
    let corridor = corridor();
    let base = text(corridor.parent().unwrap());
    let arguments = ["--base", base, "--api", "127.0.0.1:0", "--speed", "max", "--bundled", "okpi"];
    let played = cotorra(["replay", text(&runs.okpi)]).args(arguments).output().unwrap();
    assert!(played.status.success(), "{}", stderr(&played));
    let decisions = |lines: &str| -> Vec<Value> {
        let decision = |line: &str| {
            let mut decision: Value = serde_json::from_str(line).unwrap();
            decision.as_object_mut().unwrap().remove("refused");
            decision
        };
        lines.lines().map(decision).collect()
    };
    let recorded = runs.answer(&["events", text(&runs.okpi), "--kinds", "decision", "--json"]);
    let recorded = decisions(&recorded);
    assert!(!recorded.is_empty());
    assert_eq!(decisions(&stdout(&played)), recorded);
}
