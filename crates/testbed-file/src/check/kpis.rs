//! KPIs: some placement can keep each.

use cotorra_graph::{
    Bound, Edge, Figure, HardwareGraph, Measure, Node, NodeId, NodeKind, Service, Testbed, Topology, Total,
    Vnf,
};

use super::services::carries;
use crate::{
    bound::report,
    records::ServiceRecord,
    yaml::{Sink, decode::Spanned},
};

/// KPIs that some placement can keep.
pub(super) fn kpis(
    record: &ServiceRecord,
    service: &Service,
    testbed: &Testbed,
    topology: &mut Topology<'_>,
    sink: &mut Sink,
) {
    let graph = &testbed.graph;
    let robot = graph.robots().find(|(node, _)| node.id == service.robot).map(|(_, robot)| robot);
    let ssid = &robot.expect("the builder found it").network;
    let network = &graph.wireless[ssid];
    let units: Vec<_> =
        graph.radio_units().filter(|(_, unit)| unit.network == *ssid).map(|(node, _)| &node.id).collect();
    let kpis = &record.kpis;
    if let Some(radio) = kpis.radio.as_ref().filter(|radio| radio.value != network.standard) {
        sink.error(&radio.span, format!("this service needs {}", radio.value.described())).help(format!(
            "the wireless network of `{}` has {}: change one of them",
            service.robot,
            network.standard.described()
        ));
    }
    if let Some(kept) = kpis.kept.as_ref().filter(|kept| kept.value.get() <= 0.0) {
        sink.error(&kept.span, "every run keeps 0 %")
            .help("demand more, such as `kept: 95 %`, or leave it out: any share will do then");
    }
    if let Some(area) = kpis.area.as_ref().filter(|area| area.value.len() < 3) {
        sink.error(&area.span, format!("an area of {} corners", area.value.len()))
            .help("write 3 places or more, such as `[[0, 0], [5, 0], [5, 5]]`");
    }
    for bound in &kpis.require {
        subjects(bound, service, testbed, sink);
    }
    let target = &kpis.service_time;
    // The way of another node's requests through the VNFs is not declared.
    let is_elsewhere = service.kpis.flow.as_ref().is_some_and(|flow| flow.from != service.robot);
    match fastest_ns(service, &units, testbed, topology, target.value.as_nanos()) {
        Some(best) if u128::from(best) > target.value.as_nanos() && !is_elsewhere => {
            sink.error(&target.span, "no placement reaches this service time").help(format!(
                "the delays of the fastest paths alone add up to {} ms: allow more, or shorten a link",
                best as f64 / 1e6
            ));
        }
        _ => {}
    }
    if let Some(wanted) = &kpis.reliability {
        let best = most_reliable(service, &units, testbed, topology);
        if best < wanted.value.get() - 1e-12 {
            sink.error(&wanted.span, "no placement is that reliable").help(format!(
                "the most reliable servers and links together give {:.4} %: ask for less, or improve them",
                best * 100.0
            ));
        }
    }
}

/// Subjects of a bounded figure are complete, and are there.
fn subjects(bound: &Spanned<Bound>, service: &Service, testbed: &Testbed, sink: &mut Sink) {
    let graph = &testbed.graph;
    let figure = match bound.value.measure(&service.id, &service.robot) {
        Ok(Measure::Of(figure, _)) => figure,
        Ok(Measure::Total(Total::Bill | Total::TotalBill)) if testbed.currency.is_none() => {
            sink.error(&bound.span, "there is no bill without a currency")
                .help("write `currency: EUR`, or another one, at the top of the file");
            return;
        }
        Ok(Measure::Total(total)) => {
            if let Some(help) = lacks_power(total, service, graph) {
                sink.error(&bound.span, "nothing says how much power is taken").help(help);
            }
            return;
        }
        Err(wrong) => return report(&wrong, &bound.span, sink),
    };
    let nodes = match &figure {
        Figure::Link(link, ..) => {
            // A wireless link has the names of its robot and its radio unit.
            let is_wireless = link.as_str().split_once('~').is_some_and(|(robot, unit)| {
                graph.nodes.iter().any(|node| node.id.as_str() == robot)
                    && graph.radio_units().any(|(node, _)| node.id.as_str() == unit)
            });
            if graph.link(link).is_none() && !is_wireless {
                let links = graph.links.iter().map(|link| link.id.as_str());
                sink.unknown_name(&bound.span, "link named", link.as_str(), links);
            }
            return;
        }
        Figure::Robot(node, _) | Figure::Load(node) | Figure::Machine(node, _) => vec![node],
        Figure::Signal { robot, radio_unit } => vec![robot, radio_unit],
        Figure::Sensor { robot, .. } => vec![robot],
        Figure::ServiceTime { robot, .. }
        | Figure::TimePart { robot, .. }
        | Figure::HandoverGap { robot } => robot.iter().collect(),
        Figure::Lateness(_) => return,
    };
    for node in nodes.into_iter().filter(|node| graph.node(node).is_none()) {
        let known = graph.nodes.iter().map(|node| node.id.as_str());
        sink.unknown_name(&bound.span, "node named", node.as_str(), known);
    }
}

/// Returns what would have to be written for an energy to be known.
fn lacks_power(total: Total, service: &Service, graph: &HardwareGraph) -> Option<&'static str> {
    let servers = || graph.servers().any(|(_, server)| server.power.is_some());
    let robots = || graph.robots().any(|(_, robot)| robot.power.is_some());
    let its = graph.robots().find(|(node, _)| node.id == service.robot);
    let its = its.and_then(|(_, robot)| robot.power.as_deref());
    match total {
        Total::Energy | Total::TotalEnergy if !servers() && !robots() => {
            Some("write `power: { idle: 100 W, full: 250 W }` of a server, or a robot's")
        }
        Total::RobotEnergy if its.is_none() => {
            Some("write `power: { idle: 15 W, driving: 40 W }` of the service's robot")
        }
        Total::BatteryLeft if its.is_none_or(|power| power.battery_wh.is_none()) => {
            Some("write `power: { idle: 15 W, driving: 40 W, battery: 55 Wh }` of the service's robot")
        }
        _ => None,
    }
}

/// The hosts that could carry a VNF.
fn candidates(vnf: &Vnf, testbed: &Testbed) -> Vec<usize> {
    let fits = |node: &Node| match &vnf.pinned_to {
        Some(pinned) => node.id == *pinned,
        None => carries(node, vnf, &testbed.containers),
    };
    testbed.graph.nodes.iter().enumerate().filter(|(_, node)| fits(node)).map(|(i, _)| i).collect()
}

/// The least that link delays add up to from the robot through the VNFs, in order, and back, over all placements and
/// radio units; the first found within `enough_ns` will do.
fn fastest_ns(
    service: &Service,
    units: &[&NodeId],
    testbed: &Testbed,
    topology: &mut Topology<'_>,
    enough_ns: u128,
) -> Option<u64> {
    let stages: Vec<_> = service.vnfs.iter().map(|vnf| candidates(vnf, testbed)).collect();
    let start = topology.place(&service.robot)?;
    let mut best = None;
    for unit in units {
        topology.attach(&service.robot, unit);
        let mut at = vec![(start, 0)];
        for stage in &stages {
            let reached = topology.shortest(&at, Edge::delay_ns);
            at = stage.iter().filter_map(|&host| Some((host, reached[host]?))).collect();
        }
        let back = topology.shortest(&at, Edge::delay_ns)[start];
        topology.detach(&service.robot);
        best = best.into_iter().chain(back).min();
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
    testbed: &Testbed,
    topology: &mut Topology<'_>,
) -> f64 {
    // -ln in fixed point, so that products become sums of integers; rounded down, as befits an upper bound.
    const UNIT: f64 = 1e12;
    let cost = |reliability: f64| (-reliability.ln() * UNIT) as u64;
    units.iter().for_each(|unit| topology.attach(&service.robot, unit));
    let start = topology.place(&service.robot).expect("the builder found it");
    let reached = topology.shortest(&[(start, 0)], |edge| {
        edge.wired().map_or(0, |link| cost(testbed.graph.links[link].reliability))
    });
    topology.detach(&service.robot);
    let host = |i: usize| {
        let own = match &testbed.graph.nodes[i].kind {
            NodeKind::Server(server) => cost(server.reliability),
            _ => 0,
        };
        reached[i].map(|path| path + own)
    };
    let best = |vnf: &Vnf| candidates(vnf, testbed).into_iter().filter_map(host).min();
    let worst = service.vnfs.iter().filter_map(best).max().unwrap_or(0);
    (-(worst as f64) / UNIT).exp()
}
