use serde_json::{Value, json};

use super::*;

fn subscription(change: impl Fn(&mut Value)) -> Result<Subscription, InvalidRequest> {
    let mut body = json!({
        "subscriptionType": "StaDataRateSubscription",
        "callbackReference": "http://127.0.0.1:9/",
        "staId": [{ "macId": "02:77:00:00:00:01" }],
        "notificationPeriod": 5,
    });
    change(&mut body);
    let subscription = Subscription::read(body.to_string().as_bytes())?;
    subscription.check_constraints().map(|()| subscription)
}

#[test]
fn parsed_requests_serialize_unchanged() {
    let read = subscription(|_| ()).unwrap();
    let written = serde_json::to_vec(&read).unwrap();
    assert_eq!(Subscription::read(&written).unwrap(), read);
    assert_eq!(serde_json::to_value(&read).unwrap()["subscriptionType"], "StaDataRateSubscription");
}

#[test]
fn errors_name_their_place() {
    type Change = fn(&mut Value);
    let changes: [(Change, &str); 12] = [
        (|s| s["subscriptionType"] = json!("Other"), "there is no subscriptionType `Other`"),
        (|s| s["subscriptionType"] = Value::Null, "subscriptionType: invalid type"),
        (|s| s["staId"] = json!([]), "at least one station"),
        (|s| s["staId"][0]["macId"] = json!("x"), "staId[0].macId: `x` is not a MAC address"),
        (|s| drop(s.as_object_mut().unwrap().remove("staId")), "missing field `staId`"),
        (|s| s["notificationPeriod"] = json!(256), "notificationPeriod: invalid value"),
        (|s| s["notificationPeriod"] = json!(0), "at least 1 second"),
        (|s| s["notificationPeriod"] = Value::Null, "one of notificationPeriod and notificationEvent"),
        (|s| s["notificationEvent"] = json!({ "trigger": 9 }), "from 1 to 8"),
        (|s| s["notificationEvent"] = json!({ "trigger": 1 }), "need downlinkRateThreshold"),
        (|s| s["notificationEvent"] = json!({ "trigger": 4 }), "need uplinkRateThreshold"),
        (
            |s| s["notificationEvent"] = json!({ "trigger": 6, "uplinkRateThreshold": 1 }),
            "need downlinkRateThreshold and uplinkRateThreshold",
        ),
    ];
    for (change, part) in changes {
        let error = subscription(change).unwrap_err().to_string();
        assert!(error.contains(part), "{part}: {error}");
    }
    for text in ["", "{", "[]", "{\"subscriptionType\": \"AssocStaSubscription\"} x"] {
        assert!(Subscription::read(text.as_bytes()).is_err(), "{text}");
    }
}

#[test]
fn measurements_must_be_one_of_the_available_kinds() {
    let load = json!({ "operatingClass": 81, "channel": 6 });
    for (info, part) in [
        (json!({}), "exactly one"),
        (json!({ "channelLoadConf": load, "neighborReportConf": {} }), "exactly one"),
        (json!({ "staStatisticsConf": { "groupIdentity": 0, "triggeredReport": false } }), "does not have"),
        (
            json!({ "channelLoadConf": { "operatingClass": 81, "channel": 6, "reportingCondition": 1 } }),
            "a threshold",
        ),
        (
            json!({ "channelLoadConf": { "operatingClass": 81, "channel": 6, "reportingCondition": 3 } }),
            "0 to 2",
        ),
    ] {
        let info: MeasurementInfo = serde_json::from_value(info).unwrap();
        let error = info.check().unwrap_err().to_string();
        assert!(error.contains(part), "{part}: {error}");
    }
    let info: MeasurementInfo = serde_json::from_value(json!({ "channelLoadConf": load })).unwrap();
    assert_eq!(info.check(), Ok(()));
}

#[test]
fn rate_triggers_follow_the_standard() {
    let met = |trigger: u8, down: u32, up: u32| {
        let event =
            StaDataRateEvent { trigger, downlink_rate_threshold: Some(10), uplink_rate_threshold: Some(20) };
        event.is_met(down, up)
    };
    for (trigger, expected) in [
        (1, [true, true, false, false]),
        (2, [true, false, true, true]),
        (3, [true, false, true, false]),
        (4, [true, true, false, true]),
        (5, [true, false, false, false]),
        (6, [true, false, false, true]),
        (7, [true, true, true, false]),
        (8, [true, true, true, true]),
    ] {
        // At both thresholds; above and below; below and above; below both.
        let rates = [(10, 20), (11, 19), (9, 21), (9, 19)];
        assert_eq!(rates.map(|(down, up)| met(trigger, down, up)), expected, "{trigger}");
    }
}
