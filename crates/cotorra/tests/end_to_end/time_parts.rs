//! Parts of service times, with real packets.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::collections::BTreeMap;

use serde_json::Value;

use crate::harness::{Run, corridor, project_file, wait_until};

const PARTS: [&str; 4] = ["sender_ms", "vnf_ms", "receiver_ms", "unknown_time_ms"];
const ON_LINKS: [&str; 3] = ["queueing_ms", "retries_ms", "crossing_ms"];

/// Returns all answered service times of a service so far.
fn answered(run: &Run, service: &str) -> Vec<Value> {
    let mut page = run.get("/api/v1/measurements/service-times?limit=10000");
    let samples = page["items"].as_array_mut().unwrap().drain(..);
    samples.filter(|sample| sample["service"] == service && !sample["service_time_ms"].is_null()).collect()
}

/// Returns the time on each link in each leg, and checks that the parts add up to the sample within 1 %.
fn checked(sample: &Value) -> BTreeMap<(String, bool), f64> {
    let parts = &sample["parts"];
    let ms = |of: &Value, name: &str| of[name].as_f64().unwrap_or_else(|| panic!("{name} of {sample:#}"));
    let links = parts["links"].as_array().unwrap_or_else(|| panic!("{sample:#}"));
    let on = |link: &Value| {
        let key = (link["link"].as_str().unwrap().to_owned(), link["back"].as_bool().unwrap());
        (key, ON_LINKS.iter().map(|name| ms(link, name)).sum())
    };
    let links: BTreeMap<_, f64> = links.iter().map(on).collect();
    let total = PARTS.iter().map(|name| ms(parts, name)).sum::<f64>() + links.values().sum::<f64>();
    let took = ms(sample, "service_time_ms");
    assert!((total - took).abs() <= took / 100.0, "{total} ms of {took} ms: {sample:#}");
    links
}

#[test]
fn parts_of_real_packets_add_up_and_name_the_slow_link() {
    let slow = ["--set", "links.R1-cloud.delay=20 ms", "--until", "5s"];
    let mut run = Run::start(&corridor(), &slow);
    wait_until(|| answered(&run, "navigation").len() > 40);
    for sample in &answered(&run, "navigation") {
        let links = checked(sample);
        assert_eq!(links.len(), 4, "{links:?}");
        for back in [false, true] {
            assert!(links[&("R1-cloud".to_owned(), back)] >= 20.0, "{links:?}");
            assert!(links[&("robot~R1".to_owned(), back)] >= 1.0, "{links:?}");
        }
        // A process has answered.
        assert!(sample["parts"]["vnf_ms"].as_f64().unwrap() > 0.0, "{sample:#}");
    }
    wait_until(|| answered(&run, "localization").len() > 2);
    for sample in &answered(&run, "localization") {
        let links = checked(sample);
        assert!(links.contains_key(&("R1-edge".to_owned(), true)) && links.len() == 4, "{links:?}");
        // The filter takes part of a millisecond.
        assert!(sample["parts"]["vnf_ms"].as_f64().unwrap() > 0.1, "{sample:#}");
    }
    let (summary, printed) = run.report();
    let parts = &summary["time_parts"][0];
    assert_eq!((&parts["service"], &parts["parts"][0]["part"]), (&"navigation".into(), &"R1-cloud".into()));
    assert_eq!(parts["without_parts"], 0, "{parts:#}");
    assert!(printed.contains("R1-cloud added"), "{printed}");
}

#[test]
fn parts_of_flows_add_up_with_real_packets() {
    let run = Run::start(&project_file("testbeds/flows.yaml"), &["--until", "5min"]);
    let services = ["echo", "detect", "first-byte"];
    wait_until(|| services.iter().all(|service| answered(&run, service).len() > 10));
    for service in services {
        for sample in answered(&run, service) {
            let links = checked(&sample);
            // Twice the air and the wire, of 1 and 4 ms.
            assert!(links.len() == 4 && links.values().sum::<f64>() >= 10.0, "{sample:#}");
            assert!(sample["parts"]["vnf_ms"].as_f64().unwrap() > 0.0, "{sample:#}");
        }
    }
}
