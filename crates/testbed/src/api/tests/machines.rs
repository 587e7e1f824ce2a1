//! Contexts of machines over the API.

use cotorra_graph::Stamped;
use serde_json::json;

use super::{notice, serve};

/// Report of a node's machine in a second of the run.
pub(super) fn machine(node: &str, second: u64) -> Stamped {
    let traffic = json!({ "packets": 7, "bytes": 900, "errors": 0, "dropped": 1, "throughput_bps": 8e6 });
    let event = json!({
        "at_ns": second * 1_000_000_000, "event": "machine", "node": node,
        "reading": { "measured_ns": second * 999_000_000, "time_error_ms": 0.5 },
        "cpu": { "cpus": 4, "busy": 0.25 },
        "load_average": { "one_minute": second as f64, "five_minutes": 0.5, "fifteen_minutes": 0.25 },
        "memory": { "memory_bytes": 8_000_000_000_u64, "available_bytes": 2_000_000_000 },
        "interfaces": [{
            "name": "eth0", "up": true, "carrier": true, "speed_bps": 1_000_000_000, "mtu_bytes": 1500,
            "received": traffic, "sent": traffic,
        }],
        "interfaces_left_out": 0, "wifi": [], "wifi_left_out": 0,
    });
    serde_json::from_value(event).unwrap()
}

#[test]
fn machines_are_served_with_their_age_and_history() {
    let served = serve(false);
    let path = "network/nodes/left/machine";
    for (path, expected) in [
        (path, "the machine of node `left` has reported nothing"),
        ("network/nodes/nobody/machine", "there is no node `nobody`"),
        ("measurements/machines/nobody", "there is no node `nobody`"),
    ] {
        let (status, body) = served.get(path);
        assert_eq!((status, &body["error"]), (404, &json!(expected)), "{path}");
    }
    let recorder = served.history.paced_recorder(served.runs[1]).unwrap();
    for second in 0..3 {
        served.live.absorb(&machine("left", second));
        recorder.record(machine("left", second));
    }
    recorder.flush().unwrap();
    served.live.absorb(&notice(3_500_000_000));

    let body = served.answer(path);
    let mut expected = serde_json::to_value(machine("left", 2)).unwrap();
    let event = expected.as_object_mut().unwrap();
    event.retain(|name, _| !["at_ns", "event"].contains(&name.as_str()));
    event.insert("age_ms".to_owned(), json!(1500.0));
    assert_eq!(body, expected);

    let page = served.answer("measurements/machines/left?from_ns=1000000000");
    let loads: Vec<_> =
        page["items"].as_array().unwrap().iter().map(|item| &item["load_average"]["one_minute"]).collect();
    assert_eq!(loads, [&json!(1.0), &json!(2.0)]);
    let state = served.answer("measurements/state?at_ns=1500000000");
    assert_eq!(state["machines"][0]["at_ns"], 1_000_000_000);
    for (figure, unit, last) in
        [("cpu", "", 0.25), ("load_average", "", 2.0), ("available_memory", "bytes", 2e9)]
    {
        let curve = served.answer(&format!("measurements/series?figure={figure}:left&points=1"));
        assert_eq!((&curve["unit"], &curve["points"][0]["last"]), (&json!(unit), &json!(last)), "{figure}");
    }
}
