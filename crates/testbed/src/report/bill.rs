//! The bill of a run: what VNFs took of servers and what crossed links, at the prices of the testbed file.
//!
//! A server is paid for the CPUs and the memory that VNFs reserve, used or not, from their placement to the run's end or
//! to the next placement, and for the CPU time that they use. `cost` of OKpi's objective is that of the reserved CPUs for one hour.

use std::{
    collections::BTreeMap,
    ops::{Add, AddAssign},
};

use cotorra_graph::{
    Accelerators, Direction, DomainId, Event, Instruction, LinkId, NodeId, NodeKind, Nodes, Program,
    ServiceId, Stamped, Testbed, Timestamp, Vnf, VnfId,
};
use serde::Serialize;

use super::{amount::amount, energy::EnergySummary};
use crate::computed::Computed;

const SECONDS_PER_HOUR: f64 = 3600.0;
const BYTES_PER_GB: f64 = 1e9;
const WATT_HOURS_PER_KWH: f64 = 1000.0;

/// Prices of what a run took, in the testbed's currency.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Bill {
    /// The currency, as the testbed file names it.
    pub currency: String,
    /// Everything.
    pub total_price: f64,
    /// What the VNFs of each service took, in the file's order.
    pub services: Vec<ServiceBill>,
    /// What VNFs that belong to no service took.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub without_service: Option<Taken>,
    /// What VNFs took of each server that has any, by name.
    pub servers: Vec<ServerBill>,
    /// Traffic of links that have a price, in the file's order.
    pub links: Vec<LinkBill>,
    /// Energy of servers and robots that has a price, in the file's order.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub energy: Vec<EnergyBill>,
    /// What each domain has to be paid for its servers, robots and links, in the file's order.
    pub domains: Vec<DomainBill>,
}

/// What the VNFs of a service took.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ServiceBill {
    pub service: ServiceId,
    /// The robot that it serves.
    pub robot: NodeId,
    #[serde(flatten)]
    pub taken: Taken,
}

/// What VNFs took of a server.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ServerBill {
    pub server: NodeId,
    #[serde(flatten)]
    pub taken: Taken,
}

/// Traffic of a link.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LinkBill {
    pub link: LinkId,
    /// Bytes that it delivered in both directions.
    pub bytes: u64,
    /// Their price.
    pub price: f64,
}

/// Energy of a server or a robot.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct EnergyBill {
    pub node: NodeId,
    pub energy_wh: f64,
    /// Its price.
    pub price: f64,
}

/// What a domain has to be paid.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DomainBill {
    pub domain: DomainId,
    pub price: f64,
}

/// What VNFs took of servers.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Taken {
    /// CPUs that were reserved, times hours.
    pub cpu_hours: f64,
    /// Their price.
    pub cpu_price: f64,
    /// CPU time that was used, in hours, where that has a price.
    #[serde(skip_serializing_if = "is_zero")]
    pub used_cpu_hours: f64,
    /// Its price.
    #[serde(skip_serializing_if = "is_zero")]
    pub used_cpu_price: f64,
    /// Accelerators that models took, by the share of their memory, times hours.
    #[serde(skip_serializing_if = "is_zero")]
    pub accelerator_hours: f64,
    /// Their price.
    #[serde(skip_serializing_if = "is_zero")]
    pub accelerator_price: f64,
    /// GB of memory that were reserved, times hours.
    pub memory_gb_hours: f64,
    /// Their price.
    pub memory_price: f64,
    /// Number of instances that came to a server after the start.
    pub migrations: usize,
    /// Their price.
    pub migration_price: f64,
    /// Price of all.
    pub price: f64,
}

fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

impl Add for Taken {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self {
            cpu_hours: self.cpu_hours + other.cpu_hours,
            cpu_price: self.cpu_price + other.cpu_price,
            used_cpu_hours: self.used_cpu_hours + other.used_cpu_hours,
            used_cpu_price: self.used_cpu_price + other.used_cpu_price,
            accelerator_hours: self.accelerator_hours + other.accelerator_hours,
            accelerator_price: self.accelerator_price + other.accelerator_price,
            memory_gb_hours: self.memory_gb_hours + other.memory_gb_hours,
            memory_price: self.memory_price + other.memory_price,
            migrations: self.migrations + other.migrations,
            migration_price: self.migration_price + other.migration_price,
            price: self.price + other.price,
        }
    }
}

impl AddAssign for Taken {
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl Bill {
    /// Returns the price of what the VNFs of a service took.
    pub(super) fn of(&self, service: &ServiceId) -> Option<f64> {
        let its = self.services.iter().find(|its| its.service == *service)?;
        Some(its.taken.price)
    }

    /// Describes it in one line, such as `0.27 EUR: CPUs 0.20, memory 0.01, migrations 0.05, links 0.01`.
    pub fn sentence(&self) -> String {
        let taken = self.servers.iter().fold(Taken::default(), |sum, its| sum + its.taken);
        let links: f64 = self.links.iter().map(|its| its.price).sum();
        let energy: f64 = self.energy.iter().map(|its| its.price).sum();
        let items = [
            ("CPUs", taken.cpu_price),
            ("CPU time", taken.used_cpu_price),
            ("accelerators", taken.accelerator_price),
            ("memory", taken.memory_price),
            ("migrations", taken.migration_price),
            ("links", links),
            ("energy", energy),
        ];
        let items = items.into_iter().filter(|(_, price)| *price > 0.0);
        let items: Vec<_> = items.map(|(what, price)| format!("{what} {}", amount(price))).collect();
        let of = if items.is_empty() { String::new() } else { format!(": {}", items.join(", ")) };
        format!("{} {}{of}", amount(self.total_price), self.currency)
    }
}

/// Prices of a server.
#[derive(Debug, Clone)]
struct Prices {
    domain: DomainId,
    cpu: f64,
    used_cpu: f64,
    accelerators: Option<Accelerators>,
    memory: f64,
    migration: f64,
}

/// Demand of a VNF.
#[derive(Debug, Clone)]
struct Demand {
    service: Option<ServiceId>,
    cpus: f64,
    memory_gb: f64,
    /// Bytes of memory of an accelerator.
    accelerator_bytes: u64,
}

/// A link that has a price.
#[derive(Debug, Clone)]
struct Priced {
    link: LinkId,
    domain: DomainId,
    cost: f64,
    /// Bytes so far, by direction.
    bytes: BTreeMap<Direction, u64>,
}

/// Collects what a run takes.
#[derive(Debug, Clone)]
pub(super) struct Billing {
    currency: String,
    domains: Vec<DomainId>,
    services: Vec<(ServiceId, NodeId)>,
    servers: BTreeMap<NodeId, Prices>,
    vnfs: BTreeMap<VnfId, Demand>,
    /// Nodes of each VNF, and since when.
    placed: BTreeMap<VnfId, (Timestamp, Nodes)>,
    taken: BTreeMap<(Option<ServiceId>, NodeId), Taken>,
    links: Vec<Priced>,
    /// Nodes whose energy has a price: the domain, and the price of a kWh.
    energy: BTreeMap<NodeId, (DomainId, f64)>,
}

impl Demand {
    fn of(service: Option<&ServiceId>, vnf: &Vnf) -> Self {
        let memory_gb = vnf.memory_bytes as f64 / BYTES_PER_GB;
        let accelerator_bytes = match &vnf.program {
            Program::PolicyServer(model) => model.accelerator_bytes,
            _ => 0,
        };
        Self { service: service.cloned(), cpus: vnf.cpus, memory_gb, accelerator_bytes }
    }
}

impl Billing {
    /// Returns the bill to keep for a testbed; `None` if it has no currency.
    pub(super) fn new(testbed: &Testbed) -> Option<Self> {
        let graph = &testbed.graph;
        let servers = graph.nodes.iter().filter_map(|node| {
            let NodeKind::Server(server) = &node.kind else { return None };
            let prices = Prices {
                domain: node.domain.clone(),
                cpu: server.cost,
                used_cpu: server.used_cost,
                accelerators: server.capacity.accelerators,
                memory: server.memory_cost,
                migration: server.migration_cost,
            };
            Some((node.id.clone(), prices))
        });
        let of_services = testbed.services.iter().flat_map(|service| {
            service.vnfs.iter().map(|vnf| (vnf.id.clone(), Demand::of(Some(&service.id), vnf)))
        });
        let hosts = testbed.containers.hosts.iter().map(|vnf| (vnf.id.clone(), Demand::of(None, vnf)));
        let links = graph.links.iter().filter(|link| link.cost > 0.0).filter_map(|link| {
            let domain = graph.node(&link.ends[0])?.domain.clone();
            Some(Priced { link: link.id.clone(), domain, cost: link.cost, bytes: BTreeMap::new() })
        });
        let energy = graph.nodes.iter().filter_map(|node| {
            let cost = match &node.kind {
                NodeKind::Server(server) => server.power.as_ref()?.energy_cost,
                NodeKind::Robot(robot) => robot.power.as_ref()?.energy_cost,
                _ => return None,
            };
            (cost > 0.0).then(|| (node.id.clone(), (node.domain.clone(), cost)))
        });
        Some(Self {
            currency: testbed.currency.clone()?,
            domains: graph.domains.clone(),
            services: testbed.services.iter().map(|its| (its.id.clone(), its.robot.clone())).collect(),
            servers: servers.collect(),
            vnfs: of_services.chain(hosts).collect(),
            placed: BTreeMap::new(),
            taken: BTreeMap::new(),
            links: links.collect(),
            energy: energy.collect(),
        })
    }

    /// Adds an event.
    pub(super) fn absorb(&mut self, Stamped { at, event }: &Stamped) {
        match event {
            Event::Placement(placement) => self.place(*at, &placement.vnf, Some(&placement.node)),
            Event::Decision(decision) if decision.refused.is_none() => match &decision.instruction {
                Instruction::AddVnf { vnf } => {
                    self.vnfs.entry(vnf.id.clone()).or_insert_with(|| Demand::of(None, vnf));
                }
                Instruction::RemoveVnf { vnf } => self.place(*at, vnf, None),
                _ => {}
            },
            Event::Link(context) => {
                let priced = self.links.iter_mut().find(|its| its.link == context.link);
                if let Some(priced) = priced {
                    priced.bytes.insert(context.direction, context.counters.bytes);
                }
            }
            _ => {}
        }
    }

    /// Moves a VNF to these nodes, or ends it.
    fn place(&mut self, at: Timestamp, vnf: &VnfId, nodes: Option<&Nodes>) {
        let before = self.placed.remove(vnf);
        if let Some((since, nodes)) = &before {
            let taken = self.reserved(vnf, nodes, *since, at);
            taken.into_iter().for_each(|(whose, taken)| *self.taken.entry(whose).or_default() += taken);
        }
        let Some(nodes) = nodes else { return };
        self.placed.insert(vnf.clone(), (at, nodes.clone()));
        let Some((_, before)) = before else { return };
        for node in nodes.all().iter().filter(|node| !before.all().contains(node)) {
            let (Some(prices), Some(demand)) = (self.servers.get(node), self.vnfs.get(vnf)) else { continue };
            let price = prices.migration;
            let moved = Taken { migrations: 1, migration_price: price, price, ..Taken::default() };
            *self.taken.entry((demand.service.clone(), node.clone())).or_default() += moved;
        }
    }

    /// Returns what a VNF reserved on these nodes over a time.
    fn reserved(
        &self,
        vnf: &VnfId,
        nodes: &Nodes,
        since: Timestamp,
        until: Timestamp,
    ) -> Vec<((Option<ServiceId>, NodeId), Taken)> {
        let Some(demand) = self.vnfs.get(vnf) else { return Vec::new() };
        let hours = until.since(since).as_secs_f64() / SECONDS_PER_HOUR;
        let on = |node: &NodeId| {
            let prices = self.servers.get(node)?;
            let (cpu_hours, memory_gb_hours) = (demand.cpus * hours, demand.memory_gb * hours);
            let (cpu_price, memory_price) = (cpu_hours * prices.cpu, memory_gb_hours * prices.memory);
            let (accelerator_hours, accelerator_price) = prices.accelerators.map_or((0.0, 0.0), |its| {
                let taken = demand.accelerator_bytes as f64 / its.memory_bytes as f64 * hours;
                (taken, taken * its.cost)
            });
            let taken = Taken {
                cpu_hours,
                cpu_price,
                accelerator_hours,
                accelerator_price,
                memory_gb_hours,
                memory_price,
                price: cpu_price + accelerator_price + memory_price,
                ..Taken::default()
            };
            Some(((demand.service.clone(), node.clone()), taken))
        };
        nodes.all().iter().filter_map(on).collect()
    }

    /// Returns the CPU time that a VNF used on a server, if that has a price.
    fn used(&self, computed: &Computed) -> Option<((Option<ServiceId>, NodeId), Taken)> {
        let cost = self.servers.get(&computed.node)?.used_cpu;
        let service = self.vnfs.get(&computed.vnf)?.service.clone();
        let used_cpu_hours = computed.load.cpu_time().as_secs_f64() / SECONDS_PER_HOUR;
        let price = used_cpu_hours * cost;
        let taken = Taken { used_cpu_hours, used_cpu_price: price, price, ..Taken::default() };
        (cost > 0.0).then(|| ((service, computed.node.clone()), taken))
    }

    /// Returns the bill of a run that ended at `end`, with what its VNFs computed and its energy.
    pub(super) fn bill(&self, end: Timestamp, computed: &[Computed], energy: Option<&EnergySummary>) -> Bill {
        let mut all = self.taken.clone();
        for (whose, used) in computed.iter().filter_map(|computed| self.used(computed)) {
            *all.entry(whose).or_default() += used;
        }
        for (vnf, (since, nodes)) in &self.placed {
            let taken = self.reserved(vnf, nodes, *since, end);
            taken.into_iter().for_each(|(whose, taken)| *all.entry(whose).or_default() += taken);
        }
        let sum = |is_its: &dyn Fn(&Option<ServiceId>, &NodeId) -> bool| {
            let its = all.iter().filter(|((service, node), _)| is_its(service, node));
            its.map(|(_, taken)| *taken).fold(Taken::default(), Add::add)
        };
        let service = |(service, robot): &(ServiceId, NodeId)| ServiceBill {
            service: service.clone(),
            robot: robot.clone(),
            taken: sum(&|its, _| its.as_ref() == Some(service)),
        };
        let server =
            |server: &NodeId| ServerBill { server: server.clone(), taken: sum(&|_, node| node == server) };
        let is_used = |server: &&NodeId| all.keys().any(|(_, node)| node == *server);
        let link = |priced: &Priced| {
            let bytes = priced.bytes.values().sum();
            LinkBill { link: priced.link.clone(), bytes, price: bytes as f64 / BYTES_PER_GB * priced.cost }
        };
        let links: Vec<_> = self.links.iter().map(link).collect();
        let servers: Vec<_> = self.servers.keys().filter(is_used).map(server).collect();
        let energy = energy.into_iter().flat_map(EnergySummary::nodes).filter_map(|(node, energy_wh)| {
            let (domain, cost) = self.energy.get(node)?;
            let price = energy_wh / WATT_HOURS_PER_KWH * cost;
            Some((domain, EnergyBill { node: node.clone(), energy_wh, price }))
        });
        let energy: Vec<_> = energy.collect();
        let domain = |domain: &DomainId| {
            let of_servers = servers.iter().filter(|its| self.servers[&its.server].domain == *domain);
            let of_links = self.links.iter().zip(&links).filter(|(priced, _)| priced.domain == *domain);
            let of_energy = energy.iter().filter(|(of, _)| *of == domain).map(|(_, its)| its.price);
            let of_links = of_links.map(|(_, its)| its.price).chain(of_energy);
            let price: f64 = of_servers.map(|its| its.taken.price).chain(of_links).sum();
            DomainBill { domain: domain.clone(), price }
        };
        let has_others = all.keys().any(|(service, _)| service.is_none());
        let others = links.iter().map(|its| its.price).chain(energy.iter().map(|(_, its)| its.price));
        Bill {
            currency: self.currency.clone(),
            total_price: sum(&|_, _| true).price + others.sum::<f64>(),
            services: self.services.iter().map(service).collect(),
            without_service: has_others.then(|| sum(&|service, _| service.is_none())),
            domains: self.domains.iter().map(domain).collect(),
            energy: energy.into_iter().map(|(_, its)| its).collect(),
            servers,
            links,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use cotorra_graph::Placement;

    use super::*;

    const LAB: &str = "name: lab
currency: EUR
domains: [factory, operator]
wireless: { w: {} }
nodes:
  r: { kind: robot }
  unit: { kind: radio_unit, position: [0, 2], channel: 1 }
  edge: { kind: server, tier: edge, cpus: 4, memory: 8 GB, cost: 3, memory_cost: 0.5, migration_cost: 0.25 }
  cloud: { kind: server, tier: cloud, domain: operator, cpus: 4, memory: 8 GB, cost: 1 }
links:
  - { ends: [unit, edge], delay: 1 ms }
  - { ends: [cloud, unit], delay: 1 ms, cost: 0.1 }
services:
  s:
    robot: r
    kpis: { service_time: 15 ms }
    vnfs:
      driver: { program: robot_driver, pinned_to: r }
      nav: { program: navigation, node: cloud, cpus: 2, memory: 1 GB }
walks: { r: { waypoints: [[0, 0], [5, 0]] } }
";

    fn billing() -> Billing {
        Billing::new(&cotorra_testbed_file::parse("lab.yaml", LAB, Path::new("")).unwrap()).unwrap()
    }

    fn hours(hours: f64) -> Timestamp {
        Timestamp::from_secs_f64(hours * SECONDS_PER_HOUR)
    }

    fn place(billing: &mut Billing, at: f64, node: &str) {
        let node: NodeId = node.parse().unwrap();
        let event = Event::Placement(Placement { vnf: "nav".parse().unwrap(), node: node.into() });
        billing.absorb(&Stamped { at: hours(at), event });
    }

    #[test]
    fn a_server_is_paid_from_each_placement_to_the_next_and_each_migration_once() {
        let mut billing = billing();
        place(&mut billing, 0.0, "cloud");
        place(&mut billing, 1.0, "edge");
        place(&mut billing, 3.0, "cloud");
        let bill = billing.bill(hours(7.0), &[], None);
        let [service] = &bill.services[..] else { panic!("{bill:?}") };
        // 2 CPUs for 5 h at 1 and for 2 h at 3; 1 GB for 2 h at 0.5.
        assert_eq!((service.taken.cpu_hours, service.taken.cpu_price), (14.0, 22.0));
        assert_eq!((service.taken.memory_gb_hours, service.taken.memory_price), (7.0, 1.0));
        assert_eq!((service.taken.migrations, service.taken.migration_price), (2, 0.25));
        assert_eq!((service.taken.price, bill.total_price), (23.25, 23.25));
        let servers: Vec<_> = bill.servers.iter().map(|its| (its.server.as_str(), its.taken.price)).collect();
        assert_eq!(servers, [("cloud", 10.0), ("edge", 13.25)]);
        let domains: Vec<_> = bill.domains.iter().map(|its| (its.domain.as_str(), its.price)).collect();
        assert_eq!(domains, [("factory", 13.25), ("operator", 10.0)]);
        assert_eq!(bill.sentence(), "23.25 EUR: CPUs 22.00, memory 1.00, migrations 0.25");
    }

    #[test]
    fn a_model_pays_for_the_share_of_an_accelerators_memory_that_it_takes() {
        let text = LAB
            .replace(
                "memory: 8 GB, cost: 1 }",
                "memory: 8 GB, accelerators: { count: 2, memory: 40 GB, cost: 2 } }",
            )
            .replace(
                "nav: { program: navigation, node: cloud",
                "nav: { program: policy_server, inference: { model: pi0 }, node: cloud",
            )
            .replace("      driver: { program: robot_driver, pinned_to: r }\n", "")
            .replace("    robot: r\n", "    robot: r\n    policy: { server: nav }\n");
        let testbed = cotorra_testbed_file::parse("lab.yaml", &text, Path::new("")).unwrap();
        let mut billing = Billing::new(&testbed).unwrap();
        place(&mut billing, 0.0, "cloud");
        let bill = billing.bill(hours(3.0), &[], None);
        // 8 of 40 GB for three hours, and two CPUs.
        let taken = bill.services[0].taken;
        assert_eq!((taken.accelerator_hours, taken.accelerator_price), (0.2 * 3.0, 0.2 * 3.0 * 2.0));
        assert_eq!(bill.sentence(), "7.20 EUR: CPUs 6.00, accelerators 1.20");
    }

    #[test]
    fn links_are_paid_by_the_bytes_of_both_directions() {
        let mut billing = billing();
        let testbed = cotorra_testbed_file::parse("lab.yaml", LAB, Path::new("")).unwrap();
        let link = testbed.graph.links[1].id.clone();
        for (direction, bytes) in [(Direction::Forward, 1), (Direction::Backward, 3), (Direction::Forward, 2)]
        {
            let mut context = cotorra_graph_testing::link_context(link.as_str());
            context.direction = direction;
            context.counters.bytes = bytes * 1_000_000_000;
            billing.absorb(&Stamped { at: hours(0.0), event: Event::Link(context) });
        }
        let bill = billing.bill(hours(1.0), &[], None);
        let [its] = &bill.links[..] else { panic!("{bill:?}") };
        assert_eq!((its.bytes, its.price, bill.total_price), (5_000_000_000, 0.5, 0.5));
        assert_eq!(bill.domains[1].price, 0.5, "the link's first end is the operator's");
    }

    #[test]
    fn a_testbed_without_a_currency_has_no_bill() {
        let text = LAB.replace("currency: EUR\n", "");
        let testbed = cotorra_testbed_file::parse("lab.yaml", &text, Path::new("")).unwrap();
        assert!(Billing::new(&testbed).is_none());
    }
}
