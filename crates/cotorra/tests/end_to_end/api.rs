//! The HTTP API of a live run.

#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{
    os::unix::{fs::MetadataExt as _, process::CommandExt as _},
    process::Command,
};

use serde_json::json;

use crate::harness::{Run, corridor, cotorra, output, project_file, stderr, stdout};

const INSTRUCTIONS: &str = "/api/v1/instructions";

#[test]
fn the_api_serves_the_state_and_rejects_invalid_requests() {
    let run = Run::start_beside(&corridor(), &["--until", "5min"]);
    run.wait_for_service();
    let robot = run.get("/api/v1/robots/robot");
    assert!(robot["sensors"]["pose"]["x"].is_number(), "{robot:#}");
    assert_eq!(run.get("/api/v1/testbed")["name"], "corridor");
    assert_eq!(run.get("/api/v1/network/placements").as_array().map(Vec::len), Some(4));
    assert!(!run.get("/api/v1/network/links").as_array().unwrap().is_empty());
    assert!(run.get("/openapi.json")["paths"].is_object());

    let (status, body) = run.ask("/api/v1/robots/nobody", None);
    assert_eq!(status, 404);
    assert!(body["error"].as_str().unwrap().contains("`nobody`"), "{body}");
    let (status, body) = run.ask("/api/v1/nothing", None);
    assert_eq!((status, body["error"].is_string()), (404, true));

    let (status, body) = run.post(INSTRUCTIONS, "{ not JSON");
    assert_eq!((status, body["error"].is_string()), (400, true), "{body}");
    let (status, body) = run.post(INSTRUCTIONS, r#"{ "instruction": { "instruction": "dance" } }"#);
    assert_eq!((status, body["error"].is_string()), (422, true), "{body}");
    let attach = json!({ "instruction": { "instruction": "attach", "robot": "robot", "radio_unit": "R9" } });
    let (status, body) = run.post(INSTRUCTIONS, &attach.to_string());
    assert_eq!((status, body["refused"].is_string()), (409, true), "{body}");

    // A negative delay and a rate above the medium's are rejected.
    for change in
        [json!({ "delay_ms": -1.0 }), json!({ "rate": { "kind": "fixed", "rate_bps": 1e11 as u64 } })]
    {
        let body =
            json!({ "instruction": { "instruction": "condition", "link": "R1-cloud", "change": change } });
        let (status, body) = run.post(INSTRUCTIONS, &body.to_string());
        assert_eq!((status, body["refused"].is_string()), (409, true), "{body}");
    }
    let slower = json!({ "instruction": { "instruction": "condition", "link": "R1-cloud", "change": { "delay_ms": 50.0 } } });
    let (status, body) = run.post(INSTRUCTIONS, &slower.to_string());
    assert_eq!((status, &body["done"]), (200, &json!(true)), "{body}");
}

#[test]
fn by_default_a_run_is_its_users_alone() {
    let run = Run::start_private(&corridor(), &["--until", "5min"]);
    // Whoever reaches the port: another user, or a page in a browser.
    let add = json!({ "vnf": { "id": "spy", "command": ["cat", "/etc/shadow"] } }).to_string();
    assert_eq!(run.post("/api/v1/vnfs", &add).0, 401);
    for path in ["/api/v1/testbed", "/wai/v2/queries/ap/ap_information", "/fog05/node"] {
        assert_eq!(run.ask(path, None).0, 401, "{path}");
    }
    // The user's tools and clients find it, with its address and without.
    let links = output(["link", "show", "--run", run.address()]);
    assert!(stdout(&links).contains("lan-cloud"), "{}", stderr(&links));
    let socket = stdout(&output(["ps", "--socket", "--run", run.address()]));
    let script = "from cotorra import Client; print(len(Client().links()))";
    let mut python = Command::new("python3");
    python.args(["-c", script]).env("PYTHONPATH", project_file("clients/python"));
    let counted = python.env("COTORRA_API", &run.api).env_remove("COTORRA_TOKEN").output().unwrap();
    assert!(counted.status.success() && stdout(&counted) != "0\n", "{}", stderr(&counted));
    // Another user cannot open the socket.
    let ask = |uid: Option<u32>| {
        let mut python = Command::new("python3");
        let connect = "import socket, sys; socket.socket(socket.AF_UNIX).connect(sys.argv[1])";
        python.args(["-c", connect, socket.trim()]);
        uid.into_iter().for_each(|uid| _ = python.uid(uid));
        stderr(&python.output().unwrap())
    };
    assert_eq!(ask(None), "");
    if std::fs::metadata("/proc/self").unwrap().uid() == 0 {
        assert!(ask(Some(65_534)).contains("PermissionError"), "{}", ask(Some(65_534)));
    }
}

#[test]
fn requests_without_the_token_are_rejected() {
    const TOKEN: &str = "a-secret-of-some-length";
    let run = Run::start_beside_with(&corridor(), &["--until", "5min"], |command| {
        command.env("COTORRA_TOKEN", TOKEN);
    });
    for wrong in [None, Some("a-secret-of-some-lengths"), Some("")] {
        assert_eq!(run.ask("/api/v1/robots", wrong).0, 401, "{wrong:?}");
    }
    assert_eq!(run.ask("/api/v1/robots", Some(TOKEN)).0, 200);
}

#[test]
fn an_api_on_the_network_needs_a_token() {
    let out = tempfile::tempdir().unwrap();
    let mut command = cotorra(["run", "--headless", "--api", "0.0.0.0:0", "--out"]);
    let refused = command.arg(out.path()).arg(corridor()).output().unwrap();
    assert_eq!(refused.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&refused.stderr).contains("COTORRA_TOKEN"), "{refused:?}");
    let short = command.env("COTORRA_TOKEN", "short").output().unwrap();
    assert_eq!(short.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&short.stderr).contains("16 characters"), "{short:?}");
}
