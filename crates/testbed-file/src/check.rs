//! Checks between the records of a testbed: names that are taken or lead elsewhere, unreachable nodes, KPIs that no placement keeps, walks
//! through walls.

mod accelerators;
mod agents;
mod containers;
mod kpis;
mod machines;
mod names;
mod real_ports;
mod sensors;
mod services;

use std::collections::{HashMap, HashSet};

use cotorra_graph::{
    ChannelWidth, Driver, Edge, HardwareGraph, NodeId, NodeKind, Offer, Position, RadioUnit, Rmw, Ros, Ros1,
    Ros2, RosMaster, RosNetwork, Testbed, Topology, WifiStandard, WirelessNetwork,
};

use crate::{
    records::{NodeRecord, TestbedRecord},
    yaml::{
        Sink,
        decode::{Either, Spanned},
    },
};

/// Parts of service times that are no links (`docs/use/time-parts.md`). Those that are have the links' names.
const PARTS_OF_TIMES: [&str; 4] = ["sender", "vnf", "receiver", "unknown"];

/// Checks the whole. Tables of the record and lists of the testbed have the same order.
pub(super) fn check(record: &TestbedRecord, testbed: &Testbed, sink: &mut Sink) {
    names::names(record, testbed, sink);
    links(record, &testbed.graph, sink);
    machines::machines(record, &testbed.graph, sink);
    real_ports::real_ports(record, &testbed.graph, sink);
    agents::agents(record, sink);
    agents::services(record, &testbed.graph, sink);
    containers::hosts(record, testbed, sink);
    radio_units(record, &testbed.graph, sink);
    wide_channels(record, &testbed.graph, sink);
    ros(record, &testbed.graph, sink);
    ports(record, &testbed.graph, sink);
    sensors::receivers(record, testbed, sink);
    let broken = !sink.is_empty();
    services::vnfs(record, testbed, sink);
    walks(record, testbed, sink);
    // Checks that follow from paths would only repeat their mistakes.
    let mut topology = Topology::new(&testbed.graph);
    if !broken && reach(record, &testbed.graph, &topology, sink) {
        for ((_, r), service) in record.services.0.iter().zip(&testbed.services) {
            kpis::kpis(r, service, testbed, &mut topology, sink);
        }
    }
}

/// Links have names of their own.
fn links(record: &TestbedRecord, graph: &HardwareGraph, sink: &mut Sink) {
    let robots: HashSet<_> = graph.robots().map(|(robot, _)| robot.id.as_str()).collect();
    let mut seen = HashSet::new();
    for (link, span) in graph.links.iter().zip(record.link_places()) {
        if !seen.insert(&link.id) {
            sink.error(span, format!("the link `{}` is here twice", link.id))
                .help("remove one of them, or give it an `id` of its own");
        }
        if PARTS_OF_TIMES.contains(&link.id.as_str()) {
            sink.error(span, format!("`{}` is the name of a part of service times that is no link", link.id))
                .help(format!("give it another `id` than {}", PARTS_OF_TIMES.join(", ")));
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
                let channels = channels(standard, graph.wireless[&unit.network].width);
                if !channels.contains(&unit.channel) {
                    let numbers: Vec<_> = channels.iter().map(u8::to_string).collect();
                    sink.error(&r.channel.span, format!("there is no channel {}", unit.channel)).help(
                        format!(
                            "`{}` uses {}: write one of {}",
                            unit.network,
                            standard.described(),
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

/// Each serial port of a machine has one device.
fn ports(record: &TestbedRecord, graph: &HardwareGraph, sink: &mut Sink) {
    let mut taken = HashMap::new();
    for ((id, _), node) in record.nodes.0.iter().zip(&graph.nodes) {
        let NodeKind::Robot(robot) = &node.kind else { continue };
        let Driver::Kobuki(its) = &robot.driver else { continue };
        for port in [Some(&its.port), its.lidar.as_ref().map(|lidar| &lidar.port)].into_iter().flatten() {
            if let Some(before) = taken.insert((&its.agent, port), &node.id) {
                let port = port.display();
                let message = if *before == node.id {
                    format!("the base and the lidar of `{before}` are both at `{port}`")
                } else {
                    format!("`{before}` and `{}` are both at `{port}`", node.id)
                };
                sink.error(&id.span, message).help("give each device a port of its own by a udev rule");
            }
        }
    }
}

/// Robots in one place of ROS have topics of their own.
fn ros(record: &TestbedRecord, graph: &HardwareGraph, sink: &mut Sink) {
    /// Network in which ROS nodes discover each other.
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
            Driver::Simulated { offer: None } | Driver::Kobuki(_) => continue,
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

/// Channels of 20 MHz (IEEE 802.11-2020, annex E; Europe's for 2.4 GHz), of which wider ones exist.
fn channels(standard: WifiStandard, width: ChannelWidth) -> Vec<u8> {
    // Channel 165 has no neighbour.
    let last = if width == ChannelWidth::Mhz20 { 165 } else { 161 };
    let at_5_ghz = (36..=64).step_by(4).chain((100..=144).step_by(4)).chain((149..=last).step_by(4));
    let at_2_ghz = 1..=13;
    match standard {
        WifiStandard::G => at_2_ghz.collect(),
        WifiStandard::A | WifiStandard::Ac => at_5_ghz.collect(),
        WifiStandard::N | WifiStandard::Ax if width == ChannelWidth::Mhz80 => at_5_ghz.collect(),
        WifiStandard::N | WifiStandard::Ax => at_2_ghz.chain(at_5_ghz).collect(),
    }
}

/// The radio units of a network are in one band. Where a channel is wider than 20 MHz, others have the same primary channel
/// or none of its frequencies: stations sense only their primary channel.
fn wide_channels(record: &TestbedRecord, graph: &HardwareGraph, sink: &mut Sink) {
    let mut before: Vec<(&NodeId, &RadioUnit)> = Vec::new();
    for ((_, r), node) in record.nodes.0.iter().zip(&graph.nodes) {
        let (NodeRecord::RadioUnit(r), NodeKind::RadioUnit(unit)) = (r, &node.kind) else { continue };
        let network = &graph.wireless[&unit.network];
        for (id, other) in &before {
            let others = &graph.wireless[&other.network];
            let of = |network: &WirelessNetwork, unit: &RadioUnit| network.standard.band(unit.channel);
            if unit.network == other.network && of(network, unit) != of(others, other) {
                let message =
                    format!("`{id}` of the same network is in another band, on channel {}", other.channel);
                sink.error(&r.channel.span, message).help("give the other band a network of its own");
                return;
            }
            let [low, high] = network.standard.span_mhz(unit.channel, network.width);
            let [others_low, others_high] = others.standard.span_mhz(other.channel, others.width);
            let same =
                network.standard.frequency_mhz(unit.channel) == others.standard.frequency_mhz(other.channel);
            let is_wide = network.width.max(others.width) > ChannelWidth::Mhz20;
            if is_wide && !same && low < others_high && others_low < high {
                let message =
                    format!("this channel overlaps with that of `{id}`, {others_low} to {others_high} MHz");
                sink.error(&r.channel.span, message).help(format!(
                    "write {}, or a channel that has none of these frequencies",
                    other.channel
                ));
                return;
            }
        }
        before.push((&node.id, unit));
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
        if matches!(&walk.position_interval.value, Either::Short(interval) if interval.is_zero()) {
            sink.error(&walk.position_interval.span, "position packets without a pause")
                .help("write an interval above zero, such as `200 ms`");
        }
        for at in &walk.waypoints.value {
            free(at, "waypoint", testbed, sink);
        }
    }
    // A robot on its way stands where it believed to be.
    let on_its_way =
        |id: &NodeId| record.walks.0.iter().any(|(robot, walk)| robot.value == *id && walk.next.is_some());
    for (id, node) in &record.nodes.0 {
        if let NodeRecord::Robot(robot) = node
            && let Some(at) = &robot.position
            && !on_its_way(&id.value)
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
