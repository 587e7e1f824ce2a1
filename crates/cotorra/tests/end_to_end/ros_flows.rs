//! Service times of programs in ROS 2 and of services of ROS 1, against the programs' own measurements.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{collections::BTreeMap, fs, path::Path, process::Command};

use cotorra_testing::{
    process::Process,
    python,
    ros1::Ros,
    ros2::{Meeting, start},
};
use tempfile::TempDir;

use crate::{
    harness::{Run, cotorra, wait_until},
    one_robot::testbed,
};

/// Delay of two crossings of the air and of the wire, ms.
const DELAYS_MS: f64 = 2.0 * (1.0 + 4.0);
/// Time by which frames may be delivered before the time that counts: up to 15 µs, in ms.
const EARLY_MS: f64 = 0.015;

/// Runs a robot and a server with services for flows, each with a target of one second.
fn flows(folder: &Path, flows: &[(&str, &str)]) -> Run {
    let service = |(name, flow): &(&str, &str)| {
        format!(
            "  {name}: {{ robot: robot, kpis: {{ service_time: 1 s, flow: {{ {flow} }} }}, vnfs: {{}} }}\n"
        )
    };
    let file = folder.join("flows.yaml");
    let place = "
name: flows
wireless: { lab: { delay: 1 ms } }
nodes:
  unit: { kind: radio_unit, position: [5, 0], channel: 1 }
  edge: { kind: server, tier: edge, cpus: 2, memory: 4 GB }
  robot: { kind: robot, position: [0, 0] }
links:
  - { ends: [unit, edge], delay: 4 ms, rate: 100 Mbit/s }
services:
";
    fs::write(&file, format!("{place}{}", flows.iter().map(service).collect::<String>())).unwrap();
    Run::start_beside(&file, &["--until", "5min"])
}

/// Returns a command that runs its arguments in a node.
fn inside(run: &Run, node: &str) -> Command {
    cotorra(["exec", "--api", run.address(), node, "--"])
}

/// Starts a program over Cyclone DDS in a node: see `ros2_flows.py`.
fn cyclone(python: &Path, run: &Run, meeting: &Meeting, node: &str, role: &str) -> Process {
    let mut command = inside(run, node);
    command.arg(python).args(["-u", "-c", include_str!("ros2_flows.py")]);
    start(command.args([&meeting.domain().to_string(), role]))
}

/// Returns the measurements that a client printed for a name, by number.
fn measured(client: &Process, name: &str) -> BTreeMap<u64, f64> {
    let said = client.output();
    // The last line may be incomplete.
    let whole = said.rfind('\n').map_or("", |end| &said[..end]);
    let lines = whole.lines().filter_map(|line| {
        let mut words = line.split_whitespace();
        let is_its = words.next() == Some(name);
        is_its.then(|| (words.next().unwrap().parse().unwrap(), words.next().unwrap().parse().unwrap()))
    });
    lines.collect()
}

/// Returns the service times of a service by number, in ms, without lost requests.
fn samples(run: &Run, service: &str) -> BTreeMap<u64, f64> {
    let page = run.get("/api/v1/measurements/service-times?limit=10000");
    let all = page["items"].as_array().unwrap().iter().filter(|sample| sample["service"] == service);
    let answered = all.filter_map(|sample| {
        let took = sample["service_time_ms"].as_f64()?;
        let places = [&sample["robot"], &sample["server"], &sample["attachment"]];
        assert_eq!(places, ["robot", "edge", "unit"], "{sample}");
        Some((sample["sequence"].as_u64().unwrap(), took))
    });
    answered.collect()
}

/// Waits for service times, each of which must lie between the network's delay `least` and the client's measurement.
fn compare(run: &Run, service: &str, client: &Process, name: &str, least: f64) {
    let mut both = Vec::new();
    wait_until(|| {
        let (took, itself) = (samples(run, service), measured(client, name));
        both = took.iter().filter_map(|(number, took)| Some((*took, *itself.get(number)?))).collect();
        both.len() > 10
    });
    for (took, itself) in both {
        assert!(
            (least..=itself + EARLY_MS).contains(&took),
            "{service}: {took} ms, by the client {itself} ms"
        );
    }
}

#[test]
fn topics_services_and_actions_over_cyclone_dds_are_measured() {
    let meeting = Meeting::new();
    let Some(python) = python("cyclonedds", "Cyclone DDS") else { return };
    let folder = TempDir::new().unwrap();
    let mut run = flows(
        folder.path(),
        &[
            ("image", "protocol: ros2, request: /camera, answer: /camera_back, id: { offset: 0, length: 8 }"),
            ("unnamed", "protocol: ros2, request: /camera, answer: /camera_back"),
            ("plan", "protocol: ros2_service, service: /plan"),
            ("dock", "protocol: ros2_action, action: /dock"),
            ("nobody", "protocol: ros2_action, action: /undock"),
        ],
    );
    let start = |node: &str, role: &str| cyclone(&python, &run, &meeting, node, role);
    let _server = start("edge", "server");
    let client = start("robot", "client");
    // 30 kB each way, in fragments of DDS and of IP, take 2.4 ms each at 100 Mbit/s.
    compare(&run, "image", &client, "image", DELAYS_MS + 4.8);
    compare(&run, "unnamed", &client, "image", DELAYS_MS + 4.8);
    compare(&run, "plan", &client, "plan", DELAYS_MS);
    // The goal, its acceptance, the question for the result, 20 ms of driving, and the result.
    compare(&run, "dock", &client, "dock", 2.0 * DELAYS_MS + 20.0);
    let refused = samples(&run, "dock").keys().filter(|number| *number % 4 == 3).count();
    assert_eq!(refused, 0, "a goal that was refused has no time");
    run.signal("INT");
    let (_, printed) = run.report();
    assert!(printed.contains("flow of service `nobody`: no request seen"), "{printed}");
    assert!(printed.contains("because the server refused them"), "{printed}");
}

/// Images to several subscribers go to a multicast group. The subscriber that answers is the server.
#[test]
fn images_to_several_subscribers_are_measured_to_the_one_that_answers() {
    let meeting = Meeting::new();
    let Some(python) = python("cyclonedds", "Cyclone DDS") else { return };
    let folder = TempDir::new().unwrap();
    let flow = "protocol: ros2, request: /camera, answer: /camera_back, id: { offset: 0, length: 8 }";
    let run = flows(folder.path(), &[("image", flow)]);
    let start = |node: &str, role: &str| cyclone(&python, &run, &meeting, node, role);
    let watcher = start("unit", "watch");
    let _server = start("edge", "server");
    let client = start("robot", "client");
    watcher.prints("seen 10");
    compare(&run, "image", &client, "image", DELAYS_MS + 4.8);
}

#[test]
fn calls_over_fast_dds_are_measured() {
    let meeting = Meeting::new();
    let folder = TempDir::new().unwrap();
    let run = flows(folder.path(), &[("plan", "protocol: ros2_service, service: /plan")]);
    let start = |node: &str, action: &str| {
        meeting.fast_dds_by(inside(&run, node), action, "Twist", "/plan", "commands")
    };
    let Some(_server) = start("edge", "serve") else { return };
    let client = start("robot", "call").unwrap();
    compare(&run, "plan", &client, "plan", DELAYS_MS);
}

#[test]
fn commands_that_answer_an_offered_robots_scans_are_measured() {
    let Some(python) = python("cyclonedds", "Cyclone DDS") else { return };
    let (meeting, folder) = (Meeting::new(), TempDir::new().unwrap());
    let offer = format!("{{ kind: ros2, domain: {}, namespace: /tb2 }}", meeting.domain());
    let offered = format!("{{ kind: robot, position: [2, 3], offer: {offer} }}");
    let rest = "
services:
  follow:
    robot: tb
    kpis: { service_time: 50 ms, flow: { protocol: ros2, request: /tb2/scan, answer: /tb2/cmd_vel } }
    vnfs: {}
";
    let run = Run::start_beside(&testbed(folder.path(), "offered", &offered, rest), &[]);
    let _follower = cyclone(&python, &run, &meeting, "cloud", "follow");
    let took = || {
        let page = run.get("/api/v1/measurements/service-times?limit=10000");
        let all = page["items"].as_array().unwrap();
        all.iter().filter_map(|sample| sample["service_time_ms"].as_f64()).collect::<Vec<_>>()
    };
    wait_until(|| took().len() > 10);
    // The wire delays by 1 ms each way.
    assert!(took().iter().all(|took| *took >= 2.0), "{:?}", took());
}

#[test]
fn calls_of_a_service_of_ros_1_are_measured() {
    // rospy in nodes, with a master on the edge.
    if Ros::with_master(0).is_none() {
        return;
    }
    let folder = TempDir::new().unwrap();
    let run = flows(folder.path(), &[("plan", "protocol: ros1_service, service: /plan")]);
    let start = |node: &str, arguments: &[&str]| {
        let address = if node == "edge" { "10.77.0.2" } else { "10.77.0.3" };
        let mut command = inside(&run, node);
        command.args(["/usr/bin/env", "ROS_MASTER_URI=http://10.77.0.2:11311", &format!("ROS_IP={address}")]);
        command.arg(format!("ROS_HOME={}", folder.path().display())).args(arguments).env_remove("PYTHONPATH");
        Process::spawn(&mut command).unwrap()
    };
    let _master = start("edge", &["/usr/bin/python3", "-u", "/usr/bin/rosmaster", "--core", "-p", "11311"]);
    let program = include_str!("ros1_service.py");
    let _server = start("edge", &["/usr/bin/python3", "-u", "-c", program, "server"]);
    let client = start("robot", &["/usr/bin/python3", "-u", "-c", program, "client"]);
    // One connection for several calls, then one for each. The time to open a connection does not count.
    compare(&run, "plan", &client, "plan", DELAYS_MS);
}
