//! Speed limits and goals of a robot, with real packets.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use serde_json::{Value, json};

use crate::harness::{Run, output, project_file, stdout, wait_until};

fn instruct(run: &Run, instruction: Value) -> (u16, Value) {
    run.post("/api/v1/instructions", &json!({ "instruction": instruction }).to_string())
}

/// Returns whether the robot's context satisfies a condition now.
fn is(run: &Run, condition: impl Fn(&Value) -> bool) -> bool {
    let (status, context) = run.ask("/api/v1/robots/robot", None);
    status == 200 && condition(&context)
}

#[test]
fn a_robot_is_slowed_and_sent_to_a_goal_over_the_api() {
    let mut run = Run::start_beside(&project_file("testbeds/two-paths.yaml"), &["--until", "600s"]);
    let speed = |context: &Value| context["sensors"]["velocity"]["linear"].as_f64().unwrap();
    wait_until(|| is(&run, |context| speed(context) > 0.25));
    let limit =
        |limit: Value| json!({ "instruction": "limit_speed", "robot": "robot", "speed_limit_mps": limit });
    let (status, body) = instruct(&run, limit(json!(-0.1)));
    assert!(status == 409 && body["refused"].as_str().unwrap().contains("from 0 on"), "{status}: {body}");
    assert_eq!(instruct(&run, limit(json!(0.1))).0, 200);
    wait_until(|| is(&run, |context| context["speed_limit_mps"] == 0.1 && speed(context) < 0.13));

    let to = |goal: Value| json!({ "instruction": "navigate_to", "robot": "robot", "goal": goal });
    let (status, body) = instruct(&run, to(json!({ "x": 1.5, "y": 1.0, "z": 2.0 })));
    assert!(
        status == 409 && body["refused"].as_str().unwrap().contains("no TurtleBot 2 leaves the floor"),
        "{status}: {body}"
    );
    let mut told = run.follow().filter(|event| event["event"] == "goal");
    assert_eq!(instruct(&run, to(json!({ "x": 1.5, "y": 1.0 }))).0, 200);
    let set = told.next().unwrap();
    assert_eq!((&set["state"], &set["goal"]), (&json!("set"), &json!({ "x": 1.5, "y": 1.0 })));
    let progress = told.next().unwrap();
    assert_eq!(progress["state"], "progress", "{progress}");
    assert!(progress["remaining_m"].as_f64().unwrap() > 0.1, "{progress}");
    assert_eq!(instruct(&run, limit(Value::Null)).0, 200);
    let ended = told.find(|event| event["state"] != "progress").unwrap();
    assert_eq!(ended["state"], "reached", "{ended}");
    wait_until(|| is(&run, |context| context.get("speed_limit_mps").is_none() && speed(context) == 0.0));
    let pose = run.get("/api/v1/robots/robot")["sensors"]["pose"].clone();
    let off = (pose["x"].as_f64().unwrap() - 1.5).hypot(pose["y"].as_f64().unwrap() - 1.0);
    assert!(off < 0.4, "{off} m off: {pose}");
    assert_eq!(instruct(&run, to(Value::Null)).0, 200);
    wait_until(|| is(&run, |context| speed(context) > 0.2));

    run.signal("INT");
    run.wait();
    let listed =
        |kinds: &str| stdout(&output(["history", "events", run.folder.to_str().unwrap(), "--kinds", kinds]));
    let decisions = listed("decision");
    for done in
        ["limit robot to 0.10 m/s", "limit robot no more", "send robot to (1.5, 1.0)", "back to its walk"]
    {
        assert!(decisions.contains(done), "{done}: {decisions}");
    }
    let goals = listed("goal");
    assert!(goals.contains("robot to (1.5, 1.0): reached"), "{goals}");
}
