//! Documents of Eclipse fog05 v0.2: records of descriptors, instances and nodes.

use cotorra_graph::{Node, NodeKind};
use serde_json::{Map, Value, json};

use crate::{Application, Descriptor, Seen, Stage};

/// Returns a descriptor as the catalog knows it.
pub fn descriptor(id: &str, descriptor: &Descriptor) -> Value {
    let mut keys = descriptor.keys.clone();
    keys.insert("uuid".to_owned(), id.into());
    keys.insert("name".to_owned(), descriptor.name.as_str().into());
    Value::Object(keys)
}

/// Returns the state of an instance: `DEFINE`, `CONFIGURE`, `RUN` or `ERROR`. A started one is configured until it serves.
pub fn status(instance: &Application) -> &'static str {
    match &instance.stage {
        Stage::Defined => "DEFINE",
        Stage::Configured | Stage::Started(_, Seen::Starting) => "CONFIGURE",
        Stage::Started(_, Seen::Serves | Seen::Restarts) => "RUN",
        Stage::Started(_, Seen::Failed(_) | Seen::Gone) => "ERROR",
    }
}

/// Returns the record of an instance.
pub fn record(instance: &Application, of: &Descriptor) -> Value {
    let mut keys: Map<String, Value> = of.keys.clone();
    for unused in ["id", "name", "description"] {
        keys.remove(unused);
    }
    let error = match &instance.stage {
        Stage::Started(_, Seen::Failed(reason)) => Some(reason.clone()),
        Stage::Started(_, Seen::Gone) => Some("its VNF was removed".to_owned()),
        _ => None,
    };
    let mut set = |key: &str, value: Value| keys.insert(key.to_owned(), value);
    set("uuid", instance.id.as_str().into());
    set("fdu_id", instance.descriptor.as_str().into());
    set("status", status(instance).into());
    set("error_code", if error.is_some() { 1.into() } else { Value::Null });
    set("error_msg", error.map_or(Value::Null, Value::from));
    let vnf = match &instance.stage {
        Stage::Started(vnf, _) => Value::from(vnf.as_str()),
        Stage::Defined | Stage::Configured => Value::Null,
    };
    set("hypervisor_info", json!({ "node": instance.node, "vnf": vnf }));
    Value::Object(keys)
}

/// Whether a node is one of those that run FDUs: a server.
pub fn is_node(node: &Node) -> bool {
    matches!(node.kind, NodeKind::Server(_))
}

/// Returns what is known of a node.
pub fn node_info(node: &Node) -> Value {
    let capacity = node.capacity();
    let cpus = capacity.map_or(0.0, |capacity| capacity.cpus);
    let memory_mb = capacity.map_or(0.0, |capacity| capacity.memory_bytes as f64 / 1e6);
    json!({
        "uuid": node.id, "name": node.id, "os": "linux",
        "cpu": [{ "arch": std::env::consts::ARCH, "count": cpus }],
        "ram": { "size": memory_mb },
        "disks": [], "io": [], "accelerator": [], "network": [],
    })
}

/// Returns the state of a node on which VNFs take so many bytes.
pub fn node_status(node: &Node, taken_bytes: u64) -> Value {
    let total = node.capacity().map_or(0, |capacity| capacity.memory_bytes);
    let free = total.saturating_sub(taken_bytes);
    json!({
        "uuid": node.id, "ram": { "total": total as f64 / 1e6, "free": free as f64 / 1e6 }, "disk": [], "neighbors": [],
    })
}
