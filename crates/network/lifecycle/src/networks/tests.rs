use serde_json::{Value, json};

use super::*;
use crate::{Descriptor, DescriptorError, LONGEST_DESCRIPTOR};

const NET: &str = "6cc2aa30";

fn network() -> Value {
    json!({ "uuid": NET, "name": "net1", "net_type": "ELAN", "is_mgmt": false })
}

fn read(network: &Value) -> Result<NetworkDescriptor, DescriptorError> {
    NetworkDescriptor::read(network.to_string().as_bytes())
}

fn node(name: &str) -> NodeId {
    name.parse().unwrap()
}

/// The catalog with an FDU whose interface names the network.
fn with_fdu() -> Applications {
    let fdu = json!({
        "id": "a", "hypervisor": "BARE", "migration_kind": "COLD", "command": { "binary": "a" },
        "computation_requirements": { "cpu_min_count": 1, "ram_size_mb": 64.0 },
        "interfaces": [{ "name": "eth0", "is_mgmt": false, "if_type": "INTERNAL", "cp_id": "cp1",
            "virtual_interface": { "intf_type": "VIRTIO", "vpci": "", "bandwidth": 10 } }],
        "connection_points": [{ "id": "cp1", "name": "to the net", "vld_ref": NET }],
    });
    let mut all = Applications::default();
    all.onboard(None, Descriptor::read(fdu.to_string().as_bytes()).unwrap()).unwrap();
    all
}

#[test]
fn what_the_emulated_network_does_is_accepted() {
    let plain = read(&network()).unwrap();
    assert_eq!((plain.uuid.as_str(), plain.name.as_str()), (NET, "net1"));
    for (version, subnet) in [("IPV4", "10.77.0.0/16"), ("IPV4", ""), ("IPV6", "fd77::/64")] {
        let mut other = network();
        other["ip_configuration"] = json!({ "ip_version": version, "subnet": subnet, "dhcp_enable": false });
        other["status"] = "add".into();
        other["overlay"] = true.into();
        assert_eq!(read(&other).unwrap(), plain);
    }
}

#[test]
fn what_the_emulated_network_does_not_do_is_rejected_by_name() {
    for (key, value) in [
        ("net_type", json!("ELINE")),
        ("is_mgmt", json!(true)),
        ("vni", json!(7)),
        ("vlan_id", json!(7)),
        ("mcast_addr", json!("239.0.0.1")),
        ("face", json!("eth1")),
        ("uuid", json!("../x")),
        ("name", json!("n".repeat(129))),
        ("port", json!(1)),
    ] {
        let mut other = network();
        other[key] = value;
        let error = read(&other).unwrap_err().to_string();
        assert!(error.contains(&format!("`{key}`")), "{key}: {error}");
    }
    for (key, value) in [
        ("ip_version", json!("IPV5")),
        ("subnet", json!("192.168.234.0/24")),
        ("gateway", json!("10.77.0.1")),
        ("dhcp_enable", json!(true)),
        ("dhcp_range", json!("10.77.0.2,10.77.0.9")),
        ("dns", json!("8.8.8.8")),
    ] {
        let mut other = network();
        other["ip_configuration"] = json!({ key: value });
        let error = read(&other).unwrap_err().to_string();
        assert!(error.contains(&format!("`ip_configuration.{key}`")), "{key}: {error}");
    }
    let long = vec![b' '; LONGEST_DESCRIPTOR + 1];
    assert_eq!(NetworkDescriptor::read(&long), Err(DescriptorError::TooLong(long.len())));
}

#[test]
fn a_record_can_be_added_again() {
    let mut all = Applications::default();
    all.add_network(None, read(&network()).unwrap()).unwrap();
    let record = all.connect(None, NET, node("edge")).unwrap().record();
    assert_eq!(record["properties"]["nodes"], json!(["edge"]));
    assert_eq!(all.add_network(None, read(&record).unwrap()).unwrap().record(), record);
    let mut other = network();
    other["name"] = "net2".into();
    let error = all.add_network(None, read(&other).unwrap()).unwrap_err().to_string();
    assert_eq!(error, format!("there is another network `{NET}` already"));
    assert_eq!(all.networks(None).count(), 1);
}

#[test]
fn a_network_stays_while_instances_are_connected_to_it() {
    let mut all = with_fdu();
    let define = |all: &mut Applications| {
        all.define(None, "a", Some(node("edge")), [None, None]).map(|instance| instance.id.clone())
    };
    assert_eq!(define(&mut all), Err(LifecycleError::Unknown("network", NET.to_owned())));
    all.add_network(None, read(&network()).unwrap()).unwrap();
    all.connect(None, NET, node("edge")).unwrap();
    all.connect(None, NET, node("fog")).unwrap();
    let id = define(&mut all).unwrap();
    let used = all.remove_network(None, NET).unwrap_err().to_string();
    assert_eq!(used, format!("the network `{NET}` has the instance `{id}`: remove that first"));
    assert_eq!(all.disconnect(None, NET, &node("edge")).unwrap_err().to_string(), used);
    all.disconnect(None, NET, &node("fog")).unwrap();
    let gone = all.disconnect(None, NET, &node("fog")).unwrap_err().to_string();
    assert!(gone.contains("was not added to the node `fog`"), "{gone}");
    all.undefine(None, &id).unwrap();
    all.remove_network(None, NET).unwrap();
    assert_eq!(all.remove_network(None, NET), Err(LifecycleError::Unknown("network", NET.to_owned())));
}

#[test]
fn a_domain_has_networks_of_its_own_and_they_are_bounded() {
    let [one, two]: [DomainId; 2] = ["one", "two"].map(|name| name.parse().unwrap());
    let mut all = with_fdu();
    all.add_network(Some(&one), read(&network()).unwrap()).unwrap();
    assert_eq!((all.networks(Some(&two)).count(), all.networks(Some(&one)).count()), (0, 1));
    assert!(all.network(Some(&two), NET).is_err() && all.remove_network(Some(&two), NET).is_err());
    assert!(all.connect(Some(&two), NET, node("edge")).is_err());
    assert!(all.add_network(Some(&two), read(&network()).unwrap()).is_err(), "its identifier is taken");
    let mut more = |number: usize| {
        let name = "net1".to_owned();
        all.add_network(Some(&two), NetworkDescriptor { uuid: number.to_string(), name }).map(drop)
    };
    (1..=64).for_each(|number| more(number).unwrap());
    let full = more(65).unwrap_err().to_string();
    assert_eq!(full, "there are 64 of your networks already: remove one");
    more(1).unwrap();
    let of_operator = NetworkDescriptor { uuid: "mine".to_owned(), name: "net1".to_owned() };
    all.add_network(None, of_operator).expect("the domain took none of the operator's places");
}
