//! The bundled brain as a ROS node drives robots across the emulated network: one that is offered, and one that is a program
//! in rospy. Cyclone DDS and ROS's own tools see its commands.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
};

use serde_json::Value;
use tempfile::TempDir;

use crate::{
    harness::{Run, cotorra, kill, output, stderr, wait_until},
    one_robot::robot,
    replicas::brains,
};
use cotorra_testing::{process::Process, ros1::Ros, ros2::Meeting};

/// Delay of the wire between the radio unit and a server, both ways, ms.
const WIRE_MS: f64 = 2.0;

/// Writes a testbed file with a robot, two servers and a brain in ROS, which walks the robot there and back. `rest` are
/// further VNFs.
fn testbed(folder: &Path, ros: &str, walk: &str, rest: &str) -> PathBuf {
    let file = folder.join("brain.yaml");
    let text = format!(
        "
name: brain
wireless: {{ w: {{}} }}
nodes:
  R1: {{ kind: radio_unit, position: [0, 0], channel: 1 }}
  edge: {{ kind: server, tier: edge, cpus: 4, memory: 8 GB }}
  cloud: {{ kind: server, tier: cloud, cpus: 4, memory: 8 GB }}
  tb: {{ kind: robot, position: [2, 3], {ros} }}
links:
  - {{ ends: [R1, [edge, cloud]], delay: 1 ms }}
services:
  navigation:
    robot: tb
    kpis: {{ service_time: 50 ms }}
    vnfs:
      navigation: {{ program: ros_navigation, node: cloud }}
{rest}
walks:
  tb: {{ waypoints: {walk}, speed_limit: 0.5 m/s }}
"
    );
    fs::write(&file, text).unwrap();
    file
}

fn x(run: &Run) -> f64 {
    robot(run)["sensors"]["pose"]["x"].as_f64().unwrap_or(f64::NAN)
}

fn speed(run: &Run) -> f64 {
    robot(run)["sensors"]["velocity"]["linear"].as_f64().unwrap_or(f64::NAN)
}

/// Returns the service times of navigation that a server answered, ms.
fn took(run: &Run, server: &str) -> Vec<f64> {
    let page = run.get("/api/v1/measurements/service-times?limit=10000");
    let of_server = |sample: &&Value| sample["service"] == "navigation" && sample["server"] == server;
    page["items"]
        .as_array()
        .unwrap()
        .iter()
        .filter(of_server)
        .filter_map(|sample| sample["service_time_ms"].as_f64())
        .collect()
}

/// Waits until the times from poses to commands are measured, which hold the delay of the wire.
fn wait_for_times(run: &Run, server: &str) {
    wait_until(|| took(run, server).len() > 10);
    let took = took(run, server);
    assert!(took.iter().all(|took| *took >= WIRE_MS), "{took:?}");
}

fn signal_brain(run: &Run, node: &str, signal: &str) {
    let all = brains(run, node);
    assert_eq!(all.len(), 1, "one instance on {node}: {all:?}");
    kill(signal, &all[0].0.to_string());
}

fn inside(run: &Run, node: &str) -> Command {
    cotorra(["exec", "--api", run.address(), node, "--"])
}

#[test]
fn an_offered_robot_follows_the_brain_over_ros_1_and_stops_without_it() {
    if Ros::with_master(0).is_none() {
        return;
    }
    let folder = TempDir::new().unwrap();
    let file = testbed(folder.path(), "offer: { kind: ros1, namespace: /tb2 }", "[[2, 3], [500, 3]]", "");
    let run = Run::start_beside(&file, &["--until", "10min"]);
    wait_until(|| x(&run) > 3.0);
    wait_for_times(&run, "cloud");

    // ROS's own tool sees the commands on another node.
    let mut echo = inside(&run, "edge");
    echo.args(["/usr/bin/env", &format!("ROS_HOME={}", folder.path().display())]);
    echo.args(["/usr/bin/python3", "-u", "/usr/bin/rostopic", "echo", "/tb2/cmd_vel"]);
    let echo = Process::spawn(echo.env_remove("PYTHONPATH")).unwrap();
    echo.prints("linear:");
    drop(echo);

    // A robot that loses its brain stops, and goes on when the brain is back.
    signal_brain(&run, "cloud", "STOP");
    wait_until(|| speed(&run) == 0.0);
    signal_brain(&run, "cloud", "CONT");
    wait_until(|| speed(&run) > 0.2);

    // The same with another process, which finds the walk's next waypoint by the place.
    let killed = brains(&run, "cloud");
    signal_brain(&run, "cloud", "KILL");
    wait_until(|| brains(&run, "cloud").iter().any(|brain| !killed.contains(brain)));
    let before = x(&run);
    wait_until(|| x(&run) > before + 1.0);
}

#[test]
fn a_robot_of_rospy_is_driven_by_the_brain() {
    if Ros::with_master(0).is_none() {
        return;
    }
    let folder = TempDir::new().unwrap();
    fs::write(folder.path().join("robot.py"), include_str!("ros1_robot.py")).unwrap();
    let program = "      robot: { command: [/usr/bin/python3, -u, robot.py], pinned_to: tb }";
    let driver = "driver: { kind: ros1, master: tb, network: testbed }";
    let file = testbed(folder.path(), driver, "[[2, 3], [500, 3]]", program);
    let run = Run::start_beside_with(&file, &["--until", "10min"], |command| {
        command.env("ROS_HOME", folder.path()).env_remove("PYTHONPATH");
    });
    wait_until(|| x(&run) > 3.0);
    wait_for_times(&run, "cloud");
}

#[test]
fn the_brain_moves_over_ros_2_while_the_robot_is_on_its_way_back() {
    let meeting = Meeting::new();
    let folder = TempDir::new().unwrap();
    let offer = format!("offer: {{ kind: ros2, domain: {}, namespace: /tb2 }}", meeting.domain());
    let file = testbed(folder.path(), &offer, "[[2, 3], [4, 3], [-500, 3]]", "");
    let run = Run::start_beside(&file, &["--until", "10min"]);
    let listener =
        meeting.cyclone_by(inside(&run, "edge"), "print", "TwistStamped", "rt/tb2/cmd_vel", "commands");
    let Some(listener) = listener else { return };
    wait_until(|| x(&run) > 3.5);
    listener.prints("frame_id='base_link'");
    wait_for_times(&run, "cloud");

    // Its next waypoint is behind it, where the place alone would take it for being on the first leg.
    wait_until(|| x(&run) < 3.2);
    let place = r#"{"instruction":{"instruction":"place","vnf":"navigation","node":"edge"}}"#;
    let (status, answer) = run.post("/api/v1/instructions", place);
    assert_eq!(status, 200, "{answer}");
    wait_for_times(&run, "edge");
    wait_until(|| x(&run) < 1.0);
}

#[test]
fn virtual_time_rejects_the_brain_in_ros() {
    let folder = TempDir::new().unwrap();
    let file = testbed(folder.path(), "offer: ros2", "[[2, 3], [5, 3]]", "");
    let arguments = ["run", "--simulate", "--headless", "--until", "1s"].map(Path::new);
    let refused = output(arguments.into_iter().chain([&*file]));
    assert!(!refused.status.success());
    assert!(stderr(&refused).contains("robot `tb` speaks ROS"), "{}", stderr(&refused));
}
