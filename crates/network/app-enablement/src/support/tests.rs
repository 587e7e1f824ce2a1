//! Tests the support of applications in virtual time, and compares each answer with ETSI's schemas.

use cotorra_mec::{Subscribed as _, conformance::Published};

use super::*;
use crate::testing::{EPOCH, World};

const PUBLISHED: Published = Published {
    schemas: include_str!("../../tests/etsi/mec011-app-support-3.1.1.schemas.json"),
    beside: &[],
};

const BASE: &str = "http://mec.lab/domains/local/mec_app_support/v1";

fn rig() -> (Support, World) {
    let world = World::new();
    let mut support = Support::new(Arc::clone(&world.site), EPOCH);
    support.observe(world.survey());
    (support, world)
}

fn confirm(
    support: &mut Support,
    application: &str,
    what: Confirmation,
    body: &Value,
) -> Result<(), RequestError> {
    support.confirm(Timestamp::from_secs_f64(3.0), application, what, body.to_string().as_bytes())
}

#[test]
fn readiness_is_confirmed_and_lost_with_the_application() {
    let (mut support, mut world) = rig();
    let ready_since = |support: &Support| {
        let mut all = support.readiness();
        all.find(|(application, _)| **application == *"planner").map(|(_, since)| since)
    };
    let ready = json!({ "indication": "READY" });
    assert_eq!(ready_since(&support), Some(None));
    confirm(&mut support, "planner", Confirmation::Ready, &ready).unwrap();
    assert_eq!(ready_since(&support), Some(Some(Timestamp::from_secs_f64(3.0))));
    let unknown = confirm(&mut support, "nobody", Confirmation::Ready, &ready);
    assert!(matches!(unknown, Err(RequestError::NotFound { .. })));
    let other = confirm(&mut support, "planner", Confirmation::Ready, &json!({ "indication": "BUSY" }));
    assert!(matches!(other, Err(RequestError::Invalid(_))));
    world.remove("planner");
    support.observe(world.survey());
    assert_eq!(ready_since(&support), None);
    // One of the same name starts anew.
    world.serve("planner", "edge");
    support.observe(world.survey());
    assert_eq!(ready_since(&support), Some(None));
}

#[test]
fn the_end_of_an_application_is_notified_once_and_confirmed_after_that() {
    let (mut support, mut world) = rig();
    let body = json!({
        "subscriptionType": "AppTerminationNotificationSubscription", "callbackReference": "http://127.0.0.1:9/",
        "appInstanceId": "planner",
    });
    let read = |application: &str| {
        TerminationSubscription::read(&subscriptions_of(application), body.to_string().as_bytes()).unwrap()
    };
    let made = support.subscribe(world.at(), BASE, read("planner")).unwrap();
    let value = json!(made.value);
    assert_eq!(PUBLISHED.differences(&value, "AppTerminationNotificationSubscription"), [""; 0]);
    assert!(support.subscribe(world.at(), BASE, read("navigation")).is_err(), "it is of another application");
    let links = support.links(BASE, "planner").unwrap();
    assert_eq!(PUBLISHED.differences(&links, "SubscriptionLinkList"), [""; 0]);
    let terminating = json!({ "operationAction": "TERMINATING" });
    let early = confirm(&mut support, "planner", Confirmation::Termination, &terminating);
    assert!(matches!(early, Err(RequestError::State(_))), "{early:?}");
    assert_eq!(world.sent(&mut support), [json!(null); 0]);
    world.remove("planner");
    let sent = world.sent(&mut support);
    assert_eq!(sent.len(), 1);
    assert_eq!(PUBLISHED.differences(&sent[0], "AppTerminationNotification"), [""; 0]);
    let confirmation = &sent[0]["_links"]["confirmTermination"]["href"];
    assert_eq!(confirmation, &json!(format!("{BASE}/applications/planner/confirm_termination")));
    assert_eq!(world.sent(&mut support), [json!(null); 0]);
    confirm(&mut support, "planner", Confirmation::Termination, &terminating).unwrap();
    let unknown = confirm(&mut support, "nobody", Confirmation::Termination, &terminating);
    assert!(matches!(unknown, Err(RequestError::NotFound { .. })));
}

#[test]
fn times_are_those_of_the_run() {
    let (support, _) = rig();
    let now = Timestamp::from_secs_f64(1.5);
    let time = support.current_time(now);
    assert_eq!((&time["seconds"], &time["nanoSeconds"]), (&json!(1001), &json!(500_000_000)));
    // The published file has a placeholder in place of the values that the standard's text permits, …
    let differences = PUBLISHED.differences(&time, "CurrentTime");
    assert_eq!(differences, ["CurrentTime.timeSourceStatus is \"NONTRACEABLE\""]);
    // … and an array of arrays in place of a time.
    let differences = PUBLISHED.differences(&support.timing_caps(now), "TimingCaps");
    assert_eq!(differences[0], "TimingCaps.timeStamp is no \"array\"");
}

#[test]
fn applications_are_registered_by_the_testbed_and_have_no_rules() {
    let (support, _) = rig();
    let info = support.registration("planner").unwrap();
    assert_eq!(PUBLISHED.differences(&info, "AppInfo"), [""; 0]);
    assert!(support.registration("nobody").is_err());
    assert!(support.register().to_string().contains("the VNFs of the testbed"));
    assert!(support.rules("planner").unwrap().is_empty());
    assert!(matches!(support.rules("nobody"), Err(RequestError::NotFound { .. })));
    let missing = support.rule("planner", Rules::Dns, "1").unwrap_err().to_string();
    assert_eq!(missing, "there is no DNS rule `1`");
}

#[test]
fn the_last_applications_that_ended_are_remembered() {
    let names: Vec<_> = (0..MOST + 40).map(|number| format!("v{number}")).collect();
    let mut testbed = cotorra_graph_testing::applications(["home", "home"]);
    let more = names.iter().map(|name| cotorra_graph_testing::vnf(name, "edge"));
    testbed.services[0].vnfs.extend(more);
    let mut world = World::of(&testbed);
    let mut support = Support::new(Arc::clone(&world.site), EPOCH);
    let terminating = json!({ "operationAction": "TERMINATING" });
    for name in &names {
        world.serve(name, "edge");
        support.observe(world.survey());
        world.remove(name);
        support.observe(world.survey());
    }
    assert_eq!(support.ended.len(), MOST);
    let confirm =
        |support: &mut Support, name: &str| confirm(support, name, Confirmation::Termination, &terminating);
    assert!(confirm(&mut support, names.last().unwrap()).is_ok());
    assert!(matches!(confirm(&mut support, &names[0]), Err(RequestError::NotFound { .. })));
}
