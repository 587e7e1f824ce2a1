//! A TurtleBot 2 at serial ports: the emulators of its base and its lidar on pseudo-terminals take the place of a real one.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{fs, path::Path, time::Duration};

use cotorra_testing::turtlebot::{Emulated, Place, room};
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::{
    harness::{Run, output, stderr, wait_until},
    one_robot::{NAVIGATED, robot, testbed},
};

/// Interior of the corridor, metres.
pub const CORRIDOR: ((f64, f64), (f64, f64)) = ((0.0, 0.0), (7.0, 2.0));

/// Writes the corridor's map: cells of 5 cm, with walls of 10 cm.
pub fn map(folder: &Path) {
    let (width, height) = (144, 44);
    let mut picture = format!("P5\n{width} {height}\n255\n").into_bytes();
    for row in 0..height {
        for column in 0..width {
            let is_wall = row < 2 || column < 2 || row >= height - 2 || column >= width - 2;
            picture.push(if is_wall { 0 } else { 254 });
        }
    }
    fs::write(folder.join("map.pgm"), picture).unwrap();
    fs::write(folder.join("map.yaml"), "image: map.pgm\nresolution: 0.05\norigin: [-0.1, -0.1, 0]\n")
        .unwrap();
}

/// Services with navigation and localization, and a walk of 3 m.
pub const LOCALIZED: &str = "
map: map.yaml
services:
  navigation:
    robot: tb
    kpis: { service_time: 50 ms }
    vnfs:
      robot-driver: { program: robot_driver, pinned_to: tb, cpus: 0 }
      navigation: { program: navigation, node: cloud }
  localization:
    robot: tb
    kpis: { service_time: 500 ms }
    vnfs:
      lidar: { program: robot_driver, pinned_to: tb, cpus: 0 }
      localization: { program: localization, node: cloud }
walks:
  tb: { waypoints: [[1, 1], [2.5, 0.8], [4, 1]], speed_limit: 0.3 m/s }
";

/// Returns the node of a robot at the emulator's ports.
pub fn node(emulated: &Emulated, rest: &str) -> String {
    let (base, lidar) = (emulated.base(), emulated.lidar());
    let driver =
        format!("{{ kind: kobuki, port: {}, lidar: {{ port: {} }} }}", base.display(), lidar.display());
    format!("{{ kind: robot, driver: {driver}, {rest} }}")
}

#[test]
fn a_walk_is_driven_to_its_end_by_a_base_and_a_lidar_at_serial_ports() {
    let folder = TempDir::new().unwrap();
    map(folder.path());
    let (low, high) = CORRIDOR;
    let start = Place { x: 1.0, y: 1.0, heading: 0.0 };
    let emulated = Emulated::start(folder.path(), room(low, high), start);
    let sensors = "sensors: { pack: { kind: battery }, turns: { kind: lidar } }";
    let mut run = Run::start(&testbed(folder.path(), "real", &node(&emulated, sensors), LOCALIZED), &[]);
    wait_until(|| robot(&run)["sensors"]["pose"]["source"] == "localization");
    // Localization knows the start before the base is heard.
    wait_until(|| robot(&run)["health"] == json!([]));
    let last = |sensor: &str| {
        let all = run.get("/api/v1/robots/tb/sensors");
        let its = all.as_array().unwrap().iter().find(|one| one["declared"]["sensor"] == sensor);
        its.unwrap()["last"].clone()
    };
    wait_until(|| last("pack").is_object() && last("turns").is_object());
    assert_eq!(last("pack")["values"]["voltage_v"], 16.0);
    assert_eq!(
        (&last("turns")["data"]["format"], &last("turns")["data"]["width"]),
        (&json!("scan"), &json!(360))
    );
    let (summary, _) = run.report();

    let place = emulated.state().kobuki.place;
    assert!((place.x - 4.0).hypot(place.y - 1.0) < 0.4, "it is at its last waypoint: {place:?}");
    let services = summary["services"].as_array().unwrap();
    let samples = |service: &str| {
        let its = services.iter().find(|its| its["service"] == service).unwrap_or(&Value::Null);
        its["samples"].as_u64().unwrap()
    };
    assert!(samples("navigation") > 20 && samples("localization") > 3, "{summary}");
    // The run leaves both at rest.
    wait_until(|| emulated.state().rplidar.motor == 0);
    assert_eq!(emulated.state().kobuki.velocity(), (0.0, 0.0));
    let controls = emulated.state().kobuki.controls.clone();
    let last = controls.iter().rposition(|(_, speed, _)| *speed != 0).unwrap();
    assert!(controls.len() - last > 5, "it is stopped several times, as bytes may be lost");
}

#[test]
fn robot_stops_when_the_network_its_cable_or_its_testbed_is_lost() {
    let folder = TempDir::new().unwrap();
    let start = Place { x: 2.0, y: 3.0, heading: 0.0 };
    let emulated = Emulated::start(folder.path(), room((-5.0, -5.0), (600.0, 8.0)), start);
    let file = testbed(folder.path(), "real", &node(&emulated, "position: [2, 3]"), NAVIGATED);
    let mut run = Run::start(&file, &[]);
    let moves = || emulated.state().kobuki.velocity().0 > 0.2;
    wait_until(moves);

    // The network: answers come late, and do not count.
    let link = |run: &Run, delay_ms: f64| {
        let change =
            json!({ "instruction": "condition", "link": "R1-cloud", "change": { "delay_ms": delay_ms } });
        let (status, answer) =
            run.post("/api/v1/instructions", &json!({ "instruction": change }).to_string());
        assert_eq!(status, 200, "{answer}");
    };
    link(&run, 2000.0);
    wait_until(|| !moves());
    let count = emulated.state().kobuki.controls.len();
    let stop = emulated.state().kobuki.controls[count - 1];
    assert_eq!((stop.1, stop.2), (0, 0));
    link(&run, 1.0);
    wait_until(moves);

    // The cable. The emulated base goes on meanwhile, as a real one may.
    emulated.unplug_base();
    wait_until(|| robot(&run)["health"] == json!(["silent"]));
    let before = emulated.state().kobuki.controls.len();
    emulated.plug_base();
    wait_until(|| emulated.state().kobuki.controls.len() > before);
    let (_, speed, radius) = emulated.state().kobuki.controls[before];
    assert_eq!((speed, radius), (0, 0), "the first command is a stop");
    wait_until(|| robot(&run)["health"] == json!([]));
    wait_until(moves);

    // The testbed is killed: no more commands reach the base, and the next run stops it first.
    run.signal("KILL");
    run.wait();
    let settled = emulated.state().now;
    wait_until(|| emulated.state().now > settled + Duration::from_millis(100));
    let before = emulated.state().kobuki.controls.len();
    let settled = emulated.state().now;
    wait_until(|| emulated.state().now > settled + Duration::from_secs(1));
    assert_eq!(emulated.state().kobuki.controls.len(), before);
    let mut run = run.another(&file, &[]);
    wait_until(|| emulated.state().kobuki.controls.len() > before);
    let (_, speed, radius) = emulated.state().kobuki.controls[before];
    assert_eq!((speed, radius), (0, 0));
    wait_until(moves);

    // Ctrl-C leaves it at rest.
    run.signal_group("INT");
    run.wait();
    wait_until(|| !moves());
}

#[test]
fn missing_port_a_port_in_use_and_virtual_time_are_explained() {
    let folder = TempDir::new().unwrap();
    let emulated = Emulated::start(folder.path(), Vec::new(), Place::default());
    let out = folder.path().join("runs");
    let refused = |driver: &str, more: &[&str]| {
        let robot = format!("{{ kind: robot, position: [0, 0], driver: {driver} }}");
        let file = testbed(folder.path(), "refused", &robot, "");
        let arguments = ["run", "--headless", "--until", "1s", "--out", out.to_str().unwrap()];
        let done = output(arguments.into_iter().chain(more.iter().copied()).chain([file.to_str().unwrap()]));
        assert!(!done.status.success(), "{driver}");
        stderr(&done).split_whitespace().filter(|word| *word != "│").collect::<Vec<_>>().join(" ")
    };
    let missing = refused("{ kind: kobuki, port: /nowhere/kobuki, lidar: none }", &[]);
    assert!(missing.contains("there is no `/nowhere/kobuki`: plug the device in"), "{missing}");
    let port = emulated.base();
    let held = fs::File::open(&port).unwrap();
    held.lock().unwrap();
    let busy = refused(&format!("{{ kind: kobuki, port: {}, lidar: none }}", port.display()), &[]);
    assert!(busy.contains("another program uses"), "{busy}");
    let real = refused("kobuki", &["--simulate"]);
    assert!(real.contains("robot `tb` is a real one"), "{real}");
}
