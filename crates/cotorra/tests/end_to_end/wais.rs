//! The WLAN Access Information Service of a live run: a MEC application uses it, and a property-based tester tries to break
//! it and the testbed's own API.

use std::{
    fs,
    path::Path,
    process::{Command, Stdio},
};

use serde_json::json;
use tempfile::TempDir;

use crate::harness::{Run, corridor, corridor_ending_in, output, project_file, stderr, stdout, wait_until};

#[test]
fn a_mec_application_hands_a_robot_over_by_wais_alone() {
    let folder = TempDir::new().unwrap();
    let testbed =
        corridor_ending_in("wais: { origin: { latitude: 41.5, longitude: 2.25 } }\n", folder.path());
    // It begins where another radio unit is about to be the strongest.
    let walk = "walks.robot.waypoints=[[25.8, -21.6], [26.4, -18.7], [27.3, -15.6]]";
    let run = Run::start_beside(&testbed, &["--until", "5min", "--set", walk]);
    run.wait_for_service();
    let mut python = Command::new("python3");
    python.arg(project_file("examples/wais_handover.py")).env("COTORRA_API", &run.api);
    let mut python = python.stdout(Stdio::null()).spawn().unwrap();
    let decided = || {
        let decisions = run.get("/api/v1/measurements/events?kinds=decision");
        let decisions = decisions["items"].as_array().unwrap().clone();
        decisions.into_iter().find(|d| d["instruction"]["instruction"] == "attach")
    };
    wait_until(|| decided().is_some() || python.try_wait().unwrap().is_some());
    assert!(python.try_wait().unwrap().is_none(), "it ended by itself");
    let decision = decided().unwrap();
    assert_eq!(decision["plugin"], "wais-handover");
    assert!(decision["reason"].as_str().unwrap().starts_with("WAIS reports"), "{decision}");
    // The service reports the attachment that the application instructed.
    let to = decision["instruction"]["radio_unit"].as_str().unwrap();
    let mac = run.get(&format!("/api/v1/network/nodes/{to}"))["address"]["mac"].clone();
    let octets = mac.as_array().unwrap().iter().map(|octet| format!("{:02x}", octet.as_u64().unwrap()));
    let bssid = octets.collect::<Vec<_>>().join(":");
    let there =
        format!("/domains/local/wai/v2/queries/sta/sta_information?filter=(eq,apAssociated/bssid,{bssid})");
    wait_until(|| !run.get(&there).as_array().unwrap().is_empty() || decision["refused"].is_string());
    assert_eq!(decision.get("refused"), None, "{decision}");
    let aps = run.get("/wai/v2/queries/ap/ap_information?fields=apLocation");
    assert!(aps.as_array().unwrap().iter().all(|ap| ap["apLocation"]["geolocation"]["datum"] == 1), "{aps}");
    python.kill().unwrap();
    python.wait().unwrap();
}

#[test]
fn a_missing_token_is_reported_as_a_problem_of_the_standard() {
    const TOKEN: &str = "a-secret-of-some-length";
    let run = Run::start_beside_with(&corridor(), &["--until", "5min"], |command| {
        command.env("COTORRA_TOKEN", TOKEN);
    });
    let path = "/wai/v2/queries/ap/ap_information";
    let (status, problem) = run.ask(path, None);
    assert_eq!((status, &problem["status"], &problem["title"]), (401, &json!(401), &json!("Unauthorized")));
    assert_eq!(run.ask(path, Some(TOKEN)).0, 200);
    assert_eq!(run.ask("/wai/v2/openapi.json", None).0, 200);
    let (status, problem) = run.ask("/domains/nowhere/wai/v2/subscriptions", Some(TOKEN));
    assert_eq!((status, &problem["status"]), (404, &json!(404)));
}

/// No request causes a 5xx or a response outside the documents. The requests conform to the documents or do not, and are
/// the same each time.
#[test]
fn no_request_breaks_the_apis() {
    let Some(python) = cotorra_testing::peers("schemathesis") else { return };
    let tester = Path::new(&python).with_file_name("schemathesis");
    let folder = TempDir::new().unwrap();
    let run = Run::start_beside(&corridor(), &["--until", "10min"]);
    run.wait_for_service();
    for (document, url, more) in [
        (&["openapi", "--wais"][..], format!("{}/wai/v2", run.api), &[][..]),
        (&["openapi", "--app-lcm"], format!("{}/app_lcm/v1", run.api), &[]),
        // Streams of events and of packets have no end.
        (
            &["openapi"],
            run.api.clone(),
            &["--exclude-path", "/api/v1/events", "--exclude-path", "/api/v1/network/captures/{id}"],
        ),
    ] {
        let file = folder.path().join("openapi.json");
        fs::write(&file, stdout(&output(document))).unwrap();
        let mut command = Command::new(&tester);
        command.arg("run").arg(&file).args(["--url", &url, "--no-color", "--continue-on-failure"]).args(more);
        command.args(["--generation-deterministic", "--max-examples", "15"]);
        command.args([
            "--checks",
            "not_a_server_error,status_code_conformance,content_type_conformance,response_headers_conformance,\
             response_schema_conformance,unsupported_method,use_after_free,ensure_resource_availability",
        ]);
        let done = command.current_dir(folder.path()).output().unwrap();
        let report = stdout(&done);
        assert!(done.status.success(), "{report}{}", stderr(&done));
        // Parts of a document that the tester cannot read would not be tested.
        assert!(!report.contains("Unresolvable"), "{report}");
        let tested = report.lines().skip_while(|line| !line.contains("SUMMARY")).collect::<Vec<_>>();
        eprintln!("{}", tested.join("\n"));
    }
    // The run has survived.
    assert_eq!(run.get("/api/v1/testbed")["name"], "corridor");
}
