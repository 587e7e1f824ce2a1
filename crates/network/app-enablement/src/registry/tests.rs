//! Tests services and subscriptions in virtual time, and compares each answer with ETSI's schemas.

use cotorra_mec::{Subscribed as _, conformance::Published};
use serde::Serialize;
use serde_json::json;

use super::*;
use crate::testing::{EPOCH, World};

const PUBLISHED: Published = Published {
    schemas: include_str!("../../tests/etsi/mec011-service-mgmt-3.1.1.schemas.json"),
    beside: &[],
};

const BASE: &str = "http://mec.lab/domains/local/mec_service_mgmt/v1";

struct Rig {
    registry: Registry,
    world: World,
}

impl Rig {
    fn new() -> Self {
        let world = World::new();
        let location = Provided {
            name: "location",
            standard: "MEC 013",
            version: "3.1.1",
            path: "/domains/local/location/v2".to_owned(),
        };
        let mut registry = Registry::new(Arc::clone(&world.site), EPOCH, vec![location]);
        registry.observe(world.survey());
        Self { registry, world }
    }

    fn register(&mut self, application: &str, body: &Value) -> Result<Resource<ServiceInfo>, RequestError> {
        let info = ServiceInfo::read(body.to_string().as_bytes())?;
        self.registry.register(self.world.at(), BASE, application, info)
    }

    fn subscribe(
        &mut self,
        application: &str,
        more: &Value,
    ) -> Result<Resource<AvailabilitySubscription>, RequestError> {
        let mut body = json!({
            "subscriptionType": "SerAvailabilityNotificationSubscription", "callbackReference": "http://127.0.0.1:9/",
        });
        body.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
        let list = subscriptions_of(application);
        let subscription = AvailabilitySubscription::read(&list, body.to_string().as_bytes())?;
        self.registry.subscribe(self.world.at(), BASE, subscription)
    }

    fn sent(&mut self) -> Vec<Value> {
        let sent = self.world.sent(&mut self.registry);
        for notification in &sent {
            assert_eq!(PUBLISHED.differences(notification, "ServiceAvailabilityNotification"), [""; 0]);
        }
        sent
    }
}

fn query(parameters: &[(&str, &str)]) -> Result<ServiceQuery, String> {
    let parameters = parameters.iter().map(|(name, value)| ((*name).to_owned(), (*value).to_owned()));
    ServiceQuery::read(parameters.collect()).map_err(|error| error.to_string())
}

fn service(name: &str, state: &str) -> Value {
    json!({
        "serName": name, "version": "1", "state": state, "serializer": "JSON",
        "serCategory": { "href": "http://x/", "id": "maps", "name": "maps", "version": "1" },
        "transportInfo": {
            "id": "1", "name": "rest", "type": "REST_HTTP", "protocol": "HTTP", "version": "1.1",
            "endpoint": { "addresses": [{ "host": "10.77.0.4", "port": 80 }] }, "security": {},
        },
    })
}

fn conforming(value: &impl Serialize, schema: &str) -> Value {
    let value = json!(value);
    assert_eq!(PUBLISHED.differences(&value, schema), [""; 0], "{value}");
    value
}

#[test]
fn the_platforms_services_are_found_under_the_callers_address() {
    let rig = Rig::new();
    let all = rig.registry.services(BASE, &query(&[("ser_name", "location")]).unwrap());
    let location = conforming(&all[0], "ServiceInfo");
    let endpoint = &location["transportInfo"]["endpoint"];
    assert_eq!(endpoint, &json!({ "uris": ["http://mec.lab/domains/local/location/v2"] }));
    assert_eq!((&location["serInstanceId"], all.len()), (&json!("location"), 1));
    let one = conforming(&rig.registry.service(BASE, "location").unwrap().value, "ServiceInfo");
    assert_eq!(one, location);
}

#[test]
fn services_belong_to_their_application_and_end_with_it() {
    let mut rig = Rig::new();
    let made = rig.register("planner", &service("map", "ACTIVE")).unwrap();
    let id = made.value.ser_instance_id.clone().unwrap();
    assert_eq!(made.href, format!("{BASE}/applications/planner/services/{id}"));
    conforming(&made.value, "ServiceInfo");
    let everything = query(&[]).unwrap();
    let names = |rig: &Rig| {
        let all = rig.registry.services(BASE, &everything);
        all.into_iter().map(|service| service.ser_name).collect::<Vec<_>>()
    };
    assert_eq!(names(&rig), ["location", "map"]);
    assert_eq!(rig.registry.services_of(BASE, "planner", &everything).unwrap().len(), 1);
    assert_eq!(rig.registry.services_of(BASE, "navigation", &everything).unwrap(), []);
    assert!(rig.registry.service_of(BASE, "navigation", &id).is_err());
    let now = rig.world.at();
    assert!(rig.registry.deregister(now, ("navigation", &id), None).is_err());
    // A robot's driver is no application.
    for nobody in ["nobody", "robot-driver"] {
        let unknown = rig.register(nobody, &service("map", "ACTIVE")).unwrap_err();
        assert!(matches!(unknown, RequestError::NotFound { .. }), "{unknown}");
    }
    rig.world.remove("planner");
    rig.sent();
    assert_eq!(names(&rig), ["location"]);
}

#[test]
fn queries_select_services() {
    let mut rig = Rig::new();
    rig.register("planner", &service("map", "ACTIVE")).unwrap();
    let mut remote = service("fleet", "INACTIVE");
    remote["scopeOfLocality"] = json!("MEC_SYSTEM");
    remote["consumedLocalOnly"] = json!(false);
    rig.register("navigation", &remote).unwrap();
    for (parameters, expected) in [
        (&[("ser_name", "map"), ("ser_name", "fleet")][..], &["map", "fleet"][..]),
        (&[("ser_instance_id", "location")], &["location"]),
        (&[("ser_category_id", "maps")], &["map", "fleet"]),
        (&[("scope_of_locality", "MEC_SYSTEM")], &["fleet"]),
        (&[("consumed_local_only", "true")], &["location", "map"]),
        (&[("is_local", "false")], &[]),
    ] {
        let found = rig.registry.services(BASE, &query(parameters).unwrap());
        let names: Vec<_> = found.iter().map(|service| &*service.ser_name).collect();
        assert_eq!(names, expected, "{parameters:?}");
    }
    for (wrong, reason) in [
        (&[("instance_id", "5")][..], "no parameter `instance_id`"),
        (&[("is_local", "yes")], "true or false"),
        (&[("is_local", "true"), ("is_local", "true")], "twice"),
        (&[("ser_name", "a"), ("ser_category_id", "b")], "exclude each other"),
    ] {
        let refused = query(wrong).unwrap_err();
        assert!(refused.contains(reason), "{refused}");
    }
}

#[test]
fn changes_of_services_are_notified_by_their_kind() {
    let mut rig = Rig::new();
    rig.register("planner", &service("old", "ACTIVE")).unwrap();
    let made = rig.subscribe("navigation", &json!({})).unwrap();
    conforming(&made.value, "SerAvailabilityNotificationSubscription");
    rig.subscribe("planner", &json!({ "filteringCriteria": { "states": ["SUSPENDED"] } })).unwrap();
    assert_eq!(rig.sent(), [json!(null); 0], "services that there are already are no change");
    let made = rig.register("planner", &service("map", "ACTIVE")).unwrap();
    let id = made.value.ser_instance_id.unwrap();
    let mut told = Vec::new();
    let mut look = |rig: &mut Rig| {
        for notification in rig.sent() {
            let change = &notification["serviceReferences"][0];
            told.push((change["changeType"].as_str().unwrap().to_owned(), change["state"].clone()));
        }
    };
    look(&mut rig);
    let mut changed = service("map", "SUSPENDED");
    let etag = made.etag;
    for attribute in ["1", "2"] {
        changed["version"] = json!(attribute);
        let info = ServiceInfo::read(changed.to_string().as_bytes()).unwrap();
        let now = rig.world.at();
        rig.registry.update(now, BASE, ("planner", &id), None, info.clone()).unwrap();
        let stale = rig.registry.update(now, BASE, ("planner", &id), Some(&etag), info);
        assert!(matches!(stale, Err(RequestError::Changed(_))), "{stale:?}");
        look(&mut rig);
    }
    rig.world.remove("planner");
    look(&mut rig);
    let state = |name: &str| json!(name);
    let expected = [
        ("ADDED", state("ACTIVE")),
        // Both subscribers want these.
        ("STATE_CHANGED", state("SUSPENDED")),
        ("STATE_CHANGED", state("SUSPENDED")),
        ("ATTRIBUTES_CHANGED", state("SUSPENDED")),
        ("ATTRIBUTES_CHANGED", state("SUSPENDED")),
        ("REMOVED", state("INACTIVE")),
    ];
    assert_eq!(told, expected.map(|(change, state)| (change.to_owned(), state)));
}

#[test]
fn invalid_services_and_subscriptions_are_rejected_with_a_reason() {
    let mut rig = Rig::new();
    type Change = fn(&mut Value);
    let changes: [(Change, &str); 4] = [
        (|s| drop(s.as_object_mut().unwrap().remove("serName")), "missing field `serName`"),
        (|s| s["transportId"] = json!("bus"), "no transports"),
        (|s| drop(s.as_object_mut().unwrap().remove("transportInfo")), "transportInfo is needed"),
        (|s| s["state"] = json!("BUSY"), "state: unknown variant `BUSY`"),
    ];
    for (change, reason) in changes {
        let mut wrong = service("map", "ACTIVE");
        change(&mut wrong);
        let refused = rig.register("planner", &wrong).unwrap_err().to_string();
        assert!(refused.contains(reason), "{refused}");
    }
    for (more, reason) in [
        (json!({ "subscriptionType": "Other" }), "subscriptionType must be"),
        (json!({ "callbackReference": null }), "is needed"),
        (
            json!({ "filteringCriteria": { "serNames": ["a"], "serInstanceIds": ["b"] } }),
            "exclude each other",
        ),
    ] {
        let refused = rig.subscribe("planner", &more).unwrap_err().to_string();
        assert!(refused.contains(reason), "{refused}");
    }
    assert!(matches!(rig.subscribe("nobody", &json!({})), Err(RequestError::NotFound { .. })));
}

#[test]
fn subscriptions_are_listed_by_their_application() {
    let mut rig = Rig::new();
    let made = rig.subscribe("planner", &json!({})).unwrap();
    let id = made.href.rsplit('/').next().unwrap().to_owned();
    assert_eq!(made.href, format!("{BASE}/applications/planner/subscriptions/{id}"));
    let links = conforming(&rig.registry.links(BASE, "planner").unwrap(), "SubscriptionLinkList");
    assert_eq!(links["_links"]["subscriptions"][0]["href"], made.href);
    let others = rig.registry.links(BASE, "navigation").unwrap();
    assert_eq!(others["_links"]["subscriptions"], json!([]));
    assert!(rig.registry.links(BASE, "nobody").is_err());
    let subscriptions = rig.registry.subscriptions();
    assert!(subscriptions.get(BASE, &subscriptions_of("navigation"), &id).is_err());
    assert!(subscriptions.get(BASE, &subscriptions_of("planner"), &id).is_ok());
}
