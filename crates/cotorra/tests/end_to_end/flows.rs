//! Service times of flows between programs without cotorra, against the programs' own measurements.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{collections::BTreeMap, fs};

use serde_json::Value;
use tempfile::TempDir;

use crate::{
    harness::{Run, output, project_file, stdout, wait_until},
    one_robot::testbed,
};

/// Delay of two crossings of the air and of the wire, ms.
const DELAYS_MS: f64 = 2.0 * (1.0 + 4.0);

/// Returns the client's own measurements by request, ms.
fn measured_by_client(run: &Run, name: &str) -> BTreeMap<u64, f64> {
    let log = fs::read_to_string(run.folder.join("logs/vnfs/client.log")).unwrap_or_default();
    // The last line may be incomplete.
    let whole = log.rfind('\n').map_or("", |end| &log[..end]);
    let lines = whole.lines().filter_map(|line| {
        let mut words = line.split_whitespace();
        (words.next() == Some(name)).then(|| {
            let mut number = || words.next().unwrap().parse::<f64>().unwrap();
            (number() as u64, number())
        })
    });
    lines.collect()
}

/// Returns the service times of a service's requests in order, ms. `None` for requests without an answer.
fn samples(run: &Run, service: &str) -> Vec<Option<f64>> {
    let page = run.get("/api/v1/measurements/service-times?limit=10000");
    let all = page["items"].as_array().unwrap().iter().filter(|sample| sample["service"] == service);
    let checked = all.inspect(|sample| {
        let places = [&sample["robot"], &sample["server"], &sample["attachment"]];
        assert_eq!(places, ["robot", "edge", "unit"], "{sample}");
    });
    let mut by_number: Vec<_> = checked
        .map(|sample| (sample["sequence"].as_u64().unwrap(), sample["service_time_ms"].as_f64()))
        .collect();
    by_number.sort_by_key(|(number, _)| *number);
    assert!(by_number.iter().map(|(number, _)| *number).eq(0..by_number.len() as u64));
    by_number.into_iter().map(|(_, took)| took).collect()
}

#[test]
fn times_of_flows_lie_between_the_delays_and_what_the_client_measures() {
    let mut run = Run::start(&project_file("testbeds/flows.yaml"), &["--until", "5min"]);
    wait_until(|| measured_by_client(&run, "health").len() > 15);
    let (echo, detect, first) = (samples(&run, "echo"), samples(&run, "detect"), samples(&run, "first-byte"));
    let [of_echo, of_detect, of_health] =
        ["echo", "detect", "health"].map(|name| measured_by_client(&run, name));
    let mut compared = 0;
    let mut compare = |took: Option<&Option<f64>>, itself: Option<&f64>| {
        let (Some(&Some(took)), Some(&itself)) = (took, itself) else { return };
        // Frames are delivered up to 15 µs before the time that counts.
        assert!((DELAYS_MS..=itself + 0.015).contains(&took), "{took} ms, by the client {itself} ms");
        compared += 1;
    };
    for number in 0..15 {
        let place = number as usize;
        compare(echo.get(place), of_echo.get(&number));
        compare(detect.get(place), of_detect.get(&number));
        // Both requests alternate on one connection.
        compare(first.get(2 * place), of_detect.get(&number));
        compare(first.get(2 * place + 1), of_health.get(&number));
    }
    assert!(compared >= 50, "{compared} of 60 were compared: {echo:?} {detect:?} {first:?}");
    for place in 0..15 {
        if let (Some(Some(whole)), Some(Some(first))) = (detect.get(place), first.get(2 * place)) {
            // 100 kB take 8 ms at 100 Mbit/s, and longer over the air.
            assert!(first + 8.0 <= *whole, "first byte after {first} ms, last after {whole} ms");
        }
    }
    run.signal("INT");
    let (summary, printed) = run.report();
    let services: Vec<_> =
        summary["services"].as_array().unwrap().iter().map(|its| its["service"].as_str().unwrap()).collect();
    assert_eq!(
        (services, &summary["notices"]),
        (vec!["echo", "detect", "first-byte"], &Value::Array(vec![]))
    );
    assert!(printed.contains("detect of robot "), "{printed}");
    let csv = fs::read_to_string(run.folder.join("service_time.csv")).unwrap();
    assert!(csv.contains(",robot,detect,3,"), "{csv}");
    let drawn = fs::read_to_string(run.folder.join("service_time.svg")).unwrap();
    for service in ["echo", "detect", "first-byte"] {
        assert!(drawn.contains(&format!(">{service}<")), "a panel for {service}");
    }
}

#[test]
fn a_flow_without_requests_is_reported_at_the_end() {
    let place = TempDir::new().unwrap();
    let rest = "
services:
  silent:
    robot: tb
    kpis: { service_time: 50 ms, flow: { protocol: udp, port: 9000 } }
    vnfs: { server: { command: [sleep, '1000'], node: cloud } }
";
    let file = testbed(place.path(), "silent", "{ kind: robot, position: [2, 3] }", rest);
    let out = place.path().join("out");
    let arguments = ["run", "--simulate", "--until", "2s", "--out", out.to_str().unwrap()];
    let ended = output(arguments.iter().copied().chain([file.to_str().unwrap()]));
    let printed = stdout(&ended);
    assert!(printed.contains("flow of service `silent`: no request seen"), "{printed}");
}
