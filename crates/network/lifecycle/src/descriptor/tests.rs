use proptest::prelude::*;
use serde_json::json;

use super::*;

fn container() -> Value {
    json!({
        "id": "detector", "name": "object detector", "description": null, "uuid": null,
        "computation_requirements": { "cpu_arch": "x86_64", "cpu_min_freq": 0, "cpu_min_count": 2,
            "ram_size_mb": 64.5, "storage_size_gb": 0.1 },
        "image": { "uri": "docker://docker.io/library/detector:1", "checksum": "", "format": "" },
        "hypervisor": "DOCKER", "migration_kind": "COLD", "storage": [], "interfaces": [], "io_ports": [],
        "connection_points": [], "depends_on": [], "configuration": null,
    })
}

fn native() -> Value {
    let mut fdu = container();
    fdu["hypervisor"] = "BARE".into();
    fdu["image"] = Value::Null;
    fdu["command"] = json!({ "binary": "python3", "args": ["-m", "http.server"] });
    fdu
}

fn read(fdu: &Value) -> Result<Descriptor, DescriptorError> {
    Descriptor::read(fdu.to_string().as_bytes())
}

#[test]
fn a_container_and_a_native_command_become_vnfs() {
    let node: NodeId = "edge".parse().unwrap();
    let fdu = read(&container()).unwrap();
    let vnf = fdu.vnf(fdu.vnf_name(7), node.clone(), vec!["A=1".to_owned()]);
    assert_eq!((vnf.id.as_str(), vnf.node.only()), ("detector-7", Some(&node)));
    assert_eq!((vnf.cpus, vnf.memory_bytes), (2.0, 64_500_000));
    assert_eq!(vnf.image.unwrap().reference, "docker.io/library/detector:1");
    assert_eq!((vnf.program, vnf.rights), (Program::Command(Vec::new()), Rights::default()));
    let fdu = read(&native()).unwrap();
    let vnf = fdu.vnf(fdu.vnf_name(8), node.clone(), Vec::new());
    let words = ["python3", "-m", "http.server"].map(str::to_owned).to_vec();
    assert_eq!((vnf.program, vnf.image), (Program::Command(words), None));
    let yaml = "detector:\n  command: [\"python3\",\"-m\",\"http.server\"]\n  node: edge\n  cpus: 2\n  memory: 64.5 MB\n";
    assert_eq!(fdu.yaml(Some(&node)).unwrap(), yaml);
}

#[test]
fn what_cannot_be_honoured_is_rejected_by_name() {
    for (key, value, named) in [
        ("hypervisor", json!("KVM"), "`hypervisor` is `KVM`"),
        ("hypervisor", json!("LXD"), "`hypervisor` is `LXD`"),
        ("hypervisor", json!("ROS2"), "`hypervisor` is `ROS2`"),
        ("migration_kind", json!("LIVE"), "`migration_kind`"),
        ("io_ports", json!([{ "name": "gpio" }]), "`io_ports`"),
        ("storage", json!([{ "id": "disk" }]), "`storage`"),
        ("connection_points", json!([{ "id": "cp1" }]), "`connection_points`"),
        ("interfaces", json!([{ "name": "eth0" }]), "`if_type`"),
        ("depends_on", json!(["other"]), "`depends_on`"),
        ("configuration", json!({ "conf_type": "SCRIPT", "script": "ls" }), "`configuration`"),
        ("geographical_requirements", json!({ "position": { "lat": "1" } }), "`geographical_requirements`"),
        ("energy_requirements", json!({ "key": "low" }), "`energy_requirements`"),
        ("image", Value::Null, "`image` is missing"),
        ("id", json!(""), "`id`"),
        ("uuid", json!("../x"), "`uuid`"),
        ("disk", json!(1), "disk"),
    ] {
        let mut fdu = container();
        fdu[key] = value;
        let error = read(&fdu).unwrap_err().to_string();
        assert!(error.contains(named), "{key}: {error}");
    }
    for (key, value) in [
        ("gpu_min_count", json!(1)),
        ("fpga_min_count", json!(1)),
        ("duty_cycle", json!(0.5)),
        ("cpu_min_count", json!(0)),
        ("ram_size_mb", json!(-1)),
        ("ram_size_mb", json!(1e300)),
    ] {
        let mut fdu = container();
        fdu["computation_requirements"][key] = value;
        assert!(read(&fdu).unwrap_err().to_string().contains(key), "{key}");
    }
    let mut fdu = container();
    fdu["image"]["checksum"] = "abc".into();
    assert!(read(&fdu).unwrap_err().to_string().contains("`image.checksum`"));
    let mut fdu = native();
    fdu["command"] = Value::Null;
    assert!(read(&fdu).unwrap_err().to_string().contains("`command` is missing, which BARE needs"));
    let long = vec![b' '; LONGEST_DESCRIPTOR + 1];
    assert_eq!(Descriptor::read(&long), Err(DescriptorError::TooLong(long.len())));
}

#[test]
fn an_interface_is_that_of_the_node_or_rejected_by_name() {
    let mut fdu = container();
    fdu["interfaces"] = json!([{ "name": "eth0", "is_mgmt": false, "if_type": "INTERNAL", "cp_id": "cp1",
        "virtual_interface": { "intf_type": "VIRTIO", "vpci": "0:0:0", "bandwidth": 10 } }]);
    fdu["connection_points"] = json!([{ "id": "cp1", "name": "cp", "cp_type": "VPORT", "vld_ref": "net" }]);
    assert_eq!(read(&fdu).unwrap().network.as_deref(), Some("net"));
    let mut alone = fdu.clone();
    (alone["interfaces"][0]["cp_id"], alone["connection_points"]) = (Value::Null, json!([]));
    alone["interfaces"][0]["if_type"] = "EXTERNAL".into();
    assert_eq!(read(&alone).unwrap().network, None);
    for (pointer, value, named) in [
        ("/interfaces/0/name", json!("eth1"), "`interfaces.name` is `eth1`"),
        ("/interfaces/0/is_mgmt", json!(true), "`interfaces.is_mgmt`"),
        ("/interfaces/0/if_type", json!("WLAN"), "`interfaces.if_type` is `WLAN`"),
        ("/interfaces/0/virtual_interface/intf_type", json!("BRIDGED"), "`virtual_interface.intf_type`"),
        ("/interfaces/0/cp_id", json!("cp2"), "`connection_points`"),
        ("/connection_points", json!([]), "`interfaces.cp_id` is `cp1`"),
        ("/connection_points/0/id", json!("cp2"), "`connection_points`"),
    ] {
        let mut other = fdu.clone();
        *other.pointer_mut(pointer).unwrap() = value;
        let error = read(&other).unwrap_err().to_string();
        assert!(error.contains(named), "{pointer}: {error}");
    }
    for (at, key, value) in [
        ("/interfaces/0", "mac_address", json!("be:ef:be:ef:00:01")),
        ("/interfaces/0", "ext_cp_id", json!("cp9")),
        ("/connection_points/0", "port_security_enabled", json!(true)),
        ("/connection_points/0", "vld_ref", json!("../net")),
        ("/connection_points/0", "pair_id", json!("net")),
    ] {
        let mut other = fdu.clone();
        other.pointer_mut(at).unwrap()[key] = value;
        assert!(read(&other).unwrap_err().to_string().contains(key), "{key}");
    }
    let first = fdu["interfaces"][0].clone();
    fdu["interfaces"].as_array_mut().unwrap().push(first);
    assert!(read(&fdu).unwrap_err().to_string().contains("`interfaces`"));
}

#[test]
fn variables_have_names_and_values() {
    assert_eq!(variables("").unwrap(), Vec::<String>::new());
    assert_eq!(variables("A=Hello World!, B=x=y,").unwrap(), ["A=Hello World!", "B=x=y"]);
    assert_eq!(variables("A=1,PATH").unwrap_err(), "`PATH`");
    assert_eq!(variables("=1").unwrap_err(), "`=1`");
}

proptest! {
    #[test]
    fn no_text_makes_the_reader_panic(text in ".{0,200}") {
        let _ = Descriptor::read(text.as_bytes());
        let _ = variables(&text);
    }

    #[test]
    fn every_name_becomes_one_of_a_vnf(id in ".{1,100}", number: u64) {
        let mut fdu = container();
        fdu["id"] = id.into();
        if let Ok(fdu) = read(&fdu) {
            fdu.vnf_name(number);
        }
    }
}
