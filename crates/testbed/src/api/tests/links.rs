//! Figures of links and candidates of robots over the API.

use std::time::Duration;

use cotorra_graph::{
    BitRate, Conditions, Event, LinkContext, LinkCounters, Probed, Rate, RobotContext, Stamped, Timestamp,
};
use cotorra_graph_testing as base;
use serde_json::json;

use super::{notice, serve};

/// A context of a link of 5 ms and 10 Mbit/s that is probed, and that carries 4 Mbit/s.
fn link(name: &str) -> Stamped {
    let (ms, rate) = (Duration::from_millis, BitRate::from_mbps(10.0).unwrap());
    let effective =
        Conditions { delay: ms(5), rate: Rate::Fixed { bits_per_second: rate }, ..Conditions::default() };
    let probed = Probed {
        delay: Some(ms(29)),
        jitter: None,
        delay_age: Some(ms(300)),
        loss: Some(0.0),
        loss_age: ms(300),
    };
    let context = LinkContext {
        throughput_bps: 4e6,
        probed: Some(probed),
        effective,
        counters: LinkCounters { packets: 1, ..LinkCounters::default() },
        ..base::link_context(name)
    };
    Stamped { at: Timestamp::from_nanos(1_000_000_000), event: Event::Link(context) }
}

#[test]
fn links_have_configured_measured_and_available_figures_now_and_in_the_history() {
    let served = serve(false);
    let recorder = served.history.paced_recorder(served.runs[1]).unwrap();
    served.live.absorb(&link("left-ap"));
    recorder.record(link("left-ap"));
    recorder.flush().unwrap();
    served.live.absorb(&notice(1_500_000_000));
    let figure = |name: &str, value: f64, age: f64, source: &str| json!({ name: value, "age_ms": age, "source": source });
    let expected = json!({
        "delay": {
            "configured": figure("delay_ms", 5.0, 0.0, "configured"),
            "measured": figure("delay_ms", 29.0, 300.0, "probed"),
        },
        "throughput": {
            "configured": figure("throughput_bps", 1e7, 0.0, "configured"),
            "measured": figure("throughput_bps", 4e6, 0.0, "carried"),
            "available": figure("throughput_bps", 6e6, 0.0, "estimated"),
        },
    });
    let now = served.answer("network/links");
    assert_eq!((&now[0]["figures"], &now[0]["age_ms"]), (&expected, &json!(500.0)));
    let history = served.answer("measurements/links/left-ap");
    assert_eq!(history["items"][0]["figures"], expected);
}

#[test]
fn candidates_have_the_delay_over_the_air_with_its_source() {
    let served = serve(false);
    assert_eq!(served.get("robots/robot/candidates").0, 404);
    let context = RobotContext {
        attachments: vec![base::attachment("ap", true, Some(-50.0))],
        ..base::robot_context("robot", base::pose(0.0, 0.0, 0.0))
    };
    let at = Timestamp::from_nanos(1_000_000_000);
    served.live.absorb(&Stamped { at, event: Event::Robot(context) });
    served.live.absorb(&link("robot~ap"));
    served.live.absorb(&notice(1_500_000_000));
    let candidates = served.answer("robots/robot/candidates");
    let candidate = &candidates[0];
    assert_eq!((&candidate["radio_unit"], &candidate["attached"]), (&json!("ap"), &json!(true)));
    let uplink = json!({ "delay_ms": 29.0, "age_ms": 800.0, "source": "probed" });
    assert_eq!((&candidate["uplink"], &candidate["downlink"]["source"]), (&uplink, &json!("configured")));
}
