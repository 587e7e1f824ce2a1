//! Service times of programs in ROS 2 and of services of ROS 1, against the programs' own measurements.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::path::Path;

use cotorra_testing::{
    process::Process,
    python,
    ros1::Ros,
    ros2::{Meeting, start},
};
use tempfile::TempDir;

use crate::{
    flow_programs::{DELAYS_MS, compare, flows, inside, samples},
    harness::{Run, wait_until},
    one_robot::testbed,
};

/// Starts a program over Cyclone DDS in a node: see `ros2_flows.py`.
fn cyclone(python: &Path, run: &Run, meeting: &Meeting, node: &str, role: &str) -> Process {
    let mut command = inside(run, node);
    command.arg(python).args(["-u", "-c", include_str!("ros2_flows.py")]);
    start(command.args([&meeting.domain().to_string(), role]))
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
