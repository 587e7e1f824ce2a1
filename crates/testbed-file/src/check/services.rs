//! VNFs: distinct names, hosts with room for them, and robots that they serve.

use std::collections::{HashMap, HashSet};

use cotorra_graph::{
    AccessPoint, Capacity, Containers, Node, NodeId, NodeKind, Program, RosNetwork, Service, Testbed, Vnf,
    VnfId,
};

use super::{
    accelerators::{AcceleratorsInUse, policy},
    containers,
};
use crate::{
    records::{ComposeRecord, ServiceRecord, TestbedRecord, VnfRecord},
    yaml::{
        Sink, Span,
        decode::{Either, Spanned, words},
    },
};

/// A VNF, and its places in the file. Those of a VNF in a compose file are where that is named.
struct Placed<'a> {
    vnf: &'a Vnf,
    /// Place of its name.
    id: &'a Span,
    /// Places of its nodes.
    starts: Vec<&'a Span>,
    /// Place of its program.
    program: &'a Span,
}

/// Returns the VNFs of a service with their places.
fn placed<'a>(record: &'a ServiceRecord, service: &'a Service) -> impl Iterator<Item = Placed<'a>> {
    let listed = record.vnfs.0.iter().zip(&service.vnfs).map(|((id, r), vnf)| Placed {
        vnf,
        id: &id.span,
        starts: starts(id, r),
        program: r.program.as_ref().map_or(&id.span, |program| &program.span),
    });
    let composed = service.vnfs.iter().skip(record.vnfs.0.len());
    let composed = composed.zip(record.compose.iter().cycle()).map(|(vnf, ComposeRecord { file, node })| {
        let start = if *vnf.node.first() == node.value { &node.span } else { &file.span };
        Placed { vnf, id: &file.span, starts: vec![start], program: &file.span }
    });
    listed.chain(composed)
}

/// VNFs have names of their own, run on hosts that can carry them, and navigation has a robot that it drives.
pub(super) fn vnfs(record: &TestbedRecord, testbed: &Testbed, sink: &mut Sink) {
    let graph = &testbed.graph;
    let mut seen = HashSet::new();
    let mut used: HashMap<&NodeId, Capacity> = HashMap::new();
    let mut accelerators = AcceleratorsInUse::default();
    for ((_, r), service) in record.services.0.iter().zip(&testbed.services) {
        for Placed { vnf, id, starts, .. } in placed(r, service) {
            if !seen.insert(&vnf.id) {
                sink.error(id, format!("the VNF `{}` is here twice", vnf.id))
                    .help("rename one of them: VNFs of all services have names of their own");
            } else if testbed.containers.hosts.iter().any(|host| host.id == vnf.id) {
                sink.error(id, format!("the VNF `{}` has the name of a node with an `image`", vnf.id))
                    .help("rename one of them: both are containers");
            } else if let Some((node, _)) =
                graph.radio_units().find(|(n, _)| AccessPoint::vnf(&n.id) == vnf.id)
            {
                sink.error(id, format!("`{}` is the name of the vAP of `{}`", vnf.id, node.id))
                    .help("rename the VNF");
            }
            let able = able(testbed, vnf);
            for (node, place) in vnf.node.all().iter().zip(starts) {
                let node = graph.node(node).expect("the builder found it");
                let Some(capacity) = node.capacity() else {
                    let what = match node.kind {
                        NodeKind::Gateway(_) => "a gateway, and a gateway runs no VNF",
                        NodeKind::Machine(_) => "a real machine, on which cotorra runs nothing",
                        _ => "a switch, and a switch runs no VNF",
                    };
                    sink.error(place, format!("`{}` is {what}", node.id))
                        .help(format!("place it on one of {}", words(&able)));
                    continue;
                };
                if vnf.image.is_some() && !containers::runs_images(&testbed.containers, node) {
                    containers::no_image(place, vnf, node, &able, sink);
                    continue;
                }
                if vnf.accelerator_bytes() > 0 {
                    accelerators.place(node, vnf, place, &able, sink);
                }
                let all = used.entry(&node.id).or_insert(Capacity {
                    cpus: 0.0,
                    memory_bytes: 0,
                    accelerators: None,
                });
                all.cpus += vnf.cpus;
                all.memory_bytes = all.memory_bytes.saturating_add(vnf.memory_bytes);
                if able.is_empty() {
                    sink.error(
                        id,
                        format!("`{}` fits no node: it takes {}", vnf.id, amount(vnf.cpus, vnf.memory_bytes)),
                    )
                    .help("let it take less, or give a node more");
                    break;
                } else if all.cpus > capacity.cpus || all.memory_bytes > capacity.memory_bytes {
                    sink.error(
                        place,
                        format!("`{}` has {}", node.id, amount(capacity.cpus, capacity.memory_bytes)),
                    )
                    .label(format!("its VNFs take {}", amount(all.cpus, all.memory_bytes)))
                    .help(format!("`{}` alone would fit {}", vnf.id, words(&able)));
                }
            }
        }
        driver(r, service, testbed, sink);
        policy(r, service, testbed, sink);
        flow(r, service, sink);
    }
}

/// Returns the places of a VNF's nodes in the file.
fn starts<'a>(id: &'a Spanned<VnfId>, record: &'a VnfRecord) -> Vec<&'a Span> {
    match (&record.pinned_to, record.node.as_ref().map(|node| &node.value)) {
        (Some(pinned), _) => vec![&pinned.span],
        (None, Some(Either::Short(one))) => vec![&one.span],
        (None, Some(Either::Long(several))) => several.iter().map(|node| &node.span).collect(),
        (None, None) => vec![&id.span],
    }
}

/// The hosts that can carry a VNF alone.
fn able<'a>(testbed: &'a Testbed, vnf: &Vnf) -> Vec<&'a str> {
    let nodes = testbed.graph.nodes.iter();
    nodes.filter(|node| carries(node, vnf, &testbed.containers)).map(|node| node.id.as_str()).collect()
}

/// Whether a node alone has room for a VNF, and an engine for its image.
pub(super) fn carries(node: &Node, vnf: &Vnf, all: &Containers) -> bool {
    let fits = |c: Capacity| {
        let memory = c.accelerators.map_or(0, |its| its.memory_bytes);
        vnf.cpus <= c.cpus && vnf.memory_bytes <= c.memory_bytes && vnf.accelerator_bytes() <= memory
    };
    node.capacity().is_some_and(fits) && (vnf.image.is_none() || containers::runs_images(all, node))
}

fn amount(cpus: f64, memory_bytes: u64) -> String {
    let s = if cpus == 1.0 { "" } else { "s" };
    format!("{cpus} CPU{s} and {:.2} GB", memory_bytes as f64 / 1e9)
}

/// Navigation answers the position packets of a robot on its walk, localization its scans, on a map.
fn driver(record: &ServiceRecord, service: &Service, testbed: &Testbed, sink: &mut Sink) {
    for Placed { vnf, program: place, .. } in placed(record, service) {
        match vnf.program {
            Program::RobotDriver if vnf.pinned_to.as_ref() != Some(&service.robot) => {
                sink.error(place, format!("a robot driver that is not pinned to `{}`", service.robot))
                    .help(format!("write `pinned_to: {}`, the robot that the service serves", service.robot));
            }
            Program::Localization => {
                driven("localization", place, service, sink);
                if testbed.map.is_none() {
                    sink.error(place, "localization without a map")
                        .help("name the map on which it finds the robot, under `map:`");
                }
            }
            Program::Navigation => {
                driven("navigation", place, service, sink);
                walks(place, service, testbed, sink);
            }
            Program::RosNavigation => {
                in_ros(vnf, place, service, testbed, sink);
                walks(place, service, testbed, sink);
            }
            _ => {}
        }
    }
    let is_asked = |vnf: &Vnf| vnf.program.serves_robots();
    let asks = service.policy.is_some() || service.vnfs.iter().any(is_asked);
    if let Some(requests) = record.requests.as_ref().filter(|_| !asks) {
        sink.error(&requests.span, "`requests` of a service that the robot asks nothing")
            .help("leave it out: where requests of your own programs go, these programs decide");
    }
    if service.vnfs.is_empty() && service.kpis.flow.is_none() && service.policy.is_none() {
        sink.error(&record.robot.span, format!("the service `{}` has no VNFs", service.id))
            .help("describe them under `vnfs:`, in the order in which packets visit them");
    }
}

/// Checks that a robot which is navigated has a walk.
fn walks(place: &Span, service: &Service, testbed: &Testbed, sink: &mut Sink) {
    if testbed.walk(&service.robot).is_none() {
        sink.error(place, format!("navigation for `{}`, which has no walk", service.robot))
            .help(format!("say where it goes, under `walks:`, at `{}:`", service.robot));
    }
}

/// Checks that a brain in ROS reaches its robot in the emulated network, and drives it alone.
fn in_ros(vnf: &Vnf, place: &Span, service: &Service, testbed: &Testbed, sink: &mut Sink) {
    let robot = testbed.graph.robots().find(|(node, _)| node.id == service.robot);
    let network = robot.and_then(|(_, robot)| Some(robot.driver.ros()?.network()));
    if network != Some(RosNetwork::Testbed) {
        sink.error(place, format!("`{}` is not in ROS in the emulated network", service.robot))
            .help("add `offer: ros1` or `offer: ros2` to the robot, without `network: machine`");
    }
    if service.vnfs.iter().any(|vnf| vnf.program == Program::RobotDriver) {
        sink.error(place, "a brain in ROS beside a robot driver")
            .help("leave out the robot driver: it drives the robot by packets of its own");
    }
    let is_real = |node: &NodeId| testbed.graph.node(node).is_some_and(|node| node.real_server().is_some());
    if let Some(node) = vnf.node.all().iter().find(|node| is_real(node)) {
        sink.error(place, format!("a brain in ROS on the real server `{node}`"))
            .help("place it on a node that cotorra emulates");
    }
}

/// Checks that a VNF which answers a robot is in a service with the robot's driver.
fn driven(what: &str, place: &Span, service: &Service, sink: &mut Sink) {
    if !service.vnfs.iter().any(|vnf| vnf.program == Program::RobotDriver) {
        sink.error(place, format!("{what} without a robot driver")).help(format!(
            "add a VNF before it, such as `driver: {{ program: robot_driver, pinned_to: {} }}`",
            service.robot
        ));
    }
}

/// A service has one time: navigation's, or that of a flow.
fn flow(record: &ServiceRecord, service: &Service, sink: &mut Sink) {
    let Some(flow) = &record.kpis.flow else { return };
    if service.vnfs.iter().any(|vnf| vnf.program == Program::RobotDriver) {
        sink.error(&flow.span, "a flow in a service whose navigation is measured")
            .help("describe the flow in a service of its own; it may have `vnfs: {}`");
    }
}
