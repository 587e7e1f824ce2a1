//! A testbed of one robot, one radio unit and one server, with any driver of the robot.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{
    fs,
    path::{Path, PathBuf},
};

use serde_json::Value;

use crate::harness::Run;

const PLACE: &str = "
wireless: { w: {} }
nodes:
  R1: { kind: radio_unit, position: [0, 0], channel: 1 }
  cloud: { kind: server, tier: cloud, cpus: 4, memory: 8 GB }
  tb: ROBOT
links:
  - { ends: [R1, cloud], delay: 1 ms }
";

/// Services and a walk that is longer than any test.
pub const NAVIGATED: &str = "
services:
  navigation:
    robot: tb
    kpis: { service_time: 50 ms }
    vnfs:
      robot-driver: { program: robot_driver, pinned_to: tb }
      navigation: { program: navigation, node: cloud }
walks:
  tb: { waypoints: [[2, 3], [500, 3]], speed_limit: 0.5 m/s }
";

/// Returns [`NAVIGATED`] with lines of further VNFs, and `rest` at its end.
pub fn navigated(vnfs: &str, rest: &str) -> String {
    NAVIGATED.replace("walks:", &format!("{vnfs}walks:")) + rest
}

/// Writes a testbed file with the node `robot` as `tb`, and with `rest` at its end.
pub fn testbed(folder: &Path, name: &str, robot: &str, rest: &str) -> PathBuf {
    let file = folder.join(format!("{name}.yaml"));
    fs::write(&file, format!("name: {name}\n{}{rest}", PLACE.replace("ROBOT", robot))).unwrap();
    file
}

/// Returns κ of the robot, or null if there is none yet.
pub fn robot(run: &Run) -> Value {
    let (status, context) = run.ask("/api/v1/robots/tb", None);
    if status == 200 { context } else { Value::Null }
}
