use serde_json::{Value, json};

use super::*;

const TESTBED: &str = "
name: two
wireless: { lab: { delay: 1 ms } }
nodes:
  robot: { kind: robot }
  unit: { kind: radio_unit, position: [5, 3], channel: 1 }
  lan: { kind: switch }
  edge: { kind: server, tier: edge, cpus: 4, memory: 8 GB }
  cloud: { kind: server, tier: cloud, cpus: 4, memory: 8 GB }
links:
  - { ends: [lan, [unit, edge, cloud]], rate: 10 Mbit/s }
services:
  navigation:
    robot: robot
    kpis: { service_time: 30 ms }
    vnfs:
      robot-driver: { program: robot_driver, pinned_to: robot }
      navigation: { program: navigation, node: cloud, cpus: 2 }
    virtual_links: [{ from: robot-driver, to: navigation, rate: 1 Mbit/s }]
walks:
  robot: { waypoints: [[0, 0], [10, 0]] }
";
const BASE: &str = "http://host/bwm/v1";

fn survey() -> Survey {
    let nodes = [("robot-driver", "robot"), ("navigation", "cloud")];
    let nodes = nodes.map(|(vnf, node)| (vnf.parse().unwrap(), vec![node.parse().unwrap()]));
    let attached = [("robot".parse().unwrap(), "unit".parse().unwrap())];
    Survey { nodes: nodes.into(), attached: attached.into(), mapped: Default::default() }
}

fn service() -> Bandwidth {
    let testbed = cotorra_testbed_file::parse("x", TESTBED, "".as_ref()).unwrap_or_else(|e| panic!("{e}"));
    Bandwidth::new(testbed.into())
}

/// An allocation of 2 Mbit/s to the navigation with other values of these attributes.
fn info(change: Value) -> BwInfo {
    let mut info = json!({
        "appInsId": "navigation", "requestType": 0, "fixedAllocation": "2000000", "allocationDirection": "00",
    });
    info.as_object_mut().unwrap().extend(change.as_object().unwrap().clone());
    serde_json::from_value(info).unwrap()
}

fn address(service: &Bandwidth, node: &str) -> String {
    service.testbed.graph.address(&node.parse().unwrap()).unwrap().ipv4.to_string()
}

fn texts(instructions: impl Iterator<Item = Instruction>) -> Vec<String> {
    instructions.map(|instruction| instruction.text()).collect()
}

fn refused(result: Result<Change, BandwidthError>) -> String {
    result.unwrap_err().to_string()
}

#[test]
fn an_allocation_maps_the_present_path_with_its_rate_as_the_most() {
    let mut service = service();
    let change = service.create(&survey(), info(json!({}))).unwrap();
    assert_eq!(
        texts(change.instructions()),
        ["map cloud to robot over lan-cloud, lan-unit, robot~unit, limited at 2 Mbit/s"]
    );
    let resource = service.commit(BASE, change).unwrap();
    assert_eq!((&*resource.href, &*resource.etag), ("http://host/bwm/v1/bw_allocations/1", "\"1-1\""));
    assert_eq!(service.get(BASE, "1").unwrap(), resource);

    // Both directions, faster: the first path changes in place.
    let deltas = json!({ "allocationId": "1", "appInsId": "navigation", "requestType": 0,
        "fixedAllocation": "3000000", "allocationDirection": "10" });
    let change =
        service.modify(&survey(), "1", Some("\"1-1\""), serde_json::from_value(deltas).unwrap()).unwrap();
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
    assert_eq!(service.commit(BASE, change).unwrap().etag, "\"1-2\"");

    let uplink = info(json!({ "allocationDirection": "01", "fixedAllocation": "3000000" }));
    let change = service.replace(&survey(), "1", None, uplink).unwrap();
    assert_eq!(texts(change.instructions()), ["unmap cloud to robot"]);
    service.commit(BASE, change);
    let change = service.remove("1", None).unwrap();
    assert_eq!(texts(change.instructions()), ["unmap robot to cloud"]);
    assert_eq!(service.commit(BASE, change), None);
    assert!(service.list(&Selection::default()).is_empty());
    let again = service.create(&survey(), info(json!({}))).unwrap();
    assert_eq!(service.commit(BASE, again).unwrap().value.allocation_id.as_deref(), Some("2"));
}

#[test]
fn a_session_is_between_two_nodes() {
    let service = service();
    let [robot, cloud, edge] = ["robot", "cloud", "edge"].map(|node| address(&service, node));
    let session = |source: &str, target: &str| {
        info(json!({ "requestType": 1, "sessionFilter": [{ "sourceIp": source, "dstAddress": target }] }))
    };
    for filter in [session(&edge, &cloud), session(&cloud, &edge)] {
        let change = service.create(&survey(), filter).unwrap();
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
        let text = refused(service.create(&survey(), filter));
        assert!(text.contains(reason), "{text}");
    }
}

#[test]
fn what_no_link_keeps_is_rejected() {
    let mut service = service();
    let cloud = address(&service, "cloud");
    let change = service.create(&survey(), info(json!({}))).unwrap();
    service.commit(BASE, change);
    let mapped = Survey {
        mapped: [("robot-driver".parse().unwrap(), "navigation".parse().unwrap())].into(),
        ..survey()
    };
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
        let text = refused(service.create(&survey, info(given)));
        assert!(text.contains(reason), "{text}");
    }
    let changed = service.replace(&survey(), "1", Some("\"1-7\""), info(json!({})));
    assert!(matches!(changed, Err(BandwidthError::Request(RequestError::Changed(_)))));
    assert!(matches!(service.remove("7", None), Err(RequestError::NotFound { .. })));
}

#[test]
fn lists_are_selected_by_one_kind_of_parameter() {
    let mut service = service();
    let change = service.create(&survey(), info(json!({ "appName": "brain" }))).unwrap();
    service.commit(BASE, change);
    let count = |given: &[(&str, &str)]| {
        let given: Vec<_> = given.iter().map(|(name, value)| (name.to_string(), value.to_string())).collect();
        Selection::read(&given).map(|selection| service.list(&selection).len())
    };
    assert_eq!(count(&[]), Ok(1));
    assert_eq!(count(&[("app_instance_id", "other,navigation")]), Ok(1));
    assert_eq!(count(&[("app_instance_id", "other")]), Ok(0));
    assert_eq!(count(&[("app_name", "brain")]), Ok(1));
    assert_eq!(count(&[("session_id", "1")]), Ok(0), "it is no session");
    assert!(count(&[("app_name", "brain"), ("session_id", "1")]).is_err());
    assert!(count(&[("application", "brain")]).is_err());
}

/// Returns how an answer differs from a schema of ETSI's OpenAPI file of v2.2.1.
fn differences(value: &Value, schema: &str) -> Vec<String> {
    let schemas: Value =
        serde_json::from_str(include_str!("../../tests/etsi/mec015-2.2.1.schemas.json")).unwrap();
    let schema = &schemas["components"]["schemas"][schema];
    let required = schema["required"].as_array().into_iter().flatten().filter_map(Value::as_str);
    let mut found: Vec<_> =
        required.filter(|name| value.get(name).is_none()).map(|name| format!("{name} is missing")).collect();
    for (name, inner) in value.as_object().unwrap() {
        let of = &schema["properties"][name];
        let is_type = match of["type"].as_str() {
            Some("string") => inner.is_string(),
            Some("integer") => inner.is_u64(),
            Some("array") => {
                let item = of["items"]["$ref"].as_str().and_then(|path| path.rsplit('/').next()).unwrap();
                found.extend(inner.as_array().unwrap().iter().flat_map(|inner| differences(inner, item)));
                true
            }
            _ => false,
        };
        let is_among = of["enum"].as_array().is_none_or(|values| values.contains(inner));
        if !is_type || !is_among {
            found.push(format!("{name} is {inner}"));
        }
    }
    found
}

#[test]
fn allocations_are_as_the_published_schemas_say() {
    let service = service();
    let [cloud, edge] = ["cloud", "edge"].map(|node| address(&service, node));
    let session = json!({ "requestType": 1, "appName": "brain", "sessionFilter": [{ "sourceIp": cloud, "dstAddress": edge }] });
    for given in [json!({}), session] {
        let change = service.create(&survey(), info(given)).unwrap();
        let value = serde_json::to_value(change.after.unwrap().info).unwrap();
        assert_eq!(differences(&value, "BwInfo"), [""; 0]);
    }
    let wrong = json!({ "appInsId": 1, "requestType": 3, "rate": "1", "allocationDirection": "00" });
    assert_eq!(
        differences(&wrong, "BwInfo"),
        ["fixedAllocation is missing", "appInsId is 1", "rate is \"1\"", "requestType is 3"]
    );
}
