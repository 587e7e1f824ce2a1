use std::path::Path;

use cotorra_graph::{RadioContext, RobotContext, StationContext};
use cotorra_graph_testing as base;
use proptest::prelude::*;
use serde_json::{Value, json};

use super::*;

const SLOW: Option<f64> = Some(0.2);

fn with(settings: Value) -> Result<Pace, String> {
    Pace::from_settings(settings.as_object().unwrap()).map_err(|error| error.to_string())
}

fn started() -> Pace {
    const TESTBED: &str = "
name: one-robot
wireless: { lab: { delay: 1 ms } }
nodes:
  r: { kind: robot, position: [0, 0] }
  A: { kind: radio_unit, position: [0, 1], channel: 1 }
";
    let testbed =
        cotorra_testbed_file::parse("test", TESTBED, Path::new("")).unwrap_or_else(|e| panic!("{e:?}"));
    let mut pace = with(json!({})).unwrap();
    pace.start(Timestamp::ZERO, &testbed, &mut Actions::default());
    pace
}

/// The limits that it asks for after these events, each at a time, s.
fn asked(pace: &mut Pace, events: impl IntoIterator<Item = (f64, Event)>) -> Vec<(f64, Option<f64>)> {
    let mut asked = Vec::new();
    for (at, event) in events {
        let mut actions = Actions::default();
        pace.handle(Timestamp::from_secs_f64(at), &event, &mut actions);
        asked.extend(actions.drain().map(|(instruction, reason)| match instruction {
            Instruction::LimitSpeed { robot, speed_limit_mps }
                if robot.as_str() == "r" && reason.is_some() =>
            {
                (at, speed_limit_mps)
            }
            other => panic!("{other:?}"),
        }));
    }
    asked
}

fn received(signal: f64) -> Event {
    let station = |robot: &str| StationContext {
        robot: robot.parse().unwrap(),
        signal: Dbm(signal),
        downlink_bps: 6.5 * 1e6,
        uplink_bps: 6.5 * 1e6,
        counted: Default::default(),
    };
    // One that the testbed does not have belongs to no robot.
    let stations = vec![station("r"), station("visitor")];
    Event::Radio(RadioContext { radio_unit: "A".parse().unwrap(), channel: 1, load: Some(0.1), stations })
}

fn limited(speed_limit_mps: Option<f64>) -> Event {
    let pose = base::pose(0.0, 0.0, 0.0);
    Event::Robot(RobotContext { speed_limit_mps, ..base::robot_context("r", pose) })
}

#[test]
fn a_weak_signal_slows_and_only_a_strong_one_takes_that_back() {
    let settings = Settings::default();
    let limit = |signal, limit| pace(Some(Dbm(signal)), limit, &settings);
    assert_eq!([limit(-76.0, None), limit(-76.0, SLOW)], [SLOW; 2]);
    assert_eq!([limit(-72.0, None), limit(-72.0, SLOW)], [None, SLOW], "it keeps what it has in between");
    assert_eq!([limit(-69.0, None), limit(-69.0, SLOW)], [None; 2]);
    assert_eq!(pace(None, None, &settings), SLOW, "no radio unit is the weakest");
    for stricter in [Some(0.0), Some(0.1)] {
        assert_eq!([limit(-76.0, stricter), limit(-69.0, stricter)], [stricter; 2], "it is another's");
    }
    assert_eq!([limit(-76.0, Some(0.5)), limit(-69.0, Some(0.5))], [SLOW, Some(0.5)]);
}

#[test]
fn robots_are_instructed_once_and_again_if_they_do_not_follow() {
    let mut pace = started();
    assert_eq!(asked(&mut pace, [(0.0, received(-60.0)), (1.0, received(-80.0))]), [(1.0, SLOW)]);
    assert_eq!(asked(&mut pace, [(1.1, limited(SLOW)), (2.0, received(-80.0)), (3.0, received(-72.0))]), []);
    assert_eq!(asked(&mut pace, [(4.0, received(-60.0))]), [(4.0, None)]);
    // It was refused, or another took it back.
    assert_eq!(asked(&mut pace, [(4.5, received(-60.0)), (5.0, received(-60.0))]), [(5.0, None)]);
    assert_eq!(asked(&mut pace, [(5.1, limited(None)), (6.0, received(-60.0))]), []);
}

#[test]
fn a_robot_that_lost_its_radio_unit_is_slowed_at_once() {
    let lost = Event::Detached { robot: "r".parse().unwrap(), from: "A".parse().unwrap() };
    assert_eq!(asked(&mut started(), [(0.3, lost)]), [(0.3, SLOW)]);
}

#[test]
fn invalid_settings_are_rejected_with_their_name() {
    let settings = with(json!({ "weak_dbm": -80, "speed_mps": 1.5 })).unwrap().settings;
    assert_eq!(settings, Settings { weak_dbm: -80.0, strong_dbm: -70.0, speed_mps: 1.5 });
    for (wrong, message) in [
        (json!({ "weak": -80 }), "weak: unknown field `weak`"),
        (json!({ "weak_dbm": "-80 dBm" }), "weak_dbm: invalid type"),
        (json!({ "weak_dbm": -70 }), "weak_dbm: -70 dBm is not below strong_dbm, -70 dBm"),
        (json!({ "speed_mps": 0 }), "speed_mps: 0 m/s is not above 0"),
    ] {
        let error = with(wrong).unwrap_err();
        assert!(error.starts_with(message), "{error}");
    }
}

proptest! {
    /// However the signal changes, instructions are few: one a second at most.
    #[test]
    fn instructions_are_bounded(signals in proptest::collection::vec(-100.0..-40.0f64, 1..200)) {
        let mut pace = started();
        let events = (0..).zip(signals).map(|(n, signal)| (f64::from(n) * 0.1, received(signal)));
        let times: Vec<_> = asked(&mut pace, events).into_iter().map(|(at, _)| at).collect();
        prop_assert!(times.windows(2).all(|pair| pair[1] - pair[0] > 0.99), "{times:?}");
    }
}
