//! Several instances of a VNF, with real packets.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::fs;

use serde_json::Value;
use tempfile::TempDir;

use crate::harness::{Run, corridor_ending_in, kill, wait_until};

/// Returns the processes that run navigation on a node, with their instance numbers.
pub fn brains(run: &Run, node: &str) -> Vec<(u32, String)> {
    let brain = |pid: u32| {
        let environment = fs::read_to_string(format!("/proc/{pid}/environ")).ok()?;
        let of = |name: &str| environment.split('\0').find_map(|entry| entry.strip_prefix(name));
        let is_it = of("COTORRA_VNF=") == Some("navigation") && of("COTORRA_NODE=") == Some(node);
        is_it.then(|| Some((pid, of("COTORRA_REPLICA=")?.to_owned()))).flatten()
    };
    run.processes().into_iter().filter_map(brain).collect()
}

/// Waits until a server has answered five position packets in a row.
fn wait_for_answers(events: &mut impl Iterator<Item = Value>, server: &str) {
    let mut answered = 0;
    for event in events.filter(|event| event["event"] == "service_time" && event["service"] == "navigation") {
        let is_by_server = event["server"] == server && event["service_time_ms"].is_number();
        answered = if is_by_server { answered + 1 } else { 0 };
        if answered == 5 {
            return;
        }
    }
    panic!("it ended");
}

#[test]
fn the_robot_goes_on_when_one_of_two_brains_is_killed() {
    let folder = TempDir::new().unwrap();
    let file = corridor_ending_in("", folder.path());
    let text = fs::read_to_string(&file).unwrap();
    fs::write(&file, text.replace("navigation, node: cloud", "navigation, node: [edge, fog], replicas: 2"))
        .unwrap();
    let run = Run::start_beside(&file, &["--until", "10min"]);
    let mut events = run.follow();
    wait_for_answers(&mut events, "edge");
    assert_eq!(["edge", "fog"].map(|node| brains(&run, node)[0].1.clone()), ["0", "1"]);
    // It is killed after each restart, so that it stays away for some time.
    let mut killed = Vec::new();
    while killed.len() < 5 {
        if let Some((pid, _)) = brains(&run, "edge").into_iter().find(|(pid, _)| !killed.contains(pid)) {
            kill("KILL", &pid.to_string());
            killed.push(pid);
        }
    }
    wait_for_answers(&mut events, "fog");
    // It is restarted, and is asked again.
    wait_for_answers(&mut events, "edge");
    for log in ["vnfs/navigation.log", "vnfs/navigation@1.log"] {
        assert!(run.folder.join("logs").join(log).exists(), "{log}");
    }
    // Instances are placed by the API, too.
    let place = |node: &str| {
        let body = format!(r#"{{"instruction":{{"instruction":"place","vnf":"navigation","node":{node}}}}}"#);
        let (status, said) = run.post("/api/v1/instructions", &body);
        assert_eq!(status, 200, "{said}");
    };
    place(r#"["fog"]"#);
    wait_for_answers(&mut events, "fog");
    wait_until(|| brains(&run, "edge").is_empty());
    place(r#"["cloud","fog"]"#);
    wait_for_answers(&mut events, "cloud");
    let placements = run.get("/api/v1/network/placements");
    let of = placements.as_array().unwrap().iter().find(|one| one["vnf"] == "navigation").unwrap();
    assert_eq!(of["node"], serde_json::json!(["cloud", "fog"]));
}
