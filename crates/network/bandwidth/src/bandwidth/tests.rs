use cotorra_graph::{Instruction, VnfId};
use cotorra_graph_testing::{applications, id};
use cotorra_mec::conformance::Published;
use serde_json::{Value, json};

use super::*;
use crate::{session::Mapped, types::BwInfo};

const PUBLISHED: Published =
    Published { schemas: include_str!("../../tests/etsi/mec015-2.2.1.schemas.json"), beside: &[] };

const BASE: &str = "http://host/bwm/v1";

fn survey() -> Survey {
    let nodes = [("robot-driver", "robot"), ("navigation", "cloud"), ("planner", "edge")];
    Survey {
        nodes: nodes.map(|(vnf, node)| (id(vnf), vec![id(node)])).into(),
        attached: [(id("robot"), id("unit"))].into(),
        ..Survey::default()
    }
}

/// The service of a testbed, and what its core does.
struct Rig {
    service: Bandwidth,
    part: Testbed,
    survey: Survey,
}

const OPERATOR: &Consumer = &Consumer::Operator;

fn rig() -> Rig {
    let part = applications(["home", "home"]);
    Rig { service: Bandwidth::new(part.clone().into()), part, survey: survey() }
}

fn application(name: &str) -> Consumer {
    Consumer::Application(id("home"), id(name))
}

impl Rig {
    /// Plans a change of a consumer.
    fn plan<E>(
        &mut self,
        consumer: &Consumer,
        plan: impl FnOnce(&mut Bandwidth, Seen<'_>) -> Result<Change, E>,
    ) -> Result<Change, E> {
        plan(&mut self.service, Seen { consumer, part: &self.part, survey: &self.survey })
    }

    fn create(&mut self, info: BwInfo) -> Result<Change, BandwidthError> {
        self.create_as(OPERATOR, info)
    }

    fn create_as(&mut self, consumer: &Consumer, info: BwInfo) -> Result<Change, BandwidthError> {
        self.plan(consumer, |service, seen| service.create(seen, info))
    }

    /// Carries a change out, and returns its instructions.
    fn done(&mut self, change: Change) -> Vec<String> {
        let instructions: Vec<_> = change.instructions().collect();
        for instruction in &instructions {
            let Instruction::Map { from, to, links, reservation } = instruction.clone() else {
                unreachable!()
            };
            if links.is_empty() {
                self.survey.mapped.remove(&[from, to]);
            } else {
                self.survey.mapped.insert([from, to], Mapped { links, reservation });
            }
        }
        self.service.commit(BASE, change);
        texts(instructions.into_iter())
    }

    /// Returns the ends of allocations that have ended, with their reasons.
    fn ended(&mut self) -> Vec<(Vec<String>, String)> {
        let ended = self.service.ended(&self.survey);
        ended.into_iter().map(|(change, why)| (self.done(change), why)).collect()
    }

    fn count(&self, consumer: &Consumer) -> usize {
        self.service.list(consumer, &Selection::default()).len()
    }

    fn address(&self, node: &str) -> String {
        self.service.testbed.graph.address(&id(node)).unwrap().ipv4.to_string()
    }
}

/// An allocation of 2 Mbit/s to the navigation with other values of these attributes.
fn info(change: Value) -> BwInfo {
    let mut info = json!({
        "appInsId": "navigation", "requestType": 0, "fixedAllocation": "2000000", "allocationDirection": "00",
    });
    info.as_object_mut().unwrap().extend(change.as_object().unwrap().clone());
    serde_json::from_value(info).unwrap()
}

/// A session of the planner with another node.
fn session(rig: &Rig, with: &str) -> BwInfo {
    let filter = json!([{ "sourceIp": rig.address("edge"), "dstAddress": rig.address(with) }]);
    info(json!({ "appInsId": "planner", "requestType": 1, "sessionFilter": filter }))
}

fn texts(instructions: impl Iterator<Item = Instruction>) -> Vec<String> {
    instructions.map(|instruction| instruction.text()).collect()
}

fn refused(result: Result<Change, BandwidthError>) -> String {
    result.unwrap_err().to_string()
}

#[test]
fn an_allocation_maps_the_present_path_with_its_rate_as_the_most() {
    let mut rig = rig();
    let change = rig.create(info(json!({}))).unwrap();
    assert_eq!(
        texts(change.instructions()),
        ["map cloud to robot over lan-cloud, lan-unit, robot~unit, limited at 2 Mbit/s"]
    );
    let resource = rig.service.commit(BASE, change).unwrap();
    assert_eq!((&*resource.href, &*resource.etag), ("http://host/bwm/v1/bw_allocations/1", "\"1-1\""));
    assert_eq!(rig.service.get(OPERATOR, BASE, "1").unwrap(), resource);

    // Both directions, faster: the first path changes in place.
    let deltas = json!({ "allocationId": "1", "appInsId": "navigation", "requestType": 0,
        "fixedAllocation": "3000000", "allocationDirection": "10" });
    let deltas = serde_json::from_value(deltas).unwrap();
    let change = rig.plan(OPERATOR, |all, seen| all.modify(seen, "1", Some("\"1-1\""), deltas)).unwrap();
    assert_eq!(
        texts(change.instructions()),
        [
            "map cloud to robot over lan-cloud, lan-unit, robot~unit, limited at 3 Mbit/s",
            "map robot to cloud over robot~unit, lan-unit, lan-cloud, limited at 3 Mbit/s",
        ]
    );
    assert_eq!(
        texts(change.undo(1)),
        ["map cloud to robot over lan-cloud, lan-unit, robot~unit, limited at 2 Mbit/s"]
    );
    assert_eq!(rig.service.commit(BASE, change).unwrap().etag, "\"1-2\"");

    let uplink = info(json!({ "allocationDirection": "01", "fixedAllocation": "3000000" }));
    let change = rig.plan(OPERATOR, |all, seen| all.replace(seen, "1", None, uplink)).unwrap();
    assert_eq!(texts(change.instructions()), ["unmap cloud to robot"]);
    rig.done(change);
    let change = rig.plan(OPERATOR, |all, seen| all.remove(seen, "1", None)).unwrap();
    assert_eq!(texts(change.instructions()), ["unmap robot to cloud"]);
    assert_eq!(rig.service.commit(BASE, change), None);
    assert_eq!(rig.count(OPERATOR), 0);
    rig.survey.mapped.clear();
    let again = rig.create(info(json!({}))).unwrap();
    assert_eq!(rig.service.commit(BASE, again).unwrap().value.allocation_id.as_deref(), Some("2"));
}

#[test]
fn a_session_is_between_two_nodes() {
    let mut rig = rig();
    let [robot, cloud, edge] = ["robot", "cloud", "edge"].map(|node| rig.address(node));
    let session = |source: &str, target: &str| {
        info(json!({ "requestType": 1, "sessionFilter": [{ "sourceIp": source, "dstAddress": target }] }))
    };
    for filter in [session(&edge, &cloud), session(&cloud, &edge)] {
        let change = rig.create(filter).unwrap();
        assert_eq!(
            texts(change.instructions()),
            ["map cloud to edge over lan-cloud, lan-edge, limited at 2 Mbit/s"]
        );
    }
    for (filter, reason) in [
        (session(&robot, &edge), "does not lead from or to the application's node `cloud`"),
        (session("10.0.0.0/8", &cloud), "is the address of one node, not `10.0.0.0/8`"),
        (session("192.0.2.1", &cloud), "no node has the address 192.0.2.1"),
    ] {
        let text = refused(rig.create(filter));
        assert!(text.contains(reason), "{text}");
    }
}

#[test]
fn what_no_link_keeps_is_rejected() {
    let mut rig = rig();
    let cloud = rig.address("cloud");
    let change = rig.create(info(json!({}))).unwrap();
    rig.done(change);
    let mapped = Mapped { links: Vec::new(), reservation: None };
    let mapped = Survey { mapped: [([id("robot"), id("cloud")], mapped)].into(), ..survey() };
    let port = json!({ "sourceIp": cloud, "dstAddress": "10.77.0.1", "dstPort": "80" });
    for (survey, given, reason) in [
        (survey(), json!({}), "are those of the allocation 1"),
        (mapped, json!({ "allocationDirection": "01" }), "have a mapped path already"),
        (survey(), json!({ "fixedBWPriority": "SEE_DESCRIPTION" }), "not priorities"),
        (survey(), json!({ "fixedAllocation": "0" }), "above 0"),
        (survey(), json!({ "fixedAllocation": "2 Mbit/s" }), "above 0"),
        (survey(), json!({ "requestType": 2 }), "requestType is 0 or 1"),
        (survey(), json!({ "requestType": 1 }), "one sessionFilter"),
        (survey(), json!({ "requestType": 1, "sessionFilter": [port] }), "leave ports and protocol out"),
        (survey(), json!({ "appInsId": "nobody" }), "there is no application `nobody`"),
        (
            Survey { attached: Default::default(), ..survey() },
            json!({ "allocationDirection": "01" }),
            "no wired link",
        ),
    ] {
        rig.survey = survey;
        let text = refused(rig.create(info(given)));
        assert!(text.contains(reason), "{text}");
    }
    let changed = rig.plan(OPERATOR, |all, seen| all.replace(seen, "1", Some("\"1-7\""), info(json!({}))));
    assert!(matches!(changed, Err(BandwidthError::Request(RequestError::Changed(_)))));
    let unknown = rig.plan(OPERATOR, |all, seen| all.remove(seen, "7", None));
    assert!(matches!(unknown, Err(RequestError::NotFound { .. })));
}

#[test]
fn an_application_has_allocations_of_its_own_which_limit_nobody() {
    let mut rig = rig();
    let (planner, navigation, domain) =
        (application("planner"), application("navigation"), Consumer::Domain(id("home")));
    let change = rig.create_as(&planner, session(&rig, "robot")).unwrap();
    assert_eq!(
        rig.done(change),
        ["map edge to robot over lan-edge, lan-unit, robot~unit, guaranteed at 2 Mbit/s"]
    );
    let change = rig.create(info(json!({}))).unwrap();
    rig.done(change);
    let seen = [OPERATOR, &domain, &planner, &navigation, &Consumer::Domain(id("other"))];
    assert_eq!(seen.map(|consumer| rig.count(consumer)), [2, 1, 1, 0, 0]);
    for (consumer, allocation) in [(&navigation, "1"), (&planner, "2"), (&domain, "2")] {
        assert!(rig.service.get(consumer, BASE, allocation).is_err(), "{allocation}");
        let removed = rig.plan(consumer, |all, seen| all.remove(seen, allocation, None));
        assert!(matches!(removed, Err(RequestError::NotFound { .. })));
    }
    for (info, reason) in [
        // Of another, between other nodes, and mapped by another.
        (info(json!({})), "the token is of the application `planner`, not of `navigation`"),
        (session(&rig, "edge"), "does not lead from or to the application's node `edge`"),
    ] {
        let text = refused(rig.create_as(&planner, info));
        assert!(text.contains(reason), "{text}");
    }
    let taken = refused(rig.create_as(&navigation, info(json!({}))));
    assert_eq!(taken, "the packets from `cloud` to `robot` have a mapped path already", "whose is not said");
    // The domain changes it, and it stays the application's.
    let more = BwInfo { fixed_allocation: "3000000".to_owned(), ..session(&rig, "robot") };
    let change = rig.plan(&domain, |all, seen| all.replace(seen, "1", None, more)).unwrap();
    assert_eq!(
        rig.done(change),
        ["map edge to robot over lan-edge, lan-unit, robot~unit, guaranteed at 3 Mbit/s"]
    );
    let other = rig.plan(&domain, |all, seen| all.replace(seen, "1", None, info(json!({}))));
    assert_eq!(refused(other), "it stays with the application that made it");
    assert_eq!(rig.count(&planner), 1);
}

#[test]
fn allocations_end_with_their_application_and_with_their_mapping() {
    let mut rig = rig();
    let planner = application("planner");
    let both = BwInfo { allocation_direction: AllocationDirection::Symmetrical, ..session(&rig, "robot") };
    let make = |rig: &mut Rig| {
        let change = rig.create_as(&planner, both.clone()).unwrap();
        rig.done(change);
        assert_eq!(rig.ended(), []);
    };
    make(&mut rig);
    rig.survey.nodes.insert(id("planner"), vec![id("cloud")]);
    let unmapped = ["unmap edge to robot", "unmap robot to edge"].map(str::to_owned);
    assert_eq!(rig.ended(), [(unmapped.to_vec(), "`planner` has left its node".to_owned())]);

    rig.survey.nodes.insert(id("planner"), vec![id("edge")]);
    make(&mut rig);
    // Somebody else maps one direction, and keeps it.
    let mapped = Mapped { links: Vec::new(), reservation: None };
    rig.survey.mapped.insert([id("edge"), id("robot")], mapped);
    let reason = "the packets from `edge` to `robot` have another mapping, or none".to_owned();
    assert_eq!(rig.ended(), [(vec![unmapped[1].clone()], reason)]);

    rig.survey.mapped.clear();
    make(&mut rig);
    // The operator's stays where it is, as long as the application is somewhere.
    let change = rig.create(info(json!({}))).unwrap();
    rig.done(change);
    rig.survey.nodes.insert(id("navigation"), vec![id("edge")]);
    rig.survey.nodes.remove(&id::<VnfId>("planner"));
    assert_eq!(rig.ended(), [(unmapped.to_vec(), "`planner` has ended".to_owned())]);
    rig.survey.nodes.clear();
    let unmapped = vec!["unmap cloud to robot".to_owned()];
    assert_eq!(rig.ended(), [(unmapped, "`navigation` has ended".to_owned())]);
    assert!(rig.service.is_empty());
}

#[test]
fn an_application_allocates_within_its_domain() {
    let mut rig = rig();
    let whole = applications(["home", "other"]);
    rig.service = Bandwidth::new(whole.clone().into());
    // The domain of the robot: the cloud is not in it.
    rig.part.graph.nodes.retain(|node| *node.id.as_str() != *"cloud");
    rig.part.graph.links.retain(|link| link.ends.iter().all(|end| *end.as_str() != *"cloud"));
    let text = refused(rig.create_as(&application("planner"), session(&rig, "cloud")));
    assert!(text.contains("no node has the address"), "{text}");
    let text = refused(rig.create_as(&application("navigation"), info(json!({}))));
    assert_eq!(text, "the application's node `cloud` is of another domain");
}

#[test]
fn the_number_of_allocations_and_of_changes_is_bounded() {
    let mut rig = rig();
    let planner = application("planner");
    let one = rig.create_as(&planner, session(&rig, "robot")).unwrap();
    for number in 1..=16 {
        let mut change = one.clone();
        change.id = number;
        rig.service.commit(BASE, change);
    }
    assert_eq!(
        refused(rig.create_as(&planner, session(&rig, "cloud"))),
        "an application has at most 16 allocations"
    );
    let mut changes = || rig.plan(&planner, |all, seen| all.remove(seen, "1", None));
    assert!((0..1000).any(|_| matches!(changes(), Err(RequestError::TooOften(_)))));
    assert!(rig.create(info(json!({}))).is_ok(), "others can change theirs");
}

#[test]
fn lists_are_selected_by_one_kind_of_parameter() {
    let mut rig = rig();
    let change = rig.create(info(json!({ "appName": "brain" }))).unwrap();
    rig.done(change);
    let count = |given: &[(&str, &str)]| {
        let given: Vec<_> = given.iter().map(|(name, value)| (name.to_string(), value.to_string())).collect();
        Selection::read(&given).map(|selection| rig.service.list(OPERATOR, &selection).len())
    };
    assert_eq!(count(&[]), Ok(1));
    assert_eq!(count(&[("app_instance_id", "other,navigation")]), Ok(1));
    assert_eq!(count(&[("app_instance_id", "other")]), Ok(0));
    assert_eq!(count(&[("app_name", "brain")]), Ok(1));
    assert_eq!(count(&[("session_id", "1")]), Ok(0), "it is no session");
    assert!(count(&[("app_name", "brain"), ("session_id", "1")]).is_err());
    assert!(count(&[("application", "brain")]).is_err());
}

#[test]
fn allocations_are_as_the_published_schemas_say() {
    let mut rig = rig();
    for given in [info(json!({})), BwInfo { app_name: Some("brain".to_owned()), ..session(&rig, "cloud") }] {
        let change = rig.create(given).unwrap();
        let value = serde_json::to_value(change.after.unwrap().info).unwrap();
        assert_eq!(PUBLISHED.differences(&value, "BwInfo"), [""; 0]);
    }
    let wrong = json!({ "appInsId": 1, "requestType": 3, "rate": "1", "allocationDirection": "00" });
    let differences = PUBLISHED.differences(&wrong, "BwInfo");
    for expected in ["lacks fixedAllocation", "has no rate", "appInsId is no", "requestType is 3"] {
        assert!(differences.iter().any(|difference| difference.contains(expected)), "{differences:?}");
    }
}
