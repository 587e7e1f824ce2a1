//! SIGKILL to each part of a run at random points of its progress: nothing acknowledged is lost, nothing is left behind,
//! and the next run starts.
//!
//! An answer of the history, a `flush`, and the orderly end of a run acknowledge events (`docs/use/history.md`).
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{
    collections::{BTreeMap, BTreeSet},
    env, fs, iter,
    net::TcpStream,
    path::{Path, PathBuf},
};

use cotorra_testing::mariadb::MariaDb;
use serde_json::Value;
use tempfile::TempDir;

#[cfg(feature = "ethereum")]
use crate::chain::STEPS;
use crate::{
    harness::{Run, are_held, cotorra, kill, project_file, stderr, stdout, wait_until},
    one_robot::{navigated, testbed},
};

/// The environment variable with the seed of the first round. Without it, each commit is tested with the same draws.
const SEED: &str = "COTORRA_KILL_SEED";

/// The environment variable with the victims' names, separated by spaces. Without it, each victim is killed.
const VICTIMS: &str = "COTORRA_KILL_VICTIMS";

/// Environment variables for cotorra, with folders of the test's own.
const FOLDERS: [(&str, &str); 4] =
    [("TMPDIR", "tmp"), ("HOME", "home"), ("XDG_STATE_HOME", "state"), ("XDG_RUNTIME_DIR", "runtime")];

/// Maximum number of events before the next action: some seconds of a run.
const LONGEST: u64 = 150;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Victim {
    Core,
    Plugin,
    Vnf,
    MariaDb,
    Anvil,
}

/// Returns the victims that the environment names, or all.
fn victims() -> Vec<Victim> {
    let all = vec![Victim::Core, Victim::Plugin, Victim::Vnf, Victim::MariaDb, Victim::Anvil];
    let Ok(names) = env::var(VICTIMS) else { return all };
    let named = |name| all.iter().copied().find(|victim| format!("{victim:?}") == name);
    names.split(' ').map(|name| named(name).unwrap_or_else(|| panic!("{name} is none of {all:?}"))).collect()
}

/// Random numbers from a seed.
struct Draw(u64);

impl Draw {
    /// Returns the draws of the rounds. Any round's seed starts with that round again.
    fn rounds() -> impl Iterator<Item = Self> {
        let first = env::var(SEED).map_or(1, |seed| seed.parse().unwrap());
        iter::successors(Some(first), |seed| Some(cotorra_numbers::seed::split(*seed, "round"))).map(Self)
    }

    /// Draws a number below `bound`.
    fn below(&mut self, bound: u64) -> u64 {
        self.0 = cotorra_numbers::seed::split(self.0, "kill");
        self.0 % bound
    }

    fn shuffle<T>(&mut self, items: &mut [T]) {
        for last in (1..items.len()).rev() {
            items.swap(last, self.below(last as u64 + 1) as usize);
        }
    }

    fn events(&mut self) -> usize {
        1 + self.below(LONGEST) as usize
    }
}

/// Sends an instruction for each event, every fifth of which is refused, and logs those that were answered.
const INSTRUCTS: &str = r#"
import os, signal, sys
sys.path.insert(0, sys.argv[1])
from cotorra import Client, Refused

testbed = Client()
answered = os.open(sys.argv[2], os.O_WRONLY | os.O_CREAT | os.O_APPEND)
for number, _ in enumerate(testbed.stream("robot", "service_time")):
    try:
        if number % 5 == 4:
            testbed.instruct(str(number), instruction="attach", robot="tb", radio_unit="R9")
        else:
            testbed.instruct(str(number), instruction="note", process="kills", step=str(number))
    except Refused:
        pass
    os.write(answered, f"{number}\n".encode())
# An external program may keep running when its run is gone.
signal.pause()
"#;

/// State that all cycles share: one testbed file, one history in SQLite, and one in a server.
struct Site {
    place: TempDir,
    testbed: PathBuf,
    server: Option<MariaDb>,
    url: String,
    interfaces: BTreeSet<String>,
    /// Control groups and the entry of the previous run, which the next start removes.
    left: Vec<PathBuf>,
    /// Number of runs in each of the two histories.
    runs: [u64; 2],
    /// Instructions that were checked.
    answered: usize,
    rows: usize,
}

/// Contents of the history of an ended run.
struct Kept {
    /// Numbers of the plug-in's instructions, with the count of each.
    instructions: BTreeMap<usize, usize>,
    /// Number of events by kind.
    events: BTreeMap<String, usize>,
}

impl Site {
    fn new(has_server: bool) -> Self {
        let place = TempDir::new().unwrap();
        let server = has_server.then(MariaDb::start).flatten();
        let url = server.as_ref().map(MariaDb::fresh).unwrap_or_default();
        for (_, folder) in FOLDERS {
            fs::create_dir(place.path().join(folder)).unwrap();
        }
        let script = place.path().join("instructs.py");
        fs::write(&script, INSTRUCTS).unwrap();
        let (client, answered) = (project_file("clients/python"), place.path().join("answered"));
        let plugin = [script, client, answered].map(|path| path.display().to_string()).join(", ");
        let rest = navigated(
            "      other: { command: [sleep, '86399'], node: cloud, cpus: 0.5 }\n",
            &format!("plugins:\n  - {{ id: mine, command: [python3, {plugin}] }}\n"),
        );
        let folder = place.path().join("testbed");
        fs::create_dir(&folder).unwrap();
        let testbed = testbed(&folder, "kills", "{ kind: robot }", &rest);
        let interfaces = interfaces();
        Self { place, testbed, server, url, interfaces, left: Vec::new(), runs: [0; 2], answered: 0, rows: 0 }
    }

    fn history(&self, in_server: bool) -> String {
        let file = self.place.path().join("all.sqlite");
        if in_server { self.url.clone() } else { file.display().to_string() }
    }

    fn start(&mut self, testbed: &Path, in_server: bool, arguments: &[&str]) -> Run {
        let _ = fs::remove_file(self.place.path().join("answered"));
        self.runs[usize::from(in_server)] += 1;
        let history = self.history(in_server);
        let run = Run::start_with(testbed, arguments, |command| {
            command.env("COTORRA_HISTORY", history).env("PYTHONDONTWRITEBYTECODE", "1");
            command.envs(self.folders());
        });
        assert_eq!(self.left.drain(..).filter(|left| left.exists()).count(), 0);
        run
    }

    /// Returns the number of instructions that were answered to the plug-in.
    fn answered(&self) -> usize {
        let noted = fs::read_to_string(self.place.path().join("answered")).unwrap_or_default();
        let numbers = noted.lines().map(|line| line.parse::<usize>().unwrap());
        let count = noted.lines().count();
        assert!(numbers.eq(0..count), "{noted}");
        count
    }

    fn ask(&self, in_server: bool, words: &[&str]) -> String {
        let mut command = cotorra(["history"]);
        let done = command.args(words).env("COTORRA_HISTORY", self.history(in_server)).output().unwrap();
        assert!(done.status.success(), "{words:?}: {}", stderr(&done));
        stdout(&done)
    }

    /// Reads the contents of the history of a run.
    fn kept(&mut self, run: &Run, in_server: bool) -> Kept {
        let told =
            self.ask(in_server, &["events", run.folder.to_str().unwrap(), "--json", "--limit", "10000"]);
        let (mut instructions, mut events) = (BTreeMap::new(), BTreeMap::new());
        for line in told.lines() {
            let event: Value = serde_json::from_str(line).unwrap();
            *events.entry(event["event"].as_str().unwrap().to_owned()).or_default() += 1;
            if event["event"] == "decision" && event["plugin"] == "mine" {
                let number: usize = event["reason"].as_str().unwrap().parse().unwrap();
                assert_eq!(event["refused"].is_null(), number % 5 != 4, "{event}");
                *instructions.entry(number).or_default() += 1;
            }
        }
        self.rows += told.lines().count();
        Kept { instructions, events }
    }

    /// Returns the environment variables with the test's own folders.
    fn folders(&self) -> [(&'static str, PathBuf); 4] {
        FOLDERS.map(|(name, folder)| (name, self.place.path().join(folder)))
    }

    fn clean(&self, words: &[&str]) -> String {
        let done = cotorra(["clean"]).args(words).envs(self.folders()).output().unwrap();
        assert!(done.status.success(), "{}", stderr(&done));
        stdout(&done)
    }

    /// Returns the entries by which tools find runs.
    fn entries(&self) -> Vec<PathBuf> {
        let folder = self.place.path().join("runtime/cotorra");
        fs::read_dir(folder).map(|all| all.map(|entry| entry.unwrap().path()).collect()).unwrap_or_default()
    }

    /// Waits until nothing of a run is left: processes, namespaces with their interfaces, the API, mounts, files.
    ///
    /// Only control groups and an entry may stay, which the next start or `clean` removes.
    fn assert_nothing_is_left(&self, run: &Run, before: &Before) {
        wait_until(|| run.processes().is_empty());
        wait_until(|| !are_held(&before.namespaces));
        wait_until(|| interfaces().is_subset(&self.interfaces));
        assert!(TcpStream::connect(run.address()).is_err(), "{} is served", run.address());
        let mounts = fs::read_to_string("/proc/self/mountinfo").unwrap();
        assert!(!mounts.contains(run.folder.to_str().unwrap()), "{mounts}");
        for folder in ["tmp", "home", "state"] {
            let left: Vec<_> = fs::read_dir(self.place.path().join(folder)).unwrap().collect();
            assert!(left.is_empty(), "{left:?}");
        }
        let found = self.clean(&["--dry-run"]);
        let entries = self.entries().into_iter().map(|entry| entry.with_extension("json"));
        for left in before.groups.iter().cloned().chain(entries) {
            assert!(!left.exists() || found.contains(&left.display().to_string()), "{found}");
        }
    }
}

/// Resources of a run before it ends.
struct Before {
    namespaces: BTreeSet<u64>,
    groups: Vec<PathBuf>,
}

impl Before {
    fn of(run: &Run) -> Self {
        // This also records the processes: the run, and one of its programs.
        wait_until(|| run.processes().len() >= 2);
        Self { namespaces: run.namespaces(), groups: run.control_groups() }
    }
}

fn interfaces() -> BTreeSet<String> {
    let all = fs::read_dir("/sys/class/net").unwrap().flatten();
    all.map(|interface| interface.file_name().into_string().unwrap()).collect()
}

/// Waits for the process of a run whose command line contains these words.
fn process(run: &Run, words: &str) -> u32 {
    let mut found = None;
    wait_until(|| {
        let line = |pid: &u32| fs::read_to_string(format!("/proc/{pid}/cmdline")).unwrap_or_default();
        found = run.processes().into_iter().find(|pid| line(pid).replace('\0', " ").contains(words));
        found.is_some()
    });
    found.unwrap()
}

/// Skips a number of events.
fn pass(stream: &mut impl Iterator<Item = Value>, events: usize) {
    assert_eq!(stream.by_ref().take(events).count(), events, "the run goes on");
}

impl Site {
    /// Kills the victim in one run, and checks what is kept and what is left.
    fn cycle(&mut self, victim: Victim, draw: &mut Draw) -> String {
        let in_server = self.server.is_some() && (victim == Victim::MariaDb || draw.below(2) == 0);
        let testbed = self.testbed.clone();
        let mut run = self.start(&testbed, in_server, &["--until", "10min"]);
        let before = Before::of(&run);
        let events = draw.events();
        let mut stream = run.follow();
        pass(&mut stream, events);
        // Not always by `clean`, because the next start cleans up, too.
        let cleans = draw.below(2) == 0;
        let then = match victim {
            Victim::Core => self.kill_core(&mut run, in_server, draw.below(4) == 0),
            Victim::Plugin => self.kill_plugin(&mut run, &mut stream, in_server, draw),
            Victim::Vnf => self.kill_vnf(&mut run, &mut stream, in_server, draw),
            Victim::MariaDb => self.kill_mariadb(&mut run, &mut stream, draw),
            Victim::Anvil => unreachable!("its cycles are of another testbed"),
        };
        self.assert_nothing_is_left(&run, &before);
        if cleans {
            self.clean(&[]);
            assert_eq!(before.groups.iter().filter(|group| group.exists()).count(), 0);
            assert_eq!(self.entries(), Vec::<PathBuf>::new());
        }
        drop(run);
        self.left = before.groups;
        self.left.extend(self.entries());
        if victim == Victim::Core {
            self.next_run(in_server);
        }
        let history = if in_server { "MariaDB" } else { "SQLite" };
        format!("{victim:?} after {events} events, history in {history}, cleaned: {cleans}; {then}")
    }

    /// Runs the same file with the same history to its end.
    fn next_run(&mut self, in_server: bool) {
        let testbed = self.testbed.clone();
        let mut run = self.start(&testbed, in_server, &[]);
        run.wait_for_service();
        run.signal("INT");
        run.report();
        self.assert_all_is_kept(&run, in_server, 0);
    }

    /// Asserts that the history of a run that ended in order has every answered instruction and no gap.
    fn assert_all_is_kept(&mut self, run: &Run, in_server: bool, at_least: usize) -> Kept {
        let kept = self.assert_none_is_missing(run, in_server, 0);
        let (answered, there) = (self.answered(), kept.instructions.len());
        assert!(answered >= at_least && there >= answered, "{answered} answered, {there} kept");
        let gaps = self.ask(in_server, &["gaps", run.folder.to_str().unwrap()]);
        assert!(gaps.contains("no events were lost"), "{gaps}");
        kept
    }

    /// Asserts that the history has each instruction once, up to the last one it has.
    ///
    /// There are at least `at_least`, and at most those that were answered plus one that was under way.
    fn assert_none_is_missing(&mut self, run: &Run, in_server: bool, at_least: usize) -> Kept {
        wait_until(|| run.processes().is_empty());
        let (answered, kept) = (self.answered(), self.kept(run, in_server));
        self.answered += answered;
        let instructions = &kept.instructions;
        let there = instructions.len();
        assert!(instructions.keys().copied().eq(0..there), "{instructions:?}");
        assert!(instructions.values().all(|count| *count == 1), "{instructions:?}");
        assert!((at_least..=answered + 1).contains(&there), "{at_least} and {answered}, {there} kept");
        kept
    }

    /// Ends a run in order, and checks its summary against the history.
    fn end(&mut self, run: &mut Run, in_server: bool, faults: usize) -> Kept {
        let at_least = self.answered();
        run.signal("INT");
        let (summary, _) = run.report();
        assert_eq!(run.control_groups(), Vec::<PathBuf>::new());
        assert_eq!(summary["plugin_faults"].as_array().unwrap().len(), faults, "{summary:#}");
        assert_eq!(summary["history_dropped"].as_u64().unwrap_or_default(), 0, "{summary:#}");
        let kept = self.assert_all_is_kept(run, in_server, at_least);
        let of_kind = |kind: &str| kept.events.get(kind).copied().unwrap_or_default();
        let samples = summary["samples"].as_u64().unwrap() as usize;
        assert_eq!(of_kind("service_time"), samples, "{:?}", kept.events);
        assert_eq!(of_kind("plugin_fault"), faults, "{:?}", kept.events);
        kept
    }

    fn kill_core(&mut self, run: &mut Run, in_server: bool, while_it_ends: bool) -> String {
        let shown = |path: &str| run.get(path)["items"].as_array().unwrap().clone();
        let samples = shown("/api/v1/measurements/service-times?limit=10000");
        let decisions = shown("/api/v1/measurements/events?kinds=decision&limit=10000");
        // This records the processes that were started since.
        run.processes();
        if while_it_ends {
            run.signal("INT");
        }
        run.signal("KILL");
        let (status, ..) = run.wait();
        assert!(while_it_ends || status.code().is_none());
        let kept = self.assert_none_is_missing(run, in_server, decisions.len());
        let kept_samples = kept.events.get("service_time").copied().unwrap_or_default();
        assert!(kept_samples >= samples.len(), "{kept_samples} of {}", samples.len());
        if !in_server {
            let history = rusqlite::Connection::open(self.history(false)).unwrap();
            let integrity: String =
                history.query_row("PRAGMA integrity_check", [], |row| row.get(0)).unwrap();
            assert_eq!(integrity, "ok");
        }
        let (answered, shown, there) = (self.answered(), decisions.len(), kept.instructions.len());
        format!("while it ended: {while_it_ends}; {answered} answered, {shown} shown as kept, {there} kept")
    }

    /// Kills the plug-in: it is cut off and reported, and the run continues.
    fn kill_plugin(
        &mut self,
        run: &mut Run,
        stream: &mut impl Iterator<Item = Value>,
        in_server: bool,
        draw: &mut Draw,
    ) -> String {
        kill("KILL", &process(run, "instructs.py").to_string());
        let fault = stream.find(|event| event["event"] == "plugin_fault").unwrap();
        assert_eq!(fault["plugin"], "mine", "{fault}");
        let more = draw.events();
        pass(stream, more);
        let kept = self.end(run, in_server, 1);
        format!("{} instructions kept, then {more} events", kept.instructions.len())
    }

    /// Kills a VNF: it is reported and restarted.
    fn kill_vnf(
        &mut self,
        run: &mut Run,
        stream: &mut impl Iterator<Item = Value>,
        in_server: bool,
        draw: &mut Draw,
    ) -> String {
        let (vnf, words) =
            [("navigation", "vnf navigation"), ("other", "sleep 86399")][draw.below(2) as usize];
        kill("KILL", &process(run, words).to_string());
        for state in ["died", "started"] {
            let told = stream
                .find(|event| event["event"] == "vnf" && event["vnf"] == vnf && event["state"] == state);
            told.unwrap_or_else(|| panic!("{vnf} has not {state}"));
        }
        // The robot is navigated again.
        let answer =
            stream.find(|event| event["event"] == "service_time" && event["service_time_ms"].is_number());
        assert!(answer.is_some());
        let more = draw.events();
        pass(stream, more);
        let kept = self.end(run, in_server, 0);
        let lives = kept.events["vnf"];
        format!(
            "{vnf}, {} instructions kept, {lives} events of VNFs, then {more} events",
            kept.instructions.len()
        )
    }

    /// Kills the server: the run continues without it. The missing events are delivered by the run, or by the next program
    /// that opens the history.
    fn kill_mariadb(
        &mut self,
        run: &mut Run,
        stream: &mut impl Iterator<Item = Value>,
        draw: &mut Draw,
    ) -> String {
        let shown = run.get("/api/v1/measurements/events?kinds=decision&limit=10000");
        let shown = shown["items"].as_array().unwrap().len();
        let server = self.server.as_ref().unwrap();
        server.kill();
        let away = draw.events();
        pass(stream, away);
        let (kept, then) = match draw.below(4) {
            0 => {
                run.signal("KILL");
                run.wait();
                server.resume();
                (self.assert_none_is_missing(run, true, shown), "the core killed meanwhile".to_owned())
            }
            1 => {
                let at_least = self.answered();
                run.signal("INT");
                run.report();
                server.resume();
                (self.assert_all_is_kept(run, true, at_least), "the run ended meanwhile".to_owned())
            }
            _ => {
                server.resume();
                wait_until(|| run.ask("/api/v1/measurements/events?limit=1", None).0 == 200);
                let more = draw.events();
                pass(stream, more);
                (self.end(run, true, 0), format!("then {more} events"))
            }
        };
        format!("away for {away} events, {then}, {} instructions kept", kept.instructions.len())
    }
}

#[cfg(feature = "ethereum")]
impl Site {
    /// Kills the ledger while a robot walks out of its domain. If the ledger returns, the robot is handed over; otherwise
    /// the robot stops in coverage.
    fn kill_anvil(&mut self, draw: &mut Draw) -> Option<String> {
        let mut chain = crate::chain::Chain::start()?;
        chain.keep();
        // Deep enough for a node that lost the whole negotiation.
        let mut settings = chain.settings(64).to_vec();
        settings.push("plugins.orchestrator-1.settings.collect=2 s".to_owned());
        settings.push("walks.robot.waypoints=[[21, 0], [34, 0]]".to_owned());
        settings.push("walks.robot.and_back=false".to_owned());
        let arguments: Vec<_> = settings.iter().flat_map(|setting| ["--set", setting]).collect();
        let mut run = self.start(&project_file("testbeds/federation.yaml"), false, &arguments);
        let before = Before::of(&run);
        // Events that the history has returned are acknowledged.
        let decisions = |run: &Run| {
            let told = run.get("/api/v1/measurements/events?kinds=decision&limit=10000");
            told["items"].as_array().unwrap().clone()
        };
        let until = |steps: &[&str]| {
            let has = |note: &Value| steps.iter().any(|step| note["instruction"]["step"] == *step);
            wait_until(|| decisions(&run).iter().any(has));
        };
        let step = draw.below(STEPS.len() as u64) as usize;
        // Later steps count, too, because the step may have passed.
        until(&STEPS[step..]);
        let then =
            ["it comes back", "it comes back as before the run", "it stays away"][draw.below(3) as usize];
        if then == "it comes back" {
            chain.keep();
        }
        chain.kill();
        if then == "it stays away" {
            until(&["halted", "attached"]);
        } else {
            chain.resume();
            until(&["in use"]);
        }
        let more = draw.events();
        pass(&mut run.follow(), more);
        let told = decisions(&run);
        run.signal("INT");
        let (summary, _) = run.report();
        assert_eq!(summary["plugin_faults"], serde_json::json!([]), "{summary:#}");
        self.assert_nothing_is_left(&run, &before);
        let words = ["events", run.folder.to_str().unwrap(), "--json", "--limit", "10000"];
        let kept = self.ask(false, &words);
        self.rows += kept.lines().count();
        let kept: Vec<Value> = kept.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
        for decision in &told {
            assert_eq!(kept.iter().filter(|event| *event == decision).count(), 1, "{decision}");
        }
        assert!(!kept.iter().any(|event| event["event"] == "detached"), "it was in coverage all the time");
        let (step, told) = (STEPS[step], told.len());
        Some(format!("Anvil after `{step}`, {then}; {told} decisions kept, then {more} events"))
    }
}

#[cfg(not(feature = "ethereum"))]
impl Site {
    fn kill_anvil(&mut self, _: &mut Draw) -> Option<String> {
        None
    }
}

#[test]
fn whatever_is_killed_nothing_acknowledged_is_lost_and_the_next_run_starts() {
    let rounds = if env::var_os("COTORRA_FULL").is_some() { 20 } else { 1 };
    let victims = victims();
    let mut site = Site::new(victims.contains(&Victim::MariaDb));
    let mut killed = [0; 5];
    for mut draw in Draw::rounds().take(rounds) {
        eprintln!("{SEED}={} repeats this round", draw.0);
        let mut victims = victims.clone();
        draw.shuffle(&mut victims);
        for victim in victims {
            let told = match victim {
                Victim::MariaDb if site.server.is_none() => None,
                Victim::Anvil => site.kill_anvil(&mut draw),
                _ => Some(site.cycle(victim, &mut draw)),
            };
            let Some(told) = told else { continue };
            killed[victim as usize] += 1;
            eprintln!("{told}");
        }
    }
    let histories = if site.server.is_some() { &[false, true][..] } else { &[false] };
    for &in_server in histories {
        site.next_run(in_server);
        let runs = site.ask(in_server, &["runs", "--limit", "1000"]);
        assert_eq!(runs.lines().count() as u64 - 1, site.runs[usize::from(in_server)], "{runs}");
    }
    let (answered, rows) = (site.answered, site.rows);
    eprintln!("killed {killed:?}; {answered} answered instructions and {rows} rows were checked");
}
