//! A run with real radios (`wifi: hardware`): three machines with real agents, two access points and a robot. Each is a network
//! namespace with one radio, whose air is the kernel's own. In the end, all is as their owners had it.

use std::{
    fs,
    path::PathBuf,
    process::{Child, Command, Stdio},
    time::Duration,
};

use cotorra_hwsim::{MacAddress, Radio, Radios};
use serde_json::{Value, json};

use crate::{
    harness::cotorra,
    rig::{Rig, is},
};

const CORE: &str = "10.9.0.1:7448";
const AUTHORITY: &str = "/run/authority";
/// Most of a gap: IEEE 802.11r aims at 50 ms.
const MOST_MS: f64 = 50.0;

const FLOOR: &str = "\
name: hardware
wireless: { lab: { access: edca, wifi: hardware, security: { method: wpa2, passphrase: correct horse } } }
nodes:
  r1: { kind: robot, position: [4, 0], agent: robot1, interface: wlan0 }
  A: { kind: radio_unit, position: [0, 0], channel: 1, agent: ap1, interface: wlan1, bridge: br0 }
  B: { kind: radio_unit, position: [12, 0], channel: 6, agent: ap2, interface: wlan2, bridge: br0 }
  lan: { kind: switch }
links:
  - { ends: [lan, [A, B]] }
";

const HOSTAPD: &str = "\
interface=wlan1
bridge=br0
ctrl_interface=/run/hostapd
ssid=home
channel=11
hw_mode=g
wpa=2
wpa_key_mgmt=WPA-PSK
rsn_pairwise=CCMP
wpa_passphrase=the owner's secret
";

const SUPPLICANT: &str = "\
ctrl_interface=/run/wpa_supplicant
network={
 ssid=\"home\"
 key_mgmt=WPA-PSK
 psk=\"the owner's secret\"
 scan_freq=2412 2437 2462
}
";

/// The machines: a robot, and two access points. Machine `n` is the namespace `un`, with the interface `wlann`: all see one
/// `/run`, where hostapd and wpa_supplicant have a socket for each interface.
const MACHINES: [&str; 3] = ["robot1", "ap1", "ap2"];

fn sh(script: &str) -> String {
    let output = Command::new("sh").args(["-ec", script]).output().unwrap();
    assert!(output.status.success(), "{script}: {output:?}");
    String::from_utf8(output.stdout).unwrap()
}

/// The machines with their agents. Their radios go with this.
struct Machines {
    agents: Vec<Child>,
    _radios: Radios,
}

impl Machines {
    /// Connects the machines to the core, starts their owners' programs, and then the agents. Access points have a cable; a robot
    /// without one reaches the core by the first access point.
    fn start(robot_has_cable: bool) -> Self {
        let mut radios = Radios::new();
        sh("ip link add lan type bridge
            ip address add 10.9.0.1/24 dev lan
            ip address add 10.8.0.1/24 dev lan
            ip link set lan up");
        for number in 0..3_u8 {
            let radio = Radio {
                permanent_address: Some(MacAddress([2, 0, 0, 9, number, 0])),
                channels: Some(1),
                ends_with_socket: true,
                ..Radio::default()
            };
            let phy = radios.create(&radio).and_then(|id| radios.name(id)).unwrap();
            sh(&format!(
                "n={number}
                ip netns add u$n
                iw phy {phy} set netns name u$n
                wlan=$(ip netns exec u$n iw dev | sed -n 's/.*Interface //p')
                [ $wlan = wlan$n ] || ip -n u$n link set $wlan name wlan$n
                ip link add up$n type veth peer name eth0 netns u$n
                ip link set up$n master lan up
                ip -n u$n link set lo up
                ip -n u$n link add br0 type bridge
                ip -n u$n link set br0 up
                ip -n u$n link set eth0 master br0 up
                ip -n u$n address add 10.9.0.1$n/24 dev br0"
            ));
        }
        if !robot_has_cable {
            sh("ip -n u0 link delete eth0");
        }
        fs::write("/run/hostapd.conf", HOSTAPD).unwrap();
        fs::write("/run/supplicant.conf", SUPPLICANT).unwrap();
        let address = if robot_has_cable { "10.8.0.10/24" } else { "10.9.0.10/24" };
        if !robot_has_cable {
            sh("ip -n u0 address flush dev br0");
        }
        sh(&format!("ip -n u0 address add {address} dev wlan0"));
        sh("ip netns exec u1 hostapd -B -f /run/hostapd.log /run/hostapd.conf
            ip netns exec u0 wpa_supplicant -B -f /run/supplicant.log -i wlan0 -D nl80211 -c /run/supplicant.conf");
        let agents = (0..3).inspect(|number| enrol(MACHINES[*number])).map(start_agent).collect();
        let machines = Self { agents, _radios: radios };
        machines.become_home();
        machines
    }

    /// Waits until each machine does what its owner wants: the first access point serves, the second does nothing, and the robot
    /// is at the first.
    fn become_home(&self) {
        let mut seen = String::new();
        for _ in 0..100 {
            seen =
                sh("ip netns exec u1 iw dev; ip netns exec u2 iw dev; ip netns exec u0 iw dev wlan0 link; \
                ip netns exec u0 wpa_cli -p /run/wpa_supplicant -i wlan0 list_networks");
            let signs = ["ssid home", "channel 11", "type managed", "SSID: home"];
            if signs.iter().all(|sign| seen.contains(sign)) && seen.matches("\tany\t").count() == 1 {
                return;
            }
            sh("sleep 0.1");
        }
        panic!("not as their owners want it: {seen}");
    }
}

impl Drop for Machines {
    fn drop(&mut self) {
        for agent in &mut self.agents {
            sh(&format!("kill {}", agent.id()));
            agent.wait().unwrap();
        }
        sh("kill $(ip netns pids u0) $(ip netns pids u1)
            for n in 0 1 2; do ip netns delete u$n; done
            ip link delete lan
            rm -r /run/authority /run/*.agent /run/state-*");
    }
}

/// Writes the credentials of an agent.
fn enrol(name: &str) {
    let enrolled = cotorra(["agent", "enrol", name, "--core", CORE, "--authority", AUTHORITY])
        .current_dir("/run")
        .output()
        .unwrap();
    assert!(enrolled.status.success(), "{enrolled:?}");
}

fn start_agent(number: usize) -> Child {
    let name = MACHINES[number];
    let program = PathBuf::from(cotorra([""; 0]).get_program()).with_file_name("cotorra-agent");
    let log = fs::File::options().create(true).append(true).open(format!("/run/{name}.log")).unwrap();
    Command::new("ip")
        .args(["netns", "exec", &format!("u{number}")])
        .arg(program)
        .args(["run", &format!("/run/{name}.agent"), "--state", &format!("/run/state-{name}")])
        .args(["--wifi", &format!("wlan{number}")])
        .stdout(Stdio::null())
        .stderr(log)
        .spawn()
        .unwrap()
}

/// Pings the core from the robot over its radio, each millisecond.
struct Ping(Child);

impl Ping {
    fn start() -> Self {
        let log = fs::File::create("/run/ping.log").unwrap();
        let arguments = "netns exec u0 ping -n -D -i 0.001 10.8.0.1".split(' ');
        Self(Command::new("ip").args(arguments).stdout(log).spawn().unwrap())
    }

    /// Returns the longest time between two answers, in ms.
    fn longest_gap(mut self) -> f64 {
        sh(&format!("kill {}", self.0.id()));
        self.0.wait().unwrap();
        let log = fs::read_to_string("/run/ping.log").unwrap();
        let answer = |line: &str| line.strip_prefix('[')?.split_once("] 64 bytes")?.0.parse::<f64>().ok();
        let answers: Vec<_> = log.lines().filter_map(answer).collect();
        assert!(answers.len() > 100, "{log}");
        answers.windows(2).map(|two| two[1] - two[0]).fold(0.0, f64::max) * 1e3
    }
}

/// Returns the signals of a robot's attachments that have one, by their radio units.
fn signals(rig: &Rig) -> Vec<(String, f64)> {
    let robot = rig.robot("r1");
    let signal = |its: &Value| Some((its["radio_unit"].as_str()?.to_owned(), its["signal_dbm"].as_f64()?));
    robot["attachments"].as_array().unwrap().iter().filter_map(signal).collect()
}

/// Waits until something holds that the agents report.
fn wait_for(rig: &Rig, what: &str, holds: impl Fn() -> bool) {
    let mut checks = 0..100;
    assert!(
        checks.any(|_| holds() || {
            rig.wait(Duration::from_millis(100));
            false
        }),
        "{what}"
    );
}

#[test]
fn machines_with_agents_serve_a_run_and_are_their_owners_again() {
    if std::env::var_os("COTORRA_RADIOS").is_none() {
        eprintln!("skipped: COTORRA_RADIOS promises no radios");
        return;
    }
    let mut machines = Machines::start(true);
    let arguments = ["--agents", CORE, "--authority", AUTHORITY];
    let mut rig = Rig::start_with(FLOOR, &arguments).expect("there are radios");
    wait_for(&rig, "the robot joins", || rig.place_of("r1").is_some());
    let here = rig.place_of("r1").unwrap();
    let there = if here == "A" { "B" } else { "A" };
    for unit in [there, here.as_str()] {
        let ping = Ping::start();
        rig.wait(Duration::from_millis(100));
        rig.attach("r1", unit).unwrap();
        let handover = rig.wait_for_handover("r1", unit);
        rig.wait(Duration::from_millis(200));
        let (by_frames, by_packets) = (handover["gap_ms"].as_f64().unwrap(), ping.longest_gap());
        println!(
            "real radios, roam to {unit}: gap by frames {by_frames:.2} ms, by packets {by_packets:.2} ms"
        );
        assert_eq!(handover["fast"], true, "{handover}");
        assert!(by_frames > 0.0 && by_frames <= MOST_MS && by_packets <= MOST_MS, "{handover}, {by_packets}");
    }

    // φ has what the robot hears, and ι what the access point reports. The kernel's air is the same everywhere.
    rig.instruct(json!({ "instruction": "scan", "robot": "r1" })).unwrap();
    rig.wait_for(|event| is(event, "scanned", "robot", "r1"));
    wait_for(&rig, "signals of both", || signals(&rig).len() == 2);
    wait_for(&rig, "the radio unit's station", || {
        let units = rig.run.get("/api/v1/network/radio-units");
        let unit = units.as_array().unwrap().iter().find(|unit| unit["radio_unit"] == here.as_str()).cloned();
        unit.is_some_and(|unit| {
            unit["stations"][0]["robot"] == "r1" && unit["stations"][0]["signal_dbm"].is_number()
        })
    });

    // A radio unit is off while its agent is away.
    let number = if there == "A" { 1 } else { 2 };
    let is_now = |event: &Value, state: &str| is(event, "vnf", "node", there) && event["state"] == state;
    machines.agents[number].kill().unwrap();
    machines.agents[number].wait().unwrap();
    rig.wait_for(|event| is_now(event, "died"));
    machines.agents[number] = start_agent(number);
    rig.wait_for(|event| is_now(event, "started"));

    // An access point that nobody wants is its owner's meanwhile.
    rig.instruct(json!({ "instruction": "remove", "radio_unit": there })).unwrap();
    wait_for(&rig, "the other radio unit is its owner's", || {
        !sh(&format!("ip netns exec u{number} iw dev")).contains("ssid lab")
    });
    let news = rig.news();
    assert!(!news.iter().any(|event| event["event"] == "detached"), "{news:#?}");

    rig.interrupt();
    rig.run.report();
    machines.become_home();
}

#[test]
fn a_robot_without_a_cable_reports_over_the_radio_that_roams() {
    if std::env::var_os("COTORRA_RADIOS").is_none() {
        eprintln!("skipped: COTORRA_RADIOS promises no radios");
        return;
    }
    let machines = Machines::start(false);
    let mut rig =
        Rig::start_with(FLOOR, &["--agents", CORE, "--authority", AUTHORITY]).expect("there are radios");
    wait_for(&rig, "the robot joins", || rig.place_of("r1").is_some());
    let here = rig.place_of("r1").unwrap();
    let there = if here == "A" { "B" } else { "A" };
    for unit in [there, here.as_str()] {
        rig.attach("r1", unit).unwrap();
        let handover = rig.wait_for_handover("r1", unit);
        println!("a robot without a cable, roam to {unit}: {handover}");
        assert_eq!(handover["fast"], true, "{handover}");
        assert!(handover["gap_ms"].as_f64().unwrap() <= MOST_MS, "{handover}");
    }
    rig.interrupt();
    rig.run.report();
    machines.become_home();
}
