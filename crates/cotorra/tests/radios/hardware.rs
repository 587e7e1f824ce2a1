//! A run with real radios (`wifi: hardware`), at machines with real agents. In the end, all is as their owners had it.

use std::time::Duration;

use cotorra_testing::radios::{self, CORE, Ping, sh};
use serde_json::{Value, json};

use crate::{
    machines::{AUTHORITY, Machines, robot_power_is, start_agent},
    rig::{Rig, is},
};

/// Most of a gap: IEEE 802.11r aims at 50 ms.
const MOST_MS: f64 = 50.0;

const FLOOR: &str = "\
name: hardware
wireless: { lab: { wifi: hardware, security: { method: wpa2, passphrase: correct horse } } }
nodes:
  r1: { kind: robot, position: [4, 0], tx_power: 9 dBm, agent: robot1, interface: wlan0 }
  A: { kind: radio_unit, position: [0, 0], channel: 1, agent: ap1, interface: wlan1, bridge: br0 }
  B: { kind: radio_unit, position: [12, 0], channel: 6, agent: ap2, interface: wlan2, bridge: br0 }
  lan: { kind: switch }
links:
  - { ends: [lan, [A, B]] }
";

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
    if !radios::are_promised() || !cotorra_testing::can_enroll_agents() {
        return;
    }
    let mut machines = Machines::start(true);
    let arguments = ["--agents", CORE, "--authority", AUTHORITY];
    let mut rig = Rig::start_with(FLOOR, &arguments).expect("there are radios");
    wait_for(&rig, "the robot joins", || rig.place_of("r1").is_some());
    assert!(robot_power_is(9));
    let here = rig.place_of("r1").unwrap();
    let there = if here == "A" { "B" } else { "A" };
    for unit in [there, here.as_str()] {
        let ping = Ping::start();
        rig.wait(Duration::from_millis(100));
        rig.attach("r1", unit).unwrap();
        let handover = rig.wait_for_handover("r1", unit);
        rig.wait(Duration::from_millis(200));
        let by_packets = ping.longest_gap().as_secs_f64() * 1e3;
        let by_frames = handover["gap_ms"].as_f64().unwrap();
        println!(
            "real radios, roam to {unit}: gap by frames {by_frames:.2} ms, by packets {by_packets:.2} ms"
        );
        assert_eq!(handover["fast"], true, "{handover}");
        assert!(by_frames > 0.0 && by_frames <= MOST_MS && by_packets <= MOST_MS, "{handover}, {by_packets}");
    }

    // Its radio unit suggests the other one, and it follows.
    for unit in [there, here.as_str()] {
        assert_eq!(rig.suggest("r1", unit), 0);
        let handover = rig.wait_for_handover("r1", unit);
        assert_eq!(handover["fast"], true, "{handover}");
    }

    // φ has what the robot hears, and ι what the access point reports. The kernel's air is the same everywhere.
    rig.instruct(json!({ "instruction": "scan", "robot": "r1" })).unwrap();
    rig.wait_for(|event| is(event, "scanned", "robot", "r1"));
    wait_for(&rig, "signals of both", || signals(&rig).len() == 2);
    wait_for(&rig, "the radio unit's station", || {
        let units = rig.run.get("/api/v1/network/radio-units");
        let unit = units.as_array().unwrap().iter().find(|unit| unit["radio_unit"] == here.as_str()).cloned();
        unit.is_some_and(|unit| {
            let station = &unit["stations"][0];
            let figures = ["signal_dbm", "retransmissions", "transmissions_failed"];
            station["robot"] == "r1" && figures.iter().all(|name| station[*name].is_number())
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

    // An access point that the run does not want is its owner's meanwhile.
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
    if !radios::are_promised() || !cotorra_testing::can_enroll_agents() {
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
