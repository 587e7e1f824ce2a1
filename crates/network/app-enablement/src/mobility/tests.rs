//! Tests announcements of migrations in virtual time, and compares each answer with ETSI's schemas.

use cotorra_mec::{Subscribed as _, conformance::Published};
use serde_json::json;

use super::*;
use crate::testing::{EPOCH, World};

const PUBLISHED: Published =
    Published { schemas: include_str!("../../tests/etsi/mec021-2.2.1.schemas.json"), beside: &[] };

const BASE: &str = "http://mec.lab/domains/local/amsi/v1";

fn rig() -> (Mobility, World) {
    let world = World::new();
    let mut mobility = Mobility::new(Arc::clone(&world.site), EPOCH);
    mobility.observe(world.survey());
    (mobility, world)
}

fn subscribe(
    mobility: &mut Mobility,
    criteria: &Value,
) -> Result<Resource<MobilitySubscription>, RequestError> {
    let body = json!({
        "subscriptionType": "MobilityProcedureSubscription", "callbackReference": "http://127.0.0.1:9/",
        "filterCriteria": criteria,
    });
    let subscription = MobilitySubscription::read(SUBSCRIPTIONS, body.to_string().as_bytes())?;
    mobility.subscribe(Timestamp::ZERO, BASE, subscription)
}

/// Status and address of the targets of notifications that conform to the published file but for the type of devices'
/// identifiers, which the file takes for strings.
fn steps(sent: &[Value]) -> Vec<(u64, String)> {
    let step = |notification: &Value| {
        let mut as_published = notification.clone();
        let device = std::mem::replace(&mut as_published["associateId"][0], json!("10.77.0.1"));
        assert_eq!(device, json!({ "type": "UE_IPv4_ADDRESS", "value": "10.77.0.1" }));
        assert_eq!(PUBLISHED.differences(&as_published, "MobilityProcedureNotification"), [""; 0]);
        let target = &notification["targetAppInfo"]["commInterface"]["ipAddresses"][0];
        (
            notification["mobilityStatus"].as_u64().unwrap(),
            format!("{}:{}", target["host"].as_str().unwrap(), target["port"]),
        )
    };
    sent.iter().map(step).collect()
}

#[test]
fn the_target_of_a_migration_is_announced_before_it_happens() {
    let (mut mobility, mut world) = rig();
    let criteria = json!({ "appInstanceId": "navigation", "mobilityStatus": [1, 2, 3] });
    let made = subscribe(&mut mobility, &criteria).unwrap();
    assert_eq!(PUBLISHED.differences(&json!(made.value), "MobilityProcedureSubscription"), [""; 0]);
    assert_eq!(world.sent(&mut mobility), [json!(null); 0]);
    world.now = 10.0;
    world.place("navigation", "edge");
    let sent = world.sent(&mut mobility);
    assert_eq!(steps(&sent), [(1, "10.77.0.3:5000".to_owned())]);
    assert_eq!(sent[0]["timeStamp"]["seconds"], 1010);
    assert_eq!(world.sent(&mut mobility), [json!(null); 0], "once");
    world.now = 12.0;
    world.serve("navigation", "edge");
    assert_eq!(steps(&world.sent(&mut mobility)), [(2, "10.77.0.3:5000".to_owned())]);
    // One that is called off has failed.
    world.place("navigation", "cloud");
    assert_eq!(steps(&world.sent(&mut mobility)), [(1, "10.77.0.4:5000".to_owned())]);
    world.place("navigation", "edge");
    assert_eq!(steps(&world.sent(&mut mobility)), [(3, "10.77.0.4:5000".to_owned())]);
}

#[test]
fn a_migration_between_two_looks_is_announced_with_its_end() {
    let (mut mobility, mut world) = rig();
    subscribe(&mut mobility, &json!({ "mobilityStatus": [1, 2] })).unwrap();
    world.place("navigation", "edge");
    world.serve("navigation", "edge");
    let steps = steps(&world.sent(&mut mobility));
    assert_eq!(steps.iter().map(|(status, _)| *status).collect::<Vec<_>>(), [1, 2]);
}

#[test]
fn migrations_are_selected_by_application_device_and_status() {
    let (mut mobility, mut world) = rig();
    let device = |value: &str| json!({ "associateId": [{ "type": "UE_IPv4_ADDRESS", "value": value }] });
    for criteria in
        [json!({}), json!({ "appInstanceId": "planner" }), device("10.77.0.1"), device("10.77.0.9")]
    {
        let made = subscribe(&mut mobility, &criteria).unwrap();
        assert_eq!(
            json!(made.value)["filterCriteria"]["mobilityStatus"],
            json!([1]),
            "the standard's default"
        );
    }
    world.place("navigation", "edge");
    assert_eq!(world.sent(&mut mobility).len(), 2);
    assert_eq!(mobility.links(BASE)["_links"]["subscription"].as_array().unwrap().len(), 4);
    assert_eq!(PUBLISHED.differences(&mobility.links(BASE), "SubscriptionLinkList"), [""; 0]);
    let unknown = subscribe(&mut mobility, &json!({ "appInstanceId": "nobody" }));
    assert!(matches!(unknown, Err(RequestError::NotFound { .. })));
    assert!(subscribe(&mut mobility, &json!({ "mobilityStatus": [4] })).is_err());
}

#[test]
fn registrations_need_an_application_and_end_with_it() {
    let (mut mobility, mut world) = rig();
    let read = |body: Value| RegistrationInfo::read(body.to_string().as_bytes());
    let body = json!({ "serviceConsumerId": { "appInstanceId": "planner" } });
    let made = mobility.register(world.at(), BASE, read(body.clone()).unwrap()).unwrap();
    assert_eq!(PUBLISHED.differences(&json!(made.value), "RegistrationInfo"), [""; 0]);
    let id = made.href.rsplit('/').next().unwrap();
    let changed =
        mobility.update(world.at(), BASE, id, Some(&made.etag), read(body.clone()).unwrap()).unwrap();
    let stale = mobility.deregister(world.at(), id, Some(&made.etag));
    assert_eq!(stale, Err(RequestError::Changed(changed.etag)));
    for wrong in [
        json!({ "serviceConsumerId": { "mepId": "x" } }),
        json!({ "serviceConsumerId": { "appInstanceId": "planner" }, "expiryTime": 5 }),
    ] {
        assert!(read(wrong).is_err());
    }
    let nobody = read(json!({ "serviceConsumerId": { "appInstanceId": "nobody" } })).unwrap();
    assert!(mobility.register(world.at(), BASE, nobody).is_err());
    world.remove("planner");
    world.sent(&mut mobility);
    assert!(mobility.registrations().is_empty());
}
