//! The HTTP API of a live run.

use serde_json::json;

use crate::harness::{Run, corridor, cotorra};

const INSTRUCTIONS: &str = "/api/v1/instructions";

#[test]
fn the_api_serves_the_state_and_rejects_invalid_requests() {
    let run = Run::start(&corridor(), &["--until", "5min"]);
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
fn requests_without_the_token_are_rejected() {
    const TOKEN: &str = "a-secret-of-some-length";
    let run = Run::start_with(&corridor(), &["--until", "5min"], |command| {
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
