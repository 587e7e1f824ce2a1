//! Service times of calls over gRPC, against the client's own measurements.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use cotorra_testing::{process::Process, python};
use tempfile::TempDir;

use crate::flow_programs::{DELAYS_MS, compare, flows, inside};

#[test]
fn calls_over_grpc_are_measured_by_their_methods() {
    let Some(python) = python("grpc", "gRPC") else { return };
    let folder = TempDir::new().unwrap();
    let mut run = flows(
        folder.path(),
        &[
            ("act", "protocol: http, port: 50051, path: /policy.Policy/Act"),
            ("watch", "protocol: http, port: 50051, path: /policy.Policy/Watch"),
            ("nobody", "protocol: http, port: 50051, path: /policy.Policy/Reset"),
        ],
    );
    let start = |node: &str, arguments: &[&str]| {
        let mut command = inside(&run, node);
        command.arg(&python).args(["-u", "-c", include_str!("grpc.py")]).args(arguments);
        Process::spawn(&mut command).unwrap()
    };
    let server = start("edge", &["serve"]);
    server.prints("serves");
    let client = start("robot", &["ask", "10.77.0.2"]);
    // 10 ms of work, and 30 kB at 100 Mbit/s.
    compare(&run, "act", &client, "act", DELAYS_MS + 10.0 + 2.4);
    compare(&run, "watch", &client, "watch", DELAYS_MS + 5.0 * 20.0);
    run.signal("INT");
    let (_, printed) = run.report();
    assert!(printed.contains("flow of service `nobody`: no request seen"), "{printed}");
}
