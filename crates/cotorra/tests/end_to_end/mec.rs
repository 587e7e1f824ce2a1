//! Applications on nodes use the services of ETSI MEC over the emulated network.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{fs, path::PathBuf, process::Command};

use serde_json::{Value, json};
use tempfile::TempDir;

use crate::harness::{Run, cotorra, project_file, stdout, wait_until};

/// Returns what a VNF has printed.
fn log(run: &Run, vnf: &str) -> String {
    fs::read_to_string(run.folder.join(format!("logs/vnfs/{vnf}.log"))).unwrap_or_default()
}

/// Writes a testbed file and its program, `{name}.yaml` and `{name}.py`, to a folder.
fn written(name: &str, text: &str, program: &str) -> (TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join(format!("{name}.yaml"));
    fs::write(&file, text).unwrap();
    fs::write(folder.path().join(format!("{name}.py")), program).unwrap();
    (folder, file)
}

/// Returns the reasons of the decisions so far.
fn reasons(run: &Run) -> Vec<String> {
    let decisions = run.get("/api/v1/measurements/events?kinds=decision");
    let all = decisions["items"].as_array().unwrap().iter();
    all.filter_map(|decision| Some(decision["reason"].as_str()?.to_owned())).collect()
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

/// All shares are of packets by their numbers, so that they do not depend on how fast the machine is.
#[test]
fn an_application_gets_the_bandwidth_that_it_asks_for() {
    let (_folder, file) =
        written("mec_bandwidth", include_str!("mec_bandwidth.yaml"), include_str!("mec_bandwidth.py"));
    let run = Run::start_beside(&file, &["--until", "10min"]);
    wait_until(|| log(&run, "receiver").ends_with("done\n"));
    let printed = log(&run, "receiver");
    println!("{printed}");
    for line in [
        "too much 403",
        "of another 403",
        "between others 400",
        "allocated 201 5000000",
        "taken 403",
        "all 1",
        "deleted 204",
    ] {
        assert!(printed.contains(line), "no `{line}` in {printed}");
    }
    assert_eq!(reasons(&run).iter().filter(|reason| *reason == "MEC 015: by `receiver`").count(), 3);
    assert_eq!(run.get("/bwm/v1/bw_allocations"), json!([]));
    // One that is added asks, and its allocation ends with it, without a request of anybody.
    let asks = "import json, os, time, urllib.request as r\n\
        body = {'appInsId': 'added', 'requestType': 1, 'fixedAllocation': '1000000', 'allocationDirection': '00', \
        'sessionFilter': [{'sourceIp': '10.77.0.3', 'dstAddress': '10.77.0.2'}]}\n\
        head = {'Authorization': 'Bearer ' + os.environ['COTORRA_MEC_TOKEN'], 'Content-Type': 'application/json'}\n\
        at = os.environ['COTORRA_MEC'] + '/bwm/v1/bw_allocations'\n\
        print(r.urlopen(r.Request(at, json.dumps(body).encode(), head)).status, flush=True)\n\
        time.sleep(3600)";
    let vnf = json!({ "vnf": {
        "id": "added", "program": { "command": ["python3", "-c", asks] }, "node": "cloud", "cpus": 0.1,
        "memory_bytes": 64 << 20,
    } });
    let (status, answer) = run.post("/api/v1/vnfs", &vnf.to_string());
    assert_eq!(status, 200, "{answer}");
    wait_until(|| log(&run, "added").contains("201"));
    assert_eq!(run.delete("/api/v1/vnfs/added"), 200);
    wait_until(|| reasons(&run).iter().any(|reason| reason == "MEC 015: `added` has ended"));
    assert_eq!(run.get("/bwm/v1/bw_allocations"), json!([]));
}

#[test]
fn applications_are_notified_over_the_emulated_network() {
    let (_folder, file) =
        written("mec_events", include_str!("mec_events.yaml"), include_str!("mec_events.py"));
    let run = Run::start_beside(&file, &["--until", "10min"]);
    let has = |line: &str| log(&run, "watcher").lines().any(|printed| printed == line);
    wait_until(|| has("zone opened 101") && has("migration opened 101"));
    wait_until(|| {
        run.get("/api/v1/network/placements").as_array().unwrap().iter().any(|p| p["vnf"] == "sleeper")
    });
    let try_to = |instruction: Value| {
        let body = json!({ "instruction": instruction }).to_string();
        run.post("/api/v1/instructions", &body)
    };
    let instruct = |instruction: Value| {
        let (status, answer) = try_to(instruction);
        assert_eq!(status, 200, "{answer}");
    };
    // Out of the zone to a radio unit of another domain, which admits the robot by a key, and back.
    let access_point = json!({ "ssid": "lab", "mobility_domain": 7, "key": "ab".repeat(32) });
    instruct(json!({ "instruction": "deploy", "radio_unit": "east", "access_point": access_point }));
    instruct(json!({
        "instruction": "provision", "robot": "robot", "radio_unit": "east", "access_point": access_point
    }));
    let attach = json!({ "instruction": "attach", "robot": "robot", "radio_unit": "east" });
    // It is off until it is deployed.
    wait_until(|| try_to(attach.clone()).0 == 200);
    wait_until(|| has("zone LEAVING_AREA_EVENT hall acr:robot"));
    instruct(json!({ "instruction": "attach", "robot": "robot", "radio_unit": "west" }));
    wait_until(|| has("zone ENTERING_AREA_EVENT hall acr:robot"));
    instruct(json!({ "instruction": "place", "vnf": "sleeper", "node": "edge" }));
    wait_until(|| has("migration 1 sleeper") && has("migration 2 sleeper"));
}
