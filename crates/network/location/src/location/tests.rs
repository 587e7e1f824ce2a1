//! Tests queries and subscriptions in virtual time, and compares each answer with ETSI's schemas.

use std::{collections::BTreeMap, path::Path};

use cotorra_graph::{Attachment, NodeId, Pose, PoseSource, RadioContext, RobotContext};
use cotorra_graph_testing as base;
use cotorra_mec::{Outcome, Resource, Scope, conformance::Published};
use serde::Serialize;
use serde_json::Value;

use super::*;
use crate::{requests::Point, view::End};

/// ETSI's OpenAPI file. It calls one attribute `AccessPointId` and requires `accessPointId`; and notifications link to their
/// subscription in the standard's text.
const PUBLISHED: Published = Published {
    schemas: include_str!("../../tests/etsi/mec013-3.1.1.schemas.json"),
    beside: &["accessPointId", "subscription"],
};

const BASE: &str = "http://mec.lab/location/v2";

const FILE: &str = "
name: rooms
domains: [hall, annex]
wireless: { lab: { standard: n } }
nodes:
  r1: { kind: robot, position: [1, 1] }
  r2: { kind: robot, position: [2, 1] }
  west: { kind: radio_unit, position: [0, 0], channel: 1, domain: hall }
  middle: { kind: radio_unit, position: [10, 0], channel: 6, domain: hall }
  east: { kind: radio_unit, position: [20, 0], channel: 6, domain: annex }
  lan: { kind: switch }
links:
  - { ends: [lan, [west, middle, east]], rate: 100 Mbit/s }
";

/// A service and its current time.
struct Rig {
    location: Location,
    now: f64,
}

fn id(name: &str) -> NodeId {
    NodeId::new(name).unwrap()
}

/// A pose that localization believes, with a standard deviation of 0.2 m along each axis.
fn localized(x: f64, y: f64) -> Pose {
    let mut covariance = [0.0; 9];
    (covariance[0], covariance[4]) = (0.04, 0.04);
    Pose::planar(x, y, 0.0, covariance, PoseSource::Localization)
}

/// The simulator's exact pose.
fn exact(x: f64, y: f64) -> Pose {
    Pose::planar(x, y, 0.0, [0.0; 9], PoseSource::Simulator)
}

impl Rig {
    fn with(scope: &Scope, origin: &str) -> Self {
        let testbed =
            cotorra_testbed_file::parse("rooms.yaml", &format!("{FILE}{origin}"), Path::new("")).unwrap();
        let site = Arc::new(Site::new(&testbed.graph, &testbed.name, testbed.wais.origin, scope));
        let epoch = Epoch { unix_ns: 1_000_000_000_000 };
        let mut rig = Self { location: Location::new(site, epoch), now: 0.0 };
        rig.see(&[("r1", Some("west"), localized(3.0, 4.0)), ("r2", Some("middle"), exact(9.0, 1.0))]);
        rig
    }

    fn new() -> Self {
        Self::with(&Scope::Testbed, "wais: { origin: { latitude: 41.5, longitude: 2.25 } }\n")
    }

    fn see(&mut self, robots: &[(&str, Option<&str>, Pose)]) {
        let robots = robots.iter().map(|(robot, place, pose)| {
            let attachments = ["west", "middle", "east"].map(|unit| Attachment {
                radio_unit: id(unit),
                attached: *place == Some(unit),
                signal: None,
                age: None,
            });
            let context =
                RobotContext { attachments: attachments.into(), ..base::robot_context(robot, *pose) };
            (id(robot), context)
        });
        let radio = ["west", "middle"].map(|unit| {
            let context = RadioContext { radio_unit: id(unit), channel: 1, load: None, stations: Vec::new() };
            (id(unit), context)
        });
        let site = Arc::clone(self.location.site());
        let survey = site.survey(self.at(), &BTreeMap::from(radio), &robots.collect());
        self.location.observe(survey);
    }

    fn at(&self) -> Timestamp {
        Timestamp::from_secs_f64(self.now)
    }

    fn try_subscribe(&mut self, list: List, body: &Value) -> Result<Resource<Subscription>, RequestError> {
        let subscription = Subscription::read(list.path(), body.to_string().as_bytes())?;
        self.location.subscribe(self.at(), BASE, subscription)
    }

    fn unsubscribe(&mut self, list: List, id: &str) -> Result<(), RequestError> {
        let now = self.at();
        self.location.subscriptions().remove(now, list.path(), id, None)
    }

    /// Subscribes, and checks the answer.
    fn subscribe(&mut self, list: List, type_name: &str, more: &Value) -> Resource<Subscription> {
        let mut body = json!({
            "subscriptionType": type_name, "callbackReference": "http://127.0.0.1:9/", "clientCorrelator": "7",
        });
        body.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
        let made = self.try_subscribe(list, &wrapped(type_name, &body)).unwrap_or_else(|e| panic!("{e}"));
        let answer = serde_json::to_value(&made.value).unwrap();
        let answer = &answer[camel(type_name)];
        assert_eq!(PUBLISHED.differences(answer, type_name), [""; 0]);
        assert_eq!(answer["_links"]["self"]["href"], made.href);
        made
    }

    /// Returns the notifications sent until a time, with their times. Each conforms to its schema, and is delivered.
    fn sent(&mut self, until: f64) -> Vec<(f64, Value)> {
        let mut sent = Vec::new();
        loop {
            let dispatches = self.location.poll(self.at());
            let idle = dispatches.is_empty();
            for Dispatch { subscription, attempt, body, .. } in dispatches {
                let notification: Value = serde_json::from_str(&body).unwrap();
                let schema = notification["notificationType"].as_str().unwrap();
                assert_eq!(PUBLISHED.differences(&notification, schema), [""; 0], "{notification}");
                sent.push((self.now, notification));
                let at = self.at();
                self.location.subscriptions().done(at, subscription, attempt, Outcome::Delivered);
            }
            if idle {
                let next = self.location.subscriptions().next_deadline();
                let next = next.map_or(f64::MAX, Timestamp::as_secs_f64);
                if next > until {
                    self.now = until;
                    return sent;
                }
                self.now = self.now.max(next);
            }
        }
    }
}

fn camel(type_name: &str) -> String {
    let (first, rest) = type_name.split_at(1);
    format!("{}{rest}", first.to_ascii_lowercase())
}

fn wrapped(type_name: &str, body: &Value) -> Value {
    json!({ camel(type_name): body })
}

/// Returns a value as JSON that conforms to a schema.
fn conforming(value: &impl Serialize, schema: &str) -> Value {
    let value = serde_json::to_value(value).unwrap();
    assert_eq!(PUBLISHED.differences(&value, schema), [""; 0], "{value}");
    value
}

fn events(sent: &[(f64, Value)]) -> Vec<(&str, &str)> {
    sent.iter()
        .map(|(_, sent)| (sent["address"].as_str().unwrap(), sent["userLocationEvent"].as_str().unwrap()))
        .collect()
}

const ENTERING: &str = "ENTERING_AREA_EVENT";
const LEAVING: &str = "LEAVING_AREA_EVENT";

#[test]
fn zones_are_domains_and_access_points_their_radio_units() {
    let rig = Rig::new();
    let zones = conforming(&rig.location.zones(BASE, &[]), "ZoneList");
    let counts = |zone: &Value| {
        (zone["zoneId"].clone(), zone["numberOfAccessPoints"].clone(), zone["numberOfUsers"].clone())
    };
    let counts: Vec<_> = zones["zone"].as_array().unwrap().iter().map(counts).collect();
    assert_eq!(counts, [(json!("annex"), json!(1), json!(0)), (json!("hall"), json!(2), json!(2))]);
    assert_eq!(rig.location.zones(BASE, &["hall".to_owned()]).zone.len(), 1);
    let zone = conforming(&rig.location.zone(BASE, "hall").unwrap(), "ZoneInfo");
    assert_eq!(zone["resourceURL"], "http://mec.lab/location/v2/queries/zones/hall");
    let list = rig.location.access_points(BASE, "hall", &[]).unwrap();
    let list = conforming(&list, "AccessPointList");
    let west = &list["accessPoint"][1];
    assert_eq!((&west["accessPointId"], &west["numberOfUsers"]), (&json!("west"), &json!(1)));
    assert_eq!((&west["operationStatus"], &west["connectionType"]), (&json!("Serviceable"), &json!("Wifi")));
    assert_eq!(west["locationInfo"]["latitude"], json!([41.5]));
    let east = conforming(&rig.location.access_point(BASE, "annex", "east").unwrap(), "AccessPointInfo");
    assert_eq!(east["operationStatus"], "Unknown", "it has reported nothing");
    for missing in [
        rig.location.zone(BASE, "roof").map(|_| ()),
        rig.location.access_points(BASE, "roof", &[]).map(|_| ()),
        rig.location.access_point(BASE, "annex", "west").map(|_| ()),
    ] {
        assert!(matches!(missing, Err(RequestError::NotFound { .. })), "{missing:?}");
    }
}

#[test]
fn users_have_the_pose_they_believe_else_the_place_of_their_access_point() {
    let rig = Rig::new();
    let users = conforming(&rig.location.users(BASE, &UserQuery::default()), "UserList");
    let (r1, r2) = (&users["user"][0], &users["user"][1]);
    assert_eq!(
        (&r1["address"], &r1["accessPointId"], &r1["zoneId"]),
        (&json!("acr:r1"), &json!("west"), &json!("hall"))
    );
    let relative = &r1["relativeLocationInfo"];
    assert_eq!(
        (&relative["X"], &relative["Y"], &relative["mapInfo"]["mapId"]),
        (&json!(3.0), &json!(4.0), &json!("rooms"))
    );
    // 2.45 standard deviations of 0.2 m, rounded up.
    assert_eq!((&r1["locationInfo"]["shape"], &r1["locationInfo"]["accuracy"]), (&json!(5), &json!(1)));
    // The simulator's exact pose of r2 is (9, 1). A network knows only its access point, at (10, 0).
    let relative = &r2["relativeLocationInfo"];
    assert_eq!((&relative["X"], &relative["Y"]), (&json!(10.0), &json!(0.0)));
    assert_eq!((&r2["locationInfo"]["shape"], r2["locationInfo"].get("accuracy")), (&json!(2), None));
    assert_eq!(r2["timestamp"], json!({ "seconds": 1000, "nanoSeconds": 0 }));
    let select = |zones: &[&str], access_points: &[&str], addresses: &[&str]| {
        let own = |list: &[&str]| list.iter().map(|text| (*text).to_owned()).collect();
        let (zones, access_points, addresses) = (own(zones), own(access_points), own(addresses));
        rig.location.users(BASE, &UserQuery { zones, access_points, addresses }).user.len()
    };
    assert_eq!(select(&["hall"], &[], &[]), 2);
    assert_eq!(select(&["hall"], &["west", "east"], &[]), 1);
    assert_eq!(select(&[], &[], &["acr:r2", "acr:r9"]), 1);
    assert_eq!(select(&["annex"], &[], &["acr:r2"]), 0);
}

#[test]
fn domains_see_their_own_zone_and_users() {
    let mut rig = Rig::with(&Scope::Domain("annex".parse().unwrap()), "");
    assert_eq!(rig.location.zones(BASE, &[]).zone.len(), 1);
    assert!(rig.location.users(BASE, &UserQuery::default()).user.is_empty());
    rig.see(&[("r1", Some("east"), localized(19.0, 0.0)), ("r2", Some("middle"), exact(9.0, 1.0))]);
    let users = conforming(&rig.location.users(BASE, &UserQuery::default()), "UserList");
    assert_eq!(
        (users["user"].as_array().unwrap().len(), &users["user"][0]["address"]),
        (1, &json!("acr:r1"))
    );
    assert_eq!(users["user"][0].get("locationInfo"), None, "the map has no place on Earth");
    assert_eq!(users["user"][0]["relativeLocationInfo"]["X"], 19.0);
}

#[test]
fn distances_are_between_users_or_to_a_place() {
    let mut rig = Rig::new();
    rig.see(&[("r1", Some("west"), localized(0.0, 0.0)), ("r2", Some("west"), localized(30.0, 40.0))]);
    let distance =
        |rig: &Rig, from: &str, to: End| rig.location.distance(&DistanceQuery { from: from.to_owned(), to });
    let between = distance(&rig, "acr:r1", End::User("acr:r2".to_owned())).unwrap();
    let between = conforming(&between, "TerminalDistance");
    assert_eq!((&between["distance"], &between["accuracy"]), (&json!(50), &json!(1)));
    // A thousandth of a degree of latitude is 111.195 m.
    let north = End::Place(Point { latitude: 41.501, longitude: 2.25 });
    assert_eq!(distance(&rig, "acr:r1", north.clone()).unwrap().distance, 111);
    let missing = distance(&rig, "acr:r3", north.clone()).unwrap_err();
    assert!(missing.to_string().contains("acr:r3"), "{missing}");
    let nowhere = Rig::with(&Scope::Testbed, "");
    let unlocated = distance(&nowhere, "acr:r1", north).unwrap_err().to_string();
    assert!(unlocated.contains("`wais.origin`"), "{unlocated}");
}

#[test]
fn users_are_notified_as_they_enter_and_leave_zones_and_access_points() {
    let mut rig = Rig::new();
    rig.subscribe(List::Users, "UserLocationEventSubscription", &json!({ "address": "acr:r1" }));
    assert_eq!(rig.sent(1.0), vec![], "where it is at the beginning is no event");
    rig.see(&[("r1", Some("middle"), localized(9.0, 0.0))]);
    assert_eq!(rig.sent(2.0), vec![], "it is in the same zone");
    rig.see(&[("r1", Some("east"), localized(19.0, 0.0))]);
    let sent = rig.sent(3.0);
    assert_eq!(events(&sent), [("acr:r1", LEAVING), ("acr:r1", ENTERING)]);
    assert_eq!((&sent[0].1["zoneId"], &sent[1].1["zoneId"]), (&json!("hall"), &json!("annex")));
    assert_eq!(sent[0].1.get("locationInfo"), None, "it was not requested");

    let mut rig = Rig::new();
    let para = json!({
        "accessPointList": ["middle"], "reportingLocationReq": true, "occurrenceInfo": "ONE_TIME_EVENT",
    });
    let more = json!({
        "address": "acr:r1", "locationEventCriteria": [ENTERING], "userEventPara": para,
        "requestTestNotification": true,
    });
    let made = rig.subscribe(List::Users, "UserLocationEventSubscription", &more);
    let sent = rig.sent(1.0);
    assert_eq!((&sent[0].1["notificationType"], sent.len()), (&json!("TestNotification"), 1));
    assert_eq!(sent[0].1["_links"]["subscription"]["href"], made.href);
    let mut told = Vec::new();
    for place in ["middle", "west", "middle"] {
        rig.see(&[("r1", Some(place), localized(9.0, 0.0))]);
        told.extend(rig.sent(rig.now));
    }
    assert_eq!(events(&told), [("acr:r1", ENTERING)], "once");
    assert_eq!(told[0].1["relativeLocationInfo"]["X"], 9.0);
}

#[test]
fn periodic_reports_end_with_the_last() {
    let mut rig = Rig::new();
    let info = json!({ "reportingAmount": 3, "reportingInterval": 2 });
    let more = json!({ "address": "acr:r1", "periodicEventInfo": info });
    rig.subscribe(List::Users, "UserLocationPeriodicSubscription", &more);
    let sent = rig.sent(5.0);
    assert_eq!(sent.iter().map(|(at, _)| *at).collect::<Vec<_>>(), [2.0, 4.0]);
    let first = &sent[0].1;
    assert_eq!((&first["result"], &first["isFinalNotification"]), (&json!("SUCCESS"), &json!(false)));
    assert_eq!((&first["accessPointId"], &first["relativeLocationInfo"]["Y"]), (&json!("west"), &json!(4.0)));
    rig.see(&[("r1", None, localized(3.0, 4.0))]);
    let sent = rig.sent(100.0);
    assert_eq!(sent.iter().map(|(at, _)| *at).collect::<Vec<_>>(), [6.0]);
    let last = &sent[0].1;
    assert_eq!((&last["result"], &last["isFinalNotification"]), (&json!("ABNORMAL"), &json!(true)));
}

#[test]
fn zones_notify_users_that_come_and_go() {
    let mut rig = Rig::new();
    let bounds = json!({ "minimumInterval": 10, "maximumCount": 3 });
    rig.subscribe(List::Zones, "ZoneLocationEventSubscription", &json!({ "zoneId": "annex" }));
    let more = json!({ "zoneId": "annex", "locationEventCriteria": [ENTERING], "reportingCtrl": bounds });
    rig.subscribe(List::Zones, "ZoneLocationEventSubscription", &more);
    assert_eq!(rig.sent(1.0), vec![]);
    rig.see(&[("r1", Some("east"), localized(19.0, 0.0)), ("r2", Some("middle"), exact(9.0, 1.0))]);
    assert_eq!(events(&rig.sent(1.0)), [("acr:r1", ENTERING), ("acr:r1", ENTERING)], "to both");
    rig.see(&[("r2", Some("east"), exact(9.0, 1.0))]);
    // The second is still within its minimum interval.
    assert_eq!(events(&rig.sent(2.0)), [("acr:r1", LEAVING), ("acr:r2", ENTERING)]);
}

#[test]
fn thresholds_of_zones_notify_once_until_left() {
    let mut rig = Rig::new();
    let more = json!({
        "zoneId": "hall", "lowerNumberOfUsersZoneThreshold": 2, "upperNumberOfUsersAPThreshold": 1,
        "operationStatus": ["Serviceable", "Unknown"],
    });
    rig.subscribe(List::Zones, "ZoneStatusSubscription", &more);
    assert_eq!(rig.sent(0.0), vec![]);
    let mut told = Vec::new();
    for (second, place) in [Some("west"), None, None, Some("west")].into_iter().enumerate() {
        rig.now = second as f64;
        rig.see(&[("r1", Some("west"), localized(1.0, 1.0)), ("r2", place, localized(1.0, 1.0))]);
        let sent = rig.sent(rig.now);
        told.extend(
            sent.iter().map(|(at, sent)| (*at, sent["userNumEvent"].clone(), sent["accessPointId"].clone())),
        );
    }
    let west = json!("west");
    assert_eq!(told, [(0.0, json!(3), west.clone()), (1.0, json!(2), Value::Null), (3.0, json!(3), west),]);
}

#[test]
fn areas_notify_users_that_enter_and_leave_them() {
    let mut rig = Rig::new();
    // 0.0001 degrees of latitude are 11 m.
    let circle = json!({ "shape": 1, "points": [{ "latitude": 41.5001, "longitude": 2.25 }], "radius": 3 });
    let corner = |latitude: f64, longitude: f64| json!({ "latitude": latitude, "longitude": longitude });
    let square = json!({ "shape": 2, "points": [
        corner(41.500_09, 2.249_9), corner(41.500_09, 2.250_1), corner(41.500_11, 2.250_1), corner(41.500_11, 2.249_9),
    ] });
    for (area, with_location) in [(circle, true), (square, false)] {
        let more = json!({
            "addressList": ["acr:r1"], "areaDefine": area, "trackingAccuracy": 1.0,
            "reportingLocationReq": with_location,
        });
        rig.subscribe(List::Area, "UserAreaSubscription", &more);
    }
    assert_eq!(rig.sent(1.0), vec![]);
    let mut told = Vec::new();
    for y in [11.0, 11.5, 30.0] {
        rig.see(&[("r1", Some("west"), localized(0.0, y))]);
        told.extend(rig.sent(rig.now));
    }
    assert_eq!(
        events(&told),
        [("acr:r1", ENTERING), ("acr:r1", ENTERING), ("acr:r1", LEAVING), ("acr:r1", LEAVING)]
    );
    let located: Vec<_> = told.iter().map(|(_, sent)| sent.get("locationInfo").is_some()).collect();
    assert_eq!(located, [true, false, true, false]);
}

#[test]
fn distances_notify_when_their_criterion_is_newly_met() {
    let mut rig = Rig::new();
    rig.see(&[("r1", Some("west"), localized(0.0, 0.0)), ("r2", Some("west"), localized(1.0, 0.0))]);
    let more = |check: bool| {
        json!({
            "monitoredAddress": ["acr:r1", "acr:r2"], "distance": 2.0, "criteria": "AllWithinDistance",
            "checkImmediate": check, "trackingAccuracy": 1.0,
        })
    };
    let at_once = rig.subscribe(List::Distance, "UserDistanceSubscription", &more(true)).href;
    rig.subscribe(List::Distance, "UserDistanceSubscription", &more(false));
    let sent = rig.sent(1.0);
    assert_eq!((sent.len(), &sent[0].1["_links"]["self"]["href"]), (1, &json!(at_once)));
    assert_eq!(sent[0].1["monitoredUsers"]["user"].as_array().unwrap().len(), 2);
    for (x, expected) in [(5.0, 0), (1.5, 2), (1.0, 0)] {
        rig.see(&[("r1", Some("west"), localized(0.0, 0.0)), ("r2", Some("west"), localized(x, 0.0))]);
        assert_eq!(rig.sent(rig.now).len(), expected, "{x}");
    }
    // A user of unknown place is neither near nor far.
    rig.see(&[("r1", Some("west"), localized(0.0, 0.0))]);
    assert_eq!(rig.sent(rig.now), vec![]);
}

#[test]
fn subscriptions_belong_to_their_list() {
    let mut rig = Rig::new();
    let made = rig.subscribe(List::Users, "UserLocationEventSubscription", &json!({ "address": "acr:r1" }));
    let number = made.href.rsplit('/').next().unwrap().to_owned();
    assert_eq!(made.href, format!("{BASE}/subscriptions/users/{number}"));
    assert!(rig.location.subscriptions().get(BASE, List::Users.path(), &number).is_ok());
    assert!(rig.location.subscriptions().get(BASE, List::Zones.path(), &number).is_err());
    let links = |list| rig.location.links(BASE, list, |_| true);
    let users = conforming(&links(List::Users), "NotificationSubscriptionList");
    assert_eq!(users["subscription"][0]["subscriptionType"], "UserLocationEventSubscription");
    assert!(links(List::Zones).subscription.is_empty());
    assert!(rig.unsubscribe(List::Zones, &number).is_err());
    assert!(rig.unsubscribe(List::Users, &number).is_ok());
}

#[test]
fn invalid_subscriptions_are_rejected_with_a_reason() {
    let callback = json!({ "callbackReference": "http://127.0.0.1:9/" });
    for (list, type_name, more, part) in [
        (List::Users, "UserLocationEventSubscription", json!({}), "missing field `address`"),
        (
            List::Users,
            "UserLocationEventSubscription",
            json!({ "address": "acr:r9" }),
            "no user with this address",
        ),
        (
            List::Zones,
            "UserLocationEventSubscription",
            json!({ "address": "acr:r1" }),
            "belongs to subscriptions/users",
        ),
        (List::Users, "OtherSubscription", json!({}), "unknown variant"),
        (
            List::Users,
            "UserLocationPeriodicSubscription",
            json!({ "address": "acr:r1", "periodicEventInfo": { "reportingAmount": 0, "reportingInterval": 1 } }),
            "at least 1",
        ),
        (
            List::Users,
            "UserLocationPeriodicSubscription",
            json!({ "address": "acr:r1", "periodicEventInfo": { "reportingAmount": 99999, "reportingInterval": 9999 } }),
            "at most 8639999",
        ),
        (
            List::Zones,
            "ZoneLocationEventSubscription",
            json!({ "zoneId": "roof" }),
            "no zone with this zoneId",
        ),
        (
            List::Zones,
            "ZoneStatusSubscription",
            json!({ "zoneId": "hall" }),
            "a threshold or operationStatus",
        ),
        (
            List::Area,
            "UserAreaSubscription",
            json!({
                "addressList": ["acr:r1"], "trackingAccuracy": 1.0,
                "areaDefine": { "shape": 1, "points": [{ "latitude": 1.0, "longitude": 2.0 }] },
            }),
            "one point and a radius",
        ),
        (
            List::Distance,
            "UserDistanceSubscription",
            json!({
                "monitoredAddress": ["acr:r1"], "distance": 1.0, "criteria": "AllWithinDistance",
                "checkImmediate": true, "trackingAccuracy": 1.0,
            }),
            "two users",
        ),
    ] {
        let mut body = callback.clone();
        body["subscriptionType"] = type_name.into();
        body.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
        let refused = Rig::new().try_subscribe(list, &wrapped(type_name, &body)).unwrap_err().to_string();
        assert!(refused.contains(part), "{type_name}: {refused}");
    }
    let body =
        json!({ "subscriptionType": "x", "address": "acr:r1", "callbackReference": "http://127.0.0.1:9/" });
    let refused = Rig::new().try_subscribe(List::Users, &wrapped("UserLocationEventSubscription", &body));
    let refused = refused.unwrap_err().to_string();
    assert!(refused.contains("subscriptionType must be UserLocationEventSubscription"), "{refused}");
}
