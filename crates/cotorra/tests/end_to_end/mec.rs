//! An application on a node uses the services of ETSI MEC over the emulated network.

use std::{fs, process::Command};

use serde_json::json;

use crate::harness::{Run, cotorra, project_file, stdout, wait_until};

/// Returns what a VNF has printed.
fn log(run: &Run, vnf: &str) -> String {
    fs::read_to_string(run.folder.join(format!("logs/vnfs/{vnf}.log"))).unwrap_or_default()
}

/// Runs Python in a node, and returns what it prints.
fn python(run: &Run, node: &str, program: &str) -> String {
    let mut command: Command =
        cotorra(["exec", "--api", run.address(), node, "--", "python3", "-c", program]);
    let done = command.output().expect("cotorra starts");
    stdout(&done).trim().to_owned()
}

/// Asks for a URL in a node, and returns the status.
fn ask(run: &Run, node: &str, url: &str, token: &str) -> String {
    let program = format!(
        "import urllib.request as r, urllib.error as e\n\
         q = r.Request('{url}', headers={{'Authorization': 'Bearer {token}', 'Host': 'localhost'}})\n\
         try: print(r.urlopen(q, timeout=10).status)\n\
         except e.HTTPError as x: print(x.code)"
    );
    python(run, node, &program)
}

#[test]
fn an_application_finds_the_location_service_and_reads_the_zone_of_the_robot() {
    let run = Run::start_beside(&project_file("testbeds/mec.yaml"), &["--until", "10min"]);
    wait_until(|| log(&run, "watcher").contains("zone acr:robot local"));
    let printed = log(&run, "watcher");
    for line in
        ["ready 204", "registered 201 watcher", "location http://10.77.0.2:7700/domains/local/location/v2"]
    {
        assert!(printed.contains(line), "{printed}");
    }
    // The operator sees what the application registered.
    let services = run.get("/domains/local/mec_service_mgmt/v1/services?ser_name=watcher");
    assert_eq!(services[0]["transportInfo"]["endpoint"]["uris"], json!(["http://cloud:8080/"]), "{services}");
    // Requests cross the links of both nodes: 21 ms each way.
    let connect = "import socket, time; t = time.perf_counter(); socket.create_connection(('10.77.0.2', 7700)).close(); \
                   print(time.perf_counter() - t)";
    let took: f64 = python(&run, "cloud", connect).parse().unwrap();
    assert!(took >= 0.042, "{took} s");
    // Without a token of an application nothing is open there, whatever host the request names.
    let platform = "http://10.77.0.2:7700";
    let zones = format!("{platform}/domains/local/location/v2/queries/zones");
    assert_eq!(ask(&run, "cloud", &zones, ""), "401");
    // Nothing of cotorra's own API is there.
    assert_eq!(ask(&run, "cloud", &format!("{platform}/api/v1/testbed"), ""), "404");
    assert_eq!(ask(&run, "cloud", &format!("{platform}/app_lcm/v1/app_instances"), ""), "403");
}
