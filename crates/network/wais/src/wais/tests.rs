//! Tests queries, subscriptions and measurements in virtual time.

use cotorra_mec::{Attribute, MOST, Outcome, Resource};
use serde_json::{Value, json};

use super::*;
use crate::{requests::MeasurementConfig, survey::Scope, testing};

const BASE: &str = "http://wais.lab/wai/v2";
const R1: &str = "02:77:00:00:00:01";
const R2: &str = "02:77:00:00:00:02";
const WEST: &str = "02:77:00:00:00:04";
const MIDDLE: &str = "02:77:00:00:00:05";
const EAST: &str = "02:77:00:00:00:06";

type Places<'a> = &'a [(&'a str, Option<&'a str>, f64)];

/// A service and its current time.
struct Rig {
    wais: Wais,
    now: f64,
}

impl Rig {
    fn new(scope: Scope) -> Self {
        let epoch = Epoch { unix_ns: 1_000_000_000_000 };
        let mut rig = Self { wais: Wais::new(testing::site(&scope), epoch), now: 0.0 };
        rig.see(&[("r1", Some("west"), 65.0), ("r2", Some("west"), 6.5), ("r3", Some("east"), 65.0)]);
        rig
    }

    fn see(&mut self, places: Places<'_>) {
        let survey = testing::survey(self.wais.site(), self.now, places);
        self.wais.observe(survey);
    }

    fn at(&self) -> Timestamp {
        Timestamp::from_secs_f64(self.now)
    }

    fn query(&mut self, of: Kind, parameters: &[(&str, &str)]) -> Value {
        let parameters: Vec<_> = parameters.iter().map(|(n, v)| ((*n).to_owned(), (*v).to_owned())).collect();
        let answer = self.wais.query(of, &Query::read(of.attributes(), &parameters).unwrap());
        serde_json::from_slice(&answer.body).unwrap()
    }

    fn try_subscribe(&mut self, body: &Value) -> Result<Resource<Subscription>, RequestError> {
        let subscription = Subscription::read(body.to_string().as_bytes())?;
        self.wais.subscribe(self.at(), BASE, subscription)
    }

    fn unsubscribe(&mut self, id: &str, if_match: Option<&str>) -> Result<(), RequestError> {
        let now = self.at();
        self.wais.subscriptions().remove(now, SUBSCRIPTIONS, id, if_match)
    }

    fn subscribe(&mut self, body: &Value) -> Resource<Subscription> {
        self.try_subscribe(body).unwrap_or_else(|refused| panic!("{refused}: {body}"))
    }

    fn configure(&mut self, body: &Value) -> Result<Resource<MeasurementConfig>, RequestError> {
        let config = MeasurementConfig::read(body.to_string().as_bytes())?;
        self.wais.configure(self.at(), BASE, config)
    }

    /// Returns the notifications sent until a time, with their times. All are delivered.
    fn sent(&mut self, until: f64) -> Vec<(f64, Value)> {
        self.sent_with(until, |_| Outcome::Delivered)
    }

    fn sent_with(&mut self, until: f64, outcome: impl Fn(usize) -> Outcome) -> Vec<(f64, Value)> {
        let mut sent = Vec::new();
        loop {
            let dispatches = self.wais.poll(self.at());
            let idle = dispatches.is_empty();
            for dispatch in dispatches {
                let outcome = outcome(sent.len());
                sent.push((self.now, serde_json::from_str(&dispatch.body).unwrap()));
                let at = self.at();
                self.wais.subscriptions().done(at, dispatch.subscription, dispatch.attempt, outcome);
            }
            if idle {
                let next = self.wais.subscriptions().next_deadline().map_or(f64::MAX, Timestamp::as_secs_f64);
                if next > until {
                    self.now = until;
                    return sent;
                }
                self.now = self.now.max(next);
            }
        }
    }
}

fn assoc(change: &Value) -> Value {
    let mut body = json!({
        "subscriptionType": "AssocStaSubscription",
        "callbackReference": "http://127.0.0.1:9/here",
        "apId": { "bssid": WEST },
    });
    body.as_object_mut().unwrap().extend(change.as_object().unwrap().clone());
    body
}

fn macs(stations: &Value) -> Vec<&str> {
    stations.as_array().unwrap().iter().map(|station| station["macId"].as_str().unwrap()).collect()
}

#[test]
fn access_points_show_the_testbeds_state() {
    let mut rig = Rig::new(Scope::Testbed);
    let all = rig.query(Kind::AccessPoints, &[]);
    assert_eq!(all.as_array().unwrap().len(), 3);
    let mut west = rig.query(Kind::AccessPoints, &[("filter", &format!("(eq,apId/bssid,{WEST})"))]);
    let west = west[0].take();
    assert_eq!(
        west["apId"],
        json!({ "bssid": WEST, "ssid": ["lab"], "ipAddress": ["10.77.0.4", "fd77::4"] })
    );
    assert_eq!(west["bssLoad"], json!({ "staCount": 2, "channelUtilization": 64, "availAdmCap": 0 }));
    assert_eq!((&west["channel"], &west["timeStamp"]["seconds"]), (&json!(1), &json!(1000)));
    assert_eq!(west["apLocation"]["geolocation"]["lat"], json!((41.5 * f64::from(1 << 25)) as u64));
    // Nothing has been reported about the wire behind it.
    assert_eq!(west.get("wanMetrics"), None);
}

#[test]
fn stations_are_where_they_report_to_be() {
    let mut rig = Rig::new(Scope::Testbed);
    let stations = rig.query(Kind::Stations, &[("filter", &format!("(eq,staId/macId,{R2})"))]);
    assert_eq!(
        stations,
        json!([{
            "timeStamp": { "seconds": 1000, "nanoSeconds": 0 },
            "staId": { "macId": R2, "ssid": ["lab"], "ipAddress": ["10.77.0.2", "fd77::2"] },
            "channel": 1,
            "apAssociated": { "bssid": WEST, "ssid": ["lab"], "ipAddress": ["10.77.0.4", "fd77::4"] },
            "rssi": { "rssi": 100 },
            "staDataRate": { "staLastDataDownlinkRate": 6500, "staLastDataUplinkRate": 3250 },
        }])
    );
    rig.see(&[("r1", Some("middle"), 65.0), ("r2", None, 0.0), ("r3", Some("east"), 65.0)]);
    let stations = rig.query(Kind::Stations, &[("fields", "apAssociated/ssid")]);
    let at: Vec<_> = stations.as_array().unwrap().iter().map(|s| &s["apAssociated"]["bssid"]).collect();
    assert_eq!(at, [MIDDLE, EAST], "one is between two access points, which do not report it");
}

#[test]
fn domains_see_their_own_access_points_and_stations() {
    let mut rig = Rig::new(Scope::Domain("annex".parse().unwrap()));
    let aps = rig.query(Kind::AccessPoints, &[]);
    assert_eq!((aps.as_array().unwrap().len(), &aps[0]["apId"]["bssid"]), (1, &json!(EAST)));
    let stations = rig.query(Kind::Stations, &[]);
    assert_eq!(
        (stations.as_array().unwrap().len(), &stations[0]["staId"]["macId"]),
        (1, &json!("02:77:00:00:00:03"))
    );
    let refused = rig.try_subscribe(&assoc(&json!({ "notificationPeriod": 1 }))).unwrap_err();
    assert!(matches!(refused, RequestError::Invalid(InvalidRequest::Unsupported(_))), "{refused}");
}

#[test]
fn periodic_notifications_end_with_their_subscription() {
    let mut rig = Rig::new(Scope::Testbed);
    let made = rig.subscribe(&assoc(&json!({ "notificationPeriod": 2 })));
    let sent = rig.sent(7.0);
    assert_eq!(sent.iter().map(|(at, _)| *at).collect::<Vec<_>>(), [2.0, 4.0, 6.0]);
    let (_, first) = &sent[0];
    assert_eq!(first["notificationType"], "AssocStaNotification");
    assert_eq!((macs(&first["staId"]), &first["apId"]["bssid"]), (vec![R1, R2], &json!(WEST)));
    // Missed periods are skipped.
    rig.now = 20.5;
    assert_eq!(rig.sent(22.0).iter().map(|(at, _)| *at).collect::<Vec<_>>(), [20.5, 22.0]);
    let id = made.href.rsplit('/').next().unwrap();
    rig.unsubscribe(id, None).unwrap();
    assert_eq!((rig.sent(100.0), rig.wais.subscriptions().next_deadline()), (vec![], None));
}

#[test]
fn thresholds_notify_once_until_left() {
    let mut rig = Rig::new(Scope::Testbed);
    rig.subscribe(&assoc(&json!({ "notificationEvent": { "trigger": 1, "threshold": 3 } })));
    let mut told = Vec::new();
    for (second, at_west) in [2, 3, 3, 2, 3].into_iter().enumerate() {
        rig.now = second as f64;
        let place = |n: usize| (n <= at_west).then_some("west").or(Some("east"));
        rig.see(&[("r1", place(1), 65.0), ("r2", place(2), 65.0), ("r3", place(3), 65.0)]);
        told.extend(rig.sent(rig.now).iter().map(|(at, sent)| (*at, macs(&sent["staId"]).len())));
    }
    assert_eq!(told, [(1.0, 3), (4.0, 3)]);
}

#[test]
fn period_and_threshold_notify_periodically_beyond_it() {
    let mut rig = Rig::new(Scope::Testbed);
    let event = json!({ "trigger": 2, "threshold": 1 });
    rig.subscribe(&assoc(&json!({ "notificationPeriod": 1, "notificationEvent": event })));
    assert_eq!(rig.sent(3.0), vec![]);
    rig.see(&[("r1", Some("west"), 65.0)]);
    assert_eq!(rig.sent(5.5).iter().map(|(at, _)| *at).collect::<Vec<_>>(), [4.0, 5.0]);
}

#[test]
fn rates_are_notified_for_stations_newly_meeting_the_threshold() {
    let mut rig = Rig::new(Scope::Testbed);
    rig.subscribe(&json!({
        "subscriptionType": "StaDataRateSubscription",
        "callbackReference": "http://127.0.0.1:9/",
        "staId": [{ "macId": R1 }, { "macId": R2 }, { "macId": "02:00:00:00:00:99" }],
        "notificationEvent": { "trigger": 2, "downlinkRateThreshold": 10_000 },
    }));
    let sent = rig.sent(0.0);
    assert_eq!(sent.len(), 1);
    let rate = &sent[0].1["staDataRate"];
    assert_eq!((rate.as_array().unwrap().len(), &rate[0]["staId"]["macId"]), (1, &json!(R2)));
    assert_eq!(rate[0]["staLastDataDownlinkRate"], 6500);
    rig.see(&[("r1", Some("west"), 5.0), ("r2", Some("west"), 6.5)]);
    let sent = rig.sent(0.0);
    assert_eq!(sent[0].1["staDataRate"][0]["staId"]["macId"], R1, "the other met it before");
    assert_eq!(rig.sent(100.0), vec![]);
}

#[test]
fn measurements_are_reported_to_subscribers_and_with_stations() {
    let mut rig = Rig::new(Scope::Testbed);
    let beacons = json!({ "beaconRequestConf": {
        "operatingClass": 81, "channelId": 0, "measurementMode": 2,
        "beaconReportingConf": { "reportingCondition": 1, "threshold": 90 },
    } });
    rig.subscribe(&json!({
        "subscriptionType": "MeasurementReportSubscription",
        "callbackReference": "http://127.0.0.1:9/",
        "staId": [{ "macId": R1 }],
        "measurementId": "who-hears-what",
        "measurementInfo": beacons,
    }));
    let sent = rig.sent(2.5);
    assert_eq!(sent.iter().map(|(at, _)| *at).collect::<Vec<_>>(), [1.0, 2.0]);
    // -50 and -60 dBm are above the threshold, -70 dBm is not.
    let reports = sent[0].1["beaconReport"].as_array().unwrap();
    let heard: Vec<_> =
        reports.iter().map(|r| (r["bssid"].as_str().unwrap(), r["rcpi"].as_u64().unwrap())).collect();
    assert_eq!(heard, [(WEST, 120), (MIDDLE, 100)]);
    assert_eq!(reports[0]["measurementId"], "who-hears-what");
    assert_eq!(reports[0]["staId"]["macId"], R1);
    assert_eq!(reports[0]["rsni"], 110, "-50 dBm over a noise floor of -95 dBm");

    let config = |name: &str, info: Value| json!({ "measurementId": name, "staId": [{ "macId": R1 }], "measurementInfo": info });
    assert_eq!(rig.query(Kind::Stations, &[])[0].get("channelLoad"), None);
    let load = json!({ "channelLoadConf": { "operatingClass": 81, "channel": 6 } });
    let made = rig.configure(&config("load", load.clone())).unwrap();
    rig.configure(&config("neighbors", json!({ "neighborReportConf": {} }))).unwrap();
    let nowhere = json!({ "channelLoadConf": { "operatingClass": 81, "channel": 13 } });
    rig.configure(&config("nowhere", nowhere)).unwrap();
    let stations = rig.query(Kind::Stations, &[]);
    assert_eq!(
        stations[0]["channelLoad"],
        json!([{ "measurementId": "load", "operatingClass": 81, "channel": 6, "measurementDuration": 255, "channelLoad": 128 }])
    );
    let neighbors: Vec<_> = stations[0]["neighborReport"]
        .as_array()
        .unwrap()
        .iter()
        .map(|n| n["bssid"].as_str().unwrap())
        .collect();
    assert_eq!(neighbors, [MIDDLE, EAST]);
    assert_eq!(stations[1].get("channelLoad"), None, "it was not requested for others");

    let twice = rig.configure(&config("load", load)).unwrap_err().to_string();
    assert!(twice.contains("another configuration is called `load`"), "{twice}");
    let id = made.href.rsplit('/').next().unwrap();
    rig.wais.unconfigure(rig.at(), id, None).unwrap();
    assert_eq!(rig.query(Kind::Stations, &[])[0].get("channelLoad"), None);
}

#[test]
fn expiry_is_announced_and_nothing_follows_it() {
    let mut rig = Rig::new(Scope::Testbed);
    rig.subscribe(&assoc(&json!({
        "notificationPeriod": 255,
        "requestTestNotification": true,
        "expiryDeadline": { "seconds": 1100, "nanoSeconds": 0 },
    })));
    let sent = rig.sent(1000.0);
    let types: Vec<_> = sent.iter().map(|(at, s)| (*at, s["notificationType"].as_str().unwrap())).collect();
    assert_eq!(types, [(0.0, "TestNotification"), (70.0, "ExpiryNotification")]);
    let href = format!("{BASE}/subscriptions/1");
    assert!(sent.iter().all(|(_, sent)| sent["_links"]["subscription"]["href"] == *href), "{sent:?}");
    assert_eq!(sent[1].1["expiryDeadline"]["seconds"], 1100);
    assert!(matches!(
        rig.wais.subscriptions().get(BASE, SUBSCRIPTIONS, "1"),
        Err(RequestError::NotFound { .. })
    ));
    // A short life is announced at its half, and a long one is cut to a day.
    rig.now = 0.0;
    let made = rig.subscribe(&assoc(&json!({
        "notificationPeriod": 255, "expiryDeadline": { "seconds": 1010, "nanoSeconds": 0 },
    })));
    assert_eq!(rig.sent(20.0).iter().map(|(at, _)| *at).collect::<Vec<_>>(), [5.0]);
    assert_eq!(made.value.notifying().expiry_deadline.unwrap().seconds, 1010);
    let year = json!({ "seconds": 1000 + 365 * 86400, "nanoSeconds": 0 });
    let made = rig.subscribe(&assoc(&json!({ "notificationPeriod": 1, "expiryDeadline": year })));
    assert_eq!(made.value.notifying().expiry_deadline.unwrap().seconds, 1020 + 86400);
    let past = json!({ "notificationPeriod": 1, "expiryDeadline": { "seconds": 999, "nanoSeconds": 0 } });
    assert!(rig.try_subscribe(&assoc(&past)).unwrap_err().to_string().contains("in the past"));
}

#[test]
fn replacing_needs_the_current_version() {
    let mut rig = Rig::new(Scope::Testbed);
    let made = rig.subscribe(&assoc(&json!({ "notificationPeriod": 1 })));
    let replace = |rig: &mut Rig, if_match: Option<&str>, body: Value| {
        let subscription = Subscription::read(body.to_string().as_bytes()).unwrap();
        rig.wais.resubscribe(rig.at(), BASE, "1", if_match, subscription)
    };
    let five = assoc(&json!({ "notificationPeriod": 5 }));
    let changed = replace(&mut rig, Some(&made.etag), five.clone()).unwrap();
    assert_ne!(changed.etag, made.etag);
    assert_eq!(
        replace(&mut rig, Some(&made.etag), five.clone()),
        Err(RequestError::Changed(changed.etag.clone()))
    );
    assert_eq!(rig.unsubscribe("1", Some(&made.etag)), Err(RequestError::Changed(changed.etag.clone())));
    assert_eq!(rig.sent(11.0).len(), 2, "the new period applies");
    let other = json!({
        "subscriptionType": "StaDataRateSubscription", "callbackReference": "http://127.0.0.1:9/",
        "staId": [{ "macId": R1 }], "notificationPeriod": 1,
    });
    assert!(replace(&mut rig, None, other).unwrap_err().to_string().contains("cannot change"));
    let elsewhere =
        assoc(&json!({ "notificationPeriod": 5, "_links": { "self": { "href": "http://x/y" } } }));
    assert!(replace(&mut rig, None, elsewhere).unwrap_err().to_string().contains("_links.self must be"));
    let itself = assoc(&json!({ "notificationPeriod": 5, "_links": { "self": { "href": made.href } } }));
    assert!(replace(&mut rig, Some("*"), itself).is_ok());
    rig.unsubscribe("1", None).unwrap();
    assert!(matches!(replace(&mut rig, None, five), Err(RequestError::NotFound { .. })));
}

#[test]
fn dead_callbacks_lose_only_their_notifications_and_are_reported() {
    let mut rig = Rig::new(Scope::Testbed);
    rig.subscribe(&assoc(&json!({ "notificationPeriod": 255, "requestTestNotification": true })));
    let sent = rig.sent_with(100.0, |_| Outcome::Failed("connection refused".to_owned()));
    let times: Vec<_> = sent.iter().map(|(at, _)| *at).collect();
    assert_eq!(times, [0.0, 0.5, 1.5, 3.5, 7.5], "five attempts, and then no more");
    let complaints = rig.wais.subscriptions().take_complaints();
    assert_eq!(complaints.len(), 1);
    assert!(
        complaints[0].contains("/subscriptions/1: a notification was dropped after 5 attempts"),
        "{complaints:?}"
    );
    // One that never answers delays only itself.
    rig.subscribe(&assoc(&json!({ "notificationPeriod": 1 })));
    rig.subscribe(&assoc(&json!({ "notificationPeriod": 1, "callbackReference": "http://127.0.0.1:8/" })));
    let mut hanging = 0;
    for second in 101..=200 {
        rig.now = f64::from(second);
        for dispatch in rig.wais.poll(rig.at()) {
            match dispatch.target {
                Target::Callback(callback) if callback.port == 9 => hanging += 1,
                _ => {
                    let at = rig.at();
                    let (id, attempt) = (dispatch.subscription, dispatch.attempt);
                    rig.wais.subscriptions().done(at, id, attempt, Outcome::Delivered);
                }
            }
        }
    }
    assert_eq!(hanging, 1, "it is called once until it answers");
    let complaints = rig.wais.subscriptions().take_complaints();
    assert!(complaints[0].contains("64 notifications wait already"), "{complaints:?}");
}

#[test]
fn websockets_get_notifications_that_waited() {
    let mut rig = Rig::new(Scope::Testbed);
    let both = json!({
        "notificationPeriod": 1, "requestTestNotification": true,
        "websockNotifConfig": { "requestWebsocketUri": true },
    });
    let made = rig.subscribe(&assoc(&both));
    let notifying = made.value.notifying();
    assert_eq!(notifying.callback_reference, None, "only the target in use is shown");
    let uri = notifying.websock_notif_config.as_ref().unwrap().websocket_uri.as_deref();
    assert_eq!(uri, Some("ws://wais.lab/wai/v2/subscriptions/1/websocket"));
    assert_eq!(rig.sent(2.5), vec![], "no WebSocket is open");
    rig.wais.subscriptions().set_websocket_open(1, true);
    assert_eq!(rig.sent(2.5).len(), 3, "the test and two periods");
    assert!(rig.wais.subscriptions().has_websocket(1) && !rig.wais.subscriptions().has_websocket(2));
}

#[test]
fn lists_link_all_resources_up_to_the_limit() {
    let mut rig = Rig::new(Scope::Testbed);
    for _ in 0..MOST {
        rig.subscribe(&assoc(&json!({ "notificationPeriod": 1 })));
    }
    assert_eq!(rig.try_subscribe(&assoc(&json!({ "notificationPeriod": 1 }))), Err(RequestError::Full));
    assert_eq!(rig.wais.subscription_links(BASE, None).subscription.len(), MOST);
    assert_eq!(rig.wais.subscription_links(BASE, Some("AssocStaSubscription")).subscription.len(), MOST);
    assert_eq!(rig.wais.subscription_links(BASE, Some("StaDataRateSubscription")).subscription.len(), 0);
    let changes = (0..1000).map(|_| rig.unsubscribe("none", None));
    let refused: Vec<_> = changes.filter(|r| matches!(r, Err(RequestError::TooOften(_)))).collect();
    assert!(!refused.is_empty());
}

/// The standard knows every attribute that is reported, so that filters and selectors can name it.
#[test]
fn all_reported_attributes_can_be_filtered_by() {
    fn check(value: &Value, of: &'static [Attribute], path: &str) {
        match value {
            Value::Array(elements) => elements.iter().for_each(|element| check(element, of, path)),
            Value::Object(map) => {
                for (name, inner) in map {
                    let attribute = of.iter().find(|attribute| attribute.name == name);
                    let attribute = attribute.unwrap_or_else(|| panic!("{path}/{name}"));
                    assert_eq!(attribute.many, inner.is_array(), "{path}/{name}");
                    if let cotorra_mec::Kind::Structure(of) = attribute.kind {
                        check(inner, of, &format!("{path}/{name}"));
                    }
                }
            }
            _ => {}
        }
    }
    let mut rig = Rig::new(Scope::Testbed);
    for (name, info) in [
        ("a", json!({ "channelLoadConf": { "operatingClass": 81, "channel": 6 } })),
        ("b", json!({ "neighborReportConf": {} })),
        (
            "c",
            json!({ "beaconRequestConf": {
                "operatingClass": 81, "channelId": 255, "measurementMode": 0,
                "beaconReportingConf": { "reportingCondition": 0, "threshold": 0 },
            } }),
        ),
    ] {
        rig.configure(&json!({ "measurementId": name, "staId": [{ "macId": R1 }], "measurementInfo": info }))
            .unwrap();
    }
    check(&rig.query(Kind::Stations, &[]), Kind::Stations.attributes(), "");
    check(&rig.query(Kind::AccessPoints, &[]), Kind::AccessPoints.attributes(), "");
}
