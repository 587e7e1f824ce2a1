//! Wi-Fi programs that are killed: they are started again, and the robot comes back. Runs that are interrupted or killed: they
//! leave nothing behind.

use std::time::Duration;

use serde_json::Value;

use crate::rig::{FLOOR, Rig, is_left, nothing_is_left};

fn seconds(event: &Value) -> f64 {
    event["at_ns"].as_f64().unwrap() / 1e9
}

#[test]
fn killed_programs_are_started_again_and_the_robot_comes_back() {
    let Some(mut rig) = Rig::start(FLOOR) else { return };
    rig.wait_until(Duration::from_secs(2));
    let place = rig.place_of("r1").unwrap();
    let killed = rig.now().as_secs_f64();
    let before = rig.process(&place, "hostapd");
    rig.kill(&place, "hostapd");
    let lost = rig.wait_for(|event| event["event"] == "detached");
    assert_eq!(lost["from"], *place);
    let life = |state: &'static str| {
        let node = place.clone();
        move |event: &Value| event["event"] == "vnf" && event["node"] == *node && event["state"] == state
    };
    let died = rig.wait_for(life("died"));
    assert!(died["detail"].as_str().unwrap().contains("started again in 100 ms"), "{died}");
    let started = rig.wait_for(life("started"));
    let back = rig.wait_for(|event| event["event"] == "handover");
    println!(
        "hostapd killed: noticed after {:.2} s, serves after {:.2} s, robot back after {:.2} s",
        seconds(&died) - killed,
        seconds(&started) - killed,
        seconds(&back) - killed
    );
    assert!(seconds(&started) - killed < 1.0 && seconds(&back) - killed < 3.0);
    assert_ne!(rig.process(&place, "hostapd"), before);

    rig.wait(Duration::from_secs(1));
    let before = rig.process("r1", "wpa_supplicant");
    let killed = rig.now().as_secs_f64();
    rig.kill("r1", "wpa_supplicant");
    rig.wait_for(|event| event["event"] == "detached");
    rig.wait_for_notice("wpa_supplicant of `r1`: it ended");
    let back = rig.wait_for(|event| event["event"] == "handover");
    println!("wpa_supplicant killed: robot back after {:.2} s", seconds(&back) - killed);
    assert!(back["from"].is_null() && seconds(&back) - killed < 3.0, "{back}");
    assert_ne!(rig.process("r1", "wpa_supplicant"), before);
    // Both radio units can be joined again.
    let at = back["to"].as_str().unwrap();
    for unit in ["A", "B", "A"].into_iter().skip_while(|unit| *unit == at).take(2) {
        rig.attach("r1", unit).unwrap();
        rig.wait_for_handover("r1", unit);
    }
    rig.end();
}

#[test]
fn a_robot_that_lost_its_radio_unit_is_sent_to_another() {
    let Some(mut rig) = Rig::start(FLOOR) else { return };
    rig.wait_until(Duration::from_secs(1));
    let killed = rig.now().as_secs_f64();
    rig.kill("A", "hostapd");
    rig.wait_for(|event| event["event"] == "detached");
    rig.attach("r1", "B").unwrap();
    let there = rig.wait_for(|event| event["event"] == "handover");
    println!("hostapd killed, robot sent to another: there after {:.2} s", seconds(&there) - killed);
    assert_eq!(there["to"], "B");
    // It would need longer by itself.
    assert!(seconds(&there) - killed < 1.0);
    // It may go anywhere again.
    rig.wait(Duration::from_millis(500));
    rig.attach("r1", "A").unwrap();
    rig.wait_for_handover("r1", "A");
    rig.end();
}

#[test]
fn ctrl_c_in_the_middle_of_a_roam_leaves_nothing() {
    let Some(mut rig) = Rig::start(FLOOR) else { return };
    rig.wait_until(Duration::from_secs(1));
    let namespaces = rig.run.namespaces();
    assert!(is_left(&namespaces), "the run is there");
    rig.attach("r1", "B").unwrap();
    rig.interrupt();
    let (summary, _) = rig.run.report();
    assert!(summary["samples"].as_u64().unwrap() > 0, "{summary}");
    nothing_is_left(&namespaces);
}

#[test]
fn kill_9_leaves_nothing_that_runs() {
    let Some(mut rig) = Rig::start(FLOOR) else { return };
    rig.wait_until(Duration::from_secs(1));
    let namespaces = rig.run.namespaces();
    rig.run.signal("KILL");
    rig.run.wait();
    nothing_is_left(&namespaces);
    drop(rig);
    // The next run can begin at once.
    Rig::start(FLOOR).unwrap().end();
}
