//! Attacks and mistakes: what real Wi-Fi software does about them, and what the run reports.

use std::{path::Path, process::Command, time::Duration};

use serde_json::{Value, json};

use crate::{packets::Packets, rig::Rig};

/// A robot `r1` between `A` and `B` of the network `lab`, and an intruder: the network `twin` looks like `lab` on the air. It has
/// a robot `r2` and an access point `X`, which is off.
fn floor_with_twin(passphrase: &str) -> String {
    format!(
        "\
name: intruders
wireless:
  lab:
    wifi: hwsim
    mobility_domain: 7
    security: {{ method: wpa2, passphrase: correct horse battery }}
    path_loss: {{ model: log_distance, exponent: 3.0 }}
    shadowing: {{ deviation: 0 dB }}
  twin:
    ssid: lab
    wifi: hwsim
    mobility_domain: 9
    security: {{ method: wpa2, passphrase: {passphrase} }}
    path_loss: {{ model: log_distance, exponent: 3.0 }}
    shadowing: {{ deviation: 0 dB }}
nodes:
  r1: {{ kind: robot, network: lab, position: [4, 0], roaming: instructed }}
  r2: {{ kind: robot, network: twin, position: [1, 3], roaming: instructed }}
  A: {{ kind: radio_unit, network: lab, position: [0, 0], channel: 1 }}
  B: {{ kind: radio_unit, network: lab, position: [12, 0], channel: 6 }}
  X: {{ kind: radio_unit, network: twin, position: [6, 3], channel: 11, serving: false }}
  lan: {{ kind: switch }}
  fog: {{ kind: server, tier: fog, cpus: 4, memory: 8 GB }}
links:
  - {{ ends: [lan, [A, B, X, fog]], delay: 1 ms, rate: 100 Mbit/s }}
"
    )
}

/// Two networks on one channel, of which only `guarded` protects its management frames. Each has an access point and a robot,
/// and `guarded` has an attacker, too.
const FLOOD: &str = "\
name: flood
wireless:
  guarded:
    wifi: hwsim
    security: { method: wpa2, management_frames: required }
    path_loss: { model: log_distance, exponent: 3.0 }
    shadowing: { deviation: 0 dB }
  bare:
    wifi: hwsim
    security: { method: wpa2, management_frames: off }
    path_loss: { model: log_distance, exponent: 3.0 }
    shadowing: { deviation: 0 dB }
nodes:
  r1: { kind: robot, network: guarded, position: [4, 0], roaming: instructed }
  r2: { kind: robot, network: bare, position: [4, 3], roaming: instructed }
  attacker: { kind: robot, network: guarded, position: [2, 2], roaming: instructed }
  A: { kind: radio_unit, network: guarded, position: [0, 0], channel: 1 }
  B: { kind: radio_unit, network: bare, position: [0, 3], channel: 1 }
  lan: { kind: switch }
  fog: { kind: server, tier: fog, cpus: 4, memory: 8 GB }
links:
  - { ends: [lan, [A, B, fog]], delay: 1 ms, rate: 100 Mbit/s }
";

/// Tenths of a second that a robot may need to find back.
const AGAIN: usize = 300;

/// Returns the words of all notices of a run so far.
fn notices(rig: &mut Rig) -> Vec<String> {
    let news = rig.news();
    let notices = news.iter().filter(|event| event["event"] == "notice");
    notices.map(|notice| notice["message"].as_str().unwrap().to_owned()).collect()
}

fn deploy(unit: &str, network: &str, mobility_domain: u16) -> Value {
    let access_point = json!({ "ssid": network, "mobility_domain": mobility_domain });
    json!({ "instruction": "deploy", "radio_unit": unit, "access_point": access_point })
}

fn remove(unit: &str) -> Value {
    json!({ "instruction": "remove", "radio_unit": unit })
}

#[test]
fn a_wrong_passphrase_and_a_wrong_mobility_domain_are_refused_and_reported() {
    let Some(mut rig) = Rig::start(&floor_with_twin("another passphrase")) else { return };
    rig.wait_for_notice("`r2` has a wrong passphrase for `lab`: it tries again after");
    assert_eq!(rig.place_of("r2"), None);
    assert_eq!(rig.place_of("r1").as_deref(), Some("A"));
    // Fast to another access point of its domain …
    rig.attach("r1", "B").unwrap();
    assert_eq!(rig.wait_for_handover("r1", "B")["fast"], true);
    // … but not to one that has come into another one since the robot heard it.
    rig.instruct(remove("A")).unwrap();
    rig.instruct(deploy("A", "lab", 9)).unwrap();
    rig.wait_for(|event| event["event"] == "vnf" && event["node"] == "A" && event["state"] == "started");
    rig.attach("r1", "A").unwrap();
    rig.wait_for_notice("`A` refused `r1` with status 54, another mobility domain");
    let ended = rig.end();
    assert_eq!(ended.summary["fidelity"]["valid"], true);
}

#[test]
fn a_rogue_access_point_is_reported_when_it_is_heard_and_when_it_is_joined() {
    let Some(mut rig) = Rig::start(&floor_with_twin("correct horse battery")) else { return };
    rig.instruct(deploy("X", "twin", 9)).unwrap();
    rig.wait_for(|event| event["event"] == "vnf" && event["node"] == "X" && event["state"] == "started");
    rig.instruct(json!({ "instruction": "scan", "robot": "r1" })).unwrap();
    let rogue = "an access point that calls itself `lab` and is none of its network: `X` of network `twin`";
    rig.wait_for_notice(&format!("`r1` hears {rogue}"));
    let refused = rig.attach("r1", "X").unwrap_err();
    assert!(refused.contains("serves another network"), "{refused}");
    // The rogue knows the passphrase. Its victim is lost for the testbed.
    for unit in ["B", "A"] {
        rig.instruct(remove(unit)).unwrap();
    }
    rig.wait_for_notice("`r1` joined an access point that is none of its network: `X` of network `twin`");
    assert_eq!(rig.place_of("r1"), None);
    rig.end();
}

#[test]
fn protected_management_frames_survive_a_flood_of_deauthentications() {
    let Some(mut rig) = Rig::start(FLOOD) else { return };
    let (flood, interval) = (Duration::from_secs(2), Duration::from_millis(20));
    let number = flood.div_duration_f64(interval) as u32;
    let run = |rig: &Rig, command: &mut Command| {
        assert!(rig.inside("attacker", || command.status().unwrap()).success());
    };
    // `active`: otherwise this kernel's radios send nothing for a monitor beside another interface.
    run(&rig, Command::new("iw").args("dev wlan0 interface add mon0 type monitor flags active".split(' ')));
    run(&rig, Command::new("ip").args("link set mon0 up".split(' ')));
    let program = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/radios/deauthenticate.py");
    let gaps = [("A", "r1"), ("B", "r2")].map(|(unit, robot)| {
        let packets = Packets::start(&rig, "fog", robot);
        rig.wait(Duration::from_millis(50));
        let ends = [unit, robot].map(|node| rig.mac(node));
        let [number, interval] = [number.to_string(), interval.as_millis().to_string()];
        let mut attack = Command::new("python3");
        run(&rig, attack.arg(&program).arg("mon0").args(ends).args([number, interval]));
        // wpa_supplicant waits for 10 s after a handshake that the flood broke.
        let is_back = (0..AGAIN).any(|_| {
            rig.wait(Duration::from_millis(100));
            rig.place_of(robot).as_deref() == Some(unit)
        });
        assert!(is_back, "{robot} has lost {unit}");
        rig.wait(Duration::from_millis(100));
        packets.longest_gap()
    });
    println!("longest gaps in a flood of {number} deauthentications, protected and not: {gaps:?}");
    assert!(gaps[0] < Duration::from_millis(20), "{gaps:?}");
    assert!(gaps[1] > flood / 2, "{gaps:?}");
    let told = notices(&mut rig);
    assert!(told.iter().all(|notice| !notice.contains("`r1`")), "{told:?}");
    assert!(told.iter().any(|notice| notice.starts_with("`B` disconnected `r2` for reason 7")), "{told:?}");
    rig.end();
}
