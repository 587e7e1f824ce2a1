//! What the plug-in knows of the testbed now, kept up with its events, as the infrastructure that a service sees.

use std::{collections::BTreeMap, time::Duration};

use cotorra_graph::{
    Conditions, Direction, Event, HardwareGraph, LinkId, NodeId, NodeKind, Rate, Service, Testbed, Trace,
    VnfId,
};

use crate::model::{self, Infrastructure, Queue};

/// Delay one way, and rate in bit/s.
type Carriage = (Duration, f64);

/// The testbed as events tell it.
#[derive(Debug)]
pub(crate) struct Now {
    pub(crate) graph: HardwareGraph,
    services: Vec<Service>,
    /// a(n).
    placements: BTreeMap<VnfId, NodeId>,
    /// a(n1,n2).
    mappings: BTreeMap<(VnfId, VnfId), Vec<LinkId>>,
    /// What the directions of links do.
    carriage: BTreeMap<(LinkId, Direction), Carriage>,
}

impl Now {
    pub(crate) fn new(testbed: &Testbed) -> Self {
        let links = testbed.graph.links.iter();
        let carriage = links.flat_map(|link| {
            [(Direction::Forward, &link.forward), (Direction::Backward, &link.backward)]
                .map(|(direction, conditions)| ((link.id.clone(), direction), carriage(conditions)))
        });
        let vnfs = testbed.services.iter().flat_map(|service| &service.vnfs);
        Self {
            carriage: carriage.collect(),
            placements: vnfs.map(|vnf| (vnf.id.clone(), vnf.node.clone())).collect(),
            mappings: BTreeMap::new(),
            graph: testbed.graph.clone(),
            services: testbed.services.clone(),
        }
    }

    /// Learns from an event; whether that can change decisions of a service that it is not about.
    pub(crate) fn learn(&mut self, event: &Event) -> bool {
        match event {
            Event::Link(context) => {
                let now = carriage(&context.effective);
                let wired = self.graph.link(&context.link).is_some();
                let key = (context.link.clone(), context.direction);
                wired && self.carriage.insert(key, now) != Some(now)
            }
            Event::Placement(placement) => {
                let before = self.placements.insert(placement.vnf.clone(), placement.node.clone());
                before.as_ref() != Some(&placement.node)
            }
            Event::VirtualLink(mapping) => {
                let key = (mapping.from.clone(), mapping.to.clone());
                self.mappings.insert(key, mapping.links.clone()).as_ref() != Some(&mapping.links)
            }
            _ => false,
        }
    }

    /// Where a VNF runs.
    pub(crate) fn node_of(&self, vnf: &VnfId) -> Option<&NodeId> {
        self.placements.get(vnf)
    }

    /// What a service can use: all that no other service takes, with these radio units in the robot's reach.
    pub(crate) fn infrastructure(&self, service: &Service, units: &[NodeId]) -> Infrastructure {
        let place: BTreeMap<_, _> =
            self.graph.nodes.iter().enumerate().map(|(i, node)| (&node.id, i)).collect();
        let mut nodes: Vec<_> = self.graph.nodes.iter().map(node).collect();
        let mut taken: BTreeMap<&LinkId, f64> = BTreeMap::new();
        for other in self.services.iter().filter(|other| other.id != service.id) {
            for vnf in &other.vnfs {
                if let Some(&at) = self.node_of(&vnf.id).and_then(|node| place.get(node)) {
                    nodes[at].cpus -= vnf.cpus;
                    nodes[at].memory_bytes = nodes[at].memory_bytes.saturating_sub(vnf.memory_bytes);
                }
            }
            for link in &other.virtual_links {
                for carrier in self.mappings.get(&(link.from.clone(), link.to.clone())).into_iter().flatten()
                {
                    *taken.entry(carrier).or_default() += link.rate.bits_per_second() as f64;
                }
            }
        }
        let wireless = self.graph.node(&service.robot).and_then(|node| match &node.kind {
            NodeKind::Robot(robot) => self.graph.wireless.get(&robot.network),
            _ => None,
        });
        let rate = wireless
            .and_then(|network| network.rate)
            .map_or(f64::INFINITY, |rate| rate.bits_per_second() as f64);
        let radio =
            wireless.filter(|network| service.kpis.radio.is_none_or(|radio| radio == network.standard));
        let attachments = radio.into_iter().flat_map(|network| units.iter().map(move |unit| (network, unit)));
        let attachments = attachments.filter_map(|(network, unit)| {
            Some(model::Link {
                id: LinkId::wireless(&service.robot, unit),
                ends: [*place.get(&service.robot)?, *place.get(unit)?],
                round_trip: 2 * network.delay,
                free_bps: rate,
                reliability: 1.0,
                wireless: true,
            })
        });
        let wired = self.graph.links.iter().map(|link| {
            let [there, back] = [Direction::Forward, Direction::Backward].map(|direction| {
                self.carriage.get(&(link.id.clone(), direction)).copied().unwrap_or_default()
            });
            let taken = taken.get(&link.id).copied().unwrap_or(0.0);
            model::Link {
                id: link.id.clone(),
                ends: link.ends.each_ref().map(|end| place[end]),
                round_trip: there.0 + back.0,
                free_bps: there.1.min(back.1).min(link.medium.bits_per_second() as f64) - taken,
                reliability: link.reliability,
                wireless: false,
            }
        });
        Infrastructure { nodes, links: attachments.chain(wired).collect() }
    }

    /// A service as the decision takes it. A VNF that is not pinned can go to any server; a virtual link between VNFs
    /// that do not follow each other takes its rate of every hop between.
    pub(crate) fn service(&self, service: &Service, processing: &BTreeMap<VnfId, Queue>) -> model::Service {
        let order = |id: &VnfId| service.vnfs.iter().position(|vnf| vnf.id == *id);
        let rate_before = |i: usize| {
            let crosses = |link: &&cotorra_graph::VirtualLink| match (order(&link.from), order(&link.to)) {
                (Some(from), Some(to)) => from.min(to) < i && i <= from.max(to),
                _ => false,
            };
            let links = service.virtual_links.iter().filter(crosses);
            links.map(|link| link.rate.bits_per_second() as f64).sum()
        };
        let hosts = |pinned: Option<&NodeId>| {
            let can = |node: &cotorra_graph::Node| match pinned {
                Some(pinned) => node.id == *pinned,
                None => matches!(node.kind, NodeKind::Server(_)),
            };
            self.graph.nodes.iter().enumerate().filter(|(_, node)| can(node)).map(|(i, _)| i).collect()
        };
        let vnf = |(i, vnf): (usize, &cotorra_graph::Vnf)| model::Vnf {
            id: vnf.id.clone(),
            cpus: vnf.cpus,
            memory_bytes: vnf.memory_bytes,
            hosts: hosts(vnf.pinned_to.as_ref()),
            rate_bps: rate_before(i),
            processing: processing.get(&vnf.id).copied(),
        };
        model::Service {
            vnfs: service.vnfs.iter().enumerate().map(vnf).collect(),
            service_time: service.kpis.service_time,
            reliability: service.kpis.reliability,
        }
    }

    pub(crate) fn services(&self) -> &[Service] {
        &self.services
    }
}

fn node(node: &cotorra_graph::Node) -> model::Node {
    let (cost, reliability) = match &node.kind {
        NodeKind::Server(server) => (server.cost, server.reliability),
        _ => (0.0, 1.0),
    };
    let (cpus, memory_bytes) = node.capacity().map_or((0.0, 0), |free| (free.cpus, free.memory_bytes));
    model::Node { id: node.id.clone(), cpus, memory_bytes, cost, reliability, forwards: node.forwards() }
}

fn carriage(conditions: &Conditions) -> Carriage {
    let rate = match &conditions.rate {
        Rate::Unlimited => f64::INFINITY,
        Rate::Fixed { bits_per_second } => bits_per_second.bits_per_second() as f64,
        Rate::Trace { trace } => {
            let opportunities = trace.opportunities_ms();
            let seconds = opportunities.last().map_or(0.0, |&end| end as f64 / 1e3);
            (opportunities.len() * Trace::BYTES * 8) as f64 / seconds
        }
    };
    (conditions.delay, rate)
}
