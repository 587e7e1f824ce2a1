use serde_json::json;

use super::*;
use crate::{fog05, mec};

fn descriptor(id: &str) -> Descriptor {
    let fdu = json!({
        "id": id, "name": id, "hypervisor": "DOCKER", "migration_kind": "COLD",
        "computation_requirements": { "cpu_min_count": 1, "ram_size_mb": 64.0 }, "image": { "uri": "a:1" },
    });
    Descriptor::read(fdu.to_string().as_bytes()).unwrap()
}

fn node(name: &str) -> NodeId {
    name.parse().unwrap()
}

/// An instance of `a` on the edge.
fn defined() -> (Applications, String) {
    let mut all = Applications::default();
    let fdu = all.onboard(None, descriptor("a")).unwrap();
    let id = all.define(None, &fdu, Some(node("edge")), [None, None]).unwrap().id.clone();
    (all, id)
}

fn status(all: &Applications, id: &str) -> &'static str {
    fog05::status(all.instance(None, id).unwrap(), &Seen::Serves)
}

#[test]
fn an_instance_goes_through_all_stages_and_back() {
    let (mut all, id) = defined();
    assert_eq!(status(&all, &id), "DEFINE");
    all.configure(None, &id).unwrap();
    assert_eq!(status(&all, &id), "CONFIGURE");
    let vnf = all.begin_start(None, &id, "A=1").unwrap();
    assert_eq!((vnf.node.only(), vnf.env.as_slice()), (Some(&node("edge")), &["A=1".to_owned()][..]));
    all.end_start(&id, Some(vnf.id.clone()));
    assert_eq!(status(&all, &id), "RUN");
    assert_eq!(all.begin_move(None, &id).unwrap(), vnf.id);
    all.end_move(&id, Some(node("fog")));
    assert_eq!(all.begin_stop(None, &id).unwrap(), vnf.id);
    all.end_stop(&id, true);
    // The next start has another name, because the last VNF still drains.
    let again = all.begin_start(None, &id, "").unwrap();
    assert_ne!(again.id, vnf.id);
    assert_eq!(again.node.only(), Some(&node("fog")));
    all.end_start(&id, None);
    assert_eq!(status(&all, &id), "CONFIGURE", "the testbed rejected the VNF");
    all.clean(None, &id).unwrap();
    all.undefine(None, &id).unwrap();
    assert_eq!(all.offload(None, "a").unwrap(), all.made_first());
    assert_eq!(all.catalog(None).count(), 0);
}

impl Applications {
    fn made_first(&self) -> String {
        "c0704a00-0000-4000-8000-000000000001".to_owned()
    }
}

#[test]
fn steps_out_of_order_are_rejected_and_change_nothing() {
    let (mut all, id) = defined();
    let text = |result: Result<(), LifecycleError>| result.unwrap_err().to_string();
    assert!(text(all.clean(None, &id)).contains("not configured"));
    assert!(all.begin_start(None, &id, "").unwrap_err().to_string().contains("not configured"));
    assert!(all.begin_stop(None, &id).unwrap_err().to_string().contains("does not run"));
    assert!(all.offload(None, "a").unwrap_err().to_string().contains("remove that first"));
    all.configure(None, &id).unwrap();
    assert!(text(all.configure(None, &id)).contains("already"));
    assert!(text(all.undefine(None, &id)).contains("clean it first"));
    assert!(all.begin_start(None, &id, "PATH").unwrap_err().to_string().contains("`PATH` is no variable"));
    all.begin_start(None, &id, "").unwrap();
    for busy in [all.clean(None, &id), all.undefine(None, &id), all.begin_start(None, &id, "").map(drop)] {
        assert!(text(busy).contains("under way"));
    }
    assert_eq!(
        all.define(None, "b", None, [None, None]),
        Err(LifecycleError::Unknown("descriptor", "b".to_owned()))
    );
    assert_eq!(text(all.configure(None, "x")), "there is no instance `x`");
}

#[test]
fn a_domain_sees_its_own_only() {
    let [one, two]: [DomainId; 2] = ["one", "two"].map(|name| name.parse().unwrap());
    let mut all = Applications::default();
    let fdu = all.onboard(Some(&one), descriptor("a")).unwrap();
    let id = all.define(Some(&one), &fdu, Some(node("edge")), [None, None]).unwrap().id.clone();
    assert!(all.descriptor(Some(&two), &fdu).is_err() && all.instance(Some(&two), &id).is_err());
    assert!(all.configure(Some(&two), &id).is_err());
    assert_eq!((all.catalog(Some(&two)).count(), all.instances(Some(&two)).count()), (0, 0));
    assert_eq!((all.catalog(None).count(), all.instances(None).count()), (1, 1));
}

#[test]
fn catalog_and_instances_are_bounded() {
    let mut all = Applications::default();
    for _ in 0..MOST_DESCRIPTORS {
        all.onboard(None, descriptor("a")).unwrap();
    }
    assert!(matches!(all.onboard(None, descriptor("a")), Err(LifecycleError::Conflict(_))));
    // Its own name does not tell which one is meant.
    assert!(all.descriptor(None, "a").is_err());
    let first = all.made_first();
    for _ in 0..MOST_INSTANCES {
        all.define(None, &first, None, [None, None]).unwrap();
    }
    assert!(all.define(None, &first, None, [None, None]).is_err());
}

#[test]
fn mec_instantiates_operates_and_terminates() {
    let mut all = Applications::default();
    all.onboard(None, descriptor("a")).unwrap();
    let create = mec::read(br#"{ "appDId": "a", "appInstanceName": "first" }"#).unwrap();
    let id = all.create(None, create).unwrap();
    let document = |all: &Applications| {
        let instance = all.instance(None, &id).unwrap();
        let of = all.descriptor(None, &instance.descriptor).unwrap().1;
        let document = mec::instance(instance, of, "/app_lcm/v1");
        (document["instantiationState"].clone(), document["instantiatedAppState"]["operationalState"].clone())
    };
    assert_eq!(document(&all), (json!("NOT_INSTANTIATED"), json!(null)));
    // A rejected VNF leaves it as it was.
    let begun = all.instantiate(None, &id, node("edge"), 5).unwrap();
    assert_eq!(begun.task, mec::Task::Start);
    all.begin_start(None, &id, "").unwrap();
    all.end_start(&id, None);
    all.end(&id, begun, false, 6);
    assert_eq!(document(&all).0, "NOT_INSTANTIATED");

    let begun = all.instantiate(None, &id, node("edge"), 7).unwrap();
    let vnf = all.begin_start(None, &id, "").unwrap();
    all.end_start(&id, Some(vnf.id));
    all.end(&id, begun, true, 8);
    assert_eq!(document(&all), (json!("INSTANTIATED"), json!("STARTED")));
    let stop =
        mec::read(br#"{ "changeStateTo": "STOPPED", "stopType": "GRACEFUL", "gracefulStopTimeout": 1 }"#);
    let begun = all.operate(None, &id, &stop.unwrap(), 9).unwrap();
    assert_eq!(begun.task, mec::Task::Stop);
    all.begin_stop(None, &id).unwrap();
    all.end_stop(&id, true);
    all.end(&id, begun, true, 10);
    assert_eq!(document(&all), (json!("INSTANTIATED"), json!("STOPPED")));
    let begun =
        all.terminate(None, &id, &mec::read(br#"{ "terminationType": "FORCEFUL" }"#).unwrap(), 11).unwrap();
    assert_eq!(begun.task, mec::Task::Nothing);
    all.end(&id, begun, true, 2_000_000_012);
    assert_eq!(document(&all).0, "NOT_INSTANTIATED");
    let occurrences = all.occurrence_documents(None, "");
    let states: Vec<_> = occurrences.iter().map(|one| one["operationState"].as_str().unwrap()).collect();
    assert_eq!(states, ["FAILED", "COMPLETED", "COMPLETED", "COMPLETED"]);
    assert_eq!(occurrences[3]["stateEnteredTime"], json!({ "seconds": 2, "nanoSeconds": 12 }));
    let number = occurrences[3]["id"].as_str().unwrap();
    assert_eq!(all.occurrence_document(None, number, "").unwrap(), occurrences[3]);
}

#[test]
fn invalid_mec_requests_name_the_mistake() {
    let node = |body: serde_json::Value| {
        let request: mec::InstantiateRequest = mec::read(body.to_string().as_bytes())?;
        request.node()
    };
    assert_eq!(
        node(json!({ "selectedMECHostInfo": [{ "hostName": "edge", "hostId": {} }] })).unwrap(),
        "edge"
    );
    assert_eq!(node(json!({ "selectedMECHostInfo": [{ "hostId": { "node": "fog" } }] })).unwrap(), "fog");
    for (body, named) in [
        (json!({}), "selectedMECHostInfo"),
        (json!({ "selectedMECHostInfo": [] }), "one host"),
        (json!({ "selectedMECHostInfo": [{ "hostId": {} }] }), "hostName"),
        (json!({ "selectedMECHostInfo": [{ "hostId": "a b" }] }), "not a name"),
        (
            json!({ "selectedMECHostInfo": [{ "hostId": "a" }], "locationConstraints": { "countryCode": "ES" } }),
            "locationConstraints",
        ),
    ] {
        let error = node(body).unwrap_err().to_string();
        assert!(error.contains(named), "{error}");
    }
    let (mut all, id) = defined();
    let operate = |all: &mut Applications, body: &str| {
        all.operate(None, &id, &mec::read(body.as_bytes())?, 0).map(drop)
    };
    for (body, named) in [
        (r#"{ "changeStateTo": "PAUSED" }"#, "PAUSED"),
        (r#"{ "changeStateTo": "STARTED", "stopType": "FORCEFUL" }"#, "stopType"),
        (r#"{ "changeStateTo": "STOPPED", "stopType": "GRACEFUL" }"#, "gracefulStopTimeout"),
        (r#"{ "changeStateTo": "STOPPED" }"#, "not instantiated"),
    ] {
        let error = operate(&mut all, body).unwrap_err().to_string();
        assert!(error.contains(named), "{error}");
    }
}
