//! A run in the kernel with radios: started, given instructions at times of its own, and examined.
//!
//! Time is virtual there. Waiting costs what the programs compute meanwhile, and a limit of a minute is no guess about the
//! speed of this machine.
#![allow(clippy::disallowed_types, clippy::disallowed_methods, reason = "the run's clock is the kernel's")]

use std::{
    collections::BTreeSet,
    fs,
    fs::File,
    os::{fd::AsFd, unix::fs::MetadataExt},
    process::Command,
    sync::mpsc::{self, Receiver},
    thread,
    time::{Duration, SystemTime},
};

use cotorra_hwsim::Radios;
use rustix::{
    process::{Pid, Signal, kill_process, kill_process_group},
    thread::{LinkNameSpaceType, move_into_link_name_space},
};
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::harness::{Run, are_held};

/// Virtual time that nothing here needs.
const LONG: Duration = Duration::from_secs(120);
/// Kinds of events that happen now and then, and are no readings or samples.
const NEWS: &str = "handover,detached,scanned,suggestion_answered,vnf,decision,plugin_fault,notice";

/// A robot `r1` that follows instructions, between the access points `A` and `B`, with a server `fog` behind them. `C` is off.
///
/// The robot walks between 4 m and 8 m for almost 5 minutes. The run ends with its walk.
pub const FLOOR: &str = "\
name: rig
wireless:
  lab:
    wifi: hwsim
    fast_transition: true
    mobility_domain: 49266
    path_loss: { model: log_distance, exponent: 3.0 }
    shadowing: { deviation: 0 dB }
nodes:
  r1: { kind: robot, roaming: instructed }
  A: { kind: radio_unit, position: [0, 0], channel: 1 }
  B: { kind: radio_unit, position: [12, 0], channel: 6 }
  C: { kind: radio_unit, position: [12, 5], channel: 11, serving: false }
  lan: { kind: switch }
  fog: { kind: server, tier: fog, cpus: 4, memory: 8 GB }
links:
  - { ends: [lan, [A, B, C, fog]], delay: 1 ms, rate: 100 Mbit/s }
services:
  navigation:
    robot: r1
    kpis: { service_time: 50 ms }
    vnfs:
      driver: { program: robot_driver, pinned_to: r1 }
      navigation: { program: navigation, node: fog }
    virtual_links:
      - { from: driver, to: navigation, rate: 1 Mbit/s }
walks:
  r1:
    waypoints: [[4, 0], [8, 0], [4, 0], [8, 0], [4, 0], [8, 0], [4, 0], [8, 0]]
    and_back: true
    speed_limit: 0.2 m/s
    position_interval: 50 ms
";

/// A running `cotorra run`, with its events. Killed on drop.
pub struct Rig {
    pub run: Run,
    /// When the run began, by the kernel's clock.
    began: SystemTime,
    arriving: Receiver<Value>,
    /// Events that arrived, in order.
    seen: Vec<Value>,
    /// Number of these that [`Self::wait_for`] has passed.
    passed: usize,
    _folder: TempDir,
}

/// A run that has ended.
pub struct Ended {
    /// Its part of `summary.json`.
    pub summary: Value,
    /// The [`NEWS`] that it kept, in order.
    pub events: Vec<Value>,
    run: Run,
}

impl Ended {
    /// Returns a log of its folder, such as `hostapd-A.log`.
    pub fn log(&self, name: &str) -> String {
        fs::read_to_string(self.run.folder.join("logs").join(name)).unwrap()
    }
}

impl Rig {
    /// Starts a testbed, whose robots have joined then; `None` where there are no radios.
    pub fn start(testbed: &str) -> Option<Self> {
        Self::start_with(testbed, &[])
    }

    /// Starts a testbed with further arguments of `cotorra run`.
    pub fn start_with(testbed: &str, arguments: &[&str]) -> Option<Self> {
        if !cotorra_testing::radios::are_promised() {
            return None;
        }
        wait_for_the_second();
        let folder = TempDir::new().unwrap();
        let file = folder.path().join("testbed.yaml");
        fs::write(&file, testbed).unwrap();
        // Threads that keep cores awake would let no time pass.
        let run = Run::start(&file, &[&["--save-power", "--until", "1h"], arguments].concat());
        let events = run.follow();
        let (sender, arriving) = mpsc::channel();
        thread::spawn(move || events.into_iter().try_for_each(|event| sender.send(event)));
        let at = Duration::from_nanos(run.get("/api/v1/clock")["at_ns"].as_u64().unwrap());
        let began = SystemTime::now() - at;
        Some(Self { run, began, arriving, seen: Vec::new(), passed: 0, _folder: folder })
    }

    /// Returns the time since the run began.
    pub fn now(&self) -> Duration {
        self.began.elapsed().unwrap()
    }

    /// Waits for a time since the run began.
    pub fn wait_until(&self, at: Duration) {
        thread::sleep(at.saturating_sub(self.now()));
    }

    /// Lets time pass.
    pub fn wait(&self, time: Duration) {
        thread::sleep(time);
    }

    /// Gives an instruction. Returns the reason if it is refused.
    pub fn instruct(&self, instruction: Value) -> Result<(), String> {
        let body = json!({ "instruction": instruction }).to_string();
        match self.run.post("/api/v1/instructions", &body) {
            (200, _) => Ok(()),
            (_, answer) => Err(answer.to_string()),
        }
    }

    /// Sends a robot to a radio unit.
    pub fn attach(&self, robot: &str, unit: &str) -> Result<(), String> {
        self.instruct(json!({ "instruction": "attach", "robot": robot, "radio_unit": unit }))
    }

    /// Lets a robot's radio unit suggest another one, and returns the status of its answer.
    pub fn suggest(&mut self, robot: &str, unit: &str) -> u64 {
        self.instruct(json!({ "instruction": "suggest", "robot": robot, "radio_unit": unit })).unwrap();
        let answer = self.wait_for(|event| is(event, "suggestion_answered", "robot", robot));
        assert_eq!(answer["radio_unit"], unit);
        answer["status"].as_u64().unwrap()
    }

    /// Waits for the next event that is wanted, behind the one that it returned last.
    pub fn wait_for(&mut self, wanted: impl Fn(&Value) -> bool) -> Value {
        loop {
            while let Some(event) = self.seen.get(self.passed) {
                self.passed += 1;
                if wanted(event) {
                    return event.clone();
                }
            }
            match self.arriving.recv_timeout(LONG) {
                Ok(event) => self.seen.push(event),
                Err(error) => panic!("{error}; there were only {:#?}", self.news()),
            }
        }
    }

    /// Waits for a robot's next handover to a radio unit.
    pub fn wait_for_handover(&mut self, robot: &str, to: &str) -> Value {
        self.wait_for(|event| is(event, "handover", "robot", robot) && event["to"] == to)
    }

    /// Waits for the next notice that contains these words.
    pub fn wait_for_notice(&mut self, words: &str) -> Value {
        self.wait_for(|event| {
            event["event"] == "notice" && event["message"].as_str().unwrap().contains(words)
        })
    }

    /// Returns the [`NEWS`] that arrived so far.
    pub fn news(&mut self) -> Vec<Value> {
        self.seen.extend(self.arriving.try_iter());
        self.seen.iter().filter(|event| is_news(event)).cloned().collect()
    }

    /// Returns the radio unit of a robot.
    pub fn place_of(&self, robot: &str) -> Option<String> {
        let robot = self.robot(robot);
        let mut attachments = robot["attachments"].as_array().unwrap().iter();
        let here = attachments.find(|attachment| attachment["attached"] == true)?;
        Some(here["radio_unit"].as_str().unwrap().to_owned())
    }

    /// Returns a robot's context, as the API describes it.
    pub fn robot(&self, robot: &str) -> Value {
        self.run.get(&format!("/api/v1/robots/{robot}"))
    }

    /// Returns a node, as the API describes it.
    pub fn node(&self, node: &str) -> Value {
        self.run.get(&format!("/api/v1/network/nodes/{node}"))
    }

    /// Returns the address of a node's radio, which is the BSSID of a radio unit.
    pub fn mac(&self, node: &str) -> String {
        let node = self.node(node);
        let bytes = node["address"]["mac"].as_array().unwrap().iter();
        bytes.map(|byte| format!("{:02x}", byte.as_u64().unwrap())).collect::<Vec<_>>().join(":")
    }

    /// Runs a closure in a node's network namespace. Sockets that it opens stay there.
    pub fn inside<T: Send>(&self, node: &str, work: impl FnOnce() -> T + Send) -> T {
        let namespace = File::open(self.node(node)["namespace"].as_str().unwrap()).unwrap();
        let work = || {
            move_into_link_name_space(namespace.as_fd(), Some(LinkNameSpaceType::Network)).unwrap();
            work()
        };
        thread::scope(|scope| scope.spawn(work).join().unwrap())
    }

    /// Runs a command in a node, and returns what it printed.
    pub fn output(&self, node: &str, command: &str) -> String {
        let [program, arguments @ ..] = &command.split(' ').collect::<Vec<_>>()[..] else { panic!() };
        let output = self.inside(node, || Command::new(program).args(arguments).output().unwrap());
        assert!(output.status.success(), "{command}: {}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8(output.stdout).unwrap()
    }

    /// Returns the number of a node's process with this program, such as `hostapd`.
    pub fn process(&self, node: &str, program: &str) -> Option<u32> {
        let namespace = fs::metadata(self.node(node)["namespace"].as_str().unwrap()).unwrap().ino();
        let is_it = |pid: &u32| {
            let file = |name: &str| format!("/proc/{pid}/{name}");
            fs::read_to_string(file("comm")).is_ok_and(|name| name.trim_end() == program)
                && fs::metadata(file("ns/net")).is_ok_and(|found| found.ino() == namespace)
        };
        self.run.processes().into_iter().find(is_it)
    }

    /// Kills a node's program.
    pub fn kill(&self, node: &str, program: &str) {
        let process = self.process(node, program).unwrap_or_else(|| panic!("`{node}` has no {program}"));
        kill_process(Pid::from_raw(process.try_into().unwrap()).unwrap(), Signal::KILL).unwrap();
    }

    /// Interrupts the run and its process group, as Ctrl-C at a terminal does.
    pub fn interrupt(&self) {
        let group = Pid::from_raw(self.run.pid().try_into().unwrap()).unwrap();
        kill_process_group(group, Signal::INT).unwrap();
    }

    /// Ends the run in order, by Ctrl-C.
    pub fn end(mut self) -> Ended {
        let (events, namespaces) = (kept(&self.run), self.run.namespaces());
        self.interrupt();
        let (summary, _) = self.run.report();
        nothing_is_left(&namespaces);
        Ended { summary, events, run: self.run }
    }
}

/// Whether a run with these namespaces has left a Wi-Fi program, a radio, a process or a namespace.
pub fn is_left(namespaces: &BTreeSet<u64>) -> bool {
    let processes = fs::read_dir("/proc").unwrap().flatten();
    let names = processes.map(|process| fs::read_to_string(process.path().join("comm")).unwrap_or_default());
    let programs = names.filter(|name| ["hostapd", "wpa_supplicant"].contains(&name.trim_end())).count();
    programs > 0 || are_held(namespaces) || !Radios::new().list().unwrap().is_empty()
}

/// Checks that a run that has ended has left nothing. The kernel may need a moment.
pub fn nothing_is_left(namespaces: &BTreeSet<u64>) {
    let checks = 0..100;
    let mut checks = checks.map(|_| thread::sleep(Duration::from_millis(20)));
    assert!(checks.any(|()| !is_left(namespaces)), "something is left");
}

/// Whether an event is of a kind, and one of its fields has a value.
pub fn is(event: &Value, kind: &str, field: &str, value: &str) -> bool {
    event["event"] == kind && event[field] == value
}

/// Whether an event is one of [`NEWS`].
pub fn is_news(event: &Value) -> bool {
    NEWS.split(',').any(|kind| event["event"] == kind)
}

/// Returns the [`NEWS`] that a run kept so far, in order.
fn kept(run: &Run) -> Vec<Value> {
    let mut events: Vec<Value> = Vec::new();
    let mut after = String::new();
    loop {
        let page = run.get(&format!("/api/v1/measurements/events?kinds={NEWS}{after}"));
        events.extend(page["items"].as_array().unwrap().iter().cloned());
        match page["next"].as_str() {
            Some(next) => after = format!("&after={next}"),
            None => return events,
        }
    }
}

/// Waits for the next full second of the kernel's clock, so that the kernel's ticks have the same phase in each run.
fn wait_for_the_second() {
    let since = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap();
    thread::sleep(Duration::from_secs(since.as_secs() + 1) - since);
}
