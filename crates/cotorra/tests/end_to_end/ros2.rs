//! Robots in ROS 2: one run offers a simulated robot, and another drives it like a real one. Cyclone DDS also subscribes to
//! it and drives it, on this machine and across the emulated network.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use serde_json::json;
use tempfile::TempDir;

use crate::{
    harness::{Run, cotorra, wait_until},
    one_robot::{NAVIGATED, robot, testbed},
};
use cotorra_testing::ros2::Meeting;

fn velocity(run: &Run) -> (f64, f64) {
    let velocity = &robot(run)["sensors"]["velocity"];
    (velocity["linear"].as_f64().unwrap_or(f64::NAN), velocity["angular"].as_f64().unwrap_or(f64::NAN))
}

#[test]
fn an_offered_robot_is_driven_by_another_run_and_by_cyclone_dds() {
    let meeting = Meeting::new();
    let Some(listener) = meeting.cyclone("print", "LaserScan", "scan", "sensors") else { return };
    let folder = TempDir::new().unwrap();
    let place = format!(
        "kind: ros2, domain: {}, interface: 127.0.0.1, namespace: {}",
        meeting.domain(),
        meeting.namespace()
    );
    let offered = format!("{{ kind: robot, position: [2, 3], offer: {{ {place}, network: machine }} }}");
    let driven = format!("{{ kind: robot, driver: {{ {place} }} }}");
    let offered = testbed(folder.path(), "offered", &offered, "");
    let driven = testbed(folder.path(), "driven", &driven, NAVIGATED);

    // The driving run starts first: its robot is absent until it is offered.
    let driver = Run::start(&driven, &[]);
    wait_until(|| robot(&driver)["health"] == json!(["absent"]));
    let mut offer = driver.another(&offered, &[]);
    wait_until(|| robot(&driver)["sensors"]["pose"]["x"].as_f64().is_some_and(|x| x > 3.0));
    assert_eq!(robot(&driver)["health"], json!([]));
    let (theirs, ours) = (robot(&offer), robot(&driver));
    assert!(theirs["sensors"]["pose"]["x"].as_f64().unwrap() > 2.9, "it is the same robot: {theirs}");
    assert_eq!(theirs["sensors"]["pose"]["source"], "simulator");
    assert_eq!(ours["sensors"]["pose"]["source"], "localization");
    let sample = driver.wait_for_service().to_string();
    assert!(sample.contains(r#""robot":"tb""#), "{sample}");
    listener.prints("frame_id='laser'");

    // The robot stops when its driver is killed, and the next driver takes over.
    driver.signal("KILL");
    wait_until(|| velocity(&offer).0 == 0.0);
    let another = meeting.cyclone("publish", "TwistStamped", "cmd_vel", "commands").unwrap();
    let is_near = |a: f64, b: f64| (a - b).abs() < 0.05;
    wait_until(|| {
        let (linear, angular) = velocity(&offer);
        is_near(linear, 0.25) && is_near(angular, -0.5)
    });
    drop(another);
    wait_until(|| velocity(&offer).0 == 0.0);
    offer.signal("INT");
    offer.wait();
}

#[test]
fn programs_in_another_node_find_an_offered_robot_across_the_emulated_network() {
    let meeting = Meeting::new();
    let folder = TempDir::new().unwrap();
    let offer = format!("{{ kind: ros2, domain: {}, namespace: /tb2, clock: true }}", meeting.domain());
    let offered = format!("{{ kind: robot, position: [2, 3], offer: {offer} }}");
    let run = Run::start(&testbed(folder.path(), "offered", &offered, ""), &[]);
    let start = |action: &str, kind: &str, topic: &str, qos: &str| {
        let inside = cotorra(["exec", "--api", run.address(), "cloud", "--"]);
        meeting.cyclone_by(inside, action, kind, topic, qos)
    };
    let Some(listener) = start("print", "LaserScan", "rt/tb2/scan", "sensors") else { return };
    let driver = start("publish", "TwistStamped", "rt/tb2/cmd_vel", "commands").unwrap();
    wait_until(|| velocity(&run).0 > 0.2);
    drop(driver);
    wait_until(|| velocity(&run).0 == 0.0);

    // Clock and stamps have the time of the testbed, which began with the run.
    let clock = start("print", "Clock", "rt/clock", "sensors").unwrap();
    clock.prints("Clock(clock=Time(sec=");
    listener.prints("frame_id='laser'");
    for said in [clock.output(), listener.output()] {
        let (_, after) = said.split_once("sec=").unwrap();
        let seconds: u32 = after.split_once(',').unwrap().0.parse().unwrap();
        assert!(seconds < 1000, "{seconds}");
    }
}
