//! Servers and links that a service uses: their reliability and cost.

use std::{
    collections::{BTreeMap, BTreeSet},
    sync::Arc,
};

use cotorra_graph::{
    Event, HardwareGraph, LinkId, NodeId, NodeKind, Nodes, Service, Total, VirtualLinkMapping, VnfId,
};

/// Parts that a service uses over a run, for the bounds on it.
#[derive(Debug)]
pub(super) struct InUse {
    graph: Arc<HardwareGraph>,
    service: Service,
    placed: BTreeMap<VnfId, Nodes>,
    /// Links of the virtual links, by their ends.
    mapped: BTreeMap<(VnfId, VnfId), BTreeSet<LinkId>>,
    /// Attachment of the last evaluated sample; `None` if anything changed since.
    evaluated: Option<Option<NodeId>>,
    /// The least.
    reliability: Option<f64>,
    /// The highest.
    cost: Option<f64>,
}

impl InUse {
    pub(super) fn new(graph: Arc<HardwareGraph>, service: &Service) -> Self {
        Self {
            graph,
            service: service.clone(),
            placed: BTreeMap::new(),
            mapped: BTreeMap::new(),
            evaluated: None,
            reliability: None,
            cost: None,
        }
    }

    pub(super) fn absorb(&mut self, event: &Event) {
        let has = |service: &Service, vnf: &VnfId| service.vnfs.iter().any(|its| its.id == *vnf);
        match event {
            Event::Placement(placement) if has(&self.service, &placement.vnf) => {
                self.placed.insert(placement.vnf.clone(), placement.node.clone());
                self.evaluated = None;
            }
            Event::VirtualLink(mapping) if has(&self.service, &mapping.from) => {
                let VirtualLinkMapping { from, to, links, others, .. } = mapping;
                let links = links.iter().chain(others.iter().flat_map(|path| &path.links)).cloned().collect();
                self.mapped.insert((from.clone(), to.clone()), links);
                self.evaluated = None;
            }
            Event::ServiceTime(sample)
                if sample.service == self.service.id
                    && self.evaluated.as_ref() != Some(&sample.attachment) =>
            {
                self.evaluate(sample.attachment.as_ref());
                self.evaluated = Some(sample.attachment.clone());
            }
            _ => {}
        }
    }

    /// Returns the figure over all samples so far; `None` for other figures, and without samples.
    pub(super) fn of(&self, total: Total) -> Option<f64> {
        match total {
            Total::Reliability => self.reliability,
            Total::Cost => self.cost,
            _ => None,
        }
    }

    fn evaluate(&mut self, attachment: Option<&NodeId>) {
        let hosts = |vnf: &VnfId| self.placed.get(vnf).map_or(&[][..], Nodes::all);
        let server = |node: &NodeId| match &self.graph.node(node)?.kind {
            NodeKind::Server(server) => Some(server),
            _ => None,
        };
        let taken =
            self.service.vnfs.iter().flat_map(|vnf| hosts(&vnf.id).iter().map(|node| (vnf.cpus, node)));
        let cost: f64 = taken.clone().filter_map(|(cpus, node)| Some(cpus * server(node)?.cost)).sum();
        // A part that is used twice counts once: it works or it does not.
        let servers: BTreeSet<_> = taken.map(|(_, node)| node).collect();
        let servers = servers.into_iter().filter_map(|node| Some(server(node)?.reliability));
        let links = self.links(attachment);
        let links = self.graph.links.iter().filter(|link| links.contains(&link.id));
        let reliability: f64 = servers.chain(links.map(|link| link.reliability)).product();
        self.cost = Some(self.cost.map_or(cost, |before| before.max(cost)));
        self.reliability = Some(self.reliability.map_or(reliability, |before| before.min(reliability)));
    }

    /// Returns the links of the virtual links; without any, those from the robot through the VNFs, in order, and back.
    fn links(&self, attachment: Option<&NodeId>) -> BTreeSet<LinkId> {
        if !self.mapped.is_empty() {
            return self.mapped.values().flatten().cloned().collect();
        }
        let robot = [self.service.robot.clone()];
        let hosts = self.service.vnfs.iter().filter_map(|vnf| Some(self.placed.get(&vnf.id)?.all()));
        let stops: Vec<&[NodeId]> = [&robot[..]].into_iter().chain(hosts).chain([&robot[..]]).collect();
        let pairs = stops.windows(2).flat_map(|ends| {
            let [from, to] = [ends[0], ends[1]];
            from.iter().flat_map(move |from| to.iter().map(move |to| (from, to)))
        });
        let attached = |robot: &NodeId| attachment.filter(|_| *robot == self.service.robot);
        let routes = pairs.filter_map(|(from, to)| self.graph.route(from, to, attached));
        routes.flat_map(|route| route.links).collect()
    }
}

#[cfg(test)]
mod tests {
    use std::{path::Path, time::Duration};

    use cotorra_graph::{Placement, ServiceTime, Timestamp};

    use super::*;

    const LAB: &str = "name: lab
wireless: { w: {} }
nodes:
  r: { kind: robot }
  A: { kind: radio_unit, position: [0, 2], channel: 1 }
  B: { kind: radio_unit, position: [9, 2], channel: 6 }
  edge: { kind: server, tier: edge, cpus: 4, memory: 8 GB, cost: 3, reliability: 90 % }
links:
  - { ends: [A, edge], delay: 1 ms, reliability: 50 % }
  - { ends: [B, edge], delay: 1 ms }
services:
  s:
    robot: r
    kpis: { service_time: 15 ms, require: [cost <= 6] }
    vnfs:
      driver: { program: robot_driver, pinned_to: r }
      nav: { program: navigation, node: edge, cpus: 2 }
walks: { r: { waypoints: [[0, 0], [5, 0]] } }
";

    #[test]
    fn the_worst_of_all_samples_counts_and_what_is_used_twice_counts_once() {
        let testbed = cotorra_testbed_file::parse("lab.yaml", LAB, Path::new("")).unwrap();
        let mut in_use = InUse::new(Arc::new(testbed.graph.clone()), &testbed.services[0]);
        let id = |name: &str| name.parse::<NodeId>().unwrap();
        for (vnf, node) in [("driver", "r"), ("nav", "edge")] {
            let placement = Placement { vnf: vnf.parse().unwrap(), node: id(node).into() };
            in_use.absorb(&Event::Placement(placement));
        }
        assert_eq!((in_use.of(Total::Reliability), in_use.of(Total::Cost)), (None, None));
        let mut sample = |unit: &str| {
            in_use.absorb(&Event::ServiceTime(ServiceTime {
                service: "s".parse().unwrap(),
                robot: id("r"),
                sequence: 1,
                emitted: Timestamp::ZERO,
                took: Some(Duration::from_millis(5)),
                attachment: Some(id(unit)),
                server: id("edge"),
                parts: None,
                lost_at: None,
            }));
            (in_use.of(Total::Reliability).unwrap(), in_use.of(Total::Cost).unwrap())
        };
        assert_eq!(sample("B"), (0.9, 6.0));
        assert_eq!(sample("A"), (0.45, 6.0));
        assert_eq!(sample("B"), (0.45, 6.0), "the least of all samples");
    }
}
