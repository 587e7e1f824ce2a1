//! Two domains with a core each, in two network namespaces, on one ledger.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{
    fs, io,
    net::{Shutdown, TcpListener, TcpStream, UdpSocket},
    path::Path,
    process::{Child, Command, Stdio},
    thread,
};

use serde_json::Value;

use crate::{
    chain::Chain,
    harness::{Run, events, output, project_file, stderr, stdout, wait_until},
};

/// The address at which both machines reach the ledger's node.
const LEDGER: &str = "192.168.78.254";
/// Names of bridges begin with it, and end with the process that made them.
const BRIDGE: &str = "cores";

/// Network namespaces of two machines, and a bridge between them, which has the ledger's address.
struct Machines {
    bridge: String,
    sleepers: [Child; 2],
}

impl Machines {
    /// `None` if this user may not make them.
    fn new() -> Option<Self> {
        remove_leftovers();
        let bridge = format!("{BRIDGE}{}", std::process::id());
        if !ip(&["link", "add", &bridge, "type", "bridge"]) {
            eprintln!("skipped: this user may not make bridges");
            return None;
        }
        let sleeper = || {
            // It ends with this test, however that ends.
            let mut command = Command::new("setpriv");
            command.args([
                "--pdeathsig",
                "KILL",
                "unshare",
                "--net",
                "sh",
                "-c",
                "echo; exec sleep infinity",
            ]);
            command.stdout(Stdio::piped());
            let mut child = command.spawn().unwrap();
            // The namespace is there once the line is.
            io::Read::read_exact(&mut child.stdout.take().unwrap(), &mut [0]).unwrap();
            child
        };
        let machines = Self { sleepers: [sleeper(), sleeper()], bridge };
        let bridge = machines.bridge.as_str();
        assert!(ip(&["address", "add", &format!("{LEDGER}/24"), "dev", bridge]));
        assert!(ip(&["link", "set", bridge, "up"]));
        for (place, sleeper) in machines.sleepers.iter().enumerate() {
            let (port, pid) = (format!("{bridge}-{place}"), sleeper.id().to_string());
            assert!(ip(&["link", "add", &port, "type", "veth", "peer", "name", "eth0", "netns", &pid]));
            assert!(ip(&["link", "set", &port, "master", bridge, "up"]));
            let address = format!("192.168.78.{}/24", place + 1);
            for line in [&["address", "add", &address, "dev", "eth0"][..], &["link", "set", "eth0", "up"]] {
                assert!(machines.inside(place).arg("ip").args(line).status().unwrap().success());
            }
            assert!(
                machines.inside(place).args(["ip", "link", "set", "lo", "up"]).status().unwrap().success()
            );
        }
        Some(machines)
    }

    /// Returns a command that runs the program after it on a machine.
    fn inside(&self, place: usize) -> Command {
        let mut command = Command::new("nsenter");
        command.arg(format!("--net=/proc/{}/ns/net", self.sleepers[place].id()));
        command
    }

    /// Changes a command to run on a machine.
    fn on(&self, place: usize, command: &mut Command) {
        let mut inside = self.inside(place);
        inside.arg(command.get_program()).args(command.get_args());
        for (name, value) in command.get_envs() {
            match value {
                Some(value) => inside.env(name, value),
                None => inside.env_remove(name),
            };
        }
        *command = inside;
    }
}

impl Drop for Machines {
    fn drop(&mut self) {
        for sleeper in &mut self.sleepers {
            let _ = sleeper.kill();
            let _ = sleeper.wait();
        }
        ip(&["link", "delete", &self.bridge]);
    }
}

/// Removes bridges of tests that were killed, which have the same address.
fn remove_leftovers() {
    for entry in fs::read_dir("/sys/class/net").unwrap().flatten() {
        let name = entry.file_name().into_string().unwrap();
        let maker = name.strip_prefix(BRIDGE).filter(|pid| pid.bytes().all(|byte| byte.is_ascii_digit()));
        if maker.is_some_and(|pid| !Path::new("/proc").join(pid).exists()) {
            ip(&["link", "delete", &name]);
        }
    }
}

fn ip(arguments: &[&str]) -> bool {
    Command::new("ip").args(arguments).stderr(Stdio::null()).status().is_ok_and(|status| status.success())
}

/// Lets both machines reach a node of this one, until the test ends. Returns its URL there.
fn offer(port: u16) -> String {
    let listener = TcpListener::bind((LEDGER, 0)).unwrap();
    let url = format!("ws://{}", listener.local_addr().unwrap());
    thread::spawn(move || {
        for near in listener.incoming().flatten() {
            let far = TcpStream::connect(("127.0.0.1", port)).unwrap();
            for (mut from, mut to) in [(near.try_clone().unwrap(), far.try_clone().unwrap()), (far, near)] {
                thread::spawn(move || {
                    let _ = io::copy(&mut from, &mut to);
                    let _ = to.shutdown(Shutdown::Both);
                });
            }
        }
    });
    url
}

/// Returns the steps that a run's orchestrator noted.
fn steps(folder: &Path) -> Vec<String> {
    let step = |event: Value| Some(event["instruction"]["step"].as_str()?.to_owned());
    events(folder, "decision").into_iter().filter_map(step).collect()
}

fn ms(event: &Value) -> f64 {
    event["at_ns"].as_f64().unwrap() / 1e6
}

/// Starts the core of each domain on its machine: that of the robot, and that of the vAP.
fn start(chain: &Chain, machines: &Machines) -> [Run; 2] {
    let [first, second, ..] = chain.settings_at(&offer(chain.port()), 0);
    let testbed = |name: &str| project_file("testbeds/two-cores").join(format!("{name}.yaml"));
    // The robot leaves its domain's coverage after 12 s, and is back in it after 29 s.
    let walk = "walks.robot.waypoints=[[20, 0], [26.2, 0]]";
    // So that it can be seen who carries the packets.
    let slow = "links.sw2-border.delay=20 ms";
    let visited = Run::start_with(&testbed("domain-2"), &["--set", &second, "--set", slow], |command| {
        machines.on(1, command);
    });
    let walk = ["--set", &first, "--set", walk];
    let home = visited.another_with(&testbed("domain-1"), &walk, |command| machines.on(0, command));
    [home, visited]
}

#[test]
fn a_robot_is_handed_over_between_two_cores_and_back() {
    let Some(chain) = Chain::start() else { return };
    let Some(machines) = Machines::new() else { return };
    let [mut home, mut visited] = start(&chain, &machines);
    let (summary, _) = home.report();
    wait_until(|| steps(&visited.folder).iter().any(|step| step == "paid"));
    visited.signal("INT");
    let (visited_summary, _) = visited.report();
    assert_eq!(summary["ended"], "every walk is done", "{summary}");

    // Each core's orchestrator notes its own steps only.
    let own = |steps: Vec<String>, expected: &[&str]| {
        let mut rest = steps.iter();
        let is_in_order = expected.iter().all(|step| rest.any(|noted| noted == step));
        assert!(is_in_order, "{steps:?}");
        steps
    };
    let creator = ["announced", "bid received", "winner chosen", "confirmation received", "attached"];
    let noted = own(steps(&home.folder), &[&creator[..], &["in use", "returned", "ended"]].concat());
    assert!(!noted.iter().any(|step| step == "failed" || step == "halted"), "{noted:?}");
    let provider =
        ["bid sent", "winner received", "deployment finished", "confirmation sent", "taken down", "paid"];
    own(steps(&visited.folder), &provider);

    // The handover there is a fast transition of the visitor, and one back.
    let handovers = events(&home.folder, "handover");
    let [there, back] = &handovers[..] else { panic!("{handovers:#?}") };
    assert_eq!([&there["from"], &there["to"]], ["R3", "n_AP"], "{handovers:#?}");
    assert_eq!(back["to"], "R3", "{handovers:#?}");
    assert!(there["fast"] == true && back["fast"] == true, "{handovers:#?}");
    let arrived = events(&visited.folder, "handover");
    let [arrived] = &arrived[..] else { panic!("{arrived:#?}") };
    assert_eq!([&arrived["robot"], &arrived["to"]], ["visitor", "n_AP"]);

    // Its packets cross the visited domain's slow link twice while it is away, and only then.
    let answered = |event: &Value| event["service_time_ms"].as_f64();
    let samples = events(&home.folder, "service_time");
    let (mut at_home, mut away) = (Vec::new(), Vec::new());
    for sample in &samples {
        if ms(sample) > ms(there) + 500.0 && ms(sample) < ms(back) - 500.0 {
            away.push(answered(sample));
        } else if ms(sample) < ms(there) - 500.0 || ms(sample) > ms(back) + 500.0 {
            at_home.push(answered(sample));
        }
    }
    let least = |samples: &[Option<f64>]| samples.iter().flatten().copied().fold(f64::MAX, f64::min);
    let share = away.iter().flatten().count() as f64 / away.len() as f64;
    assert!(away.len() > 50 && share > 0.9, "{share} of {} answered", away.len());
    assert!(least(&away) > 42.0 && least(&at_home) < 30.0, "{} {}", least(&away), least(&at_home));

    // It walks on meanwhile: the visitor stands where it is.
    let places = |folder: &Path, robot: &str| -> Vec<f64> {
        let of = events(folder, "robot").into_iter().filter(|event| event["robot"] == robot);
        of.map(|event| event["sensors"]["pose"]["x"].as_f64().unwrap()).collect()
    };
    let farthest = |places: Vec<f64>| places.into_iter().fold(f64::MIN, f64::max);
    let (robot, visitor) = (places(&home.folder, "robot"), places(&visited.folder, "visitor"));
    let apart =
        farthest(robot.clone()) - farthest(visitor.iter().copied().skip_while(|x| *x == 30.0).collect());
    assert!(apart.abs() < 0.2 && farthest(robot) > 25.8, "{apart}");
    // Neither core knows anything of the other's nodes but the names of what its robot heard.
    let radio_units = |folder: &Path| -> Vec<Value> {
        events(folder, "radio").iter().map(|event| event["radio_unit"].clone()).collect()
    };
    assert!(radio_units(&home.folder).iter().all(|unit| unit == "R3"));
    assert!(radio_units(&visited.folder).iter().all(|unit| unit == "n_AP"));
    assert_eq!(visited_summary["ended"], "it was stopped", "{visited_summary}");
}

#[test]
fn a_robot_whose_visited_core_is_killed_halts_at_its_own_radio_unit() {
    let Some(chain) = Chain::start() else { return };
    let Some(machines) = Machines::new() else { return };
    let [mut home, visited] = start(&chain, &machines);
    let about = |kinds: &str| events(&home.folder, kinds);
    let are_attached = |to: &str| about("handover").iter().any(|event| event["to"] == to);
    wait_until(|| are_attached("n_AP"));

    // Datagrams of strangers harm neither core.
    let stranger = UdpSocket::bind((LEDGER, 0)).unwrap();
    for place in 1..=2 {
        let border = format!("192.168.78.{place}:7450");
        for length in (0..2000).cycle().take(10_000) {
            // The socket may be full.
            let _ = stranger.send_to(&[length as u8; 2000][..length], &border);
        }
    }
    let answered = || about("service_time").iter().filter(|event| event["service_time_ms"].is_f64()).count();
    let before = answered();
    wait_until(|| answered() > before + 10);
    assert_eq!(about("detached").len(), 0);

    visited.signal("KILL");
    wait_until(|| steps(&home.folder).iter().any(|step| step == "failed") && are_attached("R3"));
    let [lost] = &about("detached")[..] else { panic!("{:#?}", about("detached")) };
    assert_eq!([&lost["robot"], &lost["from"]], ["robot", "n_AP"]);
    let halts = |event: &Value| event["instruction"]["instruction"] == "halt" && event["refused"].is_null();
    wait_until(|| about("decision").iter().any(halts));
    // It stands still where its own radio unit serves it.
    let is_still = || {
        let about = about("robot");
        let mut last = about.iter().rev().take(20).map(|event| &event["sensors"]["pose"]["x"]);
        let place = last.next();
        last.all(|x| Some(x) == place)
    };
    wait_until(is_still);
    // Its own domain serves it.
    let before = answered();
    wait_until(|| answered() > before + 5);
    home.signal("INT");
    let (summary, _) = home.report();
    assert_eq!(summary["ended"], "it was stopped", "{summary}");
}

#[test]
fn a_dry_run_explains_the_border_and_virtual_time_rejects_it() {
    let file = project_file("testbeds/two-cores/domain-2.yaml");
    let file = file.to_str().unwrap();
    let said = stdout(&output(["run", "--dry-run", file]));
    assert!(said.contains("they reach this one over UDP at 192.168.78.2:7450"), "{said}");
    assert!(said.contains("one robot for each visitor: visitor"), "{said}");
    let said = stdout(&output(["check", file]));
    assert!(said.contains("a border at 192.168.78.2:7450 for 1 visitor"), "{said}");
    let done = output(["run", "--headless", "--simulate", "--until", "1s", file]);
    let said = stderr(&done).replace('│', " ").split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(!done.status.success() && said.contains("virtual time has none: run in real time"), "{said}");
}
