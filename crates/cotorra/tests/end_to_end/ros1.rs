//! Robots in ROS 1: one run offers a simulated robot, and another drives it like a real one. Unmodified ROS programs
//! communicate across the emulated network.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{collections::BTreeSet, path::Path};

use serde_json::Value;
use tempfile::TempDir;

use crate::{
    harness::{Run, cotorra, output, project_file, stderr, stdout, wait_until},
    one_robot::{NAVIGATED, robot, testbed},
};
use cotorra_testing::ros1::Ros;

/// Collects the paths of all keys of a value.
fn keys(value: &Value, at: &str, found: &mut BTreeSet<String>) {
    match value {
        Value::Object(object) => object.iter().for_each(|(key, value)| {
            found.insert(format!("{at}/{key}"));
            keys(value, &format!("{at}/{key}"), found);
        }),
        Value::Array(all) => all.iter().for_each(|value| keys(value, &format!("{at}/*"), found)),
        _ => {}
    }
}

fn shape(value: &Value) -> BTreeSet<String> {
    let mut found = BTreeSet::new();
    keys(value, "", &mut found);
    found
}

fn notices(run: &Run) -> String {
    run.get("/api/v1/measurements/events?kinds=notice")["items"].to_string()
}

#[test]
fn a_robot_that_another_run_offers_is_driven_like_any_and_stops_when_either_run_is_killed() {
    let Some(ros) = Ros::start() else { return };
    let folder = TempDir::new().unwrap();
    let place = format!("master: 'http://127.0.0.1:{}', namespace: /tb2", ros.port());
    let offer = format!("{{ kind: ros1, network: machine, clock: true, {place} }}");
    let offered = format!("{{ kind: robot, position: [2, 3], offer: {offer} }}");
    let driven = format!("{{ kind: robot, driver: {{ kind: ros1, {place} }} }}");
    let offered = testbed(folder.path(), "offered", &offered, "");
    let driven = testbed(folder.path(), "driven", &driven, NAVIGATED);

    // The driving run starts first: its robot is absent until it is offered.
    let driver = Run::start(&driven, &[]);
    wait_until(|| robot(&driver)["health"] == serde_json::json!(["absent"]));
    let mut offer = driver.another(&offered, &[]);
    wait_until(|| robot(&driver)["sensors"]["pose"]["x"].as_f64().is_some_and(|x| x > 3.0));
    assert_eq!(robot(&driver)["health"], serde_json::json!([]));
    let (theirs, ours) = (robot(&offer), robot(&driver));
    assert_eq!(shape(&theirs), shape(&ours), "to a plug-in they look the same");
    assert!(theirs["sensors"]["pose"]["x"].as_f64().unwrap() > 2.9, "it is the same robot: {theirs}");
    assert_eq!(theirs["sensors"]["pose"]["source"], "simulator");
    assert_eq!(ours["sensors"]["pose"]["source"], "localization");
    let history = |run: &Run| run.get("/api/v1/measurements/robots/tb?limit=1")["items"][0].clone();
    assert_eq!(shape(&history(&offer)), shape(&history(&driver)));
    let sample = driver.wait_for_service().to_string();
    assert!(sample.contains(r#""robot":"tb""#), "{sample}");

    // The clock has the time of the testbed, which began with the run.
    let clock = ros.run("rostopic", &["echo", "-n", "1", "/clock"]);
    let (_, seconds) = clock.split_once("secs:").unwrap();
    assert!(seconds.trim().split('\n').next().unwrap().trim().parse::<u32>().unwrap() < 1000, "{clock}");

    // The fault was reported, and its end.
    wait_until(|| notices(&driver).contains("robot tb is well"));
    assert!(notices(&driver).contains("robot tb stands still: it was never heard"), "{}", notices(&driver));

    // An instruction moves the robot.
    let forward = |run: &Run| {
        let velocity = r#"{ "linear": 0.1, "angular": 0.0 }"#;
        let wanted =
            format!(r#"{{ "instruction": "move", "robot": "tb", "velocity": {velocity}, "waypoint": 1 }}"#);
        run.post("/api/v1/instructions", &format!(r#"{{ "instruction": {wanted} }}"#))
    };
    let (status, answer) = forward(&driver);
    assert_eq!(status, 200, "{answer}");

    // The robot stops when its driver is killed, and the next driver finds it.
    driver.signal("KILL");
    let speed = |run: &Run| robot(run)["sensors"]["velocity"]["linear"].as_f64().unwrap();
    wait_until(|| speed(&offer) == 0.0);
    let driver = offer.another(&driven, &[]);
    wait_until(|| speed(&offer) > 0.2);

    // A robot that is gone is silent, and rejects instructions.
    offer.signal("KILL");
    offer.wait();
    wait_until(|| robot(&driver)["health"] == serde_json::json!(["silent"]));
    let (status, answer) = forward(&driver);
    assert_eq!(status, 409, "{answer}");
    assert!(answer.to_string().contains("it is silent"), "{answer}");
    wait_until(|| notices(&driver).contains("robot tb stands still: it is silent"));
}

#[test]
fn unmodified_ros_programs_communicate_across_the_emulated_network() {
    if Ros::with_master(0).is_none() {
        return;
    }
    let relay = Path::new("/usr/lib/topic_tools/relay");
    if !relay.exists() {
        assert!(std::env::var_os("CI").is_none(), "topic-tools is not installed: scripts/test says so");
        eprintln!("skipped: topic-tools is not installed");
        return;
    }
    let home = TempDir::new().unwrap();
    let run = Run::start_with(&project_file("testbeds/ros1.yaml"), &["--until", "5min"], |command| {
        command.env("ROS_HOME", home.path());
    });
    let script = project_file("examples/ros1_delay.py");
    let words = ["exec", "--api", run.address(), "robot", "--", "/usr/bin/python3"];
    let measured = cotorra(words).arg(script).args(["--scans", "20"]).env("ROS_HOME", home.path()).output();
    let measured = measured.unwrap();
    assert!(measured.status.success(), "{}", stderr(&measured));
    let said = stdout(&measured);
    let median = said.split_once("median ").and_then(|(_, rest)| rest.split_once(" ms")).unwrap().0;
    // Each way takes 1 ms over the air and 4.5 ms to the cloud, so that no scan is back earlier.
    assert!(median.parse::<f64>().unwrap() > 11.0, "{said}");
    // The flow measures the same scans at the robot's port.
    let page = run.get("/api/v1/measurements/service-times?limit=10000");
    let flow = page["items"].as_array().unwrap().iter().filter(|sample| sample["service"] == "relay");
    let mut took: Vec<_> = flow.filter_map(|sample| sample["service_time_ms"].as_f64()).collect();
    took.sort_by(f64::total_cmp);
    assert!(took.len() >= 15 && took[0] > 11.0, "{took:?}");
    let listed = cotorra(["exec", "--api", run.address(), "cloud", "--"])
        .args(["/usr/bin/python3", "/usr/bin/rostopic", "list", "-v"])
        .env("ROS_HOME", home.path())
        .output()
        .unwrap();
    let listed = stdout(&listed);
    for topic in
        ["* /scan [sensor_msgs/LaserScan] 1 publisher", "* /scan_back [sensor_msgs/LaserScan]", "* /map"]
    {
        assert!(listed.contains(topic), "{listed}");
    }
}

#[test]
fn virtual_time_refuses_robots_in_ros() {
    let folder = TempDir::new().unwrap();
    for ros in ["driver: ros1", "offer: ros1", "driver: ros2", "offer: ros2"] {
        let robot = format!("{{ kind: robot, position: [0, 0], {ros} }}");
        let file = testbed(folder.path(), "virtual", &robot, "");
        let out = folder.path().join("runs");
        let arguments = ["run", "--simulate", "--headless", "--until", "1s", "--out"].map(Path::new);
        let refused = output(arguments.into_iter().chain([&*out, &*file]));
        assert!(!refused.status.success(), "{ros}");
        assert!(stderr(&refused).contains("robot `tb` speaks ROS"), "{ros}: {}", stderr(&refused));
        assert!(!out.exists(), "{ros}: something is left");
    }
}
