//! What is wrong between the parts of a testbed, each of which may be right by itself: names taken twice, nodes out
//! of reach, KPIs that no placement keeps, walks through walls.

use std::collections::{HashMap, HashSet};

use cotorra_graph::{
    Capacity, Driver, Edge, HardwareGraph, Node, NodeId, NodeKind, Offer, Position, Program, Rmw, Ros, Ros1,
    Ros2, RosMaster, RosNetwork, Service, Testbed, Topology, Vnf, VnfId, WifiStandard,
};

use crate::{
    flow,
    machines::machines,
    records::{NodeRecord, ServiceRecord, TestbedRecord, VnfRecord},
    sensors,
    yaml::{
        Sink, Span,
        decode::{Either, Spanned, words},
    },
};

/// Checks the whole. Tables of the record and lists of the testbed have the same order.
pub(super) fn check(record: &TestbedRecord, testbed: &Testbed, sink: &mut Sink) {
    links(record, &testbed.graph, sink);
    machines(record, &testbed.graph, sink);
    radio_units(record, &testbed.graph, sink);
    ros(record, &testbed.graph, sink);
    sensors::receivers(record, testbed, sink);
    let broken = !sink.is_empty();
    vnfs(record, testbed, sink);
    walks(record, testbed, sink);
    // What follows from paths would only repeat what is wrong with them.
    let mut topology = Topology::new(&testbed.graph);
    if !broken && reach(record, &testbed.graph, &topology, sink) {
        for ((_, r), service) in record.services.0.iter().zip(&testbed.services) {
            kpis(r, service, &testbed.graph, &mut topology, sink);
        }
    }
}

/// Where each link of the graph stands in the file, in order.
pub(super) fn places(record: &TestbedRecord) -> impl Iterator<Item = &Span> {
    entries(record).map(|(_, place)| place)
}

/// The entry that each link of the graph has in the file, and the place of that, in order.
pub(super) fn entries(record: &TestbedRecord) -> impl Iterator<Item = (usize, &Span)> {
    record.links.iter().enumerate().flat_map(|(entry, link)| {
        let ends = link.ends.value.iter().map(|end| match end {
            Either::Short(_) => 1,
            Either::Long(several) => several.len(),
        });
        let span = link.id.as_ref().map_or(&link.ends.span, |id| &id.span);
        std::iter::repeat_n((entry, span), ends.fold(1, usize::saturating_mul))
    })
}

/// Links have names of their own.
fn links(record: &TestbedRecord, graph: &HardwareGraph, sink: &mut Sink) {
    let robots: HashSet<_> = graph.robots().map(|(robot, _)| robot.id.as_str()).collect();
    let mut seen = HashSet::new();
    for (link, span) in graph.links.iter().zip(places(record)) {
        if !seen.insert(&link.id) {
            sink.error(span, format!("the link `{}` is here twice", link.id))
                .help("remove one of them, or give it an `id` of its own");
        }
        let begins = |tilde: usize| robots.contains(&link.id.as_str()[..tilde]);
        let wireless = link.id.as_str().match_indices('~').any(|(tilde, _)| begins(tilde));
        if wireless {
            sink.error(span, format!("`{}` is the name of a wireless link", link.id))
                .help("give it an `id` that does not begin with a robot's name and `~`");
        }
    }
}

/// Radio units serve somebody's network on a channel of its standard.
fn radio_units(record: &TestbedRecord, graph: &HardwareGraph, sink: &mut Sink) {
    for ((id, r), node) in record.nodes.0.iter().zip(&graph.nodes) {
        match (r, &node.kind) {
            (NodeRecord::RadioUnit(r), NodeKind::RadioUnit(unit)) => {
                let standard = graph.wireless[&unit.network].standard;
                let channels = channels(standard);
                if !channels.contains(&unit.channel) {
                    let numbers: Vec<_> = channels.iter().map(u8::to_string).collect();
                    sink.error(&r.channel.span, format!("there is no channel {}", unit.channel)).help(
                        format!(
                            "`{}` uses {}: write one of {}",
                            unit.network,
                            described(standard),
                            numbers.join(", ")
                        ),
                    );
                }
            }
            (_, NodeKind::Robot(robot)) if !graph.radio_units().any(|(_, u)| u.network == robot.network) => {
                sink.error(
                    &id.span,
                    format!("no radio unit serves `{}`, the network of `{id}`", robot.network, id = node.id),
                )
                .help(format!("add a node with `kind: radio_unit` and `network: {}`", robot.network));
            }
            _ => {}
        }
    }
}

/// Robots in one place of ROS have topics of their own.
fn ros(record: &TestbedRecord, graph: &HardwareGraph, sink: &mut Sink) {
    /// Where nodes of ROS hear each other.
    #[derive(PartialEq, Eq, Hash)]
    enum Place<'a> {
        Master(&'a RosMaster),
        Domain(RosNetwork, Option<u16>),
        Zenoh(&'a str, Option<u16>),
    }
    let mut taken = HashMap::new();
    for ((id, _), node) in record.nodes.0.iter().zip(&graph.nodes) {
        let NodeKind::Robot(robot) = &node.kind else { continue };
        let ros1 = |its: &'_ Ros1| its.resolved(&its.topics.cmd_vel);
        let ros2 = |its: &'_ Ros2| its.resolved(&its.topics.cmd_vel);
        fn domain(its: &Ros2) -> Place<'_> {
            match &its.rmw {
                Rmw::Dds { network, .. } => Place::Domain(*network, its.domain),
                Rmw::Zenoh { router } => Place::Zenoh(router, its.domain),
            }
        }
        let (place, topic, is_offer) = match &robot.driver {
            Driver::Ros1(its) => (Place::Master(&its.master), ros1(its), false),
            Driver::Ros2(its) => (domain(its), ros2(its), false),
            Driver::Simulated { offer: Some(Offer { ros: Ros::Ros1(its), .. }) } => {
                (Place::Master(&its.master), ros1(its), true)
            }
            Driver::Simulated { offer: Some(Offer { ros: Ros::Ros2(its), .. }) } => {
                (domain(its), ros2(its), true)
            }
            Driver::Simulated { offer: None } => continue,
        };
        let shared = match place {
            Place::Master(_) => "of one ROS master",
            Place::Domain(..) | Place::Zenoh(..) => "in one domain of ROS 2",
        };
        // A robot that one node offers may be driven by another: only two of a kind are in each other's way.
        if let Some(before) = taken.insert((is_offer, place, topic.clone()), &node.id) {
            sink.error(&id.span, format!("`{before}` and `{}` both hear `{topic}` {shared}", node.id))
                .help("give one of them another `namespace`, such as `/tb2`");
        }
    }
}

/// Channels of 20 MHz (IEEE 802.11-2020, annex E; Europe's for 2.4 GHz).
fn channels(standard: WifiStandard) -> Vec<u8> {
    match standard {
        WifiStandard::G | WifiStandard::N => (1..=13).collect(),
        WifiStandard::A | WifiStandard::Ac => {
            (36..=64).step_by(4).chain((100..=144).step_by(4)).chain((149..=165).step_by(4)).collect()
        }
    }
}

fn described(standard: WifiStandard) -> &'static str {
    match standard {
        WifiStandard::G => "802.11g at 2.4 GHz",
        WifiStandard::A => "802.11a at 5 GHz",
        WifiStandard::N => "802.11n at 2.4 GHz",
        WifiStandard::Ac => "802.11ac at 5 GHz",
    }
}

/// Every server is reached from every other node, whichever radio unit a robot is attached to. Radio units need not
/// reach each other: what one buffered for a station goes with it in a handover.
fn reach(record: &TestbedRecord, graph: &HardwareGraph, topology: &Topology<'_>, sink: &mut Sink) -> bool {
    let is_server = |i: &usize| matches!(graph.nodes[*i].kind, NodeKind::Server(_));
    let is_fixed = |i: &usize| !matches!(graph.nodes[*i].kind, NodeKind::Robot(_) | NodeKind::Machine(_));
    let mut roots: Vec<_> = (0..graph.nodes.len()).filter(is_server).collect();
    if roots.is_empty() {
        roots.extend((0..graph.nodes.len()).find(is_fixed));
    }
    // Servers with the same neighbours reach the same: one of them answers for all.
    let mut asked = HashSet::new();
    for &root in roots.iter().filter(|root| asked.insert(topology.neighbours(**root))) {
        let reached = topology.shortest(&[(root, 0)], Edge::delay_ns);
        let others = || (0..graph.nodes.len()).filter(|i| is_fixed(i) && *i != root);
        let lost: Vec<_> = others().filter(|i| reached[*i].is_none()).collect();
        let help = "link it to a switch or a radio unit that leads there: servers and robots forward nothing";
        let mut error = |node: usize, message| {
            sink.error(&record.nodes.0[node].0.span, message).help(help);
        };
        let name = |node: usize| &graph.nodes[node].id;
        if lost.is_empty() {
            continue;
        } else if lost.len() == others().count() {
            error(root, format!("`{}` reaches nothing", name(root)));
        } else {
            lost.iter().for_each(|&node| {
                error(node, format!("`{}` cannot be reached from `{}`", name(node), name(root)))
            });
        }
        return false;
    }
    true
}

/// VNFs have names of their own, run on hosts that can carry them, and navigation has a robot that it drives.
fn vnfs(record: &TestbedRecord, testbed: &Testbed, sink: &mut Sink) {
    let graph = &testbed.graph;
    let mut seen = HashSet::new();
    let mut used: HashMap<&NodeId, Capacity> = HashMap::new();
    for ((_, r), service) in record.services.0.iter().zip(&testbed.services) {
        for ((id, r), vnf) in r.vnfs.0.iter().zip(&service.vnfs) {
            if !seen.insert(&vnf.id) {
                sink.error(&id.span, format!("the VNF `{}` is here twice", vnf.id))
                    .help("rename one of them: VNFs of all services have names of their own");
            }
            for (node, place) in vnf.node.all().iter().zip(starts(id, r)) {
                let node = graph.node(node).expect("the builder found it");
                let Some(capacity) = node.capacity() else {
                    let what = match node.kind {
                        NodeKind::Machine(_) => "a real machine, on which cotorra runs nothing",
                        _ => "a switch, and a switch runs no VNF",
                    };
                    sink.error(place, format!("`{}` is {what}", node.id))
                        .help(format!("place it on one of {}", words(&able(graph, vnf))));
                    continue;
                };
                let all = used.entry(&node.id).or_insert(Capacity { cpus: 0.0, memory_bytes: 0 });
                all.cpus += vnf.cpus;
                all.memory_bytes = all.memory_bytes.saturating_add(vnf.memory_bytes);
                let able = able(graph, vnf);
                if able.is_empty() {
                    sink.error(
                        &id.span,
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
        flow::check(r, service, sink);
    }
}

/// Where each node of a VNF stands in the file.
fn starts<'a>(id: &'a Spanned<VnfId>, record: &'a VnfRecord) -> Vec<&'a Span> {
    match (&record.pinned_to, record.node.as_ref().map(|node| &node.value)) {
        (Some(pinned), _) => vec![&pinned.span],
        (None, Some(Either::Short(one))) => vec![&one.span],
        (None, Some(Either::Long(several))) => several.iter().map(|node| &node.span).collect(),
        (None, None) => vec![&id.span],
    }
}

/// The hosts that can carry a VNF alone.
fn able<'a>(graph: &'a HardwareGraph, vnf: &Vnf) -> Vec<&'a str> {
    graph.nodes.iter().filter(|node| carries(node, vnf)).map(|node| node.id.as_str()).collect()
}

fn carries(node: &Node, vnf: &Vnf) -> bool {
    node.capacity().is_some_and(|c| vnf.cpus <= c.cpus && vnf.memory_bytes <= c.memory_bytes)
}

fn amount(cpus: f64, memory_bytes: u64) -> String {
    let s = if cpus == 1.0 { "" } else { "s" };
    format!("{cpus} CPU{s} and {:.2} GB", memory_bytes as f64 / 1e9)
}

/// Navigation answers the position packets of a robot on its walk, localization its scans, on a map.
fn driver(record: &ServiceRecord, service: &Service, testbed: &Testbed, sink: &mut Sink) {
    for ((id, r), vnf) in record.vnfs.0.iter().zip(&service.vnfs) {
        let place = r.program.as_ref().map_or(&id.span, |program| &program.span);
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
                if testbed.walk(&service.robot).is_none() {
                    sink.error(place, format!("navigation for `{}`, which has no walk", service.robot))
                        .help(format!("say where it goes, under `walks:`, at `{}:`", service.robot));
                }
            }
            _ => {}
        }
    }
    let is_asked = |vnf: &Vnf| matches!(vnf.program, Program::Navigation | Program::Localization);
    if let Some(requests) = record.requests.as_ref().filter(|_| !service.vnfs.iter().any(is_asked)) {
        sink.error(&requests.span, "`requests` of a service that the robot asks nothing")
            .help("leave it out: where requests of your own programs go, these programs decide");
    }
    if service.vnfs.is_empty() && service.kpis.flow.is_none() {
        sink.error(&record.robot.span, format!("the service `{}` has no VNFs", service.id))
            .help("describe them under `vnfs:`, in the order in which packets visit them");
    }
}

/// What answers a robot is in a service with the robot's driver.
fn driven(what: &str, place: &Span, service: &Service, sink: &mut Sink) {
    if !service.vnfs.iter().any(|vnf| vnf.program == Program::RobotDriver) {
        sink.error(place, format!("{what} without a robot driver")).help(format!(
            "add a VNF before it, such as `driver: {{ program: robot_driver, pinned_to: {} }}`",
            service.robot
        ));
    }
}

/// Walks stay where a robot can be.
fn walks(record: &TestbedRecord, testbed: &Testbed, sink: &mut Sink) {
    for (robot, walk) in &record.walks.0 {
        let robots = testbed.graph.robots();
        let model = robots.filter(|(node, _)| node.id == robot.value).map(|(_, robot)| robot.model).next();
        let model = model.unwrap_or_default();
        if walk.waypoints.value.len() < 2 {
            sink.error(&walk.waypoints.span, "a walk of fewer than 2 waypoints")
                .help("write where it begins and where it leads, such as `[[0, 0], [5, 0]]`");
        }
        let speed = walk.speed_limit.value.0;
        if speed == 0.0 || speed > model.max_speed() {
            sink.error(&walk.speed_limit.span, format!("a walk at {speed} m/s")).help(format!(
                "a {} moves above 0 and up to {} m/s",
                model.name(),
                model.max_speed()
            ));
        }
        let start = walk.waypoints.value.first().map_or(0.0, |at| at.value.z);
        for at in &walk.waypoints.value {
            if at.value.z < 0.0 {
                sink.error(&at.span, format!("the waypoint {} is below the floor", at.value))
                    .help("write a height of 0 or more");
            } else if at.value.z != start && !model.flies() {
                sink.error(&at.span, format!("a {} cannot go to the height of {}", model.name(), at.value))
                    .help("keep all heights of its walk equal, or write `model: quadrotor`");
            }
        }
        if walk.position_interval.value.is_zero() {
            sink.error(&walk.position_interval.span, "position packets without a pause")
                .help("write an interval above zero, such as `200 ms`");
        }
        for at in &walk.waypoints.value {
            free(at, "waypoint", testbed, sink);
        }
    }
    for (_, node) in &record.nodes.0 {
        if let NodeRecord::Robot(robot) = node
            && let Some(at) = &robot.position
        {
            free(at, "position", testbed, sink);
        }
    }
}

/// A robot can be there.
fn free(at: &Spanned<Position>, what: &str, testbed: &Testbed, sink: &mut Sink) {
    let Some(map) = &testbed.map else { return };
    let Some(lies) = map.not_free(at.value) else { return };
    let (near, side) = (map.origin(), map.resolution());
    let far = Position::new(near.x + map.width() as f64 * side, near.y + map.height() as f64 * side);
    sink.error(&at.span, format!("the {what} {} lies {lies}", at.value))
        .help(format!("choose free ground of the map, which reaches from {near} to {far}"));
}

/// KPIs that some placement can keep.
fn kpis(
    record: &ServiceRecord,
    service: &Service,
    graph: &HardwareGraph,
    topology: &mut Topology<'_>,
    sink: &mut Sink,
) {
    let robot = graph.robots().find(|(node, _)| node.id == service.robot).map(|(_, robot)| robot);
    let ssid = &robot.expect("the builder found it").network;
    let network = &graph.wireless[ssid];
    let units: Vec<_> =
        graph.radio_units().filter(|(_, unit)| unit.network == *ssid).map(|(node, _)| &node.id).collect();
    let kpis = &record.kpis;
    if let Some(radio) = kpis.radio.as_ref().filter(|radio| radio.value != network.standard) {
        sink.error(&radio.span, format!("this service needs {}", described(radio.value))).help(format!(
            "the wireless network of `{}` has {}: change one of them",
            service.robot,
            described(network.standard)
        ));
    }
    if let Some(area) = kpis.area.as_ref().filter(|area| area.value.len() < 3) {
        sink.error(&area.span, format!("an area of {} corners", area.value.len()))
            .help("write 3 places or more, such as `[[0, 0], [5, 0], [5, 5]]`");
    }
    let target = &kpis.service_time;
    // How the requests of another node go through the VNFs, nobody says.
    let is_elsewhere = service.kpis.flow.as_ref().is_some_and(|flow| flow.from != service.robot);
    match fastest_ns(service, &units, graph, topology, target.value.as_nanos()) {
        Some(best) if u128::from(best) > target.value.as_nanos() && !is_elsewhere => {
            sink.error(&target.span, "no placement reaches this service time").help(format!(
                "the delays of the fastest paths alone add up to {} ms: allow more, or shorten a link",
                best as f64 / 1e6
            ));
        }
        _ => {}
    }
    if let Some(wanted) = &kpis.reliability {
        let best = most_reliable(service, &units, graph, topology);
        if best < wanted.value.get() - 1e-12 {
            sink.error(&wanted.span, "no placement is that reliable").help(format!(
                "the most reliable servers and links together give {:.4} %: ask for less, or improve them",
                best * 100.0
            ));
        }
    }
}

/// The hosts that could carry a VNF.
fn candidates(vnf: &Vnf, graph: &HardwareGraph) -> Vec<usize> {
    let fits = |node: &Node| match &vnf.pinned_to {
        Some(pinned) => node.id == *pinned,
        None => carries(node, vnf),
    };
    graph.nodes.iter().enumerate().filter(|(_, node)| fits(node)).map(|(i, _)| i).collect()
}

/// The least that link delays add up to from the robot through the VNFs, in order, and back, over all placements and
/// radio units; the first found within `enough_ns` will do.
fn fastest_ns(
    service: &Service,
    units: &[&NodeId],
    graph: &HardwareGraph,
    topology: &mut Topology<'_>,
    enough_ns: u128,
) -> Option<u64> {
    let stages: Vec<_> = service.vnfs.iter().map(|vnf| candidates(vnf, graph)).collect();
    let start = topology.place(&service.robot)?;
    let mut best = None;
    for unit in units {
        topology.attach(&service.robot, unit);
        let mut at = vec![(start, 0)];
        for stage in &stages {
            let reached = topology.shortest(&at, Edge::delay_ns);
            at = stage.iter().filter_map(|&host| Some((host, reached[host]?.cost))).collect();
        }
        let back = topology.shortest(&at, Edge::delay_ns)[start];
        topology.detach(&service.robot);
        best = best.into_iter().chain(back.map(|back| back.cost)).min();
        if best.is_some_and(|best| u128::from(best) <= enough_ns) {
            break;
        }
    }
    best
}

/// An upper bound of the probability that all that a placement uses works: of each VNF alone, the best host and path
/// from the robot; the worst of these.
fn most_reliable(
    service: &Service,
    units: &[&NodeId],
    graph: &HardwareGraph,
    topology: &mut Topology<'_>,
) -> f64 {
    // -ln in fixed point, so that products become sums of integers; rounded down, as befits an upper bound.
    const UNIT: f64 = 1e12;
    let cost = |reliability: f64| (-reliability.ln() * UNIT) as u64;
    units.iter().for_each(|unit| topology.attach(&service.robot, unit));
    let start = topology.place(&service.robot).expect("the builder found it");
    let reached = topology
        .shortest(&[(start, 0)], |edge| edge.wired().map_or(0, |link| cost(graph.links[link].reliability)));
    topology.detach(&service.robot);
    let host = |i: usize| {
        let own = match &graph.nodes[i].kind {
            NodeKind::Server(server) => cost(server.reliability),
            _ => 0,
        };
        reached[i].map(|path| path.cost + own)
    };
    let best = |vnf: &Vnf| candidates(vnf, graph).into_iter().filter_map(host).min();
    let worst = service.vnfs.iter().filter_map(best).max().unwrap_or(0);
    (-(worst as f64) / UNIT).exp()
}
