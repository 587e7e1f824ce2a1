use proptest::prelude::*;
use serde_json::{Value, json};

use super::*;
use crate::{
    fog05,
    mec::{self, OperationRequest},
};

const NOW: Timestamp = Timestamp::ZERO;

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

/// Returns the VNF that an instruction adds.
fn added(instruction: Instruction) -> cotorra_graph::Vnf {
    let Instruction::AddVnf { vnf } = instruction else { panic!("{instruction:?}") };
    *vnf
}

fn status(all: &Applications, id: &str) -> &'static str {
    fog05::status(all.instance(None, id).unwrap())
}

#[test]
fn an_instance_goes_through_all_stages_and_back() {
    let (mut all, id) = defined();
    assert_eq!(status(&all, &id), "DEFINE");
    all.configure(None, &id, NOW).unwrap();
    assert_eq!(status(&all, &id), "CONFIGURE");
    let vnf = added(all.begin_start(None, &id, "A=1").unwrap());
    assert_eq!((vnf.node.only(), vnf.env.as_slice()), (Some(&node("edge")), &["A=1".to_owned()][..]));
    all.end_start(&id, Some((vnf.id.clone(), 0)), NOW);
    assert_eq!(status(&all, &id), "CONFIGURE");
    for (seen, expected) in [
        (Seen::Serves, "RUN"),
        (Seen::Restarts, "RUN"),
        (Seen::Failed("why".to_owned()), "ERROR"),
        (Seen::Gone, "ERROR"),
        (Seen::Serves, "RUN"),
    ] {
        all.observe(&vnf.id, None, &seen, NOW);
        assert_eq!(status(&all, &id), expected);
    }
    let fog = Nodes::from(node("fog"));
    let place = Instruction::Place { vnf: vnf.id.clone(), node: fog.clone() };
    assert_eq!(all.begin_move(None, &id, node("fog")).unwrap(), place);
    all.end_move(&id);
    all.observe_nodes(&vnf.id, fog.all(), &fog, NOW);
    let remove = Instruction::RemoveVnf { vnf: vnf.id.clone() };
    assert_eq!(all.begin_stop(None, &id).unwrap(), Some(remove));
    all.end_stop(&id, Some(0), NOW);
    // The next start has another name, because the last VNF still drains.
    let again = added(all.begin_start(None, &id, "").unwrap());
    assert_ne!(again.id, vnf.id);
    assert_eq!(again.node.only(), Some(&node("fog")));
    all.end_start(&id, None, NOW);
    assert_eq!(status(&all, &id), "CONFIGURE", "the testbed rejected the VNF");
    all.clean(None, &id, NOW).unwrap();
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
fn the_output_is_that_of_the_last_start() {
    let (mut all, id) = defined();
    let none = |all: &Applications| all.output(None, &id).unwrap_err().to_string();
    all.configure(None, &id, NOW).unwrap();
    assert!(none(&all).contains("has no output"), "{}", none(&all));
    let vnf = added(all.begin_start(None, &id, "").unwrap()).id;
    all.end_start(&id, Some((vnf.clone(), 7)), NOW);
    assert_eq!(all.output(None, &id), Ok(&Output { vnf: vnf.clone(), from: 7, to: None }));
    // The testbed has removed it before the stop ends.
    all.begin_stop(None, &id).unwrap();
    all.observe(&vnf, None, &Seen::Gone, NOW);
    all.end_stop(&id, Some(20), NOW);
    assert_eq!(all.output(None, &id), Ok(&Output { vnf, from: 7, to: Some(20) }));
    assert!(all.output(Some(&"one".parse().unwrap()), &id).is_err(), "it is the operator's");
    all.clean(None, &id, NOW).unwrap();
    assert!(none(&all).contains("has no output"));
    all.configure(None, &id, NOW).unwrap();
    let vnf = added(all.begin_start(None, &id, "").unwrap()).id;
    all.end_start(&id, Some((vnf.clone(), 0)), NOW);
    all.observe(&vnf, None, &Seen::Gone, NOW);
    assert!(none(&all).contains("others removed its VNF"), "{}", none(&all));
}

#[test]
fn steps_out_of_order_are_rejected_and_change_nothing() {
    let (mut all, id) = defined();
    let text = |result: Result<(), LifecycleError>| result.unwrap_err().to_string();
    assert!(text(all.clean(None, &id, NOW)).contains("not configured"));
    assert!(all.begin_start(None, &id, "").unwrap_err().to_string().contains("not configured"));
    assert!(all.begin_stop(None, &id).unwrap_err().to_string().contains("does not run"));
    assert!(all.offload(None, "a").unwrap_err().to_string().contains("remove that first"));
    all.configure(None, &id, NOW).unwrap();
    assert!(text(all.configure(None, &id, NOW)).contains("already"));
    assert!(text(all.undefine(None, &id)).contains("clean it first"));
    assert!(all.begin_start(None, &id, "PATH").unwrap_err().to_string().contains("`PATH` is no variable"));
    all.begin_start(None, &id, "").unwrap();
    for busy in [all.clean(None, &id, NOW), all.undefine(None, &id), all.begin_start(None, &id, "").map(drop)]
    {
        assert!(text(busy).contains("under way"));
    }
    assert_eq!(
        all.define(None, "b", None, [None, None]),
        Err(LifecycleError::Unknown("descriptor", "b".to_owned()))
    );
    assert_eq!(text(all.configure(None, "x", NOW)), "there is no instance `x`");
}

#[test]
fn a_domain_sees_its_own_only() {
    let [one, two]: [DomainId; 2] = ["one", "two"].map(|name| name.parse().unwrap());
    let mut all = Applications::default();
    let fdu = all.onboard(Some(&one), descriptor("a")).unwrap();
    let id = all.define(Some(&one), &fdu, Some(node("edge")), [None, None]).unwrap().id.clone();
    assert!(all.descriptor(Some(&two), &fdu).is_err() && all.instance(Some(&two), &id).is_err());
    assert!(all.configure(Some(&two), &id, NOW).is_err());
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
    // Its own name is ambiguous.
    assert!(all.descriptor(None, "a").is_err());
    let first = all.made_first();
    for _ in 0..MOST_INSTANCES {
        all.define(None, &first, None, [None, None]).unwrap();
    }
    assert!(all.define(None, &first, None, [None, None]).is_err());
}

#[test]
fn no_domain_takes_the_places_of_another_or_of_the_operator() {
    let [one, two]: [DomainId; 2] = ["one", "two"].map(|name| name.parse().unwrap());
    let mut all = Applications::default();
    for owner in [Some(&one), Some(&two), None] {
        let most = |most| share(owner, most);
        let onboarded: Vec<_> = (0..1000).map_while(|_| all.onboard(owner, descriptor("a")).ok()).collect();
        assert_eq!(onboarded.len(), most(MOST_DESCRIPTORS), "{owner:?}");
        let fdu = &onboarded[0];
        let mut define = || Some(all.define(owner, fdu, None, [None, None]).ok()?.id.clone());
        let defined: Vec<_> = (0..1000).map_while(|_| define()).collect();
        assert_eq!(defined.len(), most(MOST_INSTANCES), "{owner:?}");
        for _ in 0..3000 {
            all.record(&defined[0], Operation::Operate, NOW);
        }
        let subscription = br#"{"subscriptionType":"AppInstanceStateChange","callbackUri":"http://lab:1/a"}"#;
        let subscribe = |n: u32| {
            let subscription = crate::Subscription::read(subscription).unwrap();
            all.subscriptions.add(owner, BASE, subscription, Timestamp::from_secs_f64(f64::from(n))).is_ok()
        };
        assert_eq!((0..1000).map(subscribe).filter(|is_added| *is_added).count(), most(256), "{owner:?}");
    }
    let of = |owner| all.occurrences.values().filter(|(of, _)| of.as_ref() == owner).count();
    assert_eq!([of(Some(&one)), of(Some(&two)), of(None)], [256, 256, 1024]);
}

/// The subscriber's service.
const BASE: &str = "http://lab:7700/app_lcm/v1";

fn read(operation: &str, body: &Value) -> Result<OperationRequest, LifecycleError> {
    OperationRequest::read(operation, body.to_string().as_bytes())
}

fn instantiate(node: &str) -> OperationRequest {
    read("instantiate", &json!({ "selectedMECHostInfo": [{ "hostName": node, "hostId": {} }] })).unwrap()
}

fn stop() -> OperationRequest {
    let request = json!({ "changeStateTo": "STOPPED", "stopType": "GRACEFUL", "gracefulStopTimeout": 1 });
    read("operate", &request).unwrap()
}

fn terminate() -> OperationRequest {
    read("terminate", &json!({ "terminationType": "FORCEFUL" })).unwrap()
}

/// An application instance, as MEC creates it.
fn created() -> (Applications, String) {
    let mut all = Applications::default();
    all.onboard(None, descriptor("a")).unwrap();
    let create = mec::read(br#"{ "appDId": "a", "appInstanceName": "first" }"#).unwrap();
    let id = all.create(None, create).unwrap();
    (all, id)
}

impl Applications {
    /// Carries out what was begun, as a testbed that accepts it or not.
    fn carry_out(&mut self, id: &str, begun: mec::Begun, accepts: bool, now: Timestamp) -> Option<VnfId> {
        let mut vnf = None;
        let is_done = match begun.task {
            mec::Task::Start => self.begin_start(None, id, "").is_ok_and(|instruction| {
                vnf = accepts.then_some(added(instruction).id);
                self.end_start(id, vnf.clone().map(|vnf| (vnf, 0)), now);
                accepts
            }),
            mec::Task::Stop => self.begin_stop(None, id).is_ok_and(|_| {
                self.end_stop(id, accepts.then_some(0), now);
                accepts
            }),
            mec::Task::Nothing => true,
        };
        self.end(id, begun, is_done, now);
        vnf
    }

    fn subscribe(&mut self, viewer: Option<&DomainId>, request: &Value) -> Result<String, LifecycleError> {
        let subscription = crate::Subscription::read(request.to_string().as_bytes())?;
        let (_, document) = self.subscriptions().add(viewer, BASE, subscription, NOW)?;
        Ok(document["id"].as_str().unwrap().to_owned())
    }

    /// Delivers all notifications. Returns them, in the order of each subscription.
    fn deliver(&mut self) -> Vec<Value> {
        let mut told = Vec::new();
        loop {
            let dispatches = self.subscriptions().poll(NOW);
            if dispatches.is_empty() {
                return told;
            }
            for one in dispatches {
                told.push(serde_json::from_str(&one.body).unwrap());
                let delivered = cotorra_mec::Outcome::Delivered;
                self.subscriptions().done(one.subscription, one.attempt, delivered, NOW);
            }
        }
    }

    /// The state of an instance as its document shows it.
    fn shown(&self, id: &str) -> String {
        let instance = self.instance(None, id).unwrap();
        let (_, of) = self.descriptor(None, &instance.descriptor).unwrap();
        let document = mec::instance(instance, of, "/app_lcm/v1");
        let state = &document["instantiatedAppState"]["operationalState"];
        state.as_str().or(document["instantiationState"].as_str()).unwrap().to_owned()
    }
}

fn to(request: Value) -> Value {
    let mut whole = json!({ "callbackUri": "http://127.0.0.1:9/" });
    whole.as_object_mut().unwrap().extend(request.as_object().unwrap().clone());
    whole
}

fn kinds(notifications: &[Value]) -> Vec<&str> {
    notifications.iter().map(|one| one["notificationType"].as_str().unwrap()).collect()
}

#[test]
fn mec_instantiates_operates_and_terminates() {
    let (mut all, id) = created();
    assert_eq!(all.shown(&id), "NOT_INSTANTIATED");
    // A rejected VNF leaves it as it was.
    let begun = all.begin(None, &id, &instantiate("edge"), NOW).unwrap();
    assert_eq!(begun.task, mec::Task::Start);
    all.carry_out(&id, begun, false, NOW);
    assert_eq!(all.shown(&id), "NOT_INSTANTIATED");

    let begun = all.begin(None, &id, &instantiate("edge"), NOW).unwrap();
    let vnf = all.carry_out(&id, begun, true, NOW).unwrap();
    assert_eq!(all.shown(&id), "STOPPED", "its VNF does not serve yet");
    all.observe(&vnf, None, &Seen::Serves, NOW);
    assert_eq!(all.shown(&id), "STARTED");
    let begun = all.begin(None, &id, &stop(), NOW).unwrap();
    assert_eq!(begun.task, mec::Task::Stop);
    all.carry_out(&id, begun, true, NOW);
    assert_eq!(all.shown(&id), "STOPPED");
    let begun = all.begin(None, &id, &terminate(), NOW).unwrap();
    assert_eq!(begun.task, mec::Task::Nothing);
    all.carry_out(&id, begun, true, Timestamp::from_nanos(2_000_000_012));
    assert_eq!(all.shown(&id), "NOT_INSTANTIATED");
    let occurrences = all.occurrence_documents(None, "");
    let states: Vec<_> = occurrences.iter().map(|one| one["operationState"].as_str().unwrap()).collect();
    assert_eq!(states, ["FAILED", "COMPLETED", "COMPLETED", "COMPLETED"]);
    assert_eq!(occurrences[3]["stateEnteredTime"], json!({ "seconds": 2, "nanoSeconds": 12 }));
    let number = occurrences[3]["id"].as_str().unwrap();
    assert_eq!(all.occurrence_document(None, number, "").unwrap(), occurrences[3]);
}

#[test]
fn invalid_mec_requests_name_the_mistake() {
    let node = |body: Value| Ok(read("instantiate", &body)?.node().unwrap().to_string());
    let by_name = json!({ "selectedMECHostInfo": [{ "hostName": "edge", "hostId": {} }] });
    assert_eq!(node(by_name), Ok("edge".to_owned()));
    let by_id = json!({ "selectedMECHostInfo": [{ "hostId": { "node": "fog" } }] });
    assert_eq!(node(by_id), Ok("fog".to_owned()));
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
        let error: LifecycleError = node(body).unwrap_err();
        assert!(error.to_string().contains(named), "{error}");
    }
    let (mut all, id) = defined();
    for (operation, body, named) in [
        ("operate", json!({ "changeStateTo": "PAUSED" }), "PAUSED"),
        ("operate", json!({ "changeStateTo": "STARTED", "stopType": "FORCEFUL" }), "stopType"),
        ("operate", json!({ "changeStateTo": "STOPPED", "stopType": "GRACEFUL" }), "gracefulStopTimeout"),
        ("operate", json!({ "changeStateTo": "STOPPED" }), "not instantiated"),
        (
            "terminate",
            json!({ "terminationType": "FORCEFUL", "gracefulTerminationTimeout": 1 }),
            "gracefulTerminationTimeout",
        ),
        ("pause", json!({}), "no operation `pause`"),
    ] {
        let begun = read(operation, &body).and_then(|request| all.begin(None, &id, &request, NOW));
        let error = begun.unwrap_err().to_string();
        assert!(error.contains(named), "{error}");
    }
}

#[test]
fn subscribers_are_notified_of_what_they_filter_for() {
    let (mut all, id) = created();
    let one: DomainId = "one".parse().unwrap();
    let name = &all.descriptor(None, "a").unwrap().1.name.clone();
    let of_instances = |filter: Value| {
        to(json!({ "subscriptionType": "AppInstanceStateChange", "appInstanceSubscriptionFilter": filter }))
    };
    let states = to(json!({ "subscriptionType": "AppInstanceStateChange", "appInstanceState": ["STARTED"] }));
    let provider = json!({ "appProvider": "cotorra", "appProducts": { "appName": name,
        "versions": { "appSoftVersion": "1", "appDVersion": ["1"] } } });
    let operations = json!({ "operationStates": "COMPLETED", "operationTypes": ["INSTANTIATE"] });
    let operations = to(
        json!({ "subscriptionType": "AppLcmOpOccStateChange", "appLcmOpOccSubscriptionFilter": operations }),
    );
    let wanting = [
        of_instances(json!({ "appInstSelectorType": "VOID" })),
        of_instances(json!({ "appInstSelectorType": "APP_IDENTITY", "appInstances": [id] })),
        of_instances(json!({ "appInstSelectorType": "APP_NAME", "appInstances": ["b", name] })),
        of_instances(json!({ "appInstSelectorType": "APP_FROM_PROVIDER", "appsFromProviders": [provider] })),
    ];
    let wanting = wanting.map(|request| all.subscribe(None, &request).unwrap());
    let other = json!({ "appInstSelectorType": "APP_D_ID", "appInstances": ["b"] });
    let silent =
        [all.subscribe(None, &of_instances(other)).unwrap(), all.subscribe(Some(&one), &states).unwrap()];
    let started = all.subscribe(None, &states).unwrap();
    let completed = all.subscribe(None, &operations).unwrap();
    let begun = all.begin(None, &id, &instantiate("edge"), NOW).unwrap();
    let vnf = all.carry_out(&id, begun, true, NOW).unwrap();
    all.observe(&vnf, None, &Seen::Serves, NOW);
    all.observe(&vnf, None, &Seen::Restarts, NOW);
    all.observe(&vnf, None, &Seen::Serves, NOW);
    let told = all.deliver();
    let of = |subscription: &String| -> Vec<Value> {
        told.iter().filter(|one| one["subscriptionId"] == **subscription).cloned().collect()
    };
    for subscription in &wanting {
        assert_eq!(kinds(&of(subscription)), ["STOPPED", "STARTED", "STOPPED", "STARTED"]);
    }
    // All get the same change under the same identifier.
    assert_eq!(of(&wanting[0])[1]["id"], of(&wanting[3])[1]["id"]);
    silent.iter().for_each(|subscription| assert_eq!(of(subscription), Vec::<Value>::new()));
    assert_eq!(kinds(&of(&started)), ["STARTED", "STARTED"]);
    let [occurred] = &of(&completed)[..] else { panic!("{told:?}") };
    assert_eq!(
        (&occurred["notificationType"], &occurred["appInstanceId"], &occurred["appLcmOpOccId"]),
        (&json!("COMPLETED"), &json!(id), &json!(begun.number.to_string()))
    );
    let links = &occurred["_links"];
    assert_eq!(links["subscription"]["href"], format!("{BASE}/subscriptions/{completed}"));
    assert_eq!(links["appLcmOpOcc"]["href"], format!("{BASE}/app_lcm_op_occs/{}", begun.number));
    assert_eq!(links["appInstance"]["href"], format!("{BASE}/app_instances/{id}"));
}

#[test]
fn subscriptions_are_seen_by_their_callers_and_bounded() {
    let (mut all, _) = created();
    let [one, two]: [DomainId; 2] = ["one", "two"].map(|name| name.parse().unwrap());
    let request = to(json!({ "subscriptionType": "AppInstanceStateChange" }));
    let id = all.subscribe(Some(&one), &request).unwrap();
    let subscriptions = all.subscriptions();
    assert!(subscriptions.document(Some(&two), BASE, &id).is_err());
    assert!(subscriptions.remove(Some(&two), &id, NOW).is_err());
    let document = subscriptions.document(None, BASE, &id).unwrap();
    assert_eq!(document["notificationType"], json!(["NOT_INSTANTIATED", "STARTED", "STOPPED"]));
    assert_eq!(document["callbackUri"], "http://127.0.0.1:9/");
    let listed = |all: &mut Applications, viewer| {
        let list = all.subscriptions().list(viewer, BASE, Some(crate::SubscriptionType::Instances));
        list["_links"]["subscriptions"].as_array().unwrap().len()
    };
    assert_eq!((listed(&mut all, Some(&two)), listed(&mut all, Some(&one))), (0, 1));
    let made = (0..100).map_while(|_| all.subscribe(Some(&one), &request).ok()).count();
    assert_eq!(made, 63);
    assert!(matches!(all.subscribe(Some(&one), &request), Err(LifecycleError::Full(_))));
    // Others have room of their own.
    all.subscribe(Some(&two), &request).unwrap();
    all.subscriptions().remove(Some(&one), &id, NOW).unwrap();
    all.subscribe(Some(&one), &request).unwrap();
    let many = (0..1000).map(|_| all.subscriptions().remove(Some(&one), "0", NOW).unwrap_err());
    assert!(many.into_iter().any(|error| matches!(error, LifecycleError::TooOften(_))));
}

#[test]
fn invalid_subscriptions_name_the_mistake() {
    for (request, named) in [
        (json!({ "subscriptionType": "X" }), "AppInstanceStateChange"),
        (
            json!({ "subscriptionType": "AppInstanceStateChange", "callbackUri": "https://a/" }),
            "not a callback",
        ),
        (json!({ "subscriptionType": "AppInstanceStateChange", "more": 1 }), "more"),
        (
            json!({ "subscriptionType": "AppInstanceStateChange", "appLcmOpOccSubscriptionFilter": {} }),
            "only",
        ),
        (json!({ "subscriptionType": "AppLcmOpOccStateChange", "appInstanceState": "STARTED" }), "no state"),
        (
            json!({ "subscriptionType": "AppInstanceStateChange",
                "appInstanceSubscriptionFilter": { "appInstSelectorType": "APP_NAME" } }),
            "take `appInstances`",
        ),
        (
            json!({ "subscriptionType": "AppLcmOpOccStateChange", "appLcmOpOccSubscriptionFilter": {
                "appInstanceSubscriptionFilter": { "appInstSelectorType": "VOID", "appInstances": ["a"] } } }),
            "VOID takes no list",
        ),
        (
            json!({ "subscriptionType": "AppInstanceStateChange", "callbackUri": "x".repeat(20_000) }),
            "16384 bytes",
        ),
    ] {
        let request = to(request).to_string();
        let error = crate::Subscription::read(request.as_bytes()).unwrap_err().to_string();
        assert!(error.contains(named), "{error}");
    }
}

proptest! {
    /// A subscriber to all changes can follow the state that the documents show, and hears of nothing else.
    #[test]
    fn notifications_follow_the_shown_state(steps in prop::collection::vec((0_u8..10, any::<bool>()), 0..60)) {
        let (mut all, id) = created();
        all.subscribe(None, &to(json!({ "subscriptionType": "AppInstanceStateChange" }))).unwrap();
        let (mut shown, mut vnf) = (all.shown(&id), None);
        for (step, accepts) in steps {
            let request = match step {
                0 => Some(instantiate("edge")),
                1 => Some(read("operate", &json!({ "changeStateTo": "STARTED" })).unwrap()),
                2 => Some(stop()),
                3 => Some(terminate()),
                _ => None,
            };
            if let Some(request) = request {
                if let Ok(begun) = all.begin(None, &id, &request, NOW) {
                    // An instance has a state between the steps of an operation, too.
                    let between = all.shown(&id);
                    vnf = all.carry_out(&id, begun, accepts, NOW).or(vnf);
                    let now = all.shown(&id);
                    let stops = begun.task == mec::Task::Stop && accepts;
                    let stopped = if stops { "STOPPED".to_owned() } else { between.clone() };
                    let states = [shown, between, stopped, now.clone()];
                    let changes: Vec<_> = states.windows(2).filter(|two| two[0] != two[1]).map(|two| two[1].as_str()).collect();
                    let told = all.deliver();
                    prop_assert_eq!(kinds(&told), changes);
                    shown = now;
                    continue;
                }
            } else {
                let seen = [Seen::Serves, Seen::Restarts, Seen::Gone, Seen::Starting];
                match (step, &vnf) {
                    (4, _) => drop(all.configure(None, &id, NOW)),
                    (5, _) => drop(all.clean(None, &id, NOW)),
                    (step, Some(vnf)) => all.observe(vnf, None, &seen[usize::from(step) - 6], NOW),
                    (_, None) => {}
                }
            }
            let now = all.shown(&id);
            let changed: Vec<_> = (now != shown).then_some(now.as_str()).into_iter().collect();
            let told = all.deliver();
            prop_assert_eq!(kinds(&told), changed);
            shown = now;
        }
    }
}
