//! `cotorra link`: shows, changes and tests links of a running testbed.

use std::process::Output;

use serde_json::Value;

use crate::harness::{Run, cotorra, project_file, stderr, stdout, wait_until};

fn link(run: &Run, arguments: &[&str]) -> Output {
    cotorra(["link"]).args(arguments).args(["--api", run.address()]).output().expect("the program is there")
}

#[test]
fn links_are_probed_changed_and_tested() {
    let run = Run::start(&project_file("testbeds/two-hosts.yaml"), &["--until", "600s"]);
    let context = |direction: &str| {
        let links = run.get("/api/v1/network/links");
        let is_it = |context: &&Value| context["link"] == "left-lan" && context["direction"] == direction;
        links.as_array().unwrap().iter().find(is_it).cloned().unwrap_or_default()
    };
    wait_until(|| context("forward")["probed"]["delay_ms"].is_number());
    let probed = context("forward")["probed"].clone();
    assert!(probed["delay_ms"].as_f64().unwrap() >= 1.0, "{probed}");
    assert!(probed["delay_age_ms"].is_number() && probed["loss_age_ms"].is_number(), "{probed}");
    assert_eq!(probed["loss"], 0.0);

    let set = link(&run, &["set", "left-lan", "--delay", "8ms", "--delay-scale", "2.5", "--rate", "8Mbit/s"]);
    assert!(set.status.success(), "{}", stderr(&set));
    assert!(stdout(&set).contains("20.000 ms, 8 Mbit/s"), "{}", stdout(&set));
    assert_eq!(context("forward")["effective"]["delay_ms"], 20.0);

    let test = link(&run, &["test", "left-lan", "--direction", "backward", "--duration", "500ms"]);
    assert!(test.status.success(), "{}", stderr(&test));
    let printed = stdout(&test);
    assert!(printed.starts_with("left-lan backward: ") && printed.contains("of 8.800 Mbit/s"), "{printed}");
    let tested = context("backward")["tested"].clone();
    assert!((tested["throughput_bps"].as_f64().unwrap() / 8e6 - 1.0).abs() < 0.02, "{tested}");
    assert!(tested["age_ms"].is_number() && context("forward")["tested"].is_null(), "{tested}");

    for (arguments, part) in [
        (&["test", "left-lan", "--duration", "11s"][..], "it lasts from 10 ms to 10 s"),
        (&["set", "left-lan", "--drop-scale", "0"], "a drop scale of 0 cannot be"),
        (&["set", "left-lan"], "--delay <DURATION>"),
        (&["show", "nothing"], "there are lan-right, left-lan"),
    ] {
        let refused = link(&run, arguments);
        let errors = stderr(&refused);
        assert!(!refused.status.success() && errors.contains(part), "{arguments:?}: {errors}");
    }
    let shown = stdout(&link(&run, &["show"]));
    assert!(shown.contains("20.000 ms, 8 Mbit/s") && shown.contains("s ago"), "{shown}");
}
